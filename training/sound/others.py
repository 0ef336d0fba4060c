"""Sounds that are no drone's, rendered by what makes them: shaped noise, impulses through resonances, turning machines, voices.

Each kind is a function of random numbers; each call is another build of it. What sounds alike is of one family, and a family
is left out as a whole when the model is judged on kinds that it has never known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from material import RATE
from numpy.typing import NDArray
from scipy.signal import lfilter
from waves import COUNT, Samples, band, harmonics, log_uniform, phase, times, wandering

from av_simulator.sound import EngineSignal, HelicopterSignal, SirenSignal, VoiceSignal
from av_simulator.sound.source_signals import SourceSignal

Rng = np.random.Generator


def shaped(rng: Rng, slope: tuple[float, float]) -> Samples:
    """Gaussian noise (n,) whose power changes as frequency to the power of -slope, through some broad resonances."""
    frequency = np.maximum(np.fft.rfftfreq(COUNT, 1.0 / RATE), 20.0)
    gain = frequency ** (-0.5 * rng.uniform(*slope))
    for _ in range(rng.integers(0, 5)):
        octaves = np.log2(frequency / log_uniform(rng, 100.0, 7000.0)) / rng.uniform(0.1, 1.0)
        gain = gain * (1.0 + rng.uniform(-0.9, 4.0) * np.exp(-0.5 * octaves**2))
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(COUNT)) * gain, COUNT)
    return noise / np.std(noise)


def steady_hiss(rng: Rng) -> Samples:
    """White, pink, brown or blue noise, or through a random filter, as microphones, valves and ventilation make it."""
    if rng.random() < 0.5:
        frequency = np.maximum(np.fft.rfftfreq(COUNT, 1.0 / RATE), 20.0)
        slope = rng.choice([0.0, 0.0, 1.0, 2.0, -1.0])
        return np.fft.irfft(np.fft.rfft(rng.standard_normal(COUNT)) * frequency ** (-0.5 * slope), COUNT)
    return shaped(rng, (-1.0, 2.5))


def swelling_hiss(rng: Rng) -> Samples:
    """Leaves, surf, traffic far away: noise that swells within seconds."""
    return shaped(rng, (0.0, 3.0)) * wandering(rng, rng.uniform(0.1, 0.6), log_uniform(rng, 0.2, 8.0))


def wind(rng: Rng) -> Samples:
    """Turbulence at a capsule: power falls as f^-5/3 above a corner (Kolmogorov), in gusts, with flutter of the cover."""
    frequency = np.fft.rfftfreq(COUNT, 1.0 / RATE)
    gain = (1.0 + (frequency / log_uniform(rng, 20.0, 300.0)) ** 2) ** (-5.0 / 12.0 * rng.uniform(1.0, 2.2))
    gusts = np.exp(1.2 * (wandering(rng, 0.6, rng.uniform(0.5, 6.0)) - 1.0))
    flutter = wandering(rng, rng.uniform(0.0, 0.5), rng.uniform(10.0, 40.0))
    return np.fft.irfft(np.fft.rfft(rng.standard_normal(COUNT)) * gain, COUNT) * gusts * flutter


def rain(rng: Rng) -> Samples:
    """Drops on a housing: impulses of random strength through two or three resonances of the shell, over a soft hiss."""
    drops = rng.random(COUNT) < log_uniform(rng, 5.0, 3000.0) / RATE
    struck = sum(rng.uniform(0.2, 1.0) * _ring(drops * np.abs(rng.standard_normal(COUNT)) ** 2, log_uniform(rng, 200.0, 6000.0),
                                               log_uniform(rng, 0.001, 0.03)) for _ in range(rng.integers(1, 4)))
    return _mixed(struck, band(rng, rng.uniform(200, 1500), rng.uniform(3000, 7500)), rng.uniform(-30.0, 5.0))


def fan(rng: Rng) -> Samples:
    """A household fan or cooler: noise of the stream, one rotor's weak blade-pass lines, hum of the motor."""
    turns = phase(log_uniform(rng, 12.0, 150.0) * wandering(rng, rng.uniform(0.0, 0.003), 0.5))
    blades = int(rng.integers(3, 12))
    lines = harmonics(blades * turns, np.arange(1, 7), np.arange(1.0, 7.0) ** -rng.uniform(0.8, 2.5), rng)
    shaft = harmonics(turns, np.arange(1, 5), rng.random(4) * 10.0 ** (-rng.uniform(5.0, 40.0) / 20.0), rng)
    hum = harmonics(phase(np.full(COUNT, rng.choice([50.0, 60.0]))), 2.0 * np.arange(1, 5), rng.random(4), rng)
    tone = lines + shaft + hum * 10.0 ** (-rng.uniform(0.0, 40.0) / 20.0)
    return _mixed(shaped(rng, (0.0, 2.0)), tone, rng.uniform(-30.0, 3.0))


