"""Audio frames to directions of arrival: the stage that doa_node, replay and experiments share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Float32MultiArray

from av_audio.drone_classifier import DroneClassifier, Judgement, load_model
from av_audio.drone_features import HIGHEST_HZ
from av_audio.drone_model import DroneModel
from av_audio.ego_noise import EgoLearning, NoiseRecording
from av_audio.file_source import SAMPLE_RATES
from av_audio.health import ChannelFault, ChannelHealth
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings, distrusted
from av_audio.messages import doa_array, doa_odds, samples_of
from av_audio.wind import WindMeter
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray
from av_common.rate_meter import MISSING_AFTER_S
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame, DoaArray, DoaOdds

LONGEST_FRAME_S = 10.0  # the longest window
OWN_SOUND_S = 5.0  # over which the share of own sound is averaged
MOST_MOTORS = 64  # of one rig; each takes time in each window


class DoaStage:
    """Estimates directions of arrival in a stream of audio frames, by one method; several methods are several stages.

    Results depend on the frames and motor speeds only, not on when they arrive.

    Parameters:
        array: positions of the microphones, one per channel of the frames.
        settings: window, hop, band and method of the localizer; defaults where None.
        ego_noise: recording of the rig alone, by whose noise spectra are whitened; None whitens nothing.
        rotor_blades: blades of each of the rig's own rotors, with which motor speeds become the frequencies that are
            notched; 0 ignores motor speeds.
        drone_model: judges whether what is heard is a drone; None leaves the probability unknown, as does a sample rate below
            twice the highest frequency of its features.
    """

    def __init__(self, array: MicrophoneArray, settings: LocalizerSettings | None = None,
                 ego_noise: NoiseRecording | None = None, rotor_blades: int = 0, drone_model: DroneModel | None = None) -> None:
        self._array = array
        self._settings = settings or LocalizerSettings()
        self.ego_noise = EgoLearning(ego_noise)
        self._rotor_blades = rotor_blades
        self.blade_pass_hz: NDArray = np.zeros(0)  # of the newest motor speeds
        self._speeds_age_s = 0.0  # of sound since then
        self._drone_model = drone_model
        self._localizer: Localizer | None = None
        self._usable: list[int] = []  # channels without severe faults
        self.used: list[int] = []  # channels from which directions are estimated
        self._part = array  # of these
        self._classifier: DroneClassifier | None = None
        self._wind: WindMeter | None = None
        self._health: ChannelHealth | None = None
        self.latest: DoaEstimate | None = None
        self.odds: list[DoaOdds] = []  # of the windows that the newest frame completed, as far as they are known
        self.judgement = Judgement()  # of the strongest source in the newest window
        self.own_sound = 0.0  # mean probability that sound of the rig itself is louder than all other
        self.sample_rate = 0.0  # Hz, of the newest frame; 0 before the first
        self.restarts = 0  # windows that were restarted by gaps or unusable samples
        self.without_phases = 0  # directions without confidence, as a lossy code has removed phases

    @property
    def faults(self) -> list[ChannelFault]:
        """What is wrong with the channels."""
        return [] if self._health is None else self._health.faults

    @property
    def levels_dbfs(self) -> NDArray:
        """Levels (m,) of the channels."""
        return np.full(self._array.channels, -np.inf) if self._health is None else self._health.levels_dbfs

    @property
    def wind_dbfs(self) -> float:
        """Level of wind at the microphones, from 50 to 100 Hz; -inf without."""
        return -math.inf if self._wind is None else self._wind.level_dbfs

    @property
    def settings(self) -> LocalizerSettings:
        """Settings of the localizer; new ones discard the samples of unfinished windows."""
        return self._settings

    @settings.setter
    def settings(self, settings: LocalizerSettings) -> None:
        if settings != self._settings:
            self._settings = settings
            self.reset()

    def reset(self) -> None:
        """Discard the samples of unfinished windows."""
        self._localizer = self._classifier = None
        self.ego_noise.interrupt()
        if self._health is not None:
            self._health.clear()

    def on_motor_speeds(self, message: Float32MultiArray) -> None:
        """Take the speeds of the motors in rad/s, which hold for 1 s. Signs, and values that are not finite, do not matter.

        Raises ValueError for more than MOST_MOTORS.
        """
        if len(message.data) > MOST_MOTORS:
            raise ValueError(f'{len(message.data)} motors, expected at most {MOST_MOTORS}')
        if not self._rotor_blades:
            return
        speeds = np.abs(np.asarray(message.data, dtype=float))
        self.blade_pass_hz, self._speeds_age_s = self._rotor_blades * speeds[np.isfinite(speeds)] / (2.0 * np.pi), 0.0

    def on_audio(self, frame: AudioFrame, arrival: float) -> list[DoaArray]:
        """Directions for every window that a frame completes.

        Parameters:
            frame: the block of samples that follows the one before; a gap or a step back restarts the window.
            arrival (s): time of its arrival. Not used: results are stamped by the capture time of the frame.

        Raises ValueError when the frame contradicts itself or does not fit the array or the settings, and whatever a method of
        another package raises; unfinished windows are then discarded.
        """
        begin = to_seconds(frame.header.stamp)
        try:
            estimates = self.estimates(frame)
        except Exception:
            self.reset()
            raise
        messages, self.odds = list[DoaArray](), []
        for estimate in estimates:
            self.latest = estimate
            self.own_sound += min(1.0, self._settings.hop_s / OWN_SOUND_S) * (estimate.own - self.own_sound)
            judged = self._judge(estimate)
            self.judgement = judged[0]
            stamp = max(0.0, begin + (estimate.centre_sample - frame.first_sample) / frame.sample_rate)
            messages.append(doa_array(estimate, self._part, stamp, frame.header.frame_id, self._settings.window_s,
                                      self._settings.method, judged))
            if len(estimate.odds):
                self.odds.append(doa_odds(estimate, messages[-1].header))
        return messages

    def _judge(self, estimate: DoaEstimate) -> list[Judgement]:
        """What the newest second of sound from the direction of each source says."""
        if self._classifier is None or not len(estimate.q):
            return [Judgement()] * len(estimate.sources)
        return self._classifier.judge([source.q for source in estimate.sources], self.blade_pass_hz)

    def estimates(self, frame: AudioFrame) -> list[DoaEstimate]:
        """Directions for every window that a frame completes, not judged. Raises ValueError as `on_audio`."""
        if frame.channels != self._array.channels:
            raise ValueError(f'{frame.channels} channels, but the array {self._array.name} has {self._array.channels} '
                             f'microphones')
        if not SAMPLE_RATES[0] <= frame.sample_rate <= SAMPLE_RATES[1]:
            raise ValueError(f'sample_rate is {frame.sample_rate} Hz, expected {SAMPLE_RATES[0]} to {SAMPLE_RATES[1]}')
        longest = round(LONGEST_FRAME_S * frame.sample_rate) * frame.channels
        if len(frame.samples) > longest:
            raise ValueError(f'{len(frame.samples)} samples in a frame, expected at most {longest} ({LONGEST_FRAME_S:g} s)')
        samples = samples_of(frame)
        self._speeds_age_s += len(samples) / frame.sample_rate
        if self._speeds_age_s > MISSING_AFTER_S:
            self.blade_pass_hz = np.zeros(0)
        localizer = self._prepare(frame.sample_rate)
        localizer.blade_pass_hz = self.blade_pass_hz
        before, without = localizer.restarts, localizer.without_phases
        estimates = localizer.process(samples[:, self.used], frame.first_sample)
        restarts = localizer.restarts - before
        self.without_phases += localizer.without_phases - without
        self.restarts += restarts
        self._listen(samples, frame.sample_rate, restarts > 0)
        return estimates if self.used == self._usable else [distrusted(one) for one in estimates]

    def _prepare(self, rate: int) -> Localizer:
        """The localizer of a sample rate in Hz and of the channels that are all right; a new one begins a new window."""
        if self._health is None or self.sample_rate != rate:
            self._wind, self._health = WindMeter(self._array, rate), ChannelHealth(self._array.channels, rate, self._array)
            self._localizer, self.sample_rate = None, float(rate)
            self.ego_noise.begin_stream(rate)
        usable = self._health.usable
        if self._localizer is None or usable != self._usable:
            self._localizer, self._usable = self._localizer_of(usable, rate), usable
        return self._localizer

    def _localizer_of(self, usable: list[int], rate: int) -> Localizer:
        """A localizer of channels, or of all where these measure no direction; and the classifier that belongs to it."""
        try:
            self._part, self.used = self._array.part(usable), usable
        except ValueError:
            self._part, self.used = self._array, list(range(self._array.channels))
        ego_noise, self._classifier = self.ego_noise.known, None
        if ego_noise is not None and self._part is not self._array:
            ego_noise = ego_noise._replace(samples=ego_noise.samples[:, usable])
        localizer = Localizer(self._part, rate, self._settings, ego_noise)
        if self._drone_model is not None and rate >= 2.0 * HIGHEST_HZ:
            self._classifier = DroneClassifier(self._part, rate, speed_of_sound(self._settings.temperature_c),
                                               self._drone_model, ego_noise)
        return localizer

    def _listen(self, samples: NDArray, rate: int, begins: bool) -> None:
        """Take samples (n, m) at a rate in Hz, which may begin anew, for what is judged and learned beside directions."""
        if self._wind is None or self._health is None:
            return
        if begins:
            self._health.clear()
            self.ego_noise.interrupt()
            if self._classifier is not None:
                self._classifier.clear()
        if np.isfinite(samples).all():
            self._wind.add(samples)
            self._health.update(samples)
            if self._classifier is not None:
                self._classifier.add(samples[:, self.used])
            if self.ego_noise.add(samples, rate):
                self._localizer = None


def localizer_settings(parameters: Any, **changes: Any) -> LocalizerSettings:
    """Settings of the parameters of doa_node, with `changes` of fields of LocalizerSettings. Raises ValueError."""
    given = {
        'window_s': parameters.window, 'hop_s': parameters.hop, 'band_hz': (parameters.band_low, parameters.band_high),
        'method': parameters.method, 'max_sources': parameters.max_sources, 'temperature_c': parameters.temperature,
        'elevation_deg': (parameters.elevation_min_deg, parameters.elevation_max_deg)}
    return LocalizerSettings(**{**given, **changes})


def make_doa_stage(parameters: Any, array: MicrophoneArray | None = None, **changes: Any) -> DoaStage:
    """The stage that the parameters of doa_node describe.

    Parameters:
        parameters: generated struct of doa_node, from the node or from `av_common.parameters.node_parameters`.
        array: microphones to use instead of those of the parameter `array_file`.
        changes: fields of LocalizerSettings that differ from the parameters, such as `method`.

    Raises ValueError or OSError that name the parameter or file that cannot be used.
    """
    if array is None:
        if not parameters.array_file:
            raise ValueError('array_file is empty, expected the path of an array file such as '
                             'config/arrays/two_microphones.yaml')
        array = MicrophoneArray.load(parameters.array_file)
    ego_noise = NoiseRecording.load(parameters.ego_noise) if parameters.ego_noise else None
    return DoaStage(array, localizer_settings(parameters, **changes), ego_noise, parameters.ego_rotor_blades,
                    load_model(parameters.drone_model))
