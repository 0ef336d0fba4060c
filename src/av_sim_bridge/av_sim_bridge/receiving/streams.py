"""The streams of a simulator: datagrams with their time of arrival in, samples, images and states dated in ROS time out.

Every `take(datagram, arrival, sender)` is called by the thread of one receiver and never waits. arrival: s of the
system's clock.  sender: host and port. It raises WireError for a datagram that cannot be used.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from av_audio.ring_buffer import RingBuffer
from av_common.clock import SenderClock
from av_sim_bridge.receiving.audio_decoder import AudioBlock, AudioDecoder
from av_sim_bridge.vehicle import VehicleState, from_truth
from av_sim_bridge.wire import WireError
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment
from av_sim_bridge.wire.imu import ImuSample, decode_imu
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, is_oracle
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import decode_truth

LATEST = 10.0    # s that a stamp may lag behind the others
Sender = tuple[Any, ...]


class AudioStream:
    """Audio datagrams into a ring buffer.

    It takes one sender at a time; another one after a second of silence, or when its datagrams have a header.

    Parameters:
        layout: format of the samples on the wire.
        ring: receives the samples, numbered from the start of the stream.
        clock: the sender's clock, shared by all streams of one simulator.
    """

    SILENCE = 1.0    # s

    def __init__(self, layout: AudioFormat, ring: RingBuffer, clock: SenderClock) -> None:
        self.decoder = AudioDecoder(layout, lambda: clock.lateness)
        self.ring = ring
        self.foreign = 0
        self._sender_clock = clock
        self._sample_clock = SenderClock()    # of samples without stamps
        self._rate = layout.sample_rate
        self._sender: Sender | None = None
        self._received = 0.0
        self._restarts = 0
        self._anchor = (0, 0.0)    # a sample and its ROS time

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Take one datagram. Raises WireError."""
        if self._sender is not None and sender != self._sender:
            if arrival - self._received < self.SILENCE and not self.decoder.yields_to(datagram):
                self.foreign += 1
                raise WireError('audio: datagram from {}:{} while {}:{} sends'.format(*sender, *self._sender))
            self.decoder.restart()
        blocks = self.decoder.decode(datagram, arrival)
        self._sender, self._received = sender, arrival
        if self.decoder.counts.restarts != self._restarts:
            self._restarts = self.decoder.counts.restarts
            self._sample_clock = SenderClock()
        for block in blocks:
            self._place(block)
            self.ring.write(block.samples, block.first_sample)

    def stamp(self, sample: int) -> float:
        """ROS time in s at which a sample was taken."""
        known, time = self._anchor
        return time + (sample - known) / self._rate

    def _place(self, block: AudioBlock) -> None:
        duration = len(block.samples) / self._rate
        clock, begin = self._sender_clock, block.time
        if begin is None:
            clock, begin = self._sample_clock, block.first_sample / self._rate
        self._anchor = (block.first_sample, _date(clock, begin + duration, block.arrival, 'audio') - duration)


@dataclass(frozen=True)
class StampedImage:
    """An encoded image with its capture in ROS time (s)."""

    image: EncodedImage
    stamp: float


@dataclass(frozen=True)
class OracleReport:
    """Boxes of the visual oracle with the capture of their image in ROS time (s)."""

    boxes: list[OracleBox]
    stamp: float


class CaptureStamps:
    """The ROS time of each capture, fixed once: what was taken at one instant carries the very same stamp."""

    def __init__(self, clock: SenderClock) -> None:
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


class ImageStream:
    """Fragments to images; the oracle's reports belong to the image whose fragments came last.

    Parameters:
        clock: the sender's clock, shared by all streams of one simulator.
        stamps: shared with the other sensors of the same camera, such as depth; by default its own.
    """

    def __init__(self, clock: SenderClock, stamps: CaptureStamps | None = None) -> None:
        self.assembler = ImageAssembler()
        self._clock = clock
        self._stamps = stamps or CaptureStamps(clock)
        self._newest: float | None = None

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> StampedImage | OracleReport | None:
        """The image or report that is complete with this datagram. Raises WireError."""
        if is_oracle(datagram):
            boxes = decode_oracle(datagram)
            return None if self._newest is None else OracleReport(boxes, self._newest)
        fragment = decode_fragment(datagram)
        _date(self._clock, fragment.time, arrival, 'image')
        self._newest = self._stamps.of(fragment.time)
        image = self.assembler.add(fragment)
        return None if image is None else StampedImage(image, self._newest)


@dataclass(frozen=True)
class StampedState:
    """State of the vehicle with the simulator's number `copter_id`, and its ROS time (s)."""

    copter_id: int
    state: VehicleState
    stamp: float


class TruthStream:
    """States of vehicles, in ROS's frames and time."""

    def __init__(self, clock: SenderClock) -> None:
        self._clock = clock

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> StampedState:
        """The state in one datagram. Raises WireError."""
        truth = decode_truth(datagram)
        stamp = _date(self._clock, truth.time, arrival, 'truth')
        return StampedState(truth.copter_id, from_truth(truth), stamp)


class ImuStream:
    """Inertial measurements of the rig in ROS time; `lost` counts what is missing in their sequence."""

    def __init__(self, clock: SenderClock) -> None:
        self.lost = 0
        self._clock = clock
        self._expected: int | None = None

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> tuple[ImuSample, float]:
        """The sample in one datagram and its ROS time in s. Raises WireError."""
        sample = decode_imu(datagram)
        stamp = _date(self._clock, sample.time, arrival, 'imu')
        if self._expected is not None and 0 < sample.sequence - self._expected < 1000:
            self.lost += sample.sequence - self._expected
        self._expected = sample.sequence + 1
        return sample, stamp


class TimeSyncStream:
    """The simulator's own Unix time, to compare with this machine's: `offset_s` is how far this one is ahead."""

    def __init__(self) -> None:
        self.offset_s = float('nan')

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> None:
        """Take one datagram. Raises WireError."""
        self.offset_s = arrival - decode_time_sync(datagram).now_ms / 1000.0


def _date(clock: SenderClock, stamp: float, arrival: float, name: str) -> float:
    """ROS time in s of a stamp; an image that took long is late and welcome. Raises WireError for any other time."""
    time = clock.date_late(stamp, arrival, LATEST)
    if time is None:
        raise WireError(f'{name}: time {stamp:g} s is out of step with the other stamps')
    return time