def vacuum_cleaner(rng: Rng) -> Samples:
    """A universal motor of 12,000 to 40,000 turns a minute, its fan's lines, loud shaped noise of the air, mains ripple."""
    turns = phase(log_uniform(rng, 200.0, 670.0) * wandering(rng, rng.uniform(0.0, 0.02), rng.uniform(0.3, 4.0)))
    fan_lines = harmonics(turns * int(rng.integers(5, 12)), np.arange(1, 4), rng.random(3), rng)
    motor = harmonics(turns, np.arange(1, 12), rng.random(11) * np.arange(1.0, 12.0) ** -rng.uniform(0.3, 1.5), rng)
    air = shaped(rng, (-0.5, 1.5)) * (1.0 + rng.uniform(0.0, 0.5) * np.sin(2.0 * np.pi * rng.choice([100.0, 120.0]) * times()))
    return _mixed(air, motor + rng.uniform(0.0, 1.5) * fan_lines, rng.uniform(-25.0, 3.0)) * wandering(rng, 0.1, 1.0)


def compressor(rng: Rng) -> Samples:
    """Strokes through resonances of the tank, hum of the motor, hiss of the valve."""
    strokes = phase(log_uniform(rng, 8.0, 60.0) * wandering(rng, rng.uniform(0.0, 0.01), 0.5))
    pulses = np.exp(rng.uniform(2.0, 30.0) * (np.cos(2.0 * np.pi * strokes) - 1.0)) * (1.0 + 0.3 * rng.standard_normal(COUNT))
    struck = sum(_ring(pulses, log_uniform(rng, 60.0, 3000.0), log_uniform(rng, 0.002, 0.05)) for _ in range(3))
    return _mixed(struck, shaped(rng, (0.0, 2.0)), rng.uniform(-25.0, 6.0))


def washing_machine(rng: Rng) -> Samples:
    """A drum that turns 1 to 25 times a second and sloshes, a motor whose whine rises and falls, water."""
    drum = 1.0 + rng.uniform(0.1, 0.9) * np.sin(2.0 * np.pi * phase(rng.uniform(0.8, 25.0) * wandering(rng, 0.05, 0.5)))
    speed = log_uniform(rng, 60.0, 700.0) * wandering(rng, rng.uniform(0.0, 0.2), 0.4)
    whine = harmonics(phase(speed), np.arange(1, 9), rng.random(8), rng)
    return _mixed(shaped(rng, (0.5, 2.5)) * drum, whine * (0.5 + 0.5 * drum), rng.uniform(-20.0, 6.0))


def engine(rng: Rng) -> Samples:
    """A piston engine of 1 to 12 cylinders, idling, steady or revving: half orders, resonances of the exhaust, and hiss."""
    firing = log_uniform(rng, 15.0, 260.0)
    cycles = phase(firing * wandering(rng, rng.choice([0.005, 0.02, 0.3]), rng.uniform(0.1, 4.0)))
    cylinders = int(rng.choice([1, 2, 3, 4, 6, 8, 12]))
    orders = np.arange(1, int(min(120, 7500.0 / firing)) * cylinders + 1) / cylinders
    level = orders ** -rng.uniform(0.4, 1.6)
    level[orders % 1.0 != 0.0] *= 10.0 ** (rng.uniform(-30.0, -3.0) / 20.0)
    resonances = sum(np.exp(-0.5 * ((orders * firing - centre) / width) ** 2)
                     for centre, width in zip(rng.uniform(80.0, 2500.0, 3), rng.uniform(50.0, 400.0, 3), strict=True))
    tone = harmonics(cycles, orders[:200], (level * (0.2 + resonances))[:200], rng)
    beat = 1.0 + rng.uniform(0.0, 0.8) * np.sin(2.0 * np.pi * cycles)
    return _mixed(tone, beat * band(rng, rng.uniform(50, 500), rng.uniform(800, 7000)), rng.uniform(-35.0, 6.0))


