"""Sound from and to the packages of audio_common, where audio_common_msgs is installed."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper

from av_audio import pcm
from av_audio.nodes.audio_common_node_parameters import audio_common_node as parameters
from av_common.clock import SampleCounter
from av_common.node import RigNode, run
from av_common.qos import LATCHED, STREAM
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame


class AudioCommonNode(RigNode):
    """Turns `audio_stamped` and `audio_info` into `audio/frames`, or the reverse."""

    def __init__(self, **kwargs: object) -> None:
        super().__init__('audio_common_node', parameters, **kwargs)

    def configure(self) -> None:
        """Raises ImportError where audio_common_msgs is absent."""
        try:
            from audio_common_msgs import msg
        except ImportError as error:
            raise ImportError('the package audio_common_msgs is not installed') from error
        self._messages = msg
        self._format = self.settings.sample_format
        self._incoming = self.settings.direction == 'from_audio_common'
        self._info: Any = None
        self._problem_with_sound = ''
        self._counter = SampleCounter()

    def activate(self) -> None:
        """Begin to translate."""
        if self._incoming:
            self._frames = self.while_active(self.create_publisher, AudioFrame, 'audio/frames', STREAM)
            self.while_active(self.create_subscription, self._messages.AudioInfo, 'audio_info', self._on_info, LATCHED)
            self.while_active(self.create_subscription, self._messages.AudioDataStamped, 'audio_stamped', self._on_sound,
                              STREAM)
        else:
            self._infos = self.while_active(self.create_publisher, self._messages.AudioInfo, 'audio_info', LATCHED)
            self._sounds = self.while_active(self.create_publisher, self._messages.AudioDataStamped, 'audio_stamped', STREAM)
            self.while_active(self.create_subscription, AudioFrame, 'audio/frames', self._on_frame, STREAM)

    def _on_info(self, info: Any) -> None:
        self._info = info

    def _on_sound(self, sound: Any) -> None:
        if self._info is None:
            return
        try:
            samples = pcm.decode(bytes(sound.audio.data), self._info.sample_format, self._info.channels)
        except ValueError as error:
            self._problem_with_sound = str(error)
            return
        self._problem_with_sound = ''
        rate = self._info.sample_rate
        first_sample = self._counter.place(len(samples), rate, to_seconds(sound.header.stamp))
        self._frames.publish(AudioFrame(header=sound.header, sample_rate=rate, channels=samples.shape[1],
                                        first_sample=first_sample, samples=array.array('f', samples.tobytes())))

    def _on_frame(self, frame: AudioFrame) -> None:
        if self._info is None or (self._info.channels, self._info.sample_rate) != (frame.channels, frame.sample_rate):
            self._info = self._messages.AudioInfo(channels=frame.channels, sample_rate=frame.sample_rate,
                                                  sample_format=self._format, coding_format='WAVE')
            self._infos.publish(self._info)
        samples = np.asarray(frame.samples, np.float32).reshape(-1, frame.channels)
        sound = self._messages.AudioDataStamped(header=frame.header)
        sound.audio.data = pcm.encode(samples, self._format)
        self._sounds.publish(sound)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """What is missing or wrong."""
        if self._info is None:
            status.mergeSummary(DiagnosticStatus.WARN, 'no audio_info' if self._incoming else 'no audio frames')
        if self._problem_with_sound:
            status.mergeSummary(DiagnosticStatus.ERROR, self._problem_with_sound)


def main() -> None:
    """Entry point."""
    run(AudioCommonNode)
