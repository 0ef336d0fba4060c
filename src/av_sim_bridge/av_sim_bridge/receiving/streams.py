"""The streams of a simulator: datagrams with their time of arrival in; samples, images and dates in ROS time out.

Every method `take` is called by the thread of one receiver, and does not block. It raises WireError for an unusable datagram,
ForeignSenderError for one of another sender. Its parameters are the content of the datagram, `arrival` (s, the system's clock)
and `sender` (host, port).
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass

from av_audio.ring_buffer import RingBuffer
from av_common.clock import SenderClock
from av_sim_bridge.receiving.audio_decoder import AudioBlock, AudioDecoder
from av_sim_bridge.receiving.common_clock import CommonClock, OneSender, Sender
from av_sim_bridge.wire import UndatedError
from av_sim_bridge.wire.audio import AudioFormat, decode_header
from av_sim_bridge.wire.image import EncodedImage, ImageAssembler, decode_fragment
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, is_oracle

SAME_CAPTURE = 0.05    # s, largest difference of the stamps of one capture in two streams


class AudioStream:
    """Writes the samples of audio datagrams to a ring buffer.

    Parameters:
        layout: format of the samples in the datagrams.
        ring: buffer for the samples, which are numbered from the start of the stream.
        clock: the clock that all streams of one simulator share.
    """

    def __init__(self, layout: AudioFormat, ring: RingBuffer, clock: CommonClock) -> None:
        self.decoder = AudioDecoder(layout)
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
        return self._clock.date('audio', sender, header.time + duration, arrival) - duration

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

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> StampedImage | tuple[list[OracleBox], float] | None:
        """The image that this datagram completes, or the oracle's boxes and the stamp (s) of their image; else None."""
        if is_oracle(datagram):
            return self._report(decode_oracle(datagram), arrival, sender)
        fragment = decode_fragment(datagram)
        try:
            stamp = self._stamps.of(fragment.time, self._clock.date(self._name, sender, fragment.time, arrival))
        except UndatedError:
            self._newest = None    # nor can its boxes be dated
            raise
        self._newest = sender, fragment.time, stamp
        image = self.assembler.add(fragment)
        return None if image is None else StampedImage(image, stamp)

    def _report(self, boxes: list[OracleBox], arrival: float, sender: Sender) -> tuple[list[OracleBox], float] | None:
        if self._newest is None or self._newest[0] != sender:
            self._clock.refuse_others(self._name, sender, arrival)
            return None
        _, time, stamp = self._newest
        if time == self._reported:    # it came twice, or its image was lost
            return None
        self._reported = time
        return boxes, stamp


class StateStream:
    """Dates the states of a stream, such as poses and measurements, but for those that come again or out of order.

    Parameters:
        clock: the clock that all streams of one simulator share.
        name: name of the stream.
    """

    SET_BACK_S = 2.0   # dates that are earlier by more are of a clock that was set back: an old state is dated within LATEST_S

    def __init__(self, clock: CommonClock, name: str) -> None:
        self._clock, self._name = clock, name
        self._stamp = self._date = -math.inf

    def date(self, stamp: float, arrival: float, sender: Sender) -> float | None:
        """ROS time (s) of a state, later than those before; None for one that is left out. Raises WireError, see `CommonClock`.

        Parameters:
            stamp (s): time of the state on the sender's clock.
            arrival (s), sender: of its datagram.
        """
        date = self._clock.date(self._name, sender, stamp, arrival)
        if (date <= self._date or stamp == self._stamp) and date > self._date - self.SET_BACK_S:
            return None
        self._stamp, self._date = stamp, date
        return date
