"""Multirotors of random build that the project renders, and as many sounds of other kinds (`others.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from material import FOLDS, RATE, Recording
from numpy.typing import NDArray
from others import KINDS
from scipy.signal import resample_poly
from waves import SECONDS, Samples, harmonics, phase, times, wandering

from av_simulator.sound import RotorSignal

OVER = 3  # rotors are rendered at this multiple of RATE, so that no harmonic is missing below half of RATE


def recordings(rng: np.random.Generator, drones: int, others: int) -> Iterator[Recording]:
    """Multirotors, spread over the folds, and `others` of each kind of other sounds, which is in the fold of its family."""
    for number in range(drones):
        yield Recording('rendered drone', f'rendered drone {number}', 1 + number % FOLDS, multirotor(rng).astype(np.float32))
    for kind, (render, fold) in KINDS.items():
        for number in range(others):
            yield Recording(kind, f'{kind} {number}', fold, render(rng).astype(np.float32))


def multirotor(rng: np.random.Generator) -> Samples:
    """A drone of 3 to 8 rotors, or an aeroplane with one or two propellers, of 0.1 to 30 kg, hovering or manoeuvring."""
    rotors = int(rng.choice([1, 2, 3, 4, 6, 8], p=[0.04, 0.04, 0.04, 0.58, 0.18, 0.12]))
    blades = int(rng.choice([2, 3, 4], p=[0.7, 0.25, 0.05]))
    hover = np.exp(rng.uniform(np.log(75.0), np.log(520.0))) / blades  # Hz; small drones are fast
    spread = rng.uniform(0.005, 0.12)
    speeds = hover * (1.0 + spread * rng.standard_normal(rotors))
    falling = -np.cumsum(np.abs(rng.normal(rng.uniform(0.5, 3.0), 1.5, 8)))
    signal = RotorSignal(
        rotor_hz=tuple(np.clip(speeds, 10.0, 900.0)), blades=blades, tone_db_spl=72.0, harmonics_db=(0.0, *falling),
        rolloff_db=rng.uniform(0.3, 2.5), harmonics=int(rng.integers(10, 60)), imbalance_db=rng.uniform(-35.0, -5.0),
        jitter=10.0 ** rng.uniform(-2.8, -1.6), jitter_hz=rng.uniform(2.0, 30.0),
        broadband_db_spl=72.0 + rng.uniform(-18.0, 8.0),
        broadband_hz=(rng.uniform(100.0, 1500.0), rng.uniform(3000.0, 12000.0)), modulation=rng.uniform(0.0, 0.8))
    manoeuvre = _manoeuvres(rng, rotors)
    rate = OVER * RATE
    at_rest = signal.stream(rate, [int(rng.integers(2**31))], lambda moments: np.zeros((len(moments), 3)), manoeuvre)
    wave = at_rest.read(0, int(SECONDS * rate))
    sound = resample_poly(wave, 1, OVER)
    if rng.random() < 0.75:
        whine = _motor_whine(rng, speeds * np.broadcast_to(manoeuvre(times()), (len(sound), rotors)))
        sound = sound + whine * np.std(sound) * 10.0 ** (rng.uniform(-22.0, 12.0) / 20.0)
    return sound


def _manoeuvres(rng: np.random.Generator, rotors: int) -> Callable[[NDArray], NDArray]:
    """Speeds relative to hovering: all together for climbs and gusts, each for itself for turns."""
    together, alone = 10.0 ** rng.uniform(-2.5, -0.8), 10.0 ** rng.uniform(-2.7, -1.3)
    rates = rng.uniform(0.1, 2.5, (rotors + 1, 3))
    phases = rng.uniform(0.0, 2 * np.pi, (rotors + 1, 3))

    def speed(times: NDArray) -> NDArray:
        waves = np.sin(2 * np.pi * np.multiply.outer(times, rates) + phases).mean(axis=-1)
        return np.clip(1.0 + together * waves[:, :1] + alone * waves[:, 1:], 0.5, 1.5)

    return speed


def _motor_whine(rng: np.random.Generator, speeds: NDArray) -> Samples:
    """Lines (n,) of the motors' commutation at multiples of each rotor's speed (Hz, (n, rotors)), of about unit power."""
    multiple = max(1.0, round(np.exp(rng.uniform(np.log(700.0), np.log(4500.0))) / speeds.mean()))
    wander = wandering(rng, 10.0 ** rng.uniform(-3.0, -1.7), rng.uniform(1.0, 20.0))
    second = rng.uniform(0.0, 0.7)
    levels = np.array([1.0, second])
    tones = sum(rng.uniform(0.3, 1.0) * harmonics(phase(speed * multiple * wander), np.arange(1, 3), levels, rng)
                for speed in speeds.T)
    return np.asarray(tones) / np.sqrt(0.5 * speeds.shape[1])
