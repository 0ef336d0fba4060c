"""Sound in, directions of arrival out: the object behind doa_node, `localize` and offline replay."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_audio.baselines import Music, Mvdr
from av_audio.ego_noise import EgoNoise, NoiseRecording
from av_audio.ego_rotors import find_blade_pass, notch
from av_audio.spectra import SpectrumAnalyzer
from av_audio.steered_response import Peak, SteeredResponse
from av_audio.weighting import Weighting, maximum_likelihood, phat, plain
from av_common.acoustics import speed_of_sound
from av_common.angles import direction_to_angles, wrap
from av_common.microphone_array import MicrophoneArray

METHODS: dict[str, tuple[type[SteeredResponse], Weighting]] = {
    'ml': (SteeredResponse, maximum_likelihood),
    'phat': (SteeredResponse, phat),
    'plain': (SteeredResponse, plain),
    'music': (Music, maximum_likelihood),
    'mvdr': (Mvdr, maximum_likelihood),
}
# A significance of 2.8 is as likely noise as a source; both numbers were fitted to the share of wrong peaks over
# simulated drones in noise (`ros2 run av_audio benchmark sigma` shows how well they hold).
EVEN_SIGNIFICANCE = 2.8
SIGNIFICANCE_SLOPE = 1.9
# Windows with more clipped samples than this are worth nothing.
CLIPPED_SHARE = 0.01
FULL_SCALE = 0.999
# Below this level there is no sound but the converter's last bits.
SILENCE_DBFS = -100.0
# Within 15 degrees of the axis of a line of microphones an error of the delay becomes a large error of the angle.
END_FIRE_COSINE = float(np.cos(np.radians(15.0)))

POSTERIOR_STEPS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class LocalizerSettings:
    """What the user may choose. Raises ValueError when out of bounds."""

    window_s: float = 0.5
    hop_s: float = 0.1
    band_hz: tuple[float, float] = (200.0, 4000.0)
    method: str = 'ml'
    temperature_c: float = 20.0
    elevation_deg: tuple[float, float] = (0.0, 90.0)  # mirror images outside of this range are left out
    estimated_rotors: int = 0  # so many own rotors are looked for in the sound and notched

    def __post_init__(self) -> None:
        if not 0.02 <= self.window_s <= 10.0:
            raise ValueError(f'window_s={self.window_s}, expected 0.02..10 s')
        if not 0.001 <= self.hop_s <= 60.0:
            raise ValueError(f'hop_s={self.hop_s}, expected 0.001..60 s')
        if self.method not in METHODS:
            raise ValueError(f'method={self.method!r}, expected one of {", ".join(METHODS)}')
        if not 0 <= self.estimated_rotors <= 16:
            raise ValueError(f'estimated_rotors={self.estimated_rotors}, expected 0..16')
        if not -90.0 <= self.elevation_deg[0] < self.elevation_deg[1] <= 90.0:
            raise ValueError(f'elevation_deg={self.elevation_deg}, expected a rising range within -90..90')


@dataclass(frozen=True)
class DoaEstimate:
    """What one window says. Arrays (k,) have one entry per hypothesis; k = 0 when the window is silent.

    time: s of the window's centre since sample 0; azimuth, elevation in rad in the array's frame, variances in rad^2
    (inf where the array cannot tell); confidence 0..1; group: mirror images share a number, exactly one of them is
    true; end_fire: the angle is hardly resolved; level in dB relative to full scale after the band-pass; q (rank,) is
    what was measured, before calibration: the direction's projection on the array's basis.
    """

    time: float
    centre_sample: float
    azimuth: NDArray
    elevation: NDArray
    azimuth_variance: NDArray
    elevation_variance: NDArray
    confidence: NDArray
    group: NDArray
    end_fire: NDArray
    level_dbfs: float
    q: NDArray


class Localizer:
    """Cuts a stream into overlapping windows and estimates the direction of arrival in each.

    `ego_noise` is a recording of the rig alone, whose noise is taken off. Raises ValueError when it or the settings do not
    fit the array or the sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, settings: LocalizerSettings | None = None,
                 ego_noise: NoiseRecording | None = None) -> None:
        settings = settings or LocalizerSettings()
        self.array = array
        self.sample_rate = sample_rate
        self.settings = settings
        # Of the rig's own rotors: their harmonics are left out. May change at any time.
        self.blade_pass_hz: NDArray = np.zeros(0)
        self.restarts = 0  # how often a gap or unusable samples made the window start anew
        self._window = round(settings.window_s * sample_rate)
        self._hop = max(1, round(settings.hop_s * sample_rate))
        self._analyzer = SpectrumAnalyzer(sample_rate, self._window, settings.band_hz)
        estimator, weighting = METHODS[settings.method]
        self._estimator = estimator(array, self._analyzer.frequencies, self._analyzer.response,
                                    speed_of_sound(settings.temperature_c), weighting)
        if ego_noise is not None:
            self._estimator.ego_noise = self._learn(ego_noise)
        self._elevations = np.radians(settings.elevation_deg)
        # Room for two windows, so that one slides a whole window before it is copied back to the beginning.
        self._buffer = np.zeros((array.channels, 2 * self._window), np.float32)
        self._begin = 0  # where the current window lies in the buffer
        self._filled = 0  # how much of it is there; negative while samples between two windows are skipped
        self._next_sample: int | None = None

    @property
    def next_sample(self) -> int:
        """Index of the sample that continues the stream without a gap."""
        return self._next_sample or 0

    def process(self, samples: ArrayLike, first_sample: int) -> list[DoaEstimate]:
        """Estimates of the windows that samples (n, m) complete; `first_sample` is their index in the stream.

        A gap or a step back of the index, and samples that are not finite, start the window anew, so that no estimate
        mixes sound of different times.
        """
        samples = np.asarray(samples, np.float32)
        if samples.ndim != 2 or samples.shape[1] != self.array.channels:
            raise ValueError(f'samples of shape {samples.shape}, expected (n, {self.array.channels}) for the array '
                             f'{self.array.name}')
        finite = bool(np.isfinite(samples).all())
        if self._next_sample is not None and (first_sample != self._next_sample or not finite):
            self.restarts += 1
            self._filled = 0
        self._next_sample = first_sample + len(samples)
        if not finite:
            return []
        estimates = []
        taken = 0
        while taken < len(samples):
            count = min(len(samples) - taken, (self._window if self._filled >= 0 else 0) - self._filled)
            if self._filled >= 0:
                end = self._begin + self._filled
                self._buffer[:, end:end + count] = samples[taken:taken + count].T
            taken += count
            self._filled += count
            if self._filled == self._window:
                window = self._buffer[:, self._begin:self._begin + self._window]
                estimates.append(self._estimate(window, first_sample + taken - self._window))
                self._slide()
        return estimates

    def _learn(self, ego_noise: NoiseRecording) -> EgoNoise:
        ego_noise.check(self.array.channels, self.sample_rate)
        starts = range(0, len(ego_noise.samples) - self._window + 1, max(1, self._window // 2))
        if not starts:
            raise ValueError(f'{ego_noise.name} is shorter than a window of {self.settings.window_s:g} s')
        windows = (self._analyzer.spectra(ego_noise.samples[start:start + self._window].T) for start in starts)
        return EgoNoise(windows, self.sample_rate / self._window)

    def _slide(self) -> None:
        self._filled -= self._hop
        self._begin += self._hop
        if self._begin > self._window or self._filled <= 0:
            self._buffer[:, :max(0, self._filled)] = self._buffer[:, self._begin:self._begin + max(0, self._filled)]
            self._begin = 0

    def _estimate(self, window: NDArray, start: int) -> DoaEstimate:
        centre = start + 0.5 * self._window
        spectra = self._analyzer.spectra(window)
        level = self._analyzer.level_dbfs(spectra)
        if level < SILENCE_DBFS:
            nothing = np.zeros(0)
            return DoaEstimate(centre / self.sample_rate, centre, nothing, nothing, nothing, nothing, nothing,
                               np.zeros(0, int), np.zeros(0, bool), level, nothing)
        peak = self._estimator.estimate(self._without_ego_rotors(spectra))
        q, slope = self._straighten(peak.q)
        angles, variances = self._directions(q, slope**2 * peak.covariance)
        if peak.bias.any():  # the angle stays where it is: what reflections did to it has no mean that we knew
            variances = self._directions(q, slope**2 * (peak.covariance + peak.bias))[1]
        kept = self._kept(angles)
        count = int(kept.sum())
        end_fire = self.array.rank == 1 and abs(q[0]) > END_FIRE_COSINE
        return DoaEstimate(
            centre / self.sample_rate, centre, *angles[:, kept], *variances[:, kept],
            np.full(count, self._confidence(peak, window)), np.zeros(count, int), np.full(count, end_fire), level, peak.q)

    def _without_ego_rotors(self, spectra: NDArray) -> NDArray:
        """Spectra (m, k) with zeros where the rig's own rotors sound."""
        frequencies = self._analyzer.frequencies
        own = self.blade_pass_hz
        if self.settings.estimated_rotors:
            power = np.mean(np.abs(spectra) ** 2, axis=0)
            own = np.concatenate([own, find_blade_pass(frequencies, power, self.settings.estimated_rotors)])
        return spectra * notch(frequencies, own) if len(own) else spectra

    def _confidence(self, peak: Peak, window: NDArray) -> float:
        source = 1.0 / (1.0 + np.exp(-SIGNIFICANCE_SLOPE * (peak.significance - EVEN_SIGNIFICANCE)))
        loud = max(float(window.max()), -float(window.min())) >= FULL_SCALE
        clipped = np.count_nonzero(np.abs(window) >= FULL_SCALE) / window.size if loud else 0.0
        return float(source * peak.main_share * max(0.0, 1.0 - clipped / CLIPPED_SHARE))

    def _straighten(self, q: NDArray) -> tuple[NDArray, NDArray | float]:
        """Return q with the array's delay curve undone, and the slope of doing so."""
        curve = self.array.delay_curve
        if curve is None:
            return q, 1.0
        step = 1e-3
        slope = (curve.true_cosine(q + step) - curve.true_cosine(q - step)) / (2.0 * step)
        return curve.true_cosine(q), slope

    def _directions(self, q: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Azimuths and elevations (2, k) of the mirror images, and their variances (2, k).

        The variances come from points one sigma away along the covariance's axes, the further side counting.
        """
        if not np.all(np.isfinite(covariance)):
            angles = np.array(direction_to_angles(self.array.hypotheses(q)))
            return angles, np.full_like(angles, np.inf)
        if self.array.rank == 1:
            angle, sigma = angle_to_axis(float(q[0]), math.sqrt(covariance[0, 0]))
            axis = self.array.basis[:, 0]
            if axis[2] == 0.0:  # the usual case in closed form, as it is the most frequent
                turn = math.atan2(axis[1], axis[0])
                azimuths = math.remainder(turn - angle, math.tau), math.remainder(turn + angle, math.tau)
                return np.array([azimuths, (0.0, 0.0)]), np.array([(sigma**2, sigma**2), (np.inf, np.inf)])
            points = np.cos([[angle], [min(angle + sigma, np.pi)], [max(angle - sigma, 0.0)]])
        else:
            eigenvalues, axes = np.linalg.eigh(covariance)
            offsets = (axes * np.sqrt(np.maximum(eigenvalues, 0.0))).T
            points = np.concatenate([q[None], q + offsets, q - offsets])
        angles, *sides = np.moveaxis(np.array(direction_to_angles(self.array.hypotheses(points))), 1, 0)
        deviations = wrap(np.array(sides) - angles) ** 2
        variances = np.maximum(*np.split(deviations, 2)).sum(axis=0)
        if self.array.rank == 1:
            variances[1] = np.inf
        return angles, variances

    def _kept(self, angles: NDArray) -> NDArray:
        """Which hypotheses (k,) to keep of angles (2, k): those in the elevation range, or the one nearest to it.

        Where two coincide, in the plane of a flat array, one is kept.
        """
        low, high = self._elevations
        outside = np.maximum(low - angles[1], angles[1] - high)
        kept = outside <= max(float(outside.min()), 1e-9)
        if self.array.rank == 2 and np.allclose(angles[:, 0], angles[:, 1], atol=1e-6):
            kept[1] = False
        return kept


def angle_to_axis(cosine: float, sigma: float) -> tuple[float, float]:
    """Mean and standard deviation in rad of the angle whose cosine was measured with a normal error `sigma`.

    The posterior mean under a uniform prior of the angle. Unlike arccos, it has no bias and no infinite derivative at
    end-fire, and its error over the full circle is 13 % smaller. Away from there it is arccos and sigma / sin.
    """
    nearest, furthest = (math.acos(max(-1.0, min(1.0, cosine + side * sigma))) for side in (5.0, -5.0))
    angles = nearest + (furthest - nearest) * POSTERIOR_STEPS
    deviations = ((np.cos(angles) - cosine) / max(sigma, 1e-9)) ** 2
    likelihood = np.exp(-0.5 * (deviations - deviations.min()))
    likelihood[[0, -1]] *= 0.5
    likelihood /= likelihood.sum()
    mean = float(likelihood @ angles)
    return mean, float(np.sqrt(likelihood @ (angles - mean) ** 2))
