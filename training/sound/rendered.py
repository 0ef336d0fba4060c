"""Multirotors and aeroplanes of random build that the project renders, and sounds of other kinds (`others.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from material import FOLDS, RATE, SPEED_OF_SOUND, Recording
from numpy.typing import NDArray
from others import KINDS
from scipy.signal import resample_poly
from waves import SECONDS, Samples, harmonics, log_uniform, phase, times, wandering

from av_simulator.sound import RotorSignal

OVER = 3  # rotors are rendered at this multiple of RATE, so that no harmonic is missing below half of RATE


def recordings(rng: np.random.Generator, counts: dict[str, int]) -> Iterator[Recording]:
    """Drones of each build, spread over the folds, and sounds of each other kind, which is in the fold of its family.

    Parameters:
        rng: source of random numbers.
        counts: numbers of sounds by kind, `drone` for each build and `other` for kinds that have none of their own.
    """
    for kind, render in (('rendered drone', multirotor), ('aeroplane drone', aeroplane)):
        for number in range(counts['drone']):
            yield Recording(kind, 1 + number % FOLDS, render(rng).astype(np.float32))
    for kind, (render, fold) in KINDS.items():
        for _ in range(counts.get(kind, counts['other'])):
            yield Recording(kind, fold, render(rng).astype(np.float32))


def multirotor(rng: np.random.Generator) -> Samples:
    """A drone of 3 to 8 rotors, of 0.1 to 30 kg, hovering or manoeuvring."""
    rotors = int(rng.choice([3, 4, 6, 8], p=[0.04, 0.66, 0.18, 0.12]))
    blades = int(rng.choice([2, 3, 4], p=[0.7, 0.25, 0.05]))
    hover = log_uniform(rng, 75.0, 520.0) / blades  # Hz; small drones are fast
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
    sound = _at_rest(signal, manoeuvre, rng)
    if rng.random() < 0.75:
        whine = _motor_whine(rng, speeds * np.broadcast_to(manoeuvre(times()), (len(sound), rotors)))
        sound = sound + whine * np.std(sound) * 10.0 ** (rng.uniform(-22.0, 12.0) / 20.0)
    return sound


def aeroplane(rng: np.random.Generator) -> Samples:
    """An electric aeroplane of 0.5 to 20 kg with one propeller or two that flies past, straight and evenly.

    Two or three blades turn at 4,000 to 12,000 a minute; their speed wanders by some thousandths, as no controller changes it
    to hold the attitude. A propeller in free air loses its harmonics quickly; one behind a wing or fuselage keeps many, as each
    blade cuts the wake (Block and Gentry, NASA TP-2609, 1986). Its blades always hiss. The motor, without gears, whines at
    multiples of its speed.
    """
    propellers = int(rng.choice([1, 2], p=[0.7, 0.3]))
    pusher = rng.random() < 0.5
    speeds = rng.uniform(4000.0, 12000.0) / 60.0 * (1.0 + rng.uniform(0.0, 0.02) * rng.standard_normal(propellers))
    falling = -np.cumsum(rng.uniform(*((0.0, 4.0) if pusher else (2.0, 8.0)), 5))
    signal = RotorSignal(
        rotor_hz=tuple(speeds), blades=int(rng.choice([2, 3], p=[0.75, 0.25])), tone_db_spl=72.0, harmonics_db=(0.0, *falling),
        rolloff_db=rng.uniform(0.3, 2.0) if pusher else rng.uniform(1.0, 4.0), harmonics=int(rng.integers(12, 50)),
        imbalance_db=rng.uniform(-40.0, -12.0), jitter=10.0 ** rng.uniform(-3.2, -2.2), jitter_hz=rng.uniform(1.0, 15.0),
        broadband_db_spl=72.0 + rng.uniform(-13.0, 5.0),
        broadband_hz=(rng.uniform(200.0, 1200.0), rng.uniform(4000.0, 12000.0)), modulation=rng.uniform(0.1, 0.8))
    passing = _flypast(rng)
    sound = _at_rest(signal, passing, rng)
    if rng.random() < 0.75:
        whine = _motor_whine(rng, speeds * np.broadcast_to(passing(times()), (len(sound), propellers)))
        sound = sound + whine * np.std(sound) * 10.0 ** (rng.uniform(-25.0, 3.0) / 20.0)
    return sound


def _flypast(rng: np.random.Generator) -> Callable[[NDArray], NDArray]:
    """Frequencies relative to those at rest, of a source that flies straight past at 10 to 30 m/s: the Doppler shift."""
    velocity, closest, along = rng.uniform(10.0, 30.0), log_uniform(rng, 10.0, 150.0), rng.uniform(-150.0, 150.0)

    def speed(times: NDArray) -> NDArray:
        ahead = along + velocity * np.asarray(times)
        return (1.0 / (1.0 + velocity / SPEED_OF_SOUND * ahead / np.hypot(ahead, closest)))[:, None]

    return speed


def _at_rest(signal: RotorSignal, speed: Callable[[NDArray], NDArray], rng: np.random.Generator) -> Samples:
    """The sound (n,) of rotors at a place, which turn at given speeds relative to hovering."""
    rate = OVER * RATE
    stream = signal.stream(rate, [int(rng.integers(2**31))], lambda moments: np.zeros((len(moments), 3)), speed)
    return np.asarray(resample_poly(stream.read(0, int(SECONDS * rate)), 1, OVER))


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
    multiple = max(1.0, round(log_uniform(rng, 700.0, 4500.0) / speeds.mean()))
    wander = wandering(rng, 10.0 ** rng.uniform(-3.0, -1.7), rng.uniform(1.0, 20.0))
    second = rng.uniform(0.0, 0.7)
    levels = np.array([1.0, second])
    tones = sum(rng.uniform(0.3, 1.0) * harmonics(phase(speed * multiple * wander), np.arange(1, 3), levels, rng)
                for speed in speeds.T)
    return np.asarray(tones) / np.sqrt(0.5 * speeds.shape[1])