def mower(rng: Rng) -> Samples:
    """One cylinder of four strokes, 20 to 30 firings a second (or two strokes up to 180), and a blade that cuts."""
    two_strokes = rng.random() < 0.4
    turns = phase((rng.uniform(60.0, 180.0) if two_strokes else rng.uniform(40.0, 60.0))
                  * wandering(rng, rng.uniform(0.002, 0.06), rng.uniform(0.5, 5.0)))
    firings = turns if two_strokes else 0.5 * turns
    bangs = np.exp(rng.uniform(5.0, 40.0) * (np.cos(2.0 * np.pi * firings) - 1.0)) * (1.0 + 0.4 * rng.standard_normal(COUNT))
    exhaust = sum(_ring(bangs, log_uniform(rng, 80.0, 2500.0), log_uniform(rng, 0.001, 0.015)) for _ in range(4))
    blade = harmonics(2.0 * turns, np.arange(1, 9), np.arange(1.0, 9.0) ** -1.0, rng)
    return _mixed(_mixed(exhaust, blade, rng.uniform(-30.0, -3.0)), shaped(rng, (0.0, 2.0)), rng.uniform(-25.0, 3.0))


def car(rng: Rng) -> Samples:
    """It passes: noise of tyres around 1 kHz, a weak engine, louder and quieter."""
    octaves = np.log2(np.maximum(np.fft.rfftfreq(COUNT, 1.0 / RATE), 20.0) / rng.uniform(500.0, 1500.0))
    tyres = np.fft.irfft(np.fft.rfft(rng.standard_normal(COUNT)) * (1.0 + octaves**2) ** -rng.uniform(0.5, 1.5), COUNT)
    near = (1.0 + ((times() - rng.uniform(-2.0, 4.5)) / rng.uniform(0.5, 3.0)) ** 2) ** -0.5
    return near * _mixed(tyres, engine(rng), rng.uniform(-25.0, 0.0))


def train(rng: Rng) -> Samples:
    """Rolling wheels, their joints in pairs, squeal at times, a motor of the inverter that steps."""
    joints = np.zeros(COUNT)
    every = rng.uniform(0.3, 1.5)
    for at in np.arange(rng.uniform(0.0, every), COUNT / RATE, every):
        for later in (0.0, rng.uniform(0.05, 0.2)):
            joints[min(int((at + later) * RATE), COUNT - 1)] = rng.uniform(0.5, 1.0)
    clack = _ring(joints, log_uniform(rng, 150.0, 1500.0), rng.uniform(0.01, 0.05))
    squeal = harmonics(phase(log_uniform(rng, 500.0, 4000.0) * wandering(rng, 0.01, 5.0)), np.arange(1, 4), rng.random(3), rng)
    rolling = shaped(rng, (0.5, 2.0)) * wandering(rng, 0.2, 3.0)
    return _mixed(_mixed(rolling, clack, rng.uniform(-20.0, 10.0)), squeal * wandering(rng, 0.8, 2.0), rng.uniform(-40.0, 0.0))


def aeroplane(rng: Rng) -> Samples:
    """A jet far away: broad noise that falls with frequency, beats of its echo, whine of the fan."""
    whine = harmonics(phase(log_uniform(rng, 800.0, 4000.0) * wandering(rng, 0.003, 0.5)), np.arange(1, 3), rng.random(2), rng)
    return _mixed(shaped(rng, (1.0, 3.0)) * wandering(rng, 0.2, rng.uniform(0.5, 4.0)), whine, rng.uniform(-50.0, -10.0))


def helicopter(rng: Rng) -> Samples:
    """Slaps of the main rotor (9 to 35 a second), lines of the tail rotor, whine of the turbine, broadband noise."""
    main = phase(rng.uniform(9.0, 35.0) * wandering(rng, 0.01, 0.3))
    slap = np.exp(rng.uniform(2.0, 20.0) * (np.cos(2.0 * np.pi * main) - 1.0))
    tail = harmonics(phase(rng.uniform(45.0, 140.0) * wandering(rng, 0.005, 0.3)), np.arange(1, 12),
                     np.arange(1.0, 12.0) ** -rng.uniform(0.5, 2.0), rng)
    whine = harmonics(phase(rng.uniform(1500.0, 6000.0) * wandering(rng, 0.003, 0.5)), np.arange(1, 3), np.ones(2), rng)
    hiss = band(rng, rng.uniform(30, 200), rng.uniform(600, 6000))
    return (hiss * (rng.uniform(0.0, 0.4) + slap) + rng.uniform(0.0, 0.5) * tail / np.std(tail)
            + rng.uniform(0.0, 0.2) * whine + rng.uniform(0.0, 2.0) * np.diff(slap, append=0.0) * 20.0)


