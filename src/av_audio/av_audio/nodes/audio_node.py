"""Node that publishes the sound of a file or a device as audio frames."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_msgs.msg import Header

from av_audio.device_source import DeviceSource
from av_audio.file_source import FileSource, pick_channels
from av_audio.messages import audio_frame
from av_audio.nodes.audio_node_parameters import audio_node as parameters
from av_audio.ring_buffer import RingBuffer
from av_common.clock import CHASE, STEP_S
from av_common.node import RigNode, run
from av_common.playback import Playback
from av_common.qos import STREAM
from av_common.rate_meter import RateMeter
from av_common.refused_inputs import RECENT_S
from av_common.stamps import to_stamp
from av_interfaces.msg import AudioFrame

BLOCK = 1600  # samples of a message: 33 ms at 48 kHz, a third of the usual hop
BUFFER_BYTES, SAMPLE_BYTES = 200_000, 4  # of the buffer between the capturing thread and the node, at least two blocks
LARGEST_LUMP_S = CHASE * STEP_S  # by which `SenderClock` corrects itself at once


class AudioNode(RigNode):
    """Publishes `audio/frames`. The capturing thread fills a ring buffer and never waits for the publisher."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('audio_node', parameters, **kwargs)

    def configure(self) -> None:
        """Open the source. Raises ValueError or OSError that names the parameter or file."""
        settings = self.settings
        self._frame_id = settings.frame_id
        self._source = self._open(settings)
        self._publisher = self.create_publisher(AudioFrame, 'audio/frames', STREAM)
        self._new_stream()

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Each channel once."""
        channels = _channels(settings)
        if channels:
            pick_channels(max(channels) + 1, channels, 'the source')

    def _new_stream(self) -> None:
        self._buffer = RingBuffer(self._source.channels, max(BUFFER_BYTES, 2 * SAMPLE_BYTES * BLOCK * self._source.channels))
        self._losses, self._lost = RateMeter(), 0
        self._playback = Playback(self.get_name())
        self._started, self._stamped = False, -math.inf

    def _open(self, settings: Any) -> FileSource | DeviceSource:
        channels = _channels(settings)
        if settings.source == 'device':
            return DeviceSource(settings.device, settings.sample_rate, channels, BLOCK, self.now)
        if not settings.file:
            raise ValueError('file is empty, expected the path of a sound file')
        return FileSource(settings.file, channels, BLOCK, settings.loop, self.now)

    def activate(self) -> None:
        """Start to capture. Raises ValueError when the device cannot."""
        self._new_stream()
        if isinstance(self._source, DeviceSource):
            self._source.start(self._buffer)
            self._started = True
        self.create_timer(0.25 * BLOCK / self._source.sample_rate, self._publish)

    def _start_file(self, source: FileSource) -> None:
        """Start a file when those who hear it are there, so that its beginning is not lost while other nodes start."""
        subscribers = self.get_subscriptions_info_by_topic(self._publisher.topic_name)
        begin = self._playback.begin({info.node_name for info in subscribers}, self.now())
        if begin is not None:
            source.start(self._buffer, begin)
            self._started = True

    def deactivate(self) -> None:
        """Stop capturing."""
        self._source.stop()

    def cleanup(self) -> None:
        """Close the source."""
        self._source.close()

    def _publish(self) -> None:
        if not self._started and isinstance(self._source, FileSource):
            self._start_file(self._source)
        while self._buffer.available >= BLOCK or (self._source.finished and self._buffer.available):
            first_sample, samples = self._buffer.read(BLOCK)
            time = self._source.time_of(first_sample)
            # By a correction of the clock no stamp goes back; by a clock that was set it does.
            self._stamped = self._stamped if 0.0 < self._stamped - time < LARGEST_LUMP_S else time
            header = Header(stamp=to_stamp(self._stamped), frame_id=self._frame_id)
            self._publisher.publish(audio_frame(samples, first_sample, self._source.sample_rate, header))

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Clock and losses; doa_node judges the channels."""
        source = self._source
        status.add('sample rate', f'{source.sample_rate} Hz')
        status.add('overwritten samples', str(self._buffer.overwritten))
        problems = []
        if isinstance(source, DeviceSource):
            status.add('clock drift', f'{source.ppm:+.1f} ppm')
            status.add('overflows', str(source.overflows))
            status.add('reopened', str(source.reopened))
            if source.lost:
                status.mergeSummary(DiagnosticStatus.ERROR, 'the device has disappeared, trying to open it again')
        if source.finished:
            problems.append('the file has ended')
        if self._buffer.overwritten > self._lost:
            self._lost = self._buffer.overwritten
            self._losses.tick()
        if self._losses.age <= RECENT_S:
            problems.append(f'{self._lost} samples lost, the machine is too slow')
        if problems:
            status.mergeSummary(DiagnosticStatus.WARN, '; '.join(problems))


def _channels(settings: Any) -> list[int]:
    """Channels of the source in order; empty for all."""
    return [] if list(settings.channels) == [-1] else list(settings.channels)


def main() -> None:
    """Entry point."""
    run(AudioNode)
