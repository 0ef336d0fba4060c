"""Decoding of audio datagrams to consecutive numbered blocks: order, loss and alignment of the channels.

Datagrams with a header have sequence numbers, which determine loss and order exactly. Without a header, loss is inferred
from arrival times. A datagram can be late but never early; after a loss, every later datagram lags by the lost duration.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from av_sim_bridge.wire.audio import HEADER_BYTES, AudioFormat, AudioHeader, decode_header
from av_sim_bridge.wire.error import WireError


@dataclass(frozen=True)
class AudioBlock:
    """Consecutive samples of a stream.

    Parameters:
        first_sample: index of the first sample since the start of the stream; lost samples are counted.
        samples (n, channels): samples in the type of the datagrams.
        arrival (s): time of reception of the last sample.
        time (s): capture time of the first sample, None if it is not given by the datagram.
    """

    first_sample: int
    samples: np.ndarray
    arrival: float
    time: float | None = None


@dataclass
class AudioCounts:
    """Numbers of datagrams lost and out of order, of frames lost, and of restarts of the stream."""

    lost: int = 0
    lost_frames: int = 0
    reordered: int = 0
    restarts: int = 0


class AudioDecoder:
    """Decoder of streams with and without headers; a header is recognised by its magic number.

    Parameters:
        layout: format of the samples.
    """

    def __init__(self, layout: AudioFormat):
        self.layout = layout
        self.counts = AudioCounts()
        self._stream: _NumberedStream | _BareStream | None = None
        self._first_sample = 0

    def decode(self, datagram: bytes, arrival: float, time: float | None = None) -> list[AudioBlock]:
        """Blocks that are complete after this datagram, in order. Raises WireError for an unusable datagram.

        Parameters:
            datagram: content of the datagram.
            arrival (s): time of reception on the system's clock.
            time (s): capture time of the first sample of a datagram with a header.
        """
        if not datagram:
            raise WireError('audio: empty datagram')
        header = decode_header(self.layout, datagram)
        if header is not None:
            if not isinstance(self._stream, _NumberedStream):
                self.restart()
                self._stream = _NumberedStream(self.layout, self.counts, self._first_sample)
            return self._stream.decode(header, datagram, arrival, time)
        if not isinstance(self._stream, _BareStream):
            if self._stream is not None and self._stream.alive(arrival):
                raise WireError('audio: header missing in a stream that has one')
            self.restart()
            self._stream = _BareStream(self.layout, self.counts, self._first_sample)
        return self._stream.decode(datagram, arrival)

    def restart(self) -> None:
        """End the stream. The next datagram starts a new stream that continues the numbers of the samples."""
        if self._stream is not None:
            self._first_sample = self._stream.next_sample
            self._stream = None
            self.counts.restarts += 1


class _NumberedStream:
    """A stream with sequence numbers. A missing datagram counts as lost after `PATIENCE` later ones."""

    PATIENCE = 2
    SILENCE = 1.0      # s without a datagram after which a stream without headers may replace this one
    RESTART = 64       # a backward step of the sequence number by this or more starts a new stream
    MOST_LOST = 1000   # as does a larger forward step, and one back to 0 by more than PATIENCE

    def __init__(self, layout: AudioFormat, counts: AudioCounts, next_sample: int):
        self.layout, self.counts, self.next_sample = layout, counts, next_sample
        self._expected = -1    # sequence number of the next datagram, -1 before the first
        self._early: dict[int, AudioBlock] = {}
        self._last_arrival = -np.inf

    def alive(self, arrival: float) -> bool:
        return arrival - self._last_arrival < self.SILENCE

    def decode(self, header: AudioHeader, datagram: bytes, arrival: float, time: float | None) -> list[AudioBlock]:
        samples = self.layout.decode(datagram[HEADER_BYTES:])
        self._last_arrival = arrival
        if self._expected < 0:
            self._expected = header.sequence
        elif not 0 <= header.sequence - self._expected <= self.MOST_LOST:
            if 0 < self._expected - header.sequence < (self.RESTART if header.sequence > 0 else self.PATIENCE + 1):
                self.counts.reordered += 1     # already counted as lost, or a duplicate
                return []
            self.counts.restarts += 1
            self._early.clear()
            self._expected = header.sequence
        self.counts.reordered += any(sequence > header.sequence for sequence in self._early)
        self._early[header.sequence] = AudioBlock(0, samples, arrival, time)
        blocks = self._in_order()
        if len(self._early) > self.PATIENCE:
            missing = min(self._early) - self._expected
            frames = missing * len(samples)
            self.counts.lost += missing
            self.counts.lost_frames += frames
            self.next_sample += frames
            self._expected += missing
            blocks += self._in_order()
        return blocks

    def _in_order(self) -> list[AudioBlock]:
        blocks = []
        while (block := self._early.pop(self._expected, None)) is not None:
            blocks.append(AudioBlock(self.next_sample, block.samples, block.arrival, block.time))
            self.next_sample += len(block.samples)
            self._expected += 1
        return blocks


class _BareStream:
    """A stream without headers, split into datagrams at any byte. Positions are counted in bytes to keep the alignment.

    Bytes count as lost if every datagram of the last `WINDOW` seconds lags by about the same time. This lag must exceed
    half a datagram, since a datagram that is only delayed catches up. It tells how many bytes are lost to within the jitter of
    arrivals; exact is that they are a multiple of what all lengths are multiples of: a datagram, or a frame at least. In the
    meantime datagrams of whole frames are passed on, because only their numbers can be too low. Others are held back, because
    they could swap the channels. A datagram that arrives early is refused as foreign, unless an earlier loss was assumed by
    mistake: then the position returns.
    """

    WINDOW = 1.0       # s
    FEWEST = 8         # minimum number of datagrams in the window for a decision
    SETTLING = 30      # number of datagrams after which the earliest arrival counts as known
    MOST_EARLY = 15    # consecutive early datagrams after which a jump of the clock is assumed
    DRIFT = 200e-6     # maximum relative error of the sender's clock
    MOST_KEPT = 500    # datagrams that are held back, and lags that are kept, however small and many the datagrams are

    def __init__(self, layout: AudioFormat, counts: AudioCounts, next_sample: int):
        self.layout, self.counts = layout, counts
        self._rate = layout.frame_bytes * layout.sample_rate   # bytes per second
        self._position = next_sample * layout.frame_bytes      # position of the next byte to be released
        self._partial = b''
        self._held: list[tuple[bytes, float]] = []
        self._recent: deque[tuple[float, float]] = deque(maxlen=self.MOST_KEPT)    # arrival and lag
        self._offset: float | None = None                      # smallest arrival - position / rate
        self._updated = 0.0
        self._length = 0.0                                     # mean length of a datagram, bytes
        self._unit = 0                                         # greatest common divisor of all lengths, bytes
        self._taken = self._early = 0
        self._doubtful = self._skipped = 0                     # datagrams, and bytes, assumed lost
        self._shifted = False                                  # whether the next byte may be within a frame that is not kept

    @property
    def next_sample(self) -> int:
        return self._position // self.layout.frame_bytes

    def decode(self, datagram: bytes, arrival: float) -> list[AudioBlock]:
        self._length += (len(datagram) - self._length) / min(self._taken + 1, 32)
        self._unit = math.gcd(self._unit, len(datagram))
        half = self._length / self._rate / 2
        lag = self._lag(datagram, arrival, half)
        self._held.append((datagram, arrival))
        self._taken += 1
        self._recent.append((arrival, lag))
        while self._recent[0][0] < arrival - self.WINDOW:
            self._recent.popleft()
        missing = self._missing(half)
        whole = not self._partial and all(len(held) % self.layout.frame_bytes == 0 for held, _ in self._held)
        if lag > half and not missing and not whole and len(self._held) < self.MOST_KEPT:
            return []
        return self._release(missing)

    def _lag(self, datagram: bytes, arrival: float, half: float) -> float:
        """Delay (s) of a datagram's last byte relative to the earliest arrivals."""
        end = self._position + sum(len(held) for held, _ in self._held) + len(datagram)
        offset = arrival - end / self._rate
        if self._offset is not None:
            earliest = self._offset + self.DRIFT * max(arrival - self._updated, 0.0)
            if offset < earliest - half and self._taken > self.SETTLING:
                offset += self._judge_early(round((earliest - offset) / (2 * half)))
            self._offset = min(earliest, offset)
        else:
            self._offset = offset
        self._early = 0
        self._updated = arrival
        return offset - self._offset

    def _judge_early(self, datagrams: int) -> float:
        """Take datagrams back that were assumed lost if that explains the early arrival; returns their duration (s).

        Raises WireError otherwise, and returns 0 once the clock seems to have jumped.
        """
        if datagrams <= self._doubtful:
            back = self._skipped if datagrams == self._doubtful else min(self._whole(datagrams * self._length), self._skipped)
            self._shift(-datagrams, -back)
            return back / self._rate
        self._early += 1
        if self._early < self.MOST_EARLY:
            raise WireError('audio: a datagram arrived before its samples can have been captured')
        self.counts.restarts += 1
        self._taken = 0
        return 0.0

    def _whole(self, count: float) -> int:
        """The number of bytes nearest to `count` that datagrams can have."""
        return self._unit * round(count / self._unit)

    def _missing(self, half: float) -> float:
        """Lag (s) common to all datagrams of the window, 0 if there is none or it still changes."""
        if len(self._recent) < self.FEWEST or self._recent[-1][0] - self._recent[0][0] < 0.8 * self.WINDOW:
            return 0.0
        lags = [lag for _, lag in self._recent]
        middle = len(lags) // 2
        before, after = min(lags[:middle]), min(lags[middle:])
        return after if min(before, after) > half > abs(after - before) else 0.0

    def _release(self, missing: float) -> list[AudioBlock]:
        held, self._held = self._held, []
        lost, late, begin = np.zeros(len(held), int), np.zeros(len(held)), self._skipped
        if missing:
            # The loss is the smallest lag of all following datagrams, rounded to datagrams to find where it is.
            ends = self._position + np.cumsum([len(datagram) for datagram, _ in held])
            lags = np.array([arrival for _, arrival in held]) - ends / self._rate - (self._offset or 0.0)
            late = np.minimum.accumulate(lags[::-1])[::-1].clip(0.0, missing) * self._rate
            lost = np.rint(late / self._length).astype(int)
            self._recent.clear()
        blocks, refused = [], None
        for (datagram, arrival), new, missed in zip(held, np.diff(lost, prepend=0), late, strict=True):
            if new > 0:
                self._shift(int(new), self._whole(missed) - (self._skipped - begin))
            if self._shifted:
                datagram = self._from_next_frame(datagram)
            data = self._partial + datagram
            first = (self._position - len(self._partial)) // self.layout.frame_bytes
            self._position += len(datagram)
            whole = len(data) - len(data) % self.layout.frame_bytes
            self._partial = data[whole:]
            if whole:
                try:
                    blocks.append(AudioBlock(first, self.layout.decode(data[:whole]), arrival))
                except WireError as error:    # the next datagram, and what else was held back, may be sound
                    refused, self._partial, self._shifted = error, b'', True
                    self.counts.lost += 1
                    self.counts.lost_frames += whole // self.layout.frame_bytes
        if refused is not None and not blocks:
            raise refused
        return blocks

    def _shift(self, lost: int, skipped: int) -> None:
        """Advance by a number of lost datagrams and their bytes; return if they are negative."""
        before = self._skipped // self.layout.frame_bytes
        self._position += skipped
        self._skipped += skipped
        self._shifted = True
        self._doubtful += lost
        self.counts.lost += lost
        self.counts.lost_frames += self._skipped // self.layout.frame_bytes - before

    def _from_next_frame(self, datagram: bytes) -> bytes:
        """A datagram from its next whole frame on, where what came before it is not that frame's beginning."""
        ahead = min(-self._position % self.layout.frame_bytes, len(datagram))
        self._position += ahead
        self._partial, self._shifted = b'', self._position % self.layout.frame_bytes > 0
        return datagram[ahead:]
