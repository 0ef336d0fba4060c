"""Capture from a PortAudio device that may be unplugged and plugged in again."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from av_audio.device_process import HEADER, READY
from av_audio.ring_buffer import RingBuffer
from av_common.clock import SenderClock

# A device without a block for this long is considered lost: 45 blocks. It is opened again at this interval, and must then
# answer: Python, PortAudio and a sound server start within seconds on a small computer.
LOST_AFTER_S = 1.5
RETRY_S = 1.0
OPEN_WITHIN_S = 15.0
# The first blocks arrive in bursts and hold the transients of the converter: they initialise the clock only.
WARM_UP_S = 0.5
LONGEST_LOSS_S = 86_400.0    # a longer one is a step of the system's clock
# The first blocks may be late by this, and the rate off by 2 %, of which the clock lags by a second.
EARLY_S = 0.1


class DeviceSource:
    """Captures into a ring buffer; the same interface as FileSource.

    A separate process captures (see device_process). A thread reads its blocks, records the times of their arrival, and
    restarts the process when no blocks arrive. Lost samples appear as a gap of the sample index.

    Attributes:
        clock: dates blocks, whose stamps are their numbers of samples over the sample rate.

    Parameters:
        device: name, part of a name or index of the device; empty for the system's default.
        sample_rate (Hz): sample rate to capture with.
        channels: channels of the device in the order of the microphones; empty for 0 and 1.
        block_samples: samples per block.
        now: clock of the stamps, in s.
    """

    def __init__(self, device: str, sample_rate: int, channels: Sequence[int] = (0, 1), block_samples: int = 1600,
                 now: Callable[[], float] = time.time) -> None:
        picked = list(channels) or [0, 1]
        self._command = [sys.executable, '-m', 'av_audio.device_process', device, str(sample_rate), str(block_samples),
                         *map(str, picked)]
        self._block_bytes = HEADER.size + 4 * block_samples * len(picked)
        self._now = now
        self.sample_rate = sample_rate
        self.channels = len(picked)
        self.finished = False
        self.clock = SenderClock(early=EARLY_S)
        self._settled: tuple[float, float] | None = None    # time of a sample, and the clock's offset then (s)
        self.overflows = 0
        self.reopened = 0
        self.lost = False
        self._next_sample = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, buffer: RingBuffer) -> None:
        """Open the device and start to write. Raises ValueError with the reason and, where known, what the device supports."""
        self._buffer = buffer
        self._stop.clear()
        self._process = self._open()
        self.lost = self._next_sample > 0  # what it missed while it was stopped
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close the device. `start` may be called again."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            self._end_process()

    def close(self) -> None:
        """Part of the interface; `stop` has closed everything."""

    def time_of(self, sample: int) -> float:
        """Capture time in s of a sample, on the clock `now`."""
        return sample / self.sample_rate + self.clock.offset

    @property
    def ppm(self) -> float:
        """Amount in parts per million by which the device's clock is slower than nominal, on average since it settled."""
        if self._settled is None:
            return 0.0
        since, offset = self._settled
        return 1e6 * (self.clock.offset - offset) / max(self._next_sample / self.sample_rate - since, 1.0)

    def _open(self) -> subprocess.Popen:
        with tempfile.TemporaryFile() as words:  # a pipe that nobody reads would stop the process once ALSA has filled it
            process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=words, bufsize=0)
            if self._read(process, len(READY), OPEN_WITHIN_S) == READY:
                return process
            process.kill()
            process.communicate()
            words.seek(0)
            # ALSA prints warnings of its own; the reason is the last line
            reason = words.read().decode(errors='replace').strip().splitlines() or ['the device does not answer']
        raise ValueError(reason[-1])

    def _run(self) -> None:
        while not self._stop.is_set():
            block = self._read(self._process, self._block_bytes, LOST_AFTER_S)
            if block:
                self._take(block)
            elif not self._stop.is_set():
                self._reopen()

    def _read(self, process: subprocess.Popen, count: int, timeout_s: float) -> bytes:
        """`count` bytes from the process; none when it ended, did not send for `timeout_s`, or `stop` was called."""
        assert process.stdout is not None  # a pipe, see _open
        pipe = process.stdout.fileno()
        data = bytearray()
        end = time.monotonic() + timeout_s
        while len(data) < count:
            if self._stop.is_set() or time.monotonic() > end:
                return b''
            if select.select([pipe], [], [], 0.1)[0]:
                received = os.read(pipe, count - len(data))
                if not received:
                    return b''
                data += received
        return bytes(data)

    def _take(self, block: bytes) -> None:
        age, overflowed = HEADER.unpack_from(block)
        samples = np.frombuffer(block, np.float32, offset=HEADER.size).reshape(-1, self.channels)
        begin = self._now() - age
        self.overflows += overflowed
        if (overflowed or self.lost) and self._next_sample:
            missing = min(begin - self.time_of(self._next_sample), LONGEST_LOSS_S)  # NaN where no block was dated yet
            self._next_sample += round(missing * self.sample_rate) if missing > 0.0 else 0
        self.lost = False
        stamp, restarts = self._next_sample / self.sample_rate, self.clock.restarts
        is_dated = self.clock.date(stamp, begin) is not None
        if self.clock.settled and (self._settled is None or self.clock.restarts > restarts):
            self._settled = stamp, self.clock.offset
        if is_dated and stamp >= WARM_UP_S:
            self._buffer.write(samples, self._next_sample)
        self._next_sample += len(samples)

    def _reopen(self) -> None:
        self.lost = True
        self._end_process()
        while not self._stop.wait(RETRY_S):
            try:
                self._process = self._open()
                self.reopened += 1
                return
            except (ValueError, OSError):  # OSError: no memory for a process, or too many open files
                continue

    def _end_process(self) -> None:
        """End the process, also one that has been ended: after a device was lost, `stop` does so again."""
        with self._process:
            self._process.kill()
