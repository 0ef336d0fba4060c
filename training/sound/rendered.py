"""Sounds that the project renders: multirotors of random build, and engines, helicopters, sirens and alarms."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from material import KNOWN, RATE, Recording
from numpy.typing import NDArray
from scipy.signal import butter, resample_poly, sosfilt

from av_simulator.sound import EngineSignal, HelicopterSignal, RotorSignal, SirenSignal, VoiceSignal
from av_simulator.sound.source_signals import SourceSignal

SECONDS = 2.5
Samples = NDArray[np.float64]
OVER = 3  # rotors are rendered at this multiple of RATE, so that no harmonic is missing below half of RATE


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
        broadband_db_spl=72.0 + rng.uniform(-18.0, 12.0),
        broadband_hz=(rng.uniform(100.0, 1500.0), rng.uniform(3000.0, 12000.0)), modulation=rng.uniform(0.0, 0.8),
        speed=(manoeuvre := _manoeuvres(rng, rotors)))
    rate = OVER * RATE
    wave = signal.stream(rate, [int(rng.integers(2**31))], _still).read(0, int(SECONDS * rate))
    sound = resample_poly(wave, 1, OVER)
    if rng.random() < 0.75:
        whine = _motor_whine(rng, speeds * np.broadcast_to(manoeuvre(_times()), (len(sound), rotors)))
        sound = sound + whine * np.std(sound) * 10.0 ** (rng.uniform(-22.0, 12.0) / 20.0)
    return sound


def engine(rng: np.random.Generator) -> Samples:
    """A piston engine of 1 to 12 cylinders, idling, steady or revving: half orders, resonances of the exhaust, and hiss."""
    firing = np.exp(rng.uniform(np.log(15.0), np.log(260.0)))
    cycles = _phase(firing * _wandering(rng, rng.choice([0.01, 0.05, 0.4]), rng.uniform(0.1, 1.0)))
    cylinders = int(rng.choice([1, 2, 3, 4, 6, 8, 12]))
    orders = np.arange(1, int(min(120, 7500.0 / firing)) * cylinders + 1) / cylinders
    level = orders ** -rng.uniform(0.4, 1.6)
    level[orders % 1.0 != 0.0] *= 10.0 ** (rng.uniform(-30.0, -3.0) / 20.0)
    resonances = sum(np.exp(-0.5 * ((orders * firing - centre) / width) ** 2)
                     for centre, width in zip(rng.uniform(80.0, 2500.0, 3), rng.uniform(50.0, 400.0, 3), strict=True))
    tone = _harmonics(cycles, orders[:200], (level * (0.2 + resonances))[:200], rng)
    return tone / np.std(tone) + rng.uniform(0.02, 1.0) * _band(rng, rng.uniform(50, 500), rng.uniform(800, 7000))


def helicopter(rng: np.random.Generator) -> Samples:
    """Slaps of the main rotor (9 to 35 a second), lines of the tail rotor, whine of the turbine, broadband noise."""
    main = _phase(rng.uniform(9.0, 35.0) * _wandering(rng, 0.01, 0.3))
    slap = np.exp(rng.uniform(2.0, 20.0) * (np.cos(2 * np.pi * main) - 1.0))
    hiss = _band(rng, rng.uniform(30, 200), rng.uniform(600, 6000))
    tail = _harmonics(_phase(rng.uniform(45.0, 140.0) * _wandering(rng, 0.005, 0.3)), np.arange(1, 12),
                      np.arange(1.0, 12.0) ** -rng.uniform(0.5, 2.0), rng)
    whine = _harmonics(_phase(rng.uniform(1500.0, 6000.0) * _wandering(rng, 0.003, 0.5)), np.arange(1, 3), np.ones(2), rng)
    return (hiss * (rng.uniform(0.0, 0.4) + slap) + rng.uniform(0.0, 0.5) * tail / np.std(tail)
            + rng.uniform(0.0, 0.2) * whine + rng.uniform(0.0, 2.0) * np.diff(slap, append=0.0) * 20.0)


def siren(rng: np.random.Generator) -> Samples:
    """A siren or alarm: a swept or stepped tone with harmonics, or beeps."""
    time = _times()
    low = rng.uniform(300.0, 1200.0)
    high, rate = low * rng.uniform(1.0, 2.5), rng.uniform(0.1, 6.0)
    course = {'sweep': 0.5 - 0.5 * np.cos(2 * np.pi * rate * time), 'step': (rate * time) % 1.0 < 0.5,
              'saw': (rate * time) % 1.0}[str(rng.choice(['sweep', 'step', 'saw']))]
    tone = _harmonics(_phase(low + (high - low) * course), np.arange(1, 9), np.arange(1.0, 9.0) ** -rng.uniform(0.3, 2.5), rng)
    return tone * ((rate * time) % 1.0 < rng.uniform(0.3, 1.0)) if rng.random() < 0.4 else tone


def hiss(rng: np.random.Generator) -> Samples:
    """Wind, water or a road: coloured noise that swells."""
    spectrum = np.fft.rfft(rng.standard_normal(int(SECONDS * RATE)))
    frequency = np.maximum(np.fft.rfftfreq(int(SECONDS * RATE), 1.0 / RATE), 20.0)
    coloured = np.fft.irfft(spectrum * frequency ** -rng.uniform(0.0, 1.5), int(SECONDS * RATE))
    return coloured * _wandering(rng, rng.uniform(0.0, 0.6), rng.uniform(0.2, 8.0))


def hum(rng: np.random.Generator) -> Samples:
    """A fan, pump or transformer: steady lines of one fundamental over steady noise."""
    steady = _phase(np.exp(rng.uniform(np.log(20.0), np.log(400.0))) * np.ones(int(SECONDS * RATE)))
    orders = np.arange(1, int(rng.integers(3, 40)))
    tone = _harmonics(steady, orders, orders ** -rng.uniform(0.2, 2.0) * rng.random(len(orders)), rng)
    return tone / np.std(tone) + rng.uniform(0.05, 3.0) * _band(rng, rng.uniform(50, 500), rng.uniform(800, 7000))


def bystander_signal(rng: np.random.Generator) -> SourceSignal:
    """What scenarios of the simulator use as a bystander, of random pitch and speed."""
    low = rng.uniform(300.0, 1200.0)
    return (VoiceSignal(pitch_hz=rng.uniform(80.0, 280.0)),
            EngineSignal(firing_hz=rng.uniform(15.0, 200.0), revving=rng.uniform(0.0, 0.3), noise=rng.uniform(0.1, 0.95)),
            HelicopterSignal(main_hz=rng.uniform(9.0, 30.0), tail_hz=rng.uniform(50.0, 140.0), noise=rng.uniform(0.1, 0.9)),
            SirenSignal(low, low * rng.uniform(1.1, 2.5), rng.uniform(0.1, 5.0), bool(rng.random() < 0.5)))[rng.integers(4)]


def bystander(rng: np.random.Generator) -> Samples:
    """The sound of a bystander of the simulator."""
    return bystander_signal(rng).stream(RATE, [int(rng.integers(2**31))], _still).read(0, int(SECONDS * RATE))


OTHERS: dict[str, Callable[[np.random.Generator], Samples]] = {
    'engine': engine, 'helicopter': helicopter, 'alarm': siren, 'weather': hiss, 'machine': hum, 'bystander': bystander}


def recordings(rng: np.random.Generator, drones: int, others: int) -> Iterator[Recording]:
    """Multirotors, and as many of all other kinds together as `others`."""
    for number in range(drones):
        yield Recording('rendered drone', f'{number}', f'rendered/drone/{number}', KNOWN, multirotor(rng).astype(np.float32))
    kinds = list(OTHERS)
    for number in range(others):
        kind = kinds[number % len(kinds)]
        yield Recording(f'rendered {kind}', f'{number}', f'rendered/{kind}/{number}', KNOWN,
                        OTHERS[kind](rng).astype(np.float32))


def _times() -> Samples:
    return np.arange(int(SECONDS * RATE)) / RATE


def _still(times: NDArray) -> NDArray:
    return np.zeros((len(times), 3))


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
    wander = _wandering(rng, 10.0 ** rng.uniform(-3.0, -1.7), rng.uniform(1.0, 20.0))
    second = rng.uniform(0.0, 0.7)
    levels = np.array([1.0, second])
    tones = sum(rng.uniform(0.3, 1.0) * _harmonics(_phase(speed * multiple * wander), np.arange(1, 3), levels, rng)
                for speed in speeds.T)
    return np.asarray(tones) / np.sqrt(0.5 * speeds.shape[1])


def _harmonics(turns: Samples, orders: NDArray, level: NDArray, rng: np.random.Generator) -> Samples:
    """Sum of sines at the orders of turns (n,) whose frequency stays below half the rate."""
    speed = np.gradient(turns) * RATE
    total = np.zeros(len(turns))
    for order, amplitude in zip(orders, level, strict=True):
        audible = order * speed < 0.48 * RATE
        if audible.any():
            total += amplitude * audible * np.sin(2 * np.pi * (order * turns + rng.random()))
    return total


def _phase(frequency: Samples) -> Samples:
    return np.cumsum(frequency) / RATE


def _wandering(rng: np.random.Generator, depth: float, rate_hz: float) -> Samples:
    """A factor around 1 that varies slowly."""
    points = rng.standard_normal(int(SECONDS * rate_hz) + 3)
    at = np.linspace(0.0, len(points) - 1.001, int(SECONDS * RATE))
    return np.clip(1.0 + depth * np.interp(at, np.arange(len(points)), points), 0.2, 3.0)


def _band(rng: np.random.Generator, low: float, high: float) -> Samples:
    """Noise of unit power in a band."""
    noise = sosfilt(butter(2, [low, high], 'bandpass', fs=RATE, output='sos'), rng.standard_normal(int(SECONDS * RATE)))
    return noise / np.std(noise)
