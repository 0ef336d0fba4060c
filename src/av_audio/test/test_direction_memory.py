"""The memory of former windows: weak sources are tracked, clear ones are left alone."""

import numpy as np
import pytest

from av_audio.direction_memory import DirectionMemory
from av_audio.localizer import Localizer, LocalizerSettings
from av_audio.steered_response import Peak
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray

HOP_S = 0.1
PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]))
RATE = 16_000


def lobe(memory, q, width=0.03):
    density = np.exp(-0.5 * ((memory.grid - q) / width) ** 2)
    return density / density.sum()


def peak_at(q, share):
    return Peak(np.array([q]), np.array([[1e-4]]), np.zeros((1, 1)), 3.0, share)


def test_a_source_below_the_peaks_of_chance_is_tracked():
    """In each window a chance peak anywhere is twice as likely as the source, which moves steadily."""
    rng, memory = np.random.default_rng(5), DirectionMemory(HOP_S, HOP_S)
    right, alone = [], []
    for k in range(120):
        q, chance = 0.6 * np.sin(0.05 * k), rng.uniform(-1.0, 1.0)
        density = 0.35 * lobe(memory, q + rng.normal(0.0, 0.02)) + 0.65 * lobe(memory, chance)
        chosen = memory.select(peak_at(chance, 0.65), density)
        right.append(abs(chosen.q[0] - q) < 0.1)
        alone.append(abs(chance - q) < 0.1)
    assert np.mean(alone) < 0.2
    assert np.mean(right[20:]) > 0.9


@pytest.mark.parametrize('hop_s', [HOP_S, 0.5])
@pytest.mark.parametrize('own', [-0.95, 0.0, 0.4])
def test_the_first_window_stands_alone(own, hop_s):
    memory, peak = DirectionMemory(hop_s, 0.5), peak_at(own, 0.4)
    assert memory.select(peak, 0.4 * lobe(memory, own) + 0.6 * lobe(memory, 0.7)) is peak


@pytest.mark.parametrize(('share', 'within_s'), [(0.99, 0.0), (0.8, 3.0)])
def test_another_source_is_believed_at_once_where_it_is_clear(share, within_s):
    memory = DirectionMemory(HOP_S, 0.5)
    for _ in range(50):
        memory.select(peak_at(-0.5, share), lobe(memory, -0.5))
    chosen = [memory.select(peak_at(0.5, share), lobe(memory, 0.5)).q[0] for _ in range(50)]
    assert all(q == 0.5 for q in chosen[round(within_s / HOP_S):])


def test_a_window_that_excludes_the_former_direction_keeps_its_own():
    """A peak so sharp that elsewhere nothing is left in floating point, though its share is not clear."""
    memory = DirectionMemory(HOP_S, 0.5)
    for _ in range(50):
        memory.select(peak_at(-0.5, 0.8), lobe(memory, -0.5))
    sharp = np.zeros(len(memory.grid))
    sharp[np.argmin(np.abs(memory.grid - 0.5))] = 1.0
    own = peak_at(0.5, 0.8)
    assert memory.select(own, sharp) is own


def test_what_is_forgotten_has_no_effect():
    fresh, used = DirectionMemory(HOP_S, 0.5), DirectionMemory(HOP_S, 0.5)
    for _ in range(10):
        used.update(lobe(used, 0.3))
    used.clear()
    np.testing.assert_array_equal(fresh.update(lobe(fresh, 0.1)), used.update(lobe(used, 0.1)))


def test_windows_without_a_peak_let_the_source_go_anywhere():
    memory = DirectionMemory(HOP_S, HOP_S)
    for _ in range(20):
        memory.update(lobe(memory, 0.3))
    even = np.full(len(memory.grid), 1.0 / len(memory.grid))
    for _ in range(300):
        posterior = memory.update(even)
    assert posterior.max() < 2.0 * np.median(posterior)


def test_in_diffuse_sound_a_source_is_heard_by_its_persistence():
    """White noise from one direction, 11 dB below sound from everywhere that is another in each block."""
    rng, seconds, q = np.random.default_rng(3), 6.0, 0.4
    count, frequencies = round(seconds * RATE), np.fft.rfftfreq(round(seconds * RATE), 1.0 / RATE)
    white = np.fft.rfft(rng.normal(size=count))
    delays = PAIR.positions[:, 1] * q / speed_of_sound(20.0)
    direct = np.fft.irfft(white * np.exp(2j * np.pi * np.multiply.outer(delays, frequencies)), count).T
    coherence = np.sinc(2.0 * 0.2 * frequencies / speed_of_sound(20.0))
    first, second = np.fft.rfft(rng.normal(size=(2, count)))
    diffuse = np.fft.irfft(np.stack([first, coherence * first + np.sqrt(1.0 - coherence**2) * second]), count).T
    sound = 0.01 * (10.0 ** (-11.0 / 20.0) * direct + diffuse)
    settings = LocalizerSettings(window_s=0.2, max_sources=1)
    memory = [one.q[0] for one in Localizer(PAIR, RATE, settings).process(sound, 0)]
    alone = [Localizer(PAIR, RATE, settings).process(sound[start:start + round(0.2 * RATE)], start)[0].q[0]
             for start in range(0, count - round(0.2 * RATE) + 1, round(0.1 * RATE))]
    far = np.mean(np.abs(np.array(memory[20:]) - q) > 0.2)
    assert far < 0.5 * np.mean(np.abs(np.array(alone[20:]) - q) > 0.2)
