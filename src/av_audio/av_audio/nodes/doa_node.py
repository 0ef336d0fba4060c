"""Node that turns audio frames into directions of arrival."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_msgs.msg import Float32MultiArray
from std_srvs.srv import Trigger

from av_audio.ego_noise import LEARNED_S
from av_audio.nodes.doa_node_parameters import doa_node as parameters
from av_audio.stage import localizer_settings, make_doa_stage
from av_audio.start_check import check_ages, check_hearing
from av_common.microphone_array import MicrophoneArray
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import MISSING_AFTER_S, RateMeter
from av_common.refused_inputs import RECENT_S
from av_interfaces.msg import AudioFrame, DoaArray, DoaOdds


class DoaNode(RigNode):
    """Subscribes to `audio/frames` and publishes `doa`. Frames that do not fit are refused."""

    RUNTIME_PARAMETERS: ClassVar[frozenset[str]] = frozenset({
        'method', 'window', 'hop', 'band_low', 'band_high', 'max_sources', 'temperature', 'elevation_min_deg',
        'elevation_max_deg'})

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('doa_node', parameters, **kwargs)

    def configure(self) -> None:
        """Load the array and check the settings. Raises ValueError or OSError."""
        self._stage = make_doa_stage(self.settings)
        self._needs_motor_speeds, self._rotors_turn = self.settings.ego_rotor_blades > 0, False
        self._frames, self._motor_speeds = RateMeter(), RateMeter()
        self._publisher = self.create_publisher(DoaArray, 'doa', RESULT)
        self._odds_publisher = self.create_publisher(DoaOdds, 'doa/odds', RESULT)

    def activate(self) -> None:
        """Subscribe."""
        self._frames, self._motor_speeds, self._without_phases = RateMeter(), RateMeter(), RateMeter()
        self.create_subscription(AudioFrame, 'audio/frames', self._on_audio, STREAM)
        self.refuse_second_publishers('audio/frames', *(['motor_speeds'] if self._needs_motor_speeds else []))
        self.create_subscription(Float32MultiArray, 'motor_speeds', self._on_motor_speeds, STREAM)
        self.create_service(Trigger, '~/learn_ego_noise', self._on_learn_ego_noise)

    def deactivate(self) -> None:
        """Discard the samples of unfinished windows, motor speeds, and what was learned of the rig's noise."""
        self._stage.ego_noise.forget()
        self._stage.on_motor_speeds(Float32MultiArray())
        self._stage.reset()

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Band and elevations must rise; and by all of them something must be heard, in time."""
        localizer_settings(settings)
        check_ages(settings.window, settings.hop)
        if Path(settings.array_file).is_file():  # else `configure` says so
            check_hearing(settings, MicrophoneArray.load(settings.array_file))

    def check_change(self, settings: Any) -> None:
        """The band must not reach beyond half of the sample rate of the newest frames."""
        nyquist = 0.5 * self._stage.sample_rate
        if nyquist and not settings.band_high <= nyquist:
            raise ValueError(f'band_high is {settings.band_high:g} Hz, expected at most half of the sample rate ({nyquist:g})')

    def apply_parameters(self) -> None:
        """Use the new settings from the next window on."""
        self._stage.settings = localizer_settings(self.settings)

    def _on_motor_speeds(self, message: Float32MultiArray) -> None:
        self._stage.on_motor_speeds(message)
        self._motor_speeds.tick()
        self._rotors_turn = any(abs(speed) > 0.0 for speed in message.data)

    def _on_learn_ego_noise(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stage.ego_noise.begin()
        response.success, response.message = True, f'what is heard in the next {LEARNED_S:g} s is taken for the rig alone'
        return response

    def _on_audio(self, frame: AudioFrame) -> None:
        self._frames.tick()
        if self.contested:
            return
        before = self._stage.without_phases
        messages = self._stage.on_audio(frame, self.now())
        for odds in self._stage.odds:  # first, as they belong to what follows
            self._odds_publisher.publish(odds)
        for message in messages:
            self._publisher.publish(message)
        if self._stage.without_phases > before:
            self._without_phases.tick()

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Rate of frames, and level."""
        latest = self._stage.latest
        status.add('frames per second', f'{self._frames.rate:.1f}')
        status.add('windows restarted by gaps or unusable samples', str(self._stage.restarts))
        status.add('directions without phases', str(self._stage.without_phases))
        status.add('blade pass of own rotors', ', '.join(f'{hz:.0f} Hz' for hz in self._stage.blade_pass_hz) or 'none')
        if latest is not None:
            status.add('level', f'{latest.level_dbfs:.1f} dBFS; of the channels ' +
                       ', '.join(f'{level:.1f}' for level in self._stage.levels_dbfs))
            status.add('channels used', ', '.join(map(str, self._stage.used)))
            status.add('sources', str(len(latest.sources)))
            status.add('wind', f'{self._stage.wind_dbfs:.0f} dBFS' if math.isfinite(self._stage.wind_dbfs) else 'none')
            status.add('confidence', f'{max(latest.confidence, default=0.0):.2f}')
            status.add('own sound is loudest', f'{self._stage.own_sound:.2f}')
            status.add('drone probability', f'{self._stage.judgement.probability:.2f}')
            status.add('fundamental', f'{self._stage.judgement.fundamental:.0f} Hz')
        if self._frames.age > MISSING_AFTER_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no audio frames')
        elif latest is not None and not len(latest.azimuth):
            status.mergeSummary(DiagnosticStatus.WARN, 'the microphones are silent')
        elif latest is not None and self._stage.wind_dbfs > latest.level_dbfs:
            status.mergeSummary(DiagnosticStatus.WARN, 'wind at the microphones, louder below 100 Hz than all sound')
        if self._needs_motor_speeds and self._motor_speeds.age > MISSING_AFTER_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no motor speeds, ego-rotors are not notched')
        self._diagnose_own_sound(status)
        if self._without_phases.age <= RECENT_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'a lossy code has removed the phases between the channels')
        for fault in self._stage.faults:
            status.mergeSummary(DiagnosticStatus.ERROR if fault.is_severe else DiagnosticStatus.WARN, str(fault))

    def _diagnose_own_sound(self, status: DiagnosticStatusWrapper) -> None:
        noise = self._stage.ego_noise
        status.add('ego-noise', ('learning; ' if noise.is_learning else '') + (noise.known.name if noise.known else 'none'))
        if noise.refusal:
            status.mergeSummary(DiagnosticStatus.WARN, f'nothing learned: {noise.refusal}')
        if self._stage.own_sound > 0.5:
            status.mergeSummary(DiagnosticStatus.WARN, 'the loudest sound comes from within half a metre, as of own rotors: '
                                'directions have little confidence; record it for ego_noise with record_ego_noise')
        elif self._rotors_turn and self._motor_speeds.age <= MISSING_AFTER_S and not noise.known:
            status.mergeSummary(DiagnosticStatus.WARN, 'rotors turn and ego_noise names no recording of them: directions may '
                                'be theirs; make one with record_ego_noise')


def main() -> None:
    """Entry point."""
    run(DoaNode)
