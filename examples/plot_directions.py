"""Plot directions from above: what a pair and a square of microphones hear of the same drone, with standard deviations.

python3 examples/plot_directions.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_audio import Localizer
from av_common import MicrophoneArray

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
folder.mkdir(parents=True, exist_ok=True)
rate, drone = 48_000, np.radians([35.0, 10.0])  # azimuth, elevation
direction = np.array([np.cos(drone[0]) * np.cos(drone[1]), np.sin(drone[0]) * np.cos(drone[1]), np.sin(drone[1])])
random = np.random.default_rng(1)
omega = 2.0 * np.pi * np.fft.rfftfreq(rate, 1.0 / rate)
spectrum = np.fft.rfft(random.standard_normal(rate))

figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.8), subplot_kw={'projection': 'polar'}, layout='constrained')
for axis, name in zip(axes, ('two_microphones', 'quadrotor_square'), strict=True):
    array = MicrophoneArray.load(f'config/arrays/{name}.yaml')
    ahead = array.positions @ direction / 343.0  # s
    sound = np.fft.irfft(spectrum * np.exp(1j * omega * ahead[:, None]), rate).T
    estimate = Localizer(array, rate).process(0.1 * (sound + 2.0 * random.standard_normal(sound.shape)), 0)[0]
    for azimuth, variance in zip(estimate.azimuth, estimate.azimuth_variance, strict=True):
        sigma = np.sqrt(variance)
        print(f'{name}: {np.degrees(azimuth):+7.1f} deg +- {np.degrees(sigma):.1f}')
        axis.bar(azimuth, 1.0, width=6.0 * sigma, alpha=0.5, color='tab:orange')
    axis.plot([drone[0]] * 2, [0.0, 1.1], 'k--', label='truth')
    axis.set_theta_zero_location('N')
    axis.set_yticks([])
    axis.set_title(f'{name} (3 sigma to either side)', fontsize=9)
figure.savefig(folder / 'plot_directions.png', dpi=75)
