"""Formulas against scipy, numerical integration and counting; and no node imports scipy.signal, which would do the same."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from av_audio.directions import angle_to_axis
from av_audio.ego_noise import notch
from av_audio.ego_peaks import odds_of
from av_audio.spectra import butterworth_power, tukey

FREQUENCIES = np.arange(165.0, 4600.0, 2.0)


@pytest.mark.parametrize(('rate', 'band', 'order'), [
    (48_000, (300.0, 4000.0), 4), (16_000, (100.0, 7900.0), 4), (44_100, (500.0, 7900.0), 2), (8_000, (1.0, 3999.0), 6)])
def test_the_response_is_that_of_scipy(rate, band, order):
    frequencies = np.fft.rfftfreq(4096, 1.0 / rate)
    sections = signal.butter(order, band, 'bandpass', output='sos', fs=rate)
    expected = np.abs(signal.sosfreqz(sections, frequencies, fs=rate)[1]) ** 2
    response = butterworth_power(frequencies / rate, (band[0] / rate, band[1] / rate), order)
    np.testing.assert_allclose(response, expected, atol=1e-6)


@pytest.mark.parametrize('count', [64, 65, 4096, 4801])
@pytest.mark.parametrize('share', [0.1, 0.25, 1.0])
def test_the_window_is_that_of_scipy(count, share):
    np.testing.assert_allclose(tukey(count, share), signal.windows.tukey(count, share), atol=1e-12)


@pytest.mark.parametrize(('module', 'unwanted'), [
    ('av_audio.nodes.doa_node', 'scipy.signal'), ('av_audio.nodes.audio_node', 'scipy')])
def test_a_node_starts_without_what_it_does_not_use(module, unwanted):
    """An essential node that has died is to be back within 2 s; half a second of that was scipy.signal."""
    code = f'import sys, {module}; sys.exit({unwanted!r} in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


@pytest.mark.parametrize('cosine', [0.2, 0.98, 1.0, 1.02, 1.024, 1.03, 1.05, -1.04])
def test_the_angle_is_the_posterior_mean_also_where_no_angle_has_the_cosine(cosine):
    """As by an array that is 3 % longer than its file says: the variance was 0, and fusion left such directions out."""
    sigma, angles = 0.005, np.linspace(0.0, np.pi, 100_001)
    misfit = ((np.cos(angles) - cosine) / sigma) ** 2
    density = np.exp(-0.5 * (misfit - misfit.min()))
    mean = density @ angles / density.sum()
    deviation = np.sqrt(density @ (angles - mean) ** 2 / density.sum())
    assert angle_to_axis(cosine, sigma, sigma) == pytest.approx((mean, deviation), rel=0.03)


@pytest.mark.parametrize('p', [1.0, 0.999, 0.7, 0.1, 1e-3, 1e-9, 0.0])
def test_odds_of_a_peak_are_the_mean_over_sources(p):
    """Of densities x p^(x - 1), by numbers; without a limit where p is 0."""
    x = (np.arange(100_000) + 0.5) / 100_000
    assert odds_of(p) == pytest.approx(np.mean(x * max(p, 1e-30) ** (x - 1.0)), rel=1e-2) if p else odds_of(p) > 1e9


def test_a_notch_covers_the_harmonics_and_little_else():
    free = notch(FREQUENCIES, [180.0])
    for order in range(1, 25):
        assert not free[np.argmin(np.abs(FREQUENCIES - order * 180.0))]
        assert free[np.argmin(np.abs(FREQUENCIES - (order + 0.5) * 180.0))]
    assert notch(FREQUENCIES, [0.0, 1e-9, 0.5]).all()  # the last two as filters and sensors state rest
