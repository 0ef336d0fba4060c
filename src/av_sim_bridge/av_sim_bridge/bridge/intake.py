"""What becomes of the datagrams of each stream; called by the receiving threads, never waits."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from av_audio.ring_buffer import RingBuffer
from av_common.clock import SampleClock, SenderClock
from av_sim_bridge.audio_stream import AudioBlock, AudioDecoder
from av_sim_bridge.vehicle import VehicleState, from_truth
from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment
from av_sim_bridge.wire.imu import ImuSample, decode_imu
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, is_oracle
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import decode_truth

LATEST = 10.0    # s that a stamp may lag behind the others


class AudioIntake:
    """Sound into the ring buffer. Takes one sender at a time; another after a second of silence, or with a header."""

    SILENCE = 1.0

    def __init__(self, layout: AudioFormat, ring: RingBuffer, clock: SenderClock):
        self.decoder = AudioDecoder(layout, lambda: clock.lateness)
        self.ring = ring
        self.foreign = 0
        self._sender_clock = clock
        self._sample_clock = SampleClock(layout.sample_rate)
        self._rate = layout.sample_rate
        self._sender: tuple | None = None
        self._heard = 0.0
        self._restarts = 0
        self._anchor = (0, 0.0)    # a sample and its ROS time

    def take(self, datagram: bytes, arrival: float, sender: tuple) -> None:
        """Take one datagram. Raises WireError."""
        if self._sender is not None and sender != self._sender:
            if arrival - self._heard < self.SILENCE and not self.decoder.yields_to(datagram):
                self.foreign += 1
                raise WireError('audio: datagram from {}:{} while {}:{} sends'.format(*sender, *self._sender))
            self.decoder.restart()
        blocks = self.decoder.decode(datagram, arrival)
        self._sender, self._heard = sender, arrival
        if self.decoder.counts.restarts != self._restarts:
            self._restarts = self.decoder.counts.restarts
            self._sample_clock = SampleClock(self._rate)
        for block in blocks:
            self._place(block)
            self.ring.write(block.samples, block.first_sample)

    def stamp(self, sample: int) -> float:
        """ROS time in s at which a sample was taken."""
        known, time = self._anchor
        return time + (sample - known) / self._rate

    def _place(self, block: AudioBlock) -> None:
        end = block.first_sample + len(block.samples)
        if block.time is not None:
            self._sender_clock.observe(block.time + len(block.samples) / self._rate, block.arrival)
            self._anchor = (block.first_sample, self._sender_clock.to_ros(block.time))
        else:
            self._sample_clock.observe(end, block.arrival)
            self._anchor = (block.first_sample, self._sample_clock.to_ros(block.first_sample))


@dataclass(frozen=True)
class StampedImage:
    """An encoded image with its capture in ROS time (s)."""

    image: EncodedImage
    stamp: float


class CaptureStamps:
    """The ROS time of each capture, fixed once: what was taken at one instant carries the very same stamp."""

    def __init__(self, clock: SenderClock):
        self._clock, self._lock = clock, threading.Lock()
        self._known: OrderedDict[float, float] = OrderedDict()

    def of(self, time: float) -> float:
        """The stamp in s of a capture at the sender's `time` in s; from any thread."""
        with self._lock:
            if time not in self._known:
                self._known[time] = self._clock.to_ros(time)
                if len(self._known) > 32:
                    self._known.popitem(last=False)
            return self._known[time]


class ImageIntake:
    """Fragments to images; the oracle's reports belong to the image whose fragments came last."""

    def __init__(self, clock: SenderClock, on_image: Callable[[StampedImage], None],
                 on_boxes: Callable[[list[OracleBox], float], None], stamps: CaptureStamps | None = None):
        """on_boxes(boxes, stamp of the image in ROS time).  stamps: shared with the other sensors of one camera."""
        self.assembler = ImageAssembler()
        self._clock, self._on_image, self._on_boxes = clock, on_image, on_boxes
        self._stamps = stamps or CaptureStamps(clock)
        self._newest: float | None = None

    def take(self, datagram: bytes, arrival: float, _sender: tuple) -> None:
        """Take one datagram. Raises WireError."""
        if is_oracle(datagram):
            boxes = decode_oracle(datagram)
            if self._newest is not None:
                self._on_boxes(boxes, self._newest)
            return
        fragment = decode_fragment(datagram)
        _observe(self._clock, fragment.time, arrival, 'image')
        self._newest = self._stamps.of(fragment.time)
        image = self.assembler.add(fragment)
        if image is not None:
            self._on_image(StampedImage(image, self._newest))


class TruthIntake:
    """States of vehicles, in ROS's frames and time."""

    def __init__(self, clock: SenderClock, on_state: Callable[[int, VehicleState, float], None]):
        """on_state(copter id, state, ROS time in s)."""
        self._clock, self._on_state = clock, on_state

    def take(self, datagram: bytes, arrival: float, _sender: tuple) -> None:
        """Take one datagram. Raises WireError."""
        truth = decode_truth(datagram)
        _observe(self._clock, truth.time, arrival, 'truth')
        self._on_state(truth.copter_id, from_truth(truth), self._clock.to_ros(truth.time))


class ImuIntake:
    """Inertial measurements of the rig, in FLU and ROS time; counts what is missing in their sequence."""

    def __init__(self, clock: SenderClock, on_sample: Callable[[ImuSample, float], None]):
        """on_sample(sample, ROS time in s)."""
        self.lost = 0
        self._clock, self._on_sample = clock, on_sample
        self._expected: int | None = None

    def take(self, datagram: bytes, arrival: float, _sender: tuple) -> None:
        """Take one datagram. Raises WireError."""
        sample = decode_imu(datagram)
        _observe(self._clock, sample.time, arrival, 'imu')
        if self._expected is not None and 0 < sample.sequence - self._expected < 1000:
            self.lost += sample.sequence - self._expected
        self._expected = sample.sequence + 1
        self._on_sample(sample, self._clock.to_ros(sample.time))


class TimeSyncIntake:
    """The simulator's own idea of Unix time, to compare with this machine's."""

    def __init__(self):
        self.offset_s = float('nan')

    def take(self, datagram: bytes, arrival: float, _sender: tuple) -> None:
        """Take one datagram. Raises WireError."""
        self.offset_s = arrival - decode_time_sync(datagram).now_ms / 1000.0


def _observe(clock: SenderClock, stamp: float, arrival: float, name: str) -> None:
    """Take a stamp; a picture that took long is late and welcome, one from the future or from long ago is not."""
    if not clock.observe(stamp, arrival) and not -clock.restart < arrival - clock.to_ros(stamp) < LATEST:
        raise WireError(f'{name}: time {stamp:g} s is out of step with the other stamps')
