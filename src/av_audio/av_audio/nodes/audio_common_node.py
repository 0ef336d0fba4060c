"""Node that converts between audio frames and the messages of audio_common, where audio_common_msgs is installed."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper

from av_audio import pcm
from av_audio.messages import audio_frame, samples_of
from av_audio.nodes.audio_common_node_parameters import audio_common_node as parameters
from av_common.node import RigNode, run
from av_common.qos import LATCHED, STREAM
from av_common.sample_clock import SampleCounter
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame


class AudioCommonNode(RigNode):
    """Converts `audio_stamped` and `audio_info` to `audio/frames`, or the reverse."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('audio_common_node', parameters, **kwargs)

    def configure(self) -> None:
        """Load the messages. Raises ImportError where audio_common_msgs is not installed."""
        try:
            from audio_common_msgs import msg
        except ImportError as error:
            raise ImportError('the package audio_common_msgs is not installed') from error
        self._messages = msg
        self._format = self.settings.sample_format
        self._incoming = self.settings.direction == 'from_audio_common'
        self._info: Any = None
        self._counter = SampleCounter()

    def activate(self) -> None:
        """Subscribe."""
        if self._incoming:
            self._frames = self.while_active(self.create_publisher, AudioFrame, 'audio/frames', STREAM)
            self.while_active(self.create_subscription, self._messages.AudioInfo, 'audio_info', self._on_info, LATCHED)
            self.while_active(self.create_subscription, self._messages.AudioDataStamped, 'audio_stamped', self._on_data,
                              STREAM)
        else:
            self._infos = self.while_active(self.create_publisher, self._messages.AudioInfo, 'audio_info', LATCHED)
            self._data = self.while_active(self.create_publisher, self._messages.AudioDataStamped, 'audio_stamped', STREAM)
            self.while_active(self.create_subscription, AudioFrame, 'audio/frames', self._on_frame, STREAM)

    def _on_info(self, info: Any) -> None:
        self._info = info

    def _on_data(self, message: Any) -> None:
        if self._info is None:
            return
        samples = pcm.decode(bytes(message.audio.data), self._info.sample_format, self._info.channels)
        rate = self._info.sample_rate
        first_sample = self._counter.place(len(samples), rate, to_seconds(message.header.stamp))
        self._frames.publish(audio_frame(samples, first_sample, rate, message.header))

    def _on_frame(self, frame: AudioFrame) -> None:
        if self._info is None or (self._info.channels, self._info.sample_rate) != (frame.channels, frame.sample_rate):
            self._info = self._messages.AudioInfo(channels=frame.channels, sample_rate=frame.sample_rate,
                                                  sample_format=self._format, coding_format='WAVE')
            self._infos.publish(self._info)
        samples = samples_of(frame)
        message = self._messages.AudioDataStamped(header=frame.header)
        message.audio.data = pcm.encode(samples, self._format)
        self._data.publish(message)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Missing inputs."""
        if self._info is None:
            status.mergeSummary(DiagnosticStatus.WARN, 'no audio_info' if self._incoming else 'no audio frames')


def main() -> None:
    """Entry point."""
    run(AudioCommonNode)
