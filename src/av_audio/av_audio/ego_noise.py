"""The rig's own noise, known from a recording of the rig alone: its spatial covariance, by which spectra are whitened.

Without a recording, the harmonics of rotors whose speeds are known are notched.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.file_source import read_sound
from av_audio.health import DEAD_DBFS, copies
from av_audio.spectra import ALIKE_HZ, TINY

MIN_DURATION_S = 2.0  # the covariance of a shorter recording has too large an error
# Windows whose levels differ by less than this are of one throttle: the level of a rotor grows with the fifth to sixth power of
# its speed, so that speeds then differ by some 5 %, as they do while hovering.
THROTTLE_STEP_DB = 3.0
# The bins of a band of this width are the snapshots of one covariance matrix: enough of them to average, close enough to
# share phases.
BAND_HZ = 40.0
# Power of noise that microphones do not share, over that of the recording. The least of them: gains and positions are as
# recorded to about 3 %.
SHARES: NDArray = 10.0 ** np.arange(-3.0, 2.0)
LEAST_EXCESS = 1e-3  # of the mean square of levels over that of Gaussian noise
# Thirty independent windows of 0.3 s: four snapshots of each of eight microphones keep the loss of a covariance that is
# averaged below 1.5 dB (Reed, Mallett and Brennan, 1974: 2 M keep it below 3 dB).
LEARNED_S = 10.0
# Half-width of a notch: the main lobe of the taper, plus a share of the frequency for errors and changes of the speed.
NOTCH_HZ = 4.0
NOTCH_SHARE = 0.004
LEVEL_STEPS = 3  # of the expectation maximisation that finds the level of a band


class NoiseRecording(NamedTuple):
    """Recording of the rig without any other source.

    Parameters:
        samples (n, m): one channel per microphone.
        sample_rate (Hz): sample rate.
        name: name of the recording in messages.
    """

    samples: NDArray[np.float32]
    sample_rate: int
    name: str = 'ego-noise'

    @classmethod
    def load(cls, path: str | Path) -> NoiseRecording:
        """Load a sound file. Raises OSError or ValueError that names the file."""
        return cls(*read_sound(path), str(path))

    def check(self, channels: int, sample_rate: int) -> None:
        """Raise ValueError when it does not fit an array of `channels` microphones sampled at `sample_rate` in Hz.

        Parameters:
            channels: number of microphones.
            sample_rate (Hz): sample rate of the array.
        """
        if self.samples.ndim != 2 or self.samples.shape[1] != channels:
            raise ValueError(f'{self.name} has samples of shape {self.samples.shape}, expected (n, {channels}): a channel '
                             'for each microphone')
        if self.sample_rate != sample_rate:
            raise ValueError(f'{self.name} was recorded at {self.sample_rate} Hz, expected {sample_rate} Hz as the stream')
        if len(self.samples) < MIN_DURATION_S * sample_rate:
            raise ValueError(f'{self.name} lasts {len(self.samples) / sample_rate:.1f} s, '
                             f'expected {MIN_DURATION_S:g} s or more')
        if not np.isfinite(self.samples).all():
            raise ValueError(f'{self.name} has samples that are not finite')
        if (self.samples.std(axis=0, dtype=float) < 10.0 ** (0.05 * DEAD_DBFS)).any():  # whatever its offset
            raise ValueError(f'{self.name} has a silent channel')
        for piece in np.array_split(self.samples, int(len(self.samples) / (MIN_DURATION_S * sample_rate))):  # some are silent
            sound = piece.T.astype(float)
            if same := copies(sound - sound.mean(axis=1, keepdims=True)):
                raise ValueError(f'{self.name} has the same sound in channels {", ".join(map(str, same[0]))}: one microphone')

    def windows(self, length: int) -> list[NDArray[np.float32]]:
        """Windows (m, length) that overlap by half, without silent ones. Raises ValueError when there is none."""
        starts = range(0, len(self.samples) - length + 1, max(1, length // 2))
        windows = [window.T for start in starts if (window := self.samples[start:start + length]).any()]
        if not windows:
            raise ValueError(f'{self.name} has no window of {length / self.sample_rate:g} s that is not silent')
        return windows


class EgoLearning:
    """What is known of the rig's noise: its recording, or the sound of seconds in which someone said that it is alone.

    Sound does not tell when that is. A target that stays has a place in the covariance, as a rotor has, and would be whitened
    away; and where the recording no longer fits, own noise is a direction with confidence (`docs/decisions.md`).

    Parameters:
        recording: what is known at the beginning; None where nothing is.
    """

    def __init__(self, recording: NoiseRecording | None) -> None:
        self._recording = recording
        self._pieces: list[NDArray[np.float32]] | None = None  # (n, m) each; None while nothing is learned
        self.known = recording
        self.refusal = ''  # why the newest attempt failed

    @property
    def is_learning(self) -> bool:
        """Whether it listens."""
        return self._pieces is not None

    def begin(self) -> None:
        """Listen from now on; what was heard in an unfinished attempt is discarded."""
        self._pieces, self.refusal = [], ''

    def interrupt(self) -> None:
        """Listen anew, in an attempt: what follows does not continue what was heard."""
        if self._pieces is not None:
            self._pieces = []

    def begin_stream(self, sample_rate: int) -> None:
        """Listen anew, and forget what was learned at another sample rate than that (Hz) of the stream that begins."""
        self.interrupt()
        if self.known is not None and self.known.sample_rate != sample_rate:
            self.known = self._recording

    def forget(self) -> None:
        """Know the recording alone."""
        self._pieces, self.known, self.refusal = None, self._recording, ''

    def add(self, samples: NDArray[np.float32], sample_rate: int) -> bool:
        """Take the next samples of the stream; returns whether another noise is known from now on.

        Parameters:
            samples (n, m): of all channels, full scale 1.
            sample_rate (Hz): of the stream.
        """
        if self._pieces is None:
            return False
        self._pieces.append(samples)
        if sum(map(len, self._pieces)) < LEARNED_S * sample_rate:
            return False
        heard = NoiseRecording(np.concatenate(self._pieces), sample_rate, 'noise learned in flight')
        self._pieces = None
        try:
            heard.check(samples.shape[1], sample_rate)
        except ValueError as error:
            self.refusal = str(error)
            return False
        self.known = heard
        return True


class EgoNoise:
    """Covariances of noise by band: of the recording, for each throttle in it, with noise that microphones do not share.

    Rotors are louder than a target, but at fixed places: with a square root L of a band's covariance L L^H, the spectra
    L^-1 x are white in space but for what was not recorded, and a source with the steering vector a appears at L^-1 a. That is
    the generalised eigenvalue problem of both covariances (Roy and Kailath, 1989; for robots Nakamura et al., 2009, on a
    quadrotor Okutani et al., 2012). The level in each band is left free: throttle changes it, directions remain. Wind and the
    noise of capsules are in no recording: after whitening by it alone they would be coherent. Their share is that under
    which the window is most likely.

    Sheets, chains and gravel are loud in moments, between which a target is heard: noise of varying level has the complex
    t-distribution, with as many degrees of freedom as the levels of the recording have (Lange, Little and Taylor, 1989).

    Attributes:
        freedom: degrees of freedom.

    Parameters:
        windows: spectra (b, m, n) of windows of the recording, n in each band of BAND_HZ.
    """

    def __init__(self, windows: Sequence[NDArray]) -> None:
        covariances = np.stack([covariance(window) for window in windows])  # (w, b, m, m)
        group = throttles(np.einsum('wbii->w', covariances).real)
        table = np.stack([covariances[group == one].mean(axis=0) for one in np.unique(group)])
        values, self.vectors = np.linalg.eigh(table)  # (s, b, m), (s, b, m, m)
        power = np.maximum(values.mean(axis=-1), TINY)
        self._values = np.maximum(values, 0.0)[..., None] + power[..., None, None] * SHARES  # (s, b, m, l)
        self._log_volumes = np.log(self._values).sum(axis=2)
        self.freedom = freedom_of(np.stack([in_time(self.whitener(each) @ window) for each, window in zip(
            covariances, windows, strict=True)]))

    def likeliest(self, covariances: NDArray) -> tuple[int, NDArray]:
        """The throttle and the gains (b, m) with which a window with covariances (b, m, m) is most likely, whatever its levels.

        The window is white after `vectors` of the throttle, and then these gains, are applied.
        """
        shown = np.sum(self.vectors.conj() * (covariances @ self.vectors), axis=-2).real  # (s, b, m)
        white = np.maximum(np.sum(shown[..., None] / self._values, axis=2), np.finfo(float).tiny)  # (s, b, l)
        misfit = uniform_filter1d(self._log_volumes + shown.shape[-1] * np.log(white), round(ALIKE_HZ / BAND_HZ), axis=1)
        throttle = int(np.argmin(misfit.min(axis=2).sum(axis=1)))
        share = misfit[throttle].argmin(axis=1)[:, None, None]
        return throttle, 1.0 / np.sqrt(np.take_along_axis(self._values[throttle], share, axis=2)[..., 0])

    def whitener(self, covariances: NDArray) -> NDArray:
        """Matrices (b, m, m) that whiten a window with covariances (b, m, m)."""
        throttle, gains = self.likeliest(covariances)
        return gains[..., None] * self.vectors[throttle].conj().swapaxes(-1, -2)


def throttles(powers: NDArray) -> NDArray:
    """Numbers (w,) of the throttles at which windows with powers (w,) were recorded."""
    levels_db = 10.0 * np.log10(powers + np.finfo(float).tiny)
    return np.floor((levels_db - levels_db.min()) / THROTTLE_STEP_DB).astype(int)


def covariance(bands: NDArray) -> NDArray:
    """Covariances (b, m, m) of spectra (b, m, n)."""
    return bands @ bands.conj().swapaxes(-1, -2) / bands.shape[-1]


def in_time(bands: NDArray) -> NDArray:
    """The course in time (..., n) of bands with n bins: as many snapshots, with the same covariance."""
    return np.fft.ifft(bands, norm='ortho')


def freedom_of(snapshots: NDArray) -> float:
    """Degrees of freedom of the t-distribution of white snapshots (w, b, m, n), by the mean square of their levels.

    It is E(s^2) = (f - 2) / (f - 4) of that of Gaussian snapshots, whose shares of the level of a band have Dirichlet's
    distribution.
    """
    microphones, count = snapshots.shape[-2:]
    levels = np.mean(np.abs(snapshots) ** 2, axis=-2)
    square = np.mean(levels**2, axis=-1) / np.maximum(np.mean(levels, axis=-1) ** 2, TINY)
    excess = float(square.mean()) * (count * microphones + 1.0) / (count * (microphones + 1.0)) - 1.0
    return 4.0 + 2.0 / max(excess, LEAST_EXCESS)


def level_weights(snapshots: NDArray, freedom: float) -> NDArray:
    """Weights (b, 1, n) of snapshots (b, m, n) with which the covariance is the most likely one if their levels vary.

    Parameters:
        snapshots (b, m, n): white but for their levels.
        freedom: degrees of freedom of their t-distribution: with 0 all count alike, with many each by its level.
    """
    levels = np.maximum(np.mean(np.abs(snapshots) ** 2, axis=1, keepdims=True), TINY)
    mean = usual = levels.mean(axis=2, keepdims=True)
    for _ in range(LEVEL_STEPS):
        weights = 1.0 / (0.5 * freedom / snapshots.shape[1] * usual + levels)
        usual = np.mean(weights * levels, axis=2, keepdims=True) / np.mean(weights, axis=2, keepdims=True)
    return np.asarray(weights * mean / np.mean(weights * levels, axis=2, keepdims=True))


def without_lines(spectra: NDArray, frequencies: NDArray, blade_pass_hz: NDArray) -> NDArray:
    """Spectra (m, k), 0 in the notches where lines are louder than what is beside them.

    Notches of four rotors cover three fifths of the bins above 2 kHz. Lines that jitter are no louder there than the hiss of
    the rotors, and a target is in these bins, too.

    Parameters:
        spectra (m, k): of a window.
        frequencies (k,) (Hz): frequencies of the bins.
        blade_pass_hz (r,) (Hz): blade-pass frequencies; 0 for a rotor that stands still.
    """
    if not np.any(blade_pass_hz):
        return spectra
    power = np.sum(np.abs(spectra) ** 2, axis=0)
    parts = np.array_split(power, max(1, round((frequencies[-1] - frequencies[0]) / ALIKE_HZ)))
    beside = np.concatenate([np.full(len(part), np.median(part)) for part in parts])
    return np.asarray(spectra * (notch(frequencies, blade_pass_hz) | (power < 2.0 * beside)))


def notch(frequencies: NDArray, blade_pass_hz: ArrayLike) -> NDArray:
    """Which bins (k,) at frequencies (k,) in Hz are free of harmonics of the blade-pass frequencies (r,) in Hz.

    Parameters:
        frequencies (k,) (Hz): frequencies of the bins.
        blade_pass_hz (r,) (Hz): blade-pass frequencies; about 0 for a rotor that stands still.
    """
    free = np.ones(len(frequencies), bool)
    for fundamental in np.asarray(blade_pass_hz, dtype=float):
        if fundamental > 2.0 * NOTCH_HZ:  # lines closer than notches are wide leave nothing, and such a rotor is not heard
            order = np.maximum(1.0, np.round(frequencies / fundamental))
            distance = np.abs(frequencies - order * fundamental)
            free &= distance > NOTCH_HZ + NOTCH_SHARE * frequencies
    return free
