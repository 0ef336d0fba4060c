"""The streams of a simulator: datagrams with their time of arrival in; samples and images in ROS time out.

Every method `take` is called by the thread of one receiver. It raises WireError for an unusable datagram, ForeignSenderError
for one of another sender. Its parameters are the content of the datagram, `arrival` (s, the system's clock) and `sender`
(host, port).
"""

from __future__ import annotations

import math
from collections import OrderedDict

from av_common.clock import LATEST_S, SenderClock
from av_sim_bridge.receiving.allowed_senders import Sender
from av_sim_bridge.receiving.audio_decoder import AudioBlock, AudioDecoder
from av_sim_bridge.receiving.common_clock import CommonClock, OneSender
from av_sim_bridge.wire import UndatedError
from av_sim_bridge.wire.audio import AudioFormat, decode_header
from av_sim_bridge.wire.image import MOST_PARTIAL, EncodedImage, ImageAssembler, decode_fragment
from av_sim_bridge.wire.oracle import OracleBox, decode_oracle, is_oracle

MEASURED_S, BREAK_S = 10.0, 1.0    # of sound, from which its rate follows; without any, after which that begins anew


class AudioStream:
    """Dates the samples of audio datagrams, which are numbered from the start of the stream.

    Attributes:
        decoder: of the datagrams.
        sample_rate (Hz): at which samples came over the last MEASURED_S, NaN before.
        undated: number of blocks that could not be dated.

    Parameters:
        layout: format of the samples in the datagrams.
        clock: the clock that all streams of one simulator share.
    """

    def __init__(self, layout: AudioFormat, clock: CommonClock) -> None:
        self.decoder = AudioDecoder(layout)
        self.undated, self.sample_rate = 0, math.nan
        self._began, self._newest, self._bytes = -math.inf, -math.inf, 0    # arrivals (s) and bytes from which it follows
        self._layout, self._clock = layout, clock
        self._sample_clock = SenderClock()    # clock of samples without stamps
        self._sender = OneSender('audio')
        self._restarts = 0

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> list[tuple[AudioBlock, float]]:
        """The blocks that are complete after one datagram, and the capture time (s, ROS time) of each one's first sample."""
        if self._sender.check(sender, arrival):
            self.decoder.restart()
        self._measure(len(datagram), arrival)
        blocks = self.decoder.decode(datagram, arrival, self._stamp_of(datagram, arrival, sender))
        self._sender.note(sender, arrival)
        if self.decoder.counts.restarts != self._restarts:
            self._restarts = self.decoder.counts.restarts
            self._sample_clock = SenderClock()
        dated = [(block, self._time_of(block)) for block in blocks]
        self.undated += sum(time is None for _, time in dated)
        return [(block, time) for block, time in dated if time is not None]

    def _measure(self, size: int, arrival: float) -> None:
        if not 0.0 <= arrival - self._newest < BREAK_S:
            self._began, self._bytes = arrival, -size    # those of the first datagram came before
        self._newest, self._bytes = arrival, self._bytes + size
        if (elapsed := arrival - self._began) >= MEASURED_S:
            self.sample_rate = self._bytes / self._layout.frame_bytes / elapsed
            self._began, self._bytes = arrival, 0

    def _stamp_of(self, datagram: bytes, arrival: float, sender: Sender) -> float | None:
        """ROS time (s) of a datagram's first sample, None without a header. Raises UndatedError if it cannot be dated."""
        header = decode_header(self._layout, datagram)
        if header is None:
            return None
        duration = header.frames / self._layout.sample_rate
        return self._clock.date('audio', sender, header.time + duration, arrival) - duration

    def _time_of(self, block: AudioBlock) -> float | None:
        if block.time is not None:
            return block.time
        rate, duration = self._layout.sample_rate, len(block.samples) / self._layout.sample_rate
        end = self._sample_clock.date(block.first_sample / rate + duration, block.arrival)
        return None if end is None else end - duration


class ImageStream:
    """Assembles images from fragments, in whatever order they come: the first of an image dates it.

    The oracle's first report after the beginning of an image is that image's.

    Parameters:
        clock: the clock that all streams of one simulator share.
        name: name of the stream.
        most_bytes (bytes): maximum size of an encoded image.
    """

    def __init__(self, clock: CommonClock, name: str = 'image', most_bytes: int = 4_000_000) -> None:
        self.assembler = ImageAssembler(most_bytes=most_bytes)
        self._clock, self._name = clock, name
        self._newest: tuple[Sender, float, float] | None = None    # sender, time and stamp of the image that began last
        self._begun: OrderedDict[float, tuple[Sender, float]] = OrderedDict()    # senders and stamps of images, by their times
        self._reported = math.nan    # time of the image with the newest report, on the sender's clock

    def take(self, datagram: bytes, arrival: float, sender: Sender) -> tuple[EncodedImage | list[OracleBox], float] | None:
        """The image that this datagram completes, or the oracle's boxes, and the image's capture time (s, ROS time)."""
        if is_oracle(datagram):
            return self._report(decode_oracle(datagram), arrival, sender)
        fragment = decode_fragment(datagram)
        stamp = self._stamp_of(fragment.time, arrival, sender)
        image = self.assembler.add(fragment)
        return None if image is None else (image, stamp)

    def _stamp_of(self, time: float, arrival: float, sender: Sender) -> float:
        begun, stamp = self._begun.get(time, ((), math.nan))
        if begun == sender and arrival - stamp <= LATEST_S:    # a further fragment, though it is older than others that came
            self._clock.refuse_others(self._name, sender, arrival)
            return stamp
        try:
            stamp = self._clock.date_capture(self._name, sender, time, arrival)
        except UndatedError:
            self._newest = None    # nor can its boxes be dated
            raise
        self._newest, self._begun[time] = (sender, time, stamp), (sender, stamp)
        if len(self._begun) > MOST_PARTIAL:
            self._begun.popitem(last=False)
        return stamp

    def _report(self, boxes: list[OracleBox], arrival: float, sender: Sender) -> tuple[list[OracleBox], float] | None:
        if self._newest is None or self._newest[0] != sender:
            self._clock.refuse_others(self._name, sender, arrival)
            return None
        _, time, stamp = self._newest
        if time == self._reported:    # it came twice, or its image was lost
            return None
        self._reported = time
        return boxes, stamp