def alarm(rng: Rng) -> Samples:
    """A siren or alarm: a swept or stepped tone with harmonics, or beeps."""
    low = rng.uniform(300.0, 1500.0)
    high, rate = low * rng.uniform(1.0, 2.5), log_uniform(rng, 0.1, 8.0)
    turn = (rate * times() + rng.random()) % 1.0
    course = (0.5 - 0.5 * np.cos(2.0 * np.pi * turn), turn < 0.5, turn, np.abs(2.0 * turn - 1.0))[rng.integers(4)]
    tone = harmonics(phase(low + (high - low) * course), np.arange(1, 9), np.arange(1.0, 9.0) ** -rng.uniform(0.3, 2.5), rng)
    return tone * (turn < rng.uniform(0.3, 1.0)) if rng.random() < 0.4 else tone


def comb(rng: Rng) -> Samples:
    """A buzz: harmonics of one fundamental that wanders, such as of pumps, transformers, saws, hornets."""
    cycles = phase(log_uniform(rng, 20.0, 900.0) * wandering(rng, 10.0 ** rng.uniform(-3.5, -1.3), log_uniform(rng, 0.3, 10.0)))
    orders = np.arange(1, int(rng.integers(3, 60)))
    level = orders ** -rng.uniform(0.0, 2.0) * rng.uniform(rng.uniform(0.0, 1.0), 1.0, len(orders))
    tone = harmonics(cycles, orders, level, rng)
    return _mixed(tone, shaped(rng, (0.0, 2.0)), rng.uniform(-40.0, 3.0))


def insects(rng: Rng) -> Samples:
    """Wing beats of one or many (100 to 700 Hz, each wandering), or crickets: a tone of 2 to 7 kHz in chirps."""
    if rng.random() < 0.5:
        beat = log_uniform(rng, 100.0, 700.0)
        swarm = sum(rng.uniform(0.1, 1.0) * wandering(rng, 0.5, 3.0) * harmonics(
            phase(beat * rng.uniform(0.8, 1.2) * wandering(rng, rng.uniform(0.003, 0.06), rng.uniform(0.5, 8.0))),
            np.arange(1, 16), np.arange(1.0, 16.0) ** -rng.uniform(0.5, 2.0), rng) for _ in range(rng.choice([1, 2, 4, 8])))
        return _mixed(swarm, shaped(rng, (0.0, 2.0)), rng.uniform(-30.0, 3.0))
    chirps = sum(((rng.uniform(1.0, 40.0) * times() + rng.random()) % 1.0 < rng.uniform(0.2, 1.0)) * harmonics(
        phase(rng.uniform(2000.0, 7000.0) * wandering(rng, 0.01, 10.0)), np.arange(1, 3), np.array([1.0, 0.1]), rng)
        * (1.0 + rng.uniform(0.0, 1.0) * np.sin(2.0 * np.pi * rng.uniform(20.0, 90.0) * times()))
        for _ in range(rng.choice([1, 3, 6])))
    return _mixed(chirps, shaped(rng, (0.0, 2.0)), rng.uniform(-25.0, 6.0))


def birds(rng: Rng) -> Samples:
    """Calls: short sweeps between 1 and 8 kHz, of one bird or several, with pauses."""
    song = np.zeros(COUNT)
    for _ in range(int(rng.integers(2, 30))):
        length = int(log_uniform(rng, 0.02, 0.4) * RATE)
        start, frequency = int(rng.integers(0, COUNT - length)), log_uniform(rng, 1000.0, 6500.0)
        sweep = frequency * np.exp(rng.uniform(-0.4, 0.4) * np.linspace(-1.0, 1.0, length)
                                   + rng.uniform(0.0, 0.1) * np.sin(np.arange(length) / RATE * rng.uniform(100.0, 600.0)))
        song[start:start + length] += rng.uniform(0.1, 1.0) * np.hanning(length) * np.sin(2.0 * np.pi * phase(sweep))
    return _mixed(song + 1e-4 * rng.standard_normal(COUNT), shaped(rng, (0.0, 2.0)), rng.uniform(-30.0, 6.0))


def speech(rng: Rng) -> Samples:
    """A voice of the simulator, alone or among others."""
    voices = [VoiceSignal(pitch_hz=rng.uniform(80.0, 300.0)) for _ in range(rng.choice([1, 1, 2, 5]))]
    return np.asarray(sum(rng.uniform(0.3, 1.0) * played(voice, rng) for voice in voices))


