"""A tone that passes a pair of microphones in a straight line, with its analytic solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import hilbert

from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise
from av_simulator.sound.source import Source
from av_simulator.sound.source_signals import FormulaSignal
from av_simulator.sound.world import SoundWorld

RATE = 48000
PAIR = np.array([[0.0, 0.1, 1.5], [0.0, -0.1, 1.5]])
_EDGE = RATE // 10  # samples at both ends where the Hilbert transform of a finite signal is inaccurate


@dataclass(frozen=True)
class FlyBy:
    """A tone of amplitude 1 at 1 m from a source at constant velocity, received by the stationary microphones PAIR.

    Parameters:
        start (m, ENU): position of the source at time 0.
        velocity (m/s, ENU): velocity of the source.
        tone_hz (Hz): frequency of the tone.
        seconds (s): duration.
        medium: the air.
    """

    start: tuple[float, float, float] = (-20.0, 10.0, 1.5)
    velocity: tuple[float, float, float] = (20.0, 0.0, 0.0)
    tone_hz: float = 1000.0
    seconds: float = 2.0
    medium: Medium = Medium()  # noqa: RUF009 - it cannot change

    @property
    def times(self) -> NDArray:
        """Times (s, (n,)) of the samples."""
        return np.arange(int(self.seconds * RATE)) / RATE

    def position(self, times: NDArray) -> NDArray:
        """Positions (m, (k, 3)) of the source at times (s, (k,))."""
        return np.asarray(self.start) + np.multiply.outer(times, np.asarray(self.velocity))

    def delay(self, microphone: NDArray) -> NDArray:
        """Travel times (s, (n,)) to a microphone (m, (3,)): the positive root of |m - p(t - tau)|^2 = (c tau)^2."""
        c, velocity = self.medium.speed_of_sound, np.asarray(self.velocity)
        away = microphone - self.position(self.times)
        approach, a = away @ velocity, c**2 - velocity @ velocity
        return (approach + np.sqrt(approach**2 + a * (away**2).sum(axis=1))) / a

    def doppler(self, microphone: NDArray) -> NDArray:
        """Received frequencies (Hz, (n,)) at a microphone (m, (3,)): f / (1 - M cos), with M cos at the emission."""
        sent_from = self.position(self.times - self.delay(microphone))
        towards = microphone - sent_from
        mach = towards @ np.asarray(self.velocity) / np.linalg.norm(towards, axis=1) / self.medium.speed_of_sound
        return self.tone_hz / (1.0 - mach)

    def truth(self) -> NDArray:
        """The analytic signal (n, m) at the pair."""
        delays = np.array([self.delay(microphone) for microphone in PAIR]).T
        phase = 2 * np.pi * self.tone_hz * (self.times[:, None] - delays)
        return np.exp(1j * (phase - np.pi / 2)) / (delays * self.medium.speed_of_sound)

    def render(self, block: int = 1600) -> NDArray:
        """The signals (n, m) rendered by SoundWorld in blocks of `block` samples."""
        signal = FormulaSignal(lambda t: np.sin(2 * np.pi * self.tone_hz * t))
        world = SoundWorld(RATE, [Source(self.position, signal)], self.medium, noise=Noise(None))
        still = np.stack([PAIR, PAIR])
        return np.concatenate([world.render(block, still) for _ in range(len(self.times) // block)])


@dataclass(frozen=True)
class Deviation:
    """Errors of a rendering relative to the analytic solution."""

    error_db: float             # power of the difference over that of the solution
    delay_us: float             # RMS error, the larger of the channels' delays and the delay between them
    frequency_hz: float         # RMS error of the instantaneous frequency
    doppler_hz: float           # maximum error of the frequency, averaged over 20 ms, relative to f / (1 - M cos)
    spreading_db: float         # maximum error of a channel's level relative to 1 / r
    level_difference_db: float  # maximum error of the level difference between the channels


def deviation(fly_by: FlyBy, rendered: NDArray) -> Deviation:
    """Errors of a rendering.

    Parameters:
        fly_by: source and tone.
        rendered ((n, 2)): rendered samples; n may be smaller than the duration of `fly_by`.
    """
    inner = slice(_EDGE, len(rendered) - _EDGE)
    truth = fly_by.truth()[:len(rendered)]
    received = hilbert(rendered.astype(float), axis=0)[inner]
    difference = rendered[inner] - truth.real[inner]
    error = np.mean(difference**2) / np.mean(truth.real[inner] ** 2)
    exact = truth[inner]
    phase = np.angle(received * np.conj(exact))
    formula_hz = np.array([fly_by.doppler(microphone)[:len(rendered)][inner] for microphone in PAIR]).T
    off_hz = np.diff(np.unwrap(np.angle(received), axis=0), axis=0) * RATE / (2 * np.pi) - formula_hz[:-1]
    late = phase / (2 * np.pi * formula_hz)
    between = late[:, 0] - late[:, 1]
    step = RATE // 50
    smooth_hz = off_hz[:len(off_hz) // step * step].reshape(-1, step, 2).mean(axis=1)
    level = 20 * np.log10(np.abs(received) / np.abs(exact))
    return Deviation(
        error_db=float(10 * np.log10(error)), delay_us=1e6 * float(max(*_rms(late), _rms(between))),
        frequency_hz=float(np.max(_rms(off_hz))), doppler_hz=float(np.abs(smooth_hz).max()),
        spreading_db=float(np.abs(level).max()), level_difference_db=float(np.abs(level[:, 0] - level[:, 1]).max()))


def _rms(values: NDArray) -> NDArray:
    return np.sqrt(np.mean(values**2, axis=0))
