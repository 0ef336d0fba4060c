"""Compare estimators of directions in noise: ours, and those of installed packages such as examples/own_method.

pip install --no-deps --no-build-isolation examples/own_method
python3 examples/compare_methods.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_audio import DOA_METHODS, Localizer, LocalizerSettings
from av_common import MicrophoneArray, wrap

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
folder.mkdir(parents=True, exist_ok=True)
array, rate = MicrophoneArray.load('config/arrays/two_microphones.yaml'), 48_000
random = np.random.default_rng(1)
count, ratios = rate // 2, (20, 10, 0, -10)
omega = 2.0 * np.pi * np.fft.rfftfreq(count, 1.0 / rate)
errors = {method: {ratio: [] for ratio in ratios} for method in DOA_METHODS.names}
for ratio in ratios:
    for _ in range(8):
        azimuth = random.uniform(-1.0, 1.0)
        spectrum = np.fft.rfft(random.standard_normal(count)) / np.maximum(1.0, omega / 3000.0)
        ahead = array.positions @ [np.cos(azimuth), np.sin(azimuth), 0.0] / 343.0
        sound = np.fft.irfft(spectrum * np.exp(1j * omega * ahead[:, None]), count).T
        sound += sound.std() * 10.0 ** (-ratio / 20.0) * random.standard_normal(sound.shape)
        for method in errors:
            for estimate in Localizer(array, rate, LocalizerSettings(method=method)).process(0.05 * sound / sound.std(), 0):
                errors[method][ratio].append(np.abs(wrap(estimate.azimuth - azimuth)).min(initial=np.pi))

figure, axes = plt.subplots(figsize=(6.4, 3.2), layout='constrained')
for method, found in errors.items():
    medians = [np.degrees(np.median(found[ratio])) for ratio in ratios]
    print(f'{method:16s}' + ''.join(f'{median:7.2f} deg' for median in medians))
    axes.semilogy(ratios, np.maximum(medians, 0.01), 'o-', label=method)
axes.set(xlabel='signal-to-noise ratio (dB)', ylabel='median error (deg)')
axes.legend(frameon=False)
figure.savefig(folder / 'compare_methods.png', dpi=75)