def music(rng: Rng) -> Samples:
    """Notes of some instruments that fade, chords, a beat."""
    piece = np.zeros(COUNT)
    for _ in range(int(rng.integers(4, 25))):
        start = int(rng.integers(0, COUNT - 2000))
        semitone, length = rng.integers(-24, 25), COUNT - start
        note = harmonics(phase(np.full(length, 261.6 * 2.0 ** (semitone / 12.0))), np.arange(1, 12),
                         np.arange(1.0, 12.0) ** -rng.uniform(0.5, 2.5), rng)
        piece[start:] += note * np.exp(-np.arange(length) / RATE / log_uniform(rng, 0.1, 2.0))
    return _mixed(piece, rain(rng), rng.uniform(-40.0, -5.0))


def clatter(rng: Rng) -> Samples:
    """Hammers, doors, steps, tools: few impulses through resonances."""
    blows = (rng.random(COUNT) < rng.uniform(1.0, 15.0) / RATE) * rng.uniform(0.2, 1.0, COUNT)
    blows[int(rng.integers(COUNT))] = 1.0
    struck = sum(rng.random() * _ring(blows, log_uniform(rng, 80.0, 6000.0), log_uniform(rng, 0.005, 0.2)) for _ in range(6))
    return _mixed(struck, shaped(rng, (0.0, 2.0)), rng.uniform(-40.0, -5.0))


def bystander_signals(rng: Rng) -> tuple[SourceSignal, ...]:
    """What scenarios of the simulator use as bystanders, of random pitch and speed: voice, engine, helicopter, siren."""
    low = rng.uniform(300.0, 1200.0)
    return (VoiceSignal(pitch_hz=rng.uniform(80.0, 280.0)),
            EngineSignal(firing_hz=rng.uniform(15.0, 200.0), revving=rng.uniform(0.0, 0.3), noise=rng.uniform(0.1, 0.95)),
            HelicopterSignal(main_hz=rng.uniform(9.0, 30.0), tail_hz=rng.uniform(50.0, 140.0), noise=rng.uniform(0.1, 0.9)),
            SirenSignal(low, low * rng.uniform(1.1, 2.5), rng.uniform(0.1, 5.0), bool(rng.random() < 0.5)))


def played(signal: SourceSignal, rng: Rng) -> Samples:
    """The sound (n,) of a source of the simulator at rest."""
    return signal.stream(RATE, [int(rng.integers(2**31))], lambda moments: np.zeros((len(moments), 3))).read(0, COUNT)


# Each kind and its fold. What is alike is of one family, in one fold: the model that judges it has never known any of it.
KINDS: dict[str, tuple[Callable[[Rng], Samples], int]] = {
    'steady hiss': (steady_hiss, 1), 'fan': (fan, 1), 'vacuum cleaner': (vacuum_cleaner, 1),
    'swelling hiss': (swelling_hiss, 2), 'wind': (wind, 2), 'rain': (rain, 2), 'car': (car, 2), 'train': (train, 2),
    'aeroplane': (aeroplane, 2),
    'engine': (engine, 3), 'mower': (mower, 3), 'compressor': (compressor, 3), 'rendered helicopter': (helicopter, 3),
    'washing machine': (washing_machine, 3),
    'comb': (comb, 4), 'insects': (insects, 4), 'alarm': (alarm, 4),
    'birds': (birds, 5), 'speech': (speech, 5), 'music': (music, 5), 'clatter': (clatter, 5),
    'simulated voice': (lambda rng: played(bystander_signals(rng)[0], rng), 5),
    'simulated engine': (lambda rng: played(bystander_signals(rng)[1], rng), 3),
    'simulated helicopter': (lambda rng: played(bystander_signals(rng)[2], rng), 3),
    'simulated siren': (lambda rng: played(bystander_signals(rng)[3], rng), 4)}


def _ring(pulses: NDArray, frequency: float, seconds: float) -> Samples:
    """Pulses (n,) through a resonance of a frequency (Hz) that decays by 1 / e within `seconds`."""
    decay = np.exp(-1.0 / (seconds * RATE))
    rung = lfilter([1.0], [1.0, -2.0 * decay * np.cos(2.0 * np.pi * frequency / RATE), decay**2], pulses)
    return np.asarray(rung) / (np.std(rung) + 1e-12)


def _mixed(first: Samples, second: Samples, level_db: float) -> Samples:
    """Two sounds, the second `level_db` over the first."""
    return first / (np.std(first) + 1e-12) + 10.0 ** (level_db / 20.0) * second / (np.std(second) + 1e-12)
