"""A rig that flies, for tests: rotors as point sources beside the microphones, with combs that jitter, air noise, and wind."""

from __future__ import annotations

import numpy as np
from known_sound import RATE, band_power

from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

C = speed_of_sound(20.0)
TURNS = np.arange(8) * np.pi / 4.0 + 0.1
RING = MicrophoneArray(0.11 * np.stack([np.cos(TURNS), np.sin(TURNS), np.zeros(8)], axis=1), 'ring')


def propagated(sound, delays):
    """A periodic sound (n,) after delays (m,) in s: (n, m)."""
    turns = np.exp(-2j * np.pi * np.outer(np.fft.rfftfreq(len(sound), 1.0 / RATE), delays))
    return np.fft.irfft(np.fft.rfft(sound)[:, None] * turns, len(sound), axis=0)


def coloured(rng, shape, slope, corner_hz):
    """Noise (n, m) whose amplitudes fall as f^-slope above a corner."""
    frequencies = np.fft.rfftfreq(shape[0], 1.0 / RATE)[:, None]
    return np.fft.irfft(np.fft.rfft(rng.normal(size=shape), axis=0) * (1.0 + (frequencies / corner_hz) ** 2) ** (-0.5 * slope),
                        shape[0], axis=0)


class FlyingRig:
    """Four rotors with arms of random length, blades, colour, and jitter of 1.5 % of their speeds.

    Parameters:
        array: positions of the microphones.
        rng: random numbers of its build.
    """

    def __init__(self, array, rng):
        self.array = array
        arm, height = rng.uniform(0.19, 0.3), rng.uniform(-0.1, 0.06)
        angles = np.arange(4) * np.pi / 2.0 + np.pi / 4.0 + rng.uniform(-0.1, 0.1, 4)
        self.places = np.stack([arm * np.cos(angles), arm * np.sin(angles), np.full(4, height)], axis=1)
        self.blade_pass_hz = rng.uniform(120.0, 210.0) * (1.0 + 0.04 * rng.normal(size=4))
        self.levels = rng.uniform(0.4, 1.0, (4, 120)) * np.arange(1, 121) ** -rng.uniform(0.8, 1.3)
        self.hiss = rng.uniform(0.3, 1.0, 4)
        self.gains = np.ones(4)

    def alone(self, rng, seconds, throttle=1.0):
        """Its sound (n, m), of unit power in the band at full throttle; and the blade-pass frequencies (n, 4) in Hz."""
        count = round(seconds * RATE)
        knots = np.linspace(0.0, seconds, max(4, round(5.0 * seconds)))
        times = np.arange(count) / RATE
        speeds = np.stack([throttle * hz * (1.0 + 0.015 * np.interp(times, knots, rng.normal(size=len(knots))))
                           for hz in self.blade_pass_hz], axis=1)
        sound = np.zeros((count, self.array.channels))
        for rotor, place in enumerate(self.places):
            turns = 2.0 * np.pi * np.cumsum(speeds[:, rotor]) / RATE
            orders = range(1, int(6000.0 / (throttle * self.blade_pass_hz[rotor])))
            comb = sum(self.levels[rotor, k - 1] * np.cos(k * turns + rng.uniform(0.0, 6.28)) for k in orders)
            air = coloured(rng, (count, 1), 1.0, 1500.0)[:, 0]
            distances = np.linalg.norm(self.array.positions - place, axis=1)
            emitted = self.gains[rotor] * (comb / comb.std() + self.hiss[rotor] * air / air.std())
            sound += propagated(emitted, distances / C) / distances
        return throttle**2.75 * sound / np.sqrt(band_power(sound[:, 0])), speeds

    def hears(self, rng, source, azimuth, level_db, seconds=0.5, throttle=1.0):
        """Sound (n, m) of a far source (n,), rotors `level_db` louder and wind 10 dB quieter than it; and speeds (n, 4)."""
        count = round(seconds * RATE)
        heard = propagated(source, -self.array.positions @ angles_to_direction(azimuth) / C)
        wind = coloured(rng, heard.shape, 7.0 / 6.0, 30.0)
        own, speeds = self.alone(rng, seconds, throttle)
        mixed = sum(10.0 ** (gain / 20.0) * part / np.sqrt(band_power(part[:, 0]))
                    for gain, part in ((0.0, heard), (-10.0, wind), (level_db, own)))
        return 0.02 * mixed[:count], speeds
