"""Measurements of the simulated sound, with their limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

from av_evaluation.figures import Figure
from av_evaluation.simulated_sound.fly_by import PAIR, RATE, FlyBy, deviation
from av_simulator.sound.absorption import absorption_db_per_m
from av_simulator.sound.ground import Ground
from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise, Snr
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source import Source
from av_simulator.sound.source_signals import FormulaSignal
from av_simulator.sound.surroundings import Room, Surroundings
from av_simulator.sound.world import SoundWorld

CLIMATES = ((20.0, 50.0), (0.0, 30.0), (35.0, 80.0), (20.0, 10.0))  # degrees Celsius, % humidity


def fly_by() -> Iterator[Figure]:
    """A 1 kHz tone at 20 m/s, 10 m away."""
    scene = FlyBy()
    found = deviation(scene, scene.render())
    yield Figure('error against the analytic signal', found.error_db, 'dB', at_most=-55.0)
    yield Figure('delay, RMS', found.delay_us, 'us', at_most=0.3)
    yield Figure('instantaneous frequency, RMS', found.frequency_hz, 'Hz', at_most=3.0)
    yield Figure('Doppler against f / (1 - M cos), greatest', found.doppler_hz, 'Hz', at_most=3.0)
    yield Figure('level against 1 / r, greatest', found.spreading_db, 'dB', at_most=0.1)
    yield Figure('level difference of the pair, greatest', found.level_difference_db, 'dB', at_most=0.1)


def moving_rig(block: int = 1600) -> Iterator[Figure]:
    """The same tone from a stationary source, received by a rig that flies past at 10 m/s and turns at 90 degrees a second."""
    c, samples = Medium().speed_of_sound, 2 * RATE
    source = np.array([0.0, 10.0, 1.5])

    def microphones(times: NDArray) -> NDArray:
        turn = np.pi / 2 * times
        half = 0.1 * np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
        centre = np.stack([10.0 * (times - 1.0), 0 * times, 0 * times + 1.5], axis=1)
        return np.stack([centre + half, centre - half], axis=1)

    signal = FormulaSignal(lambda t: np.sin(2 * np.pi * 1000.0 * t))
    world = SoundWorld(RATE, [Source(lambda t: np.broadcast_to(source, (len(t), 3)), signal)], noise=Noise(None))
    received = np.concatenate([world.render(block, microphones((start + np.arange(0, block + 1, 160)) / RATE))
                            for start in range(0, samples, block)])
    times = np.arange(samples) / RATE
    distance = np.linalg.norm(microphones(times) - source, axis=-1)
    truth = np.sin(2 * np.pi * 1000.0 * (times[:, None] - distance / c)) / distance
    error = np.mean((received - truth) ** 2) / np.mean(truth**2)
    yield Figure('error against the analytic signal', float(10 * np.log10(error)),
                 'dB', at_most=-55.0)


def air() -> Iterator[Figure]:
    """Attenuation of rendered tones against the formula of ISO 9613-1, in four climates."""
    tones = np.array([50, 100, 200, 500, 1000, 2000, 4000, 6000, 8000, 10000])
    signal = FormulaSignal(lambda t: sum(np.sin(2 * np.pi * tone * t) for tone in tones))
    for distance in (10.0, 50.0, 100.0):
        worst = 0.0
        for temperature, humidity in CLIMATES:
            lost = _amplitudes(signal, tones, distance, Medium(temperature, humidity)) / _amplitudes(
                signal, tones, distance, Medium(temperature, humidity, absorption=True))
            formula = absorption_db_per_m(tones, temperature, humidity) * distance
            worst = max(worst, float(np.abs(20 * np.log10(lost) - formula).max()))
        yield Figure(f'rendered absorption over {distance:.0f} m, 50 Hz to 10 kHz, greatest', worst, 'dB', at_most=0.5)


def _amplitudes(signal: FormulaSignal, tones: NDArray, distance: float, medium: Medium) -> NDArray:
    source = Source(lambda t: np.broadcast_to([distance, 0.0, 0.0], (len(t), 3)), signal)
    received = SoundWorld(RATE, [source], medium, 1, Noise(None)).render(RATE + RATE // 2, np.zeros((2, 1, 3)))
    return np.abs(np.fft.rfft(received[RATE // 2:, 0]))[tones]


def room(order: int = 8, rate: int = 16000) -> Iterator[Figure]:
    """A room with a stationary source, against the image sources of pyroomacoustics."""
    import pyroomacoustics as pra

    size, place, pair, absorption = [6.0, 5.0, 3.0], [2.0, 3.1, 1.4], np.array([[4.1, 1.9, 1.2], [4.1, 2.1, 1.2]]), 0.45
    pulse = firwin(255, [100.0, 7000.0], pass_zero=False, fs=rate)
    signal = FormulaSignal(lambda t: np.interp(t - 0.05, (np.arange(255) - 127) / rate, pulse, left=0.0, right=0.0))
    source = Source(lambda t: np.broadcast_to(place, (len(t), 3)), signal)
    walls = Surroundings(room=Room([0.0, 0.0, 0.0], size, (absorption,), order=order))
    received = SoundWorld(rate, [source], noise=Noise(None), surroundings=walls).render(rate // 2, np.array([pair, pair]))
    pra.constants.set('c', Medium().speed_of_sound)
    pra.constants.set('rir_hpf_enable', False)
    theirs = pra.ShoeBox(size, fs=rate, materials=pra.Material(absorption), max_order=order)
    theirs.add_source(place)
    theirs.add_microphone_array(pair.T)
    theirs.compute_rir()
    late = pra.constants.get('frac_delay_length') // 2
    sent = signal.stream(rate, [0], source.position).read(0, rate // 2)
    known = np.array([np.convolve(sent, responses[0])[late:late + rate // 2] for responses in theirs.rir]).T
    alike = min(np.corrcoef(received[:, channel], known[:, channel])[0, 1] for channel in range(2))
    yield Figure(f'room of order {order}, correlation with pyroomacoustics', float(alike), at_least=0.99)
    ratio = _decay_s(received[:, 0], rate) / _decay_s(known[:, 0], rate)
    yield Figure(f'room of order {order}, T60 over that of pyroomacoustics', ratio, at_least=0.9, at_most=1.1)


def _decay_s(answer: NDArray, rate: int) -> float:
    """T60 (s) from the decay of the backward integral between -5 and -25 dB (ISO 3382-1)."""
    energy = np.cumsum(answer[::-1].astype(float) ** 2)[::-1]
    left = 10 * np.log10(energy / energy[0] + 1e-30)
    first, last = int(np.argmax(left < -5)), int(np.argmax(left < -25))
    return float(-60.0 / np.polyfit(np.arange(first, last) / rate, left[first:last], 1)[0])


def speed() -> Iterator[Figure]:
    """Processor time (s) for one second of two microphones at 48 kHz: a drone, ground, absorption and noise."""
    for block in (480, 1600):
        used = _work(lambda: _drone(Medium(absorption=True), Surroundings(ground=Ground()), Noise(snr=Snr(10.0))), block)
        yield Figure(f'drone, ground, absorption and noise, blocks of {block}', used, 's', at_most=0.2)


def _drone(medium: Medium, surroundings: Surroundings, noise: Noise) -> SoundWorld:
    return SoundWorld(RATE, [Source(FlyBy(start=(-20.0, 10.0, 8.0)).position, RotorSignal())], medium, noise=noise,
                      surroundings=surroundings)


def _work(make: Callable[[], SoundWorld], block: int, repeats: int = 5) -> float:
    """Minimum processor time (s) for one second of sound, after the first block."""
    world, still = make(), np.stack([PAIR, PAIR])
    world.render(block, still)
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        for _ in range(RATE // block):
            world.render(block, still)
        times.append(time.process_time() - begin)
    return min(times)
