"""The streams of a simulator: datagrams with their time of arrival in; samples, images and states in ROS time out.

Every method `take` is called by the thread of one receiver and does not block. It raises WireError for an unusable
datagram. Its parameters are the content of the datagram, `arrival` (s, the system's clock) and `sender` (host, port).
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

LATEST = 10.0    # s, maximum delay of a stamp relative to the other streams
Sender = tuple[Any, ...]


class AudioStream:
    """Writes the samples of audio datagrams to a ring buffer.

    Only one sender is accepted at a time. Another sender is accepted after a second without datagrams, or if its
    datagrams have a header and those of the present sender do not.

    Parameters:
        layout: format of the samples in the datagrams.
        ring: buffer for the samples, which are numbered from the start of the stream.
        clock: the sender's clock, shared by all streams of one simulator.
    """

    SILENCE = 1.0    # s

    def __init__(self, layout: AudioFormat, ring: RingBuffer, clock: SenderClock) -> None:
        self.decoder = AudioDecoder(layout, lambda: clock.lateness)
        self.ring = ring
        self.foreign = 0
        self._sender_clock = clock
        self._sample_clock = SenderClock()    # clock of samples without stamps
        self._rate = layout.sample_rate
        self._sender: Sender | None = None
        self._received = 0.0
        self._restarts = 0
        self._anchor = (0, 0.0)    # a sample and its ROS time

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Decode one datagram and write its samples to the ring buffer."""
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
        """Capture time (s, ROS time) of the sample with a given number."""
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
    """An encoded image with its capture time.

    Parameters:
        image: the image as the sender encoded it.
        stamp (s): capture time, ROS time.
    """

    image: EncodedImage
    stamp: float


@dataclass(frozen=True)
class OracleReport:
    """Boxes of the visual oracle in one image.

    Parameters:
        boxes: one box for each visible target.
        stamp (s): capture time of the image, ROS time.
    """

    boxes: list[OracleBox]
    stamp: float


class CaptureStamps:
    """Assigns one ROS time to each capture time, so that simultaneous captures have identical stamps.

    Parameters:
        clock: the sender's clock.
    """

    def __init__(self, clock: SenderClock) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._known: OrderedDict[float, float] = OrderedDict()

    def of(self, time: float) -> float:
        """Stamp (s, ROS time) of a capture at the sender's `time` (s). May be called from any thread."""
        with self._lock:
            if time not in self._known:
                self._known[time] = self._clock.to_ros(time)
                if len(self._known) > 32:
                    self._known.popitem(last=False)
            return self._known[time]


class ImageStream:
    """Assembles images from fragments. A report of the oracle refers to the image of the last received fragment.

    Parameters:
        clock: the sender's clock, shared by all streams of one simulator.
        stamps: stamps shared with other streams of the same camera, such as depth; None for a separate object.
        most_bytes (bytes): maximum size of an encoded image.
    """

    def __init__(self, clock: SenderClock, stamps: CaptureStamps | None = None, most_bytes: int = 4_000_000) -> None:
        self.assembler = ImageAssembler(most_bytes=most_bytes)
        self._clock = clock
        self._stamps = stamps or CaptureStamps(clock)
        self._newest: float | None = None

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> StampedImage | OracleReport | None:
        """The image or report that this datagram completes, None if it completes none."""
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
    """State of a vehicle.

    Parameters:
        copter_id: number of the vehicle in the simulator.
        state: state in ENU and FLU.
        stamp (s): time of the state, ROS time.
    """

    copter_id: int
    state: VehicleState
    stamp: float


class TruthStream:
    """Decodes states of vehicles to ROS frames and ROS time."""

    def __init__(self, clock: SenderClock) -> None:
        self._clock = clock

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> StampedState:
        """The state in one datagram."""
        truth = decode_truth(datagram)
        stamp = _date(self._clock, truth.time, arrival, 'truth')
        return StampedState(truth.copter_id, from_truth(truth), stamp)


class ImuStream:
    """Decodes inertial measurements of the rig; `lost` counts the gaps in their sequence numbers."""

    def __init__(self, clock: SenderClock) -> None:
        self.lost = 0
        self._clock = clock
        self._expected: int | None = None

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> tuple[ImuSample, float]:
        """The measurement in one datagram and its time (s, ROS time)."""
        sample = decode_imu(datagram)
        stamp = _date(self._clock, sample.time, arrival, 'imu')
        if self._expected is not None and 0 < sample.sequence - self._expected < 1000:
            self.lost += sample.sequence - self._expected
        self._expected = sample.sequence + 1
        return sample, stamp


class TimeSyncStream:
    """Compares the simulator's Unix time with this machine's: `offset_s` (s) is this machine's time minus the simulator's."""

    def __init__(self) -> None:
        self.offset_s = float('nan')

    def take(self, datagram: bytes, arrival: float, _sender: Sender) -> None:
        """Update the offset from one datagram."""
        self.offset_s = arrival - decode_time_sync(datagram).now_ms / 1000.0


def _date(clock: SenderClock, stamp: float, arrival: float, name: str) -> float:
    """ROS time (s) of a stamp. A delay of up to LATEST is accepted; raises WireError for any other stamp."""
    time = clock.date_late(stamp, arrival, LATEST)
    if time is None:
        raise WireError(f'{name}: time {stamp:g} s is inconsistent with the other stamps')
    return time
