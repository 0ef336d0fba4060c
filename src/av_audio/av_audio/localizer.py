"""Directions of arrival in a stream of samples, one estimate per analysis window."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_audio.directions import END_FIRE_COSINE, Array, to_directions, undo_delay_curve, within_elevations
from av_audio.ego_noise import NoiseRecording, without_lines
from av_audio.estimators import METHODS, make_estimator
from av_audio.further_sources import MOST_SOURCES
from av_audio.health import DEAD_DBFS
from av_audio.lost_phase import has_lost_phases
from av_audio.methods import DOA_METHODS, WindowMethod, peak_of
from av_audio.near_field import NearField
from av_audio.steered_response import Peak
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import COSINES, MicrophoneArray

# The logarithm of the likelihood by a coherence of 1 between the microphones, and the share of windows whose curve does not
# tell where a source is. Fitted to a drone and a pair that move in 30 random rooms.
NATS, MISSING = 60.0, 0.05
# A direction of less than this (q, a cosine; 3 deg) is that of no delay, which sound without phases has.
NO_DELAY = 0.05


@dataclass(frozen=True)
class LocalizerSettings:
    """Settings of the localizer.

    Parameters:
        window_s (s): length of the analysis window, 0.02 to 10.
        hop_s (s): time between the beginnings of consecutive windows, 0.001 to 60.
        band_hz (Hz): lower and upper edge of the band-pass filter.
        method: name of the estimator, one of METHODS or of another package (see `methods.py`).
        temperature_c (degrees Celsius): temperature of the air, for the speed of sound.
        elevation_deg (deg): range of elevation of possible sources; mirror images outside are discarded.
        max_sources: largest number of sources in one window, 1 to MOST_SOURCES.

    Raises ValueError when one is out of bounds.
    """

    window_s: float = 0.5
    hop_s: float = 0.1
    band_hz: tuple[float, float] = (200.0, 4000.0)
    method: str = 'ml'
    temperature_c: float = 20.0
    elevation_deg: tuple[float, float] = (0.0, 90.0)
    max_sources: int = 2

    def __post_init__(self) -> None:
        if not 0.02 <= self.window_s <= 10.0:
            raise ValueError(f'window_s={self.window_s}, expected 0.02..10 s')
        if not 0.001 <= self.hop_s <= 60.0:
            raise ValueError(f'hop_s={self.hop_s}, expected 0.001..60 s')
        DOA_METHODS.check(self.method)
        if not 1 <= self.max_sources <= MOST_SOURCES:
            raise ValueError(f'max_sources={self.max_sources}, expected 1..{MOST_SOURCES}')
        low, high = self.band_hz
        if not 0.0 < low < high < np.inf:
            raise ValueError(f'band_low is {low:g} Hz, expected more than 0 and less than band_high ({high:g} Hz)')
        low, high = self.elevation_deg
        if not -90.0 <= low < high <= 90.0:
            raise ValueError(f'elevation_min_deg is {low:g}, expected at least -90 and less than elevation_max_deg ({high:g}), '
                             'which is at most 90')


@dataclass(frozen=True)
class DoaEstimate:
    """Direction of the strongest source in one window. Arrays (k,) have one entry per hypothesis; k = 0 in silence.

    Parameters:
        time (s): centre of the window since sample 0.
        centre_sample: index of the sample at the centre of the window.
        azimuth (k,): rad in the array's frame, counter-clockwise from x.
        elevation (k,): rad, up from the horizontal plane.
        azimuth_variance (k,): rad^2.
        elevation_variance (k,): rad^2, inf where the array does not resolve elevation.
        confidence (k,): probability 0..1 that the direction stems from a source.
        group (k,): mirror images share a number; exactly one of them is true.
        end_fire (k,): whether the angle is poorly resolved, close to the axis of a linear array.
        level_dbfs (dB): level after the band-pass filter, relative to full scale.
        q (rank,): measured projection of the direction on the array's basis, before the delay curve is undone.
        cosine: cosine of the estimated angle to the axis of a linear array (see `Directions`). NaN for other
            arrays and in silence.
        cosine_variance: variance of its error, reflections included; NaN as the cosine.
        odds (n,): at COSINES of the angle to the axis of a linear array, as a density over an even one, those of a source there
            over none; empty where they are not known.
        own: probability that sound of the rig itself is louder than all other (see `NearField`); confidences count it.
        further: estimates of the other sources in the same window.
    """

    time: float
    centre_sample: float
    azimuth: Array
    elevation: Array
    azimuth_variance: Array
    elevation_variance: Array
    confidence: Array
    group: NDArray[np.int_]
    end_fire: NDArray[np.bool_]
    level_dbfs: float
    q: Array
    cosine: float = np.nan
    cosine_variance: float = np.nan
    odds: Array = field(default_factory=lambda: np.zeros(0))
    own: float = 0.0
    further: tuple[DoaEstimate, ...] = ()

    @property
    def sources(self) -> tuple[DoaEstimate, ...]:
        """The estimates of all sources, the strongest first."""
        return (self, *self.further)


def distrusted(estimate: DoaEstimate) -> DoaEstimate:
    """An estimate without confidence: by channels that are known to be at fault."""
    return replace(estimate, confidence=np.zeros(len(estimate.confidence)), odds=np.zeros(0),
                   further=tuple(map(distrusted, estimate.further)))


class Localizer:
    """Cuts a stream into overlapping windows and estimates the direction of arrival in each.

    Parameters:
        array: positions of the microphones, one per channel.
        sample_rate (Hz): sample rate of the stream.
        settings: defaults where None.
        ego_noise: recording of the rig alone, by which spectra are whitened; None whitens nothing. Methods of other packages
            do not use it.

    Raises ValueError when settings or recording do not fit the array or the sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, settings: LocalizerSettings | None = None,
                 ego_noise: NoiseRecording | None = None) -> None:
        settings = settings or LocalizerSettings()
        self.array = array
        self.sample_rate = sample_rate
        self.settings = settings
        # Blade-pass frequencies (r,) in Hz of the rig's own rotors, whose harmonics are notched. May change at any time.
        self.blade_pass_hz: Array = np.zeros(0)
        self.restarts = 0  # how often a gap or unusable samples restarted the window
        self.without_phases = 0  # directions without confidence, as a lossy code has removed phases
        self._window = round(settings.window_s * sample_rate)
        self._hop = max(1, round(settings.hop_s * sample_rate))
        self._foreign: WindowMethod | None = None
        if settings.method not in METHODS:
            self._foreign = DOA_METHODS.load(settings.method)(array, sample_rate)
            ego_noise = None  # it takes samples as they are
        self._analyzer, self._find = make_estimator(
            settings.method if self._foreign is None else 'plain', array, sample_rate, self._window, settings.band_hz,
            speed_of_sound(settings.temperature_c), ego_noise)
        self._near: NearField | None = None  # what a recording whitens needs none
        if ego_noise is None:
            self._near = NearField(array, self._analyzer.frequencies, speed_of_sound(settings.temperature_c))
        self._elevations = np.radians(settings.elevation_deg)
        self._waiting = np.zeros((array.channels, 0), np.float32)  # samples up to the newest one
        self._begin = 0  # index of the first sample of the next window
        self._next_sample: int | None = None

    @property
    def next_sample(self) -> int:
        """Index of the sample that continues the stream without a gap."""
        return self._next_sample or 0

    def process(self, samples: ArrayLike, first_sample: int) -> list[DoaEstimate]:
        """Estimates of the windows that a block of samples completes.

        A gap or a step back of the index, and samples that are not finite, restart the window, so that no estimate
        mixes sound of different times.

        Parameters:
            samples (n, channels): full scale 1.
            first_sample: index of the first of them in the stream.

        Raises ValueError when the shape does not fit the array.
        """
        block = np.asarray(samples, np.float32)
        if block.ndim != 2 or block.shape[1] != self.array.channels:
            raise ValueError(f'samples of shape {block.shape}, expected (n, {self.array.channels}) for the array '
                             f'{self.array.name}')
        finite = bool(np.isfinite(block).all())
        if first_sample != self._next_sample or not finite:
            self.restarts += self._next_sample is not None
            self._begin = first_sample if finite else first_sample + len(block)
        self._next_sample = first_sample + len(block)
        self._waiting = np.concatenate([self._waiting, block.T], axis=1)
        estimates = []
        while self._begin + self._window <= self._next_sample:
            place = self._waiting.shape[1] - (self._next_sample - self._begin)
            estimates.append(self._estimate(self._waiting[:, place:place + self._window], self._begin))
            self._begin += self._hop
        unused = self._waiting.shape[1] - max(0, self._next_sample - self._begin)
        self._waiting = self._waiting[:, unused:]
        return estimates

    def _estimate(self, window: NDArray[np.float32], start: int) -> DoaEstimate:
        centre = start + 0.5 * self._window
        spectra = self._analyzer.spectra(window)
        level = self._analyzer.level_dbfs(spectra)
        if level < DEAD_DBFS:
            return self._nothing(centre, level)
        own = 0.0
        if self._near is not None:  # a recording whitens lines, too
            own = self._near.probability(spectra)
            spectra = without_lines(spectra, self._analyzer.frequencies, self.blade_pass_hz)
        if self._foreign is not None:
            peaks = [peak_of(found, self.array) for found in self._foreign(window.T)[:self.settings.max_sources]]
            if not peaks:
                return self._nothing(centre, level)
        else:
            peaks = self._find(spectra, self.settings.max_sources)
        first, *further = (self._estimate_of(peak, k, window, centre, level, own) for k, peak in enumerate(peaks))
        return replace(first, further=tuple(further))

    def _nothing(self, centre: float, level: float) -> DoaEstimate:
        empty = np.zeros(0)
        return DoaEstimate(centre / self.sample_rate, centre, empty, empty, empty, empty, empty,
                           np.zeros(0, int), np.zeros(0, bool), level, empty)

    def _estimate_of(self, peak: Peak, group: int, window: NDArray[np.float32], centre: float, level: float, own: float
                     ) -> DoaEstimate:
        bias = peak.bias if self.array.delay_curve is None else peak.bias + self.array.delay_curve.sigma_at(peak.q)**2
        q, (alone, covariance) = undo_delay_curve(self.array, peak.q, peak.covariance, peak.covariance + bias)
        found = to_directions(self.array, q, covariance, alone)
        kept = within_elevations(self.array, found.angles, self._elevations)
        count = int(kept.sum())
        probability = (1.0 - own) * self._source_probability(peak, window)
        return DoaEstimate(
            centre / self.sample_rate, centre, azimuth=found.angles[0, kept], elevation=found.angles[1, kept],
            azimuth_variance=found.variances[0, kept], elevation_variance=found.variances[1, kept],
            confidence=np.full(count, probability * peak.main_share), group=np.full(count, group),
            end_fire=np.full(count, self.array.rank == 1 and abs(float(q[0])) > END_FIRE_COSINE), level_dbfs=level, q=peak.q,
            cosine=found.cosine, cosine_variance=found.cosine_variance,
            odds=odds_over_cosines(self.array, peak, probability), own=own)

    def _source_probability(self, peak: Peak, window: NDArray[np.float32]) -> float:
        if float(np.linalg.norm(peak.q)) < NO_DELAY and has_lost_phases(window, self.sample_rate):
            self.without_phases += 1
            return 0.0
        return peak.source_probability


def odds_over_cosines(array: MicrophoneArray, peak: Peak, probability: float) -> Array:
    """Odds (n,) that a source is at each of COSINES rather than nowhere, by all peaks of a curve; empty without one.

    Parameters:
        array: the microphones.
        peak: the highest peak.
        probability: that there is a source.
    """
    if peak.curve is None or array.delay_curve is not None:
        return np.zeros(0)
    places, response = peak.curve
    likelihood = np.exp(NATS * (np.interp(COSINES, places, response) - response.max()))
    told = (1.0 - MISSING) * probability
    return np.asarray(told / (1.0 - told) * likelihood / likelihood.mean())
