"""AudioFrame messages in, directions of arrival out."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_msgs.msg import Float32MultiArray

from av_audio.doa_messages import doa_array
from av_audio.ego_noise import NoiseRecording
from av_audio.health import SwapDetector
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_audio.nodes.doa_node_parameters import doa_node as parameters
from av_common.microphone_array import MicrophoneArray
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame, DoaArray

# Without sound for this long the node says so.
SILENT_S = 1.0
PARAMETERS_S = 1.0


class DoaNode(RigNode):
    """Listens to `audio/frames` and publishes `doa`. Frames that do not fit are reported and left out."""

    RENAMED_PARAMETERS: ClassVar = {'own_noise': 'ego_noise', 'own_rotors': 'ego_rotors',
                                    'own_rotor_count': 'ego_rotor_count', 'own_rotor_blades': 'ego_rotor_blades'}

    def __init__(self, **kwargs: object) -> None:
        super().__init__('doa_node', parameters, **kwargs)

    def configure(self) -> None:
        """Read the array and check the settings."""
        values = self.settings
        if not values.array_file:
            raise ValueError('array_file is empty, expected the path of an array file such as '
                             'config/arrays/two_microphones.yaml')
        self._array = MicrophoneArray.load(values.array_file)
        self._localizer_settings = self._read_settings()
        self._ego_noise = NoiseRecording.load(values.ego_noise) if values.ego_noise else None
        self._blades = values.ego_rotor_blades if values.ego_rotors == 'topic' else 0
        self._blade_pass_hz = np.zeros(0)
        self._localizer: Localizer | None = None
        self._last: DoaEstimate | None = None
        self._restarts = 0
        self._swaps = 0
        self._problem_with_frames = ''
        self._publisher = self.create_publisher(DoaArray, 'doa', RESULT)

    def _read_settings(self) -> LocalizerSettings:
        values = self.settings
        return LocalizerSettings(
            window_s=values.window, hop_s=values.hop, band_hz=(values.band_low, values.band_high), method=values.method,
            temperature_c=values.temperature, elevation_deg=(values.elevation_min_deg, values.elevation_max_deg),
            estimated_rotors=values.ego_rotor_count if values.ego_rotors == 'estimated' else 0)

    def _follow_parameters(self) -> None:
        """Take over what was changed at run time; what cannot be is reported and the old settings stay."""
        try:
            settings = self._read_settings()
        except ValueError as error:
            self.get_logger().error(f'parameters left as they were: {error}', throttle_duration_sec=10.0)
            return
        if settings != self._localizer_settings:
            self._localizer_settings = settings
            self._localizer = None

    def activate(self) -> None:
        """Begin to listen."""
        self.while_active(self.create_timer, PARAMETERS_S, self._follow_parameters)
        self._frames = RateMeter()
        self._swap_detector = SwapDetector()
        self.while_active(self.create_subscription, AudioFrame, 'audio/frames', self._on_frame, STREAM)
        if self._blades:
            self._motor_speeds = RateMeter()
            self.while_active(self.create_subscription, Float32MultiArray, 'motor_speeds', self._on_motor_speeds, STREAM)

    def deactivate(self) -> None:
        """Forget the sound heard so far."""
        self._localizer = None

    def cleanup(self) -> None:
        """Drop what `configure` made."""
        self.destroy_publisher(self._publisher)

    def _on_motor_speeds(self, message: Float32MultiArray) -> None:
        self._motor_speeds.tick()
        speeds = np.abs(np.asarray(message.data, dtype=float))
        self._blade_pass_hz = self._blades * speeds[np.isfinite(speeds)] / (2.0 * np.pi)

    def _on_frame(self, frame: AudioFrame) -> None:
        self._frames.tick()
        try:
            estimates = self._process(frame)
        except ValueError as error:
            if str(error) != self._problem_with_frames:
                self.get_logger().error(f'audio frame left out: {error}')
            self._problem_with_frames = str(error)
            self._localizer = None
            return
        self._problem_with_frames = ''
        for estimate in estimates:
            self._last = estimate
            self._swaps += self._array.channels == 2 and self._swap_detector.update(estimate)
            self._publisher.publish(self._message(estimate, frame))

    def _process(self, frame: AudioFrame) -> list[DoaEstimate]:
        """Raises ValueError when the frame contradicts itself or does not fit the array or the settings."""
        channels = self._array.channels
        if frame.channels != channels:
            raise ValueError(f'{frame.channels} channels, but the array {self._array.name} has {channels} microphones')
        if len(frame.samples) % channels:
            raise ValueError(f'{len(frame.samples)} samples are not a multiple of {channels} channels')
        if self._localizer is None or self._localizer.sample_rate != frame.sample_rate:
            self._localizer = Localizer(self._array, frame.sample_rate, self._localizer_settings, self._ego_noise)
        samples = np.asarray(frame.samples, np.float32).reshape(-1, channels)
        self._localizer.blade_pass_hz = self._blade_pass_hz
        before = self._localizer.restarts
        estimates = self._localizer.process(samples, frame.first_sample)
        self._restarts += self._localizer.restarts - before
        return estimates

    def _message(self, estimate: DoaEstimate, frame: AudioFrame) -> DoaArray:
        offset = (estimate.centre_sample - frame.first_sample) / frame.sample_rate
        stamp = max(0.0, to_seconds(frame.header.stamp) + offset)
        return doa_array(estimate, self._array, stamp, frame.header.frame_id, self._localizer_settings.window_s,
                         self._localizer_settings.method)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """What arrives, what is wrong with it, and how loud it is."""
        status.add('frames per second', f'{self._frames.rate:.1f}')
        status.add('windows restarted by gaps or unusable samples', str(self._restarts))
        status.add('sudden swaps of the channels', str(self._swaps))
        if self._last is not None:
            status.add('level', f'{self._last.level_dbfs:.1f} dBFS')
            status.add('confidence', f'{max(self._last.confidence, default=0.0):.2f}')
        if self._problem_with_frames:
            status.mergeSummary(DiagnosticStatus.ERROR, self._problem_with_frames)
        elif self._frames.age > SILENT_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no audio frames')
        elif self._last is not None and not len(self._last.azimuth):
            status.mergeSummary(DiagnosticStatus.WARN, 'the microphones are silent')
        if self._blades and self._motor_speeds.age > SILENT_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no motor speeds, own rotors are not left out')
        if self._swaps:
            status.mergeSummary(DiagnosticStatus.WARN, 'the channels have changed places while running')


def main() -> None:
    """Entry point."""
    run(DoaNode)
