"""Spectra of the last second of a stream, steered to directions."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import minimum_filter1d

from av_audio.drone_features import FRAME_S, HOP_S, SEGMENT_FRAMES, Segment, bin_frequencies
from av_audio.ego_noise import EgoNoise, NoiseRecording
from av_audio.ego_rotors import notch
from av_common.microphone_array import MicrophoneArray

MAIN_LOBE_BINS = 5  # of the taper, a Hann window
# Of the diagonal, added to the least squares of several sources: where their phases are hardly different, they share the power.
LOADING = 0.1
LEAST_TOTAL = 0.1  # share of the power at the microphones that at least remains when that of others is removed


class SourceSpectra:
    """Keeps the spectra of the last `SEGMENT_FRAMES` frames and gives what of them came from a direction.

    Parameters:
        array: positions of the microphones.
        sample_rate (Hz): sample rate, at least twice the highest frequency of the features.
        speed_of_sound (m/s): speed of sound.
        ego_noise: recording of the rig alone, whose noise is subtracted; None subtracts nothing.

    Raises ValueError for a recording that does not fit the array or the sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float,
                 ego_noise: NoiseRecording | None = None) -> None:
        self.sample_rate = sample_rate
        self._frame, self._hop = round(FRAME_S * sample_rate), round(HOP_S * sample_rate)
        self._frequencies = bin_frequencies()
        self._bins = slice(round(self._frequencies[0] * FRAME_S), round(self._frequencies[-1] * FRAME_S) + 1)
        self._taper = np.hanning(self._frame).astype(np.float32)[:, None]
        self._lead = (array.positions @ array.basis / speed_of_sound).astype(np.float32)  # (m, rank): s that each leads
        self._omega = (2.0 * np.pi * self._frequencies).astype(np.float32)
        self._samples = np.zeros((0, array.channels), np.float32)
        self._spectra: deque[NDArray] = deque(maxlen=SEGMENT_FRAMES)
        self._ego_noise = None
        if ego_noise is not None:
            ego_noise.check(array.channels, sample_rate)
            starts = range(0, len(ego_noise.samples) - self._frame + 1, self._frame // 2)
            windows = (self._spectrum(ego_noise.samples[start:start + self._frame]) for start in starts)
            self._ego_noise = EgoNoise(windows, 1.0 / FRAME_S)

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
        """The sound from each direction: cross-powers of all pairs after removing the delays of the direction.

        Noise that the microphones do not share has no part in it, and of other directions only what agrees by chance. Those
        that are given have no part in each other: the powers of all are fitted to the cross-powers by least squares.

        Parameters:
            directions: measured projections q (rank,) on the array's basis, of different sources.
            blade_pass_hz (r,) (Hz): blade-pass frequencies of the rig's own rotors, whose lines are removed.
        """
        spectra = np.stack(self._spectra)  # (t, m, k)
        microphones = spectra.shape[1]
        steering = np.exp(-1j * np.stack([self._lead @ q for q in directions]).astype(np.float32)[..., None] * self._omega)
        total = np.mean(np.abs(spectra) ** 2, axis=1)
        powers = np.stack([_cross_power(np.abs(np.sum(spectra * towards, axis=1)) ** 2, total, microphones)
                           for towards in steering])  # (s, t, k)
        if self._ego_noise is not None:
            noise = np.mean([self._ego_noise.covariance_in(frame) for frame in self._spectra], axis=0)
            seen = np.einsum('sik,ijk,sjk->sk', steering, noise, steering.conj()).real
            own = np.einsum('iik->k', noise).real / microphones
            powers -= _cross_power(seen, own, microphones)[:, None]
            total = np.maximum(total - own, LEAST_TOTAL * total)
        if len(directions) > 1:
            powers = _separated(powers, steering)
        free = np.ones(len(self._frequencies), bool)
        if blade_pass_hz is not None and len(blade_pass_hz):
            free = minimum_filter1d(notch(self._frequencies, blade_pass_hz), MAIN_LOBE_BINS)
        beside = np.maximum(powers, 0.0).sum(axis=0) - np.maximum(powers, 0.0)
        return [Segment(_bridged(power, free), _bridged(np.maximum(total - others, LEAST_TOTAL * total), free))
                for power, others in zip(powers, beside, strict=True)]

    def _spectrum(self, frame: NDArray) -> NDArray:
        """Spectra (m, k) of a frame (n, m)."""
        return np.ascontiguousarray(fft.rfft(frame * self._taper, axis=0)[self._bins].T)


def _cross_power(beam: NDArray, total: NDArray, microphones: int) -> NDArray:
    """Mean cross-power of all pairs, from the power of the sum of all microphones and the mean power of one."""
    if microphones == 1:
        return total
    return (beam - microphones * total) / (microphones * (microphones - 1))


def _separated(powers: NDArray, steering: NDArray) -> NDArray:
    """Powers (s, t, k) of each of several sources.

    Parameters:
        powers (s, t, k): mean cross-powers, steered to each.
        steering (s, m, k): conjugate steering vectors of each.
    """
    count, microphones, bins = steering.shape
    gram, ones = np.empty((bins, count, count)), np.ones(bins)
    for i, j in combinations_with_replacement(range(count), 2):
        gram[:, i, j] = gram[:, j, i] = _cross_power(
            np.abs(np.sum(steering[i] * steering[j].conj(), axis=0)) ** 2, ones, microphones)
    return np.linalg.solve(gram + LOADING * np.eye(count), powers.transpose(2, 0, 1)).transpose(1, 2, 0)


def _bridged(values: NDArray, free: NDArray) -> NDArray:
    """Values (t, k) with those of bins that are not free interpolated from their neighbours."""
    if free.all() or not free.any():
        return values
    bins = np.arange(len(free))
    return np.stack([np.interp(bins, bins[free], row[free]) for row in values])
