"""Absorption and spreading against tables and formulas, as numbers and in rendered sound."""

import numpy as np
import pytest

from av_simulator.sound import FormulaSignal, Medium, Noise, SoundWorld, Source

RATE = 48000
TONES_HZ = np.array([50, 100, 200, 500, 1000, 2000, 4000, 6000, 8000, 10000])


def levels(distance, medium):
    """Amplitudes of TONES_HZ, each 1 at 1 m, at one microphone."""
    signal = FormulaSignal(lambda t: sum(np.sin(2 * np.pi * tone * t) for tone in TONES_HZ))
    source = Source(lambda t: np.broadcast_to([distance, 0.0, 0.0], (len(t), 3)), signal)
    heard = SoundWorld(RATE, [source], medium, 1, Noise(None)).render(RATE + 24000, np.zeros((2, 1, 3)))[24000:, 0]
    return np.abs(np.fft.rfft(heard))[TONES_HZ] / (RATE / 2)


@pytest.mark.parametrize('climate, table', [  # ISO 9613-2:1996, table 2, octave bands from 63 Hz, dB/km
    ((10, 70), (0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117)),
    ((20, 70), (0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6)),
    ((30, 70), (0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3)),
    ((15, 20), (0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202)),
    ((15, 80), (0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8)),
])
def test_absorption_is_that_of_the_standards_table(climate, table):
    exact_midbands = 1000.0 * 10.0 ** (0.3 * np.arange(-4, 4))
    computed = 1000.0 * Medium(*climate).absorption_db_per_m(exact_midbands)
    np.testing.assert_allclose(computed, table, rtol=0.005, atol=0.05)


@pytest.mark.parametrize('distance', [10.0, 50.0, 100.0])
@pytest.mark.parametrize('climate', [(20, 50), (0, 30), (35, 80), (20, 10)])
def test_rendered_absorption_is_the_formula(climate, distance):
    damped = levels(distance, Medium(*climate, absorption=True))
    lost_db = -20 * np.log10(damped / levels(distance, Medium(*climate)))
    np.testing.assert_allclose(lost_db, Medium(*climate).absorption_db_per_m(TONES_HZ) * distance, atol=0.1)


def test_spreading_is_spherical():
    np.testing.assert_allclose(levels(20.0, Medium()), 1 / 20, rtol=1e-3)


@pytest.mark.parametrize('make, message', [
    (lambda: Medium(humidity_percent=140), 'humidity_percent is 140'),
    (lambda: Medium(temperature_c=300), 'temperature_c is 300'),
    (lambda: Medium(pressure_kpa=1013), 'pressure_kpa is 1013'),
])
def test_what_no_air_has_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
