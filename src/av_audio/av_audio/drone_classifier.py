"""How likely the sound from each direction of a window is that of a drone, and its fundamental, by spectra that are steered."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import minimum_filter1d

from av_audio.drone_features import FRAME_S, FUNDAMENTAL_SIGMA, HOP_S, SEGMENT_FRAMES, DroneFeatures, Segment, bin_frequencies
from av_audio.drone_model import DroneModel
from av_audio.ego_noise import BAND_HZ, EgoNoise, NoiseRecording, covariance, notch
from av_common.microphone_array import MicrophoneArray
from av_common.shipped import shipped_file

MAIN_LOBE_BINS = 5  # of the taper, a Hann window
# Of the diagonal, added to the least squares of several sources: where their phases are hardly different, they share the power.
LOADING = 0.1
LEAST_TOTAL = 0.1  # share of the power at the microphones that at least remains when that of others is removed


class Judgement(NamedTuple):
    """What the newest second of the sound from a direction says, by itself.

    Parameters:
        probability: that it is a drone's, if drones were as frequent as all else: the sigmoid of the logarithm of the ratio of
            the likelihoods of drones and of all else. NaN while unknown.
        fundamental (Hz), variance (Hz^2): of its harmonics; NaN where none stand out.
    """

    probability: float = math.nan
    fundamental: float = math.nan
    variance: float = math.nan


class SourceSpectra:
    """Keeps the spectra of the last `SEGMENT_FRAMES` frames and gives what of them came from a direction.

    Parameters:
        array: positions of the microphones.
        sample_rate (Hz): sample rate, at least twice the highest frequency of the features.
        speed_of_sound (m/s): speed of sound.
        ego_noise: recording of the rig alone, by which spectra are whitened; None whitens nothing.

    Raises ValueError for a recording that does not fit the array or the sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float,
                 ego_noise: NoiseRecording | None = None) -> None:
        self._frame, self._hop = round(FRAME_S * sample_rate), round(HOP_S * sample_rate)
        self._frequencies = bin_frequencies()
        self._used = slice(round(self._frequencies[0] * FRAME_S), round(self._frequencies[-1] * FRAME_S) + 1)
        self._taper = np.hanning(self._frame).astype(np.float32)[:, None]
        self._lead = (array.positions @ array.basis / speed_of_sound).astype(np.float32)  # (m, rank): s that each leads
        self._omega = (2.0 * np.pi * self._frequencies).astype(np.float32)
        self._samples = np.zeros((0, array.channels), np.float32)
        self._spectra: deque[NDArray] = deque(maxlen=SEGMENT_FRAMES)
        self._bins = round(BAND_HZ * FRAME_S)
        self._bands = np.minimum(np.arange(len(self._frequencies)) // self._bins, len(self._frequencies) // self._bins - 1)
        self._ego_noise = None
        if ego_noise is not None:
            ego_noise.check(array.channels, sample_rate)
            frames = (self._spectrum(window.T)[None] for window in ego_noise.windows(self._frame))
            self._ego_noise = EgoNoise([self._by_band(frame) for frame in frames])

    @property
    def is_full(self) -> bool:
        """Whether a whole segment is present."""
        return len(self._spectra) == SEGMENT_FRAMES

    def clear(self) -> None:
        """Discard everything, after a gap."""
        self._samples = self._samples[:0]
        self._spectra.clear()

    def add(self, samples: NDArray[np.float32]) -> None:
        """Take the next samples (n, m) of the stream, full scale 1."""
        self._samples = np.concatenate([self._samples, samples])
        while len(self._samples) >= self._frame:
            self._spectra.append(self._spectrum(self._samples[:self._frame]))
            self._samples = self._samples[self._hop:]

    def steered(self, directions: Sequence[NDArray], blade_pass_hz: NDArray | None = None) -> list[Segment]:
        """The sound from each direction: its power less that of noise, as the other directions show it.

        Noise that the microphones do not share, or that the recording has, has no part in it, and of other directions only what
        agrees by chance. Those that are given have no part in each other: the powers of all are fitted by least squares.

        Parameters:
            directions: measured projections q (rank,) on the array's basis, of different sources.
            blade_pass_hz (r,) (Hz): blade-pass frequencies of the rig's own rotors, whose lines are removed.
        """
        spectra = np.stack(self._spectra)  # (t, m, k)
        angles = np.stack([self._lead @ q for q in directions]).astype(np.float32)[..., None] * self._omega
        steering = np.cos(angles) + 1j * np.sin(angles)  # an exponential of complex numbers takes ten times as long
        if self._ego_noise is not None:
            whitener = self._ego_noise.whitener(covariance(self._by_band(spectra))).astype(np.complex64)[self._bands]
            spectra, steering = ((whitener @ part.T).T for part in (spectra, steering))
        gain = np.sum(np.abs(steering) ** 2, axis=1)  # (s, k)
        total = np.sum(np.abs(spectra) ** 2, axis=1) / gain[:, None]  # (s, t, k)
        beams = np.stack([np.abs(np.sum(spectra * one.conj(), axis=1)) ** 2 for one in steering])
        powers = _power(beams, total, gain[:, None], spectra.shape[1])
        if len(directions) > 1:
            powers = _separated(powers, steering, gain)
        free = np.ones(len(self._frequencies), bool)
        if blade_pass_hz is not None and len(blade_pass_hz):
            free = minimum_filter1d(notch(self._frequencies, blade_pass_hz), MAIN_LOBE_BINS)
        beside = np.maximum(powers, 0.0).sum(axis=0) - np.maximum(powers, 0.0)
        total = np.maximum(total - beside, LEAST_TOTAL * total)
        return [Segment(_bridged(power, free), _bridged(own, free)) for power, own in zip(powers, total, strict=True)]

    def _by_band(self, spectra: NDArray) -> NDArray:
        """Spectra (b, m, n) of bands, whose bins in all frames are alike, from spectra (t, m, k)."""
        frames, microphones, bins = spectra.shape
        whole = spectra[..., :bins // self._bins * self._bins].reshape(frames, microphones, -1, self._bins)
        return whole.transpose(2, 1, 0, 3).reshape(-1, microphones, frames * self._bins)

    def _spectrum(self, frame: NDArray) -> NDArray:
        """Spectra (m, k) of a frame (n, m)."""
        return np.ascontiguousarray(fft.rfft(frame * self._taper, axis=0)[self._used].T)


class DroneClassifier(SourceSpectra):
    """Judges the newest second of sound from directions. What former windows said is forgotten.

    Parameters:
        array, sample_rate, speed_of_sound, ego_noise: see `SourceSpectra`.
        model: see `DroneModel`.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float, model: DroneModel,
                 ego_noise: NoiseRecording | None = None) -> None:
        super().__init__(array, sample_rate, speed_of_sound, ego_noise)
        self._model, self._features = model, DroneFeatures()

    def judge(self, directions: Sequence[NDArray], blade_pass_hz: NDArray | None = None) -> list[Judgement]:
        """What is known of the sound from each direction; those of the other directions are separated from it.

        Parameters:
            directions: measured projections q (rank,) of the directions on the array's basis, of different sources.
            blade_pass_hz (r,) (Hz): blade-pass frequencies of the rig's own rotors.
        """
        if not self.is_full:
            return [Judgement()] * len(directions)
        judged = []
        for segment in self.steered(directions, blade_pass_hz):
            probability = 1.0 / (1.0 + math.exp(-self._model.log_odds(self._features(segment), self._features.lines(segment))))
            fundamental = self._features.fundamental(segment)
            judged.append(Judgement(probability, fundamental, (FUNDAMENTAL_SIGMA * fundamental) ** 2))
        return judged


def load_model(name: str) -> DroneModel | None:
    """The model of a file, or that which ships with the package for an empty name; None for `none`.

    Raises OSError or ValueError for a file that is no model.
    """
    return None if name == 'none' else DroneModel.load(name or shipped_file('av_audio', 'models', 'drone_sound.npz'))


def _power(beam: NDArray, total: NDArray, gain: NDArray, microphones: int) -> NDArray:
    """Power of a source less that of noise in all other directions, from the squared output of the beam to it.

    Parameters:
        beam: |a^H x|^2 for the steering vector a.
        total: |x|^2 / |a|^2.
        gain: |a|^2.
        microphones: dimension m of the vectors.
    """
    if microphones == 1:
        return total
    return (microphones * beam / gain**2 - total) / (microphones - 1)


def _separated(powers: NDArray, steering: NDArray, gain: NDArray) -> NDArray:
    """Powers (s, t, k) of each of several sources.

    Parameters:
        powers (s, t, k): powers in the direction of each.
        steering (s, m, k): steering vectors of each.
        gain (s, k): their squared norms.
    """
    count, microphones, _ = steering.shape
    beams = np.abs(np.sum(steering.conj()[:, None] * steering, axis=2)) ** 2
    gram = _power(beams, gain / gain[:, None], gain[:, None], microphones).transpose(2, 0, 1)
    inverse = np.linalg.inv(gram + LOADING * np.eye(count)).astype(np.float32)  # with 12 frames each: faster than `solve`
    return (inverse @ powers.transpose(2, 0, 1)).transpose(1, 2, 0)


def _bridged(values: NDArray, free: NDArray) -> NDArray:
    """Values (t, k) with those of bins that are not free interpolated from their neighbours."""
    if free.all() or not free.any():
        return values
    bins = np.arange(len(free))
    return np.stack([np.interp(bins, bins[free], row[free]) for row in values])
