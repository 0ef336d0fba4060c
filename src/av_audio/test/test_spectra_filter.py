"""The band-pass filter and the window of the spectra equal those of scipy.signal, which no node imports."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from av_audio.spectra import butterworth_power, tukey


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
