"""The streams of a simulator: datagrams with their time of arrival in; samples, images and states in ROS time out.

Every method `take` is called by the thread of one receiver, `TruthStream.take` by those of all vehicles, and does not block.
It raises WireError for an unusable datagram, ForeignSenderError for one of another sender: a stream has one sender, address
and port, at a time, until it has sent nothing usable for SILENCE_S. Its parameters are the content of the datagram, `arrival`
(s, the system's clock) and `sender` (host, port).
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from av_audio.ring_buffer import RingBuffer
from av_common.clock import ElapsedTime, SenderClock
from av_sim_bridge.receiving.audio_decoder import AudioBlock, AudioDecoder
from av_sim_bridge.receiving.common_clock import SILENCE_S, CommonClock
from av_sim_bridge.vehicle import VehicleState, from_truth
from av_sim_bridge.wire import ForeignSenderError, UndatedError
from av_sim_bridge.wire.audio import AudioFormat, decode_header
from av_sim_bridge.wire.gimbal import GimbalSample, decode_gimbal
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment
from av_sim_bridge.wire.imu import ImuSample, decode_imu
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, is_oracle
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import decode_truth

SAME_CAPTURE = 0.05    # s, largest difference of the stamps of one capture in two streams
Sender = tuple[Any, ...]


class OneSender:
    """The sender of a stream that has no stamps to be told apart by; `CommonClock` does the same for the others.

    Parameters:
        name: name of the stream.
    """

    def __init__(self, name: str) -> None:
        self._name, self._time = name, ElapsedTime()
        self._present: tuple[Sender, float] | None = None    # sender, and elapsed time of its newest datagram (s)

    def check(self, sender: Sender, arrival: float) -> bool:
        """Whether a sender is another one than before. Raises ForeignSenderError while the present one sends."""
        if self._present is None or self._present[0] == sender:
            return False
        if self._time.at(arrival) - self._present[1] < SILENCE_S:
            raise ForeignSenderError(self._name, sender, self._present[0])
        return True

    def note(self, sender: Sender, arrival: float) -> None:
        """Note a usable datagram."""
        self._present = sender, self._time.at(arrival)


class AudioStream:
    """Writes the samples of audio datagrams to a ring buffer.

    Parameters:
        layout: format of the samples in the datagrams.
        ring: buffer for the samples, which are numbered from the start of the stream.
        clock: the clock that all streams of one simulator share.
    """

    def __init__(self, layout: AudioFormat, ring: RingBuffer, clock: CommonClock) -> None:
        self.decoder = AudioDecoder(layout, lambda: clock.lateness)
        self.ring = ring
        self.undated = 0
        self._layout, self._clock = layout, clock
        self._sample_clock = SenderClock()    # clock of samples without stamps
        self._rate = layout.sample_rate
        self._sender = OneSender('audio')
        self._restarts = 0
        self._anchors: deque[tuple[int, float]] = deque(maxlen=256)    # samples and their ROS times

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Decode one datagram and write its samples to the ring buffer."""
        if self._sender.check(sender, arrival):
            self.decoder.restart()
        blocks = self.decoder.decode(datagram, arrival, self._stamp_of(datagram, arrival, sender))
        self._sender.note(sender, arrival)
        if self.decoder.counts.restarts != self._restarts:
            self._restarts = self.decoder.counts.restarts
            self._sample_clock = SenderClock()
        for block in blocks:
            time = self._time_of(block)
            if time is None:
                self.undated += 1
                continue
            self._anchors.append((block.first_sample, time))
            self.ring.write(block.samples, block.first_sample)

    def stamp(self, sample: int) -> float:
        """Capture time (s, ROS time) of the sample with a given number, which is in the ring buffer."""
        anchors = tuple(self._anchors)
        known, time = next((anchor for anchor in reversed(anchors) if anchor[0] <= sample), anchors[0])
        return time + (sample - known) / self._rate

    def _stamp_of(self, datagram: bytes, arrival: float, sender: Sender) -> float | None:
        """ROS time (s) of a datagram's first sample, None without a header. Raises UndatedError if it cannot be dated."""
        header = decode_header(self._layout, datagram)
        if header is None:
            return None
        duration = header.frames / self._rate
        return _date(self._clock, 'audio', sender, header.time + duration, arrival) - duration

    def _time_of(self, block: AudioBlock) -> float | None:
        if block.time is not None:
            return block.time
        duration = len(block.samples) / self._rate
        end = self._sample_clock.date(block.first_sample / self._rate + duration, block.arrival)
        return None if end is None else end - duration


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
    """Assigns one ROS time to each capture time, so that simultaneous captures have identical stamps."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: OrderedDict[float, float] = OrderedDict()

    def of(self, time: float, dated: float) -> float:
        """Stamp (s, ROS time) of a capture: that of its first datagram. May be called from any thread.

        Parameters:
            time (s): time of the capture on the sender's clock.
            dated (s): ROS time of that time by the newest datagram.
        """
        with self._lock:
            if abs(self._known.get(time, dated) - dated) > SAME_CAPTURE:    # the sender has restarted
                del self._known[time]
            stamp = self._known.setdefault(time, dated)
            if len(self._known) > 32:
                self._known.popitem(last=False)
            return stamp


class ImageStream:
    """Assembles images from fragments. The oracle's first report after a fragment is that of the fragment's image.

    Parameters:
        clock: the clock that all streams of one simulator share.
        stamps: stamps shared with other streams of the same camera, such as depth.
        name: name of the stream.
        most_bytes (bytes): maximum size of an encoded image.
    """

    def __init__(self, clock: CommonClock, stamps: CaptureStamps, name: str = 'image',
                 most_bytes: int = 4_000_000) -> None:
        self.assembler = ImageAssembler(most_bytes=most_bytes)
        self._clock, self._stamps, self._name = clock, stamps, name
        self._newest: tuple[Sender, float, float] | None = None    # sender, time and stamp of the newest fragment
        self._reported = math.nan    # time of the image with the newest report, on the sender's clock

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> StampedImage | OracleReport | None:
        """The image or report that this datagram completes, None if it completes none."""
        if is_oracle(datagram):
            return self._report(decode_oracle(datagram), sender)
        fragment = decode_fragment(datagram)
        try:
            stamp = self._stamps.of(fragment.time, _date(self._clock, self._name, sender, fragment.time, arrival))
        except UndatedError:
            self._newest = None    # nor can its boxes be dated
            raise
        self._newest = sender, fragment.time, stamp
        image = self.assembler.add(fragment)
        return None if image is None else StampedImage(image, stamp)

    def _report(self, boxes: list[OracleBox], sender: Sender) -> OracleReport | None:
        if self._newest is None or self._newest[0] != sender:
            _refuse_others(self._clock, self._name, sender)
            return None
        _, time, stamp = self._newest
        if time == self._reported:    # it came twice, or its image was lost
            return None
        self._reported = time
        return OracleReport(boxes, stamp)


class InOrder:
    """Leaves out states that come again or out of order, so that stamps increase."""

    RESTART_S = 0.5    # dates of a sender that begins anew are later by more: it is not dated for a second
    SET_BACK_S = 2.0   # dates that are earlier by more are of a clock that was set back: an old state is dated within LATEST_S

    def __init__(self) -> None:
        self._stamp = self._date = -math.inf

    def takes(self, stamp: float, date: float) -> bool:
        """Whether a state is newer than all before, or of a sender that has begun anew.

        Parameters:
            stamp (s): time of the state on the sender's clock.
            date (s): the same in ROS time.
        """
        again = -self.SET_BACK_S <= date - self._date < self.RESTART_S
        if again and (stamp <= self._stamp or date == self._date):
            return False
        self._stamp, self._date = stamp, date
        return True


class TruthStream:
    """Decodes states of vehicles to ROS frames and ROS time.

    Parameters:
        clock: the clock that all streams of one simulator share.
        names: name of the stream of each vehicle by its number; other vehicles are left out.
    """

    def __init__(self, clock: CommonClock, names: Mapping[int, str]) -> None:
        self._clock, self._names = clock, names
        self._order = {number: InOrder() for number in names}

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> tuple[int, VehicleState, float] | None:
        """Number and state of the vehicle in one datagram, and its time (s, ROS time); None for another, or an old one."""
        truth = decode_truth(datagram)
        number = truth.copter_id
        if number not in self._names:
            return None
        stamp = _date(self._clock, self._names[number], sender, truth.time, arrival)
        return (number, from_truth(truth), stamp) if self._order[number].takes(truth.time, stamp) else None


class ImuStream:
    """Decodes inertial measurements of the rig; `lost` counts the gaps in their sequence numbers."""

    def __init__(self, clock: CommonClock) -> None:
        self.lost = 0
        self._clock, self._order = clock, InOrder()
        self._expected: int | None = None

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> tuple[ImuSample, float] | None:
        """The measurement in one datagram and its time (s, ROS time); None for one that comes again or out of order."""
        sample = decode_imu(datagram)
        stamp = _date(self._clock, 'imu', sender, sample.time, arrival)
        if not self._order.takes(sample.time, stamp):
            return None
        if self._expected is not None and 0 < sample.sequence - self._expected < 1000:
            self.lost += sample.sequence - self._expected
        self._expected = sample.sequence + 1
        return sample, stamp


class GimbalStream:
    """Decodes measured orientations of the gimbal."""

    def __init__(self, clock: CommonClock) -> None:
        self._clock, self._order = clock, InOrder()

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> tuple[GimbalSample, float] | None:
        """The orientation in one datagram and its time (s, ROS time); None for one that comes again or out of order."""
        sample = decode_gimbal(datagram)
        stamp = _date(self._clock, 'gimbal', sender, sample.time, arrival)
        return (sample, stamp) if self._order.takes(sample.time, stamp) else None


class TimeSyncStream:
    """Compares the simulator's Unix time with this machine's: `offset_s` (s) is this machine's time minus the simulator's."""

    def __init__(self) -> None:
        self.offset_s = float('nan')
        self._sender = OneSender('time_sync')

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Update the offset from one datagram."""
        self._sender.check(sender, arrival)
        self.offset_s = arrival - decode_time_sync(datagram).now_ms / 1000.0
        self._sender.note(sender, arrival)


def _date(clock: CommonClock, name: str, sender: Sender, stamp: float, arrival: float) -> float:
    """ROS time (s) of a stamp. Raises UndatedError for one that cannot be dated, ForeignSenderError for that of another."""
    time = clock.date(name, sender, stamp, arrival)
    if time is None:
        _refuse_others(clock, name, sender)
        raise UndatedError(f'{name}: the time {stamp:g} s of {sender[0]}:{sender[1]} cannot be dated')
    return time


def _refuse_others(clock: CommonClock, name: str, sender: Sender) -> None:
    """Raise ForeignSenderError for another one than the present sender of a stream."""
    present = clock.sender(name)
    if isinstance(present, tuple) and present != sender:
        raise ForeignSenderError(name, sender, present)
