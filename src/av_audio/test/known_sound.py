"""Sound whose delays are known exactly, for tests: noise, rotors, and a target among the rig's own rotors."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import resample

from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

RATE = 48_000
BAND_HZ = (200.0, 4000.0)
PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'two_microphones')
SQUARE = MicrophoneArray(0.0325 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]), 'quadrotor_square')
# A quadrotor with arms of 0.25 m around the pair, 5 cm below it.
EGO_ROTORS = np.array([[0.18, 0.18, -0.05], [-0.18, 0.18, -0.05], [-0.18, -0.18, -0.05], [0.18, -0.18, -0.05]])
FINER = 4    # factor of the sampling before interpolation: the spline's error in the band is below -90 dB


def flat(rng, seconds, delays, band_hz=BAND_HZ, slope=0.0):
    """Gaussian noise (n, m) in a band, of amplitudes f^-slope; channel k is delayed by delays[k] (s)."""
    count = round(seconds * RATE)
    frequencies = np.fft.rfftfreq(2 * count, 1.0 / RATE)
    inside = (frequencies >= band_hz[0]) & (frequencies <= band_hz[1])
    spectrum = np.where(inside, rng.normal(size=inside.size) + 1j * rng.normal(size=inside.size), 0.0)
    spectrum /= np.maximum(frequencies, 1.0) ** slope
    return np.fft.irfft(spectrum * np.exp(-2j * np.pi * np.outer(delays, frequencies)), 2 * count, axis=1)[:, :count].T


def rotors(rng, seconds, delays):
    """Four rotors (n, m), and noise 10 dB below them, both of equal power per octave.

    The rotors are harmonics k of 150 to 220 Hz with amplitudes k^-0.5; their speeds vary by 0.3 %.
    """
    time = np.arange(round(seconds * RATE))[:, None] / RATE - delays
    tones = np.zeros(time.shape)
    for _ in range(4):
        fundamental, wander_hz = rng.uniform(150.0, 220.0), rng.uniform(0.2, 2.0)
        wander = 0.003 / (2.0 * np.pi * wander_hz) * np.sin(2.0 * np.pi * (wander_hz * time + rng.uniform()))
        harmonics = np.arange(1, int(4500.0 / fundamental))
        amplitudes = harmonics**-0.5 * np.exp(2j * np.pi * rng.uniform(size=harmonics.size))
        turn = np.exp(2j * np.pi * fundamental * (time + wander))
        tones += np.polynomial.polynomial.polyval(turn, np.concatenate([[0.0], amplitudes])).real
    noise = flat(rng, seconds, delays, (100.5, 5999.5), 0.5)
    return tones / tones[:, 0].std() + 10.0**-0.5 * noise / noise[:, 0].std()


def add_noise(rng, sound, snr_db):
    """Sound (n, m) with white noise, independent in each channel, at a signal-to-noise ratio inside BAND_HZ."""
    noise = rng.normal(size=sound.shape)
    mixed = sound + noise * np.sqrt(band_power(sound[:, 0]) / band_power(noise[:, 0]) * 10.0 ** (-snr_db / 10.0))
    return 0.2 * mixed / mixed.std()


def band_power(samples):
    """Power of samples (n,) inside BAND_HZ."""
    frequencies = np.fft.rfftfreq(len(samples), 1.0 / RATE)
    inside = (frequencies >= BAND_HZ[0]) & (frequencies <= BAND_HZ[1])
    return float(np.mean(np.abs(np.fft.rfft(samples)[inside]) ** 2))


def heard(sound, emitted):
    """Sound (n, m) that was emitted at times (n, m) in s from the middle of `sound` (k,)."""
    fine = resample(sound, FINER * len(sound))
    return CubicSpline(np.arange(len(fine)) / (FINER * RATE) - 0.5 * len(sound) / RATE, fine)(emitted)


def scene(rng, azimuth, level_db, seconds=0.5):
    """Sound (n, 2) at PAIR of a target at an azimuth (rad) under ego-rotors, and their blade-pass frequencies (4,) in Hz.

    The ego-rotors are point sources, `level_db` louder than the target; noise is 10 dB below the target.
    """
    c = speed_of_sound(20.0)
    target = rotors(rng, seconds, -PAIR.positions @ angles_to_direction(azimuth) / c)
    blade_pass = rng.uniform(150.0, 220.0, len(EGO_ROTORS))
    time, ego = np.arange(len(target))[:, None] / RATE, np.zeros(target.shape)
    for fundamental, position in zip(blade_pass, EGO_ROTORS, strict=True):
        distances = np.linalg.norm(PAIR.positions - position, axis=1)
        orders = np.arange(1, int(4500.0 / fundamental))
        amplitudes = np.concatenate([[0.0], np.exp(2j * np.pi * rng.uniform(size=orders.size)) / orders])
        ego += np.polynomial.polynomial.polyval(np.exp(2j * np.pi * fundamental * (time - distances / c)),
                                                amplitudes).real / distances
    hiss = rng.normal(size=ego.shape)
    ego += 10.0 ** (-15.0 / 20.0) * np.sqrt(band_power(ego[:, 0]) / band_power(hiss[:, 0])) * hiss
    both = target + 10.0 ** (level_db / 20.0) * np.sqrt(band_power(target[:, 0]) / band_power(ego[:, 0])) * ego
    louder_db = 10.0 * np.log10(band_power(both[:, 0]) / band_power(target[:, 0]))
    return add_noise(rng, both, 10.0 + louder_db), blade_pass
