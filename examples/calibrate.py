"""Calibrate a pair of microphones at a head: sound that goes around it arrives later than along a straight line.

python3 examples/calibrate.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_audio import Localizer, calibrate
from av_audio.calibration import measured_path, search_array
from av_common import MicrophoneArray

RATE, SPEED, RADIUS = 48_000, 343.0, 0.0875  # Hz, m/s, m
folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
folder.mkdir(parents=True, exist_ok=True)
pair = MicrophoneArray([[0.0, RADIUS, 0.0], [0.0, -RADIUS, 0.0]], 'head')
random = np.random.default_rng(1)


def recording(azimuth):
    """One second (n, 2) of noise from an azimuth (rad), by Woodworth's formula of the delay at a sphere."""
    side = np.arcsin(np.sin(azimuth))
    delay = RADIUS * (side + np.sin(side)) / SPEED  # s by which the left ear is ahead
    spectrum, omega = np.fft.rfft(random.standard_normal(RATE)), 2.0 * np.pi * np.fft.rfftfreq(RATE, 1.0 / RATE)
    ears = [np.fft.irfft(spectrum * np.exp(sign * 0.5j * omega * delay), RATE) for sign in (1.0, -1.0)]
    return 0.1 * np.stack(ears, axis=1) + 0.02 * random.standard_normal((RATE, 2))


azimuths, paths = [], []
for azimuth in np.radians(np.arange(-90.0, 91.0, 7.5)):
    _, measured = measured_path(pair, Localizer(search_array(pair), RATE).process(recording(azimuth), 0))
    azimuths += [azimuth] * len(measured)
    paths += measured.tolist()
found = calibrate(pair, azimuths, paths)
print(found.report())
found.array.save(folder / 'head.yaml')

angles = np.linspace(0.0, np.pi, 200)
figure, axes = plt.subplots(figsize=(6.4, 3.2), layout='constrained')
axes.plot(90.0 - np.degrees(azimuths), 1e3 * np.array(paths), '.', alpha=0.3, label='measured')
axes.plot(np.degrees(angles), 1e3 * 2.0 * RADIUS * np.cos(angles), 'k--', label='straight line')
axes.plot(np.degrees(angles), 1e3 * found.baseline * found.array.delay_curve.measured_cosine(np.cos(angles)), label='fitted')
axes.set(xlabel='angle to the axis (deg)', ylabel='path difference (mm)')
axes.legend(frameon=False)
figure.savefig(folder / 'calibrate.png', dpi=75)
