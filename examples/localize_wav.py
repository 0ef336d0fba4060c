"""Localise a sound file: one line for each window, and a picture.

python3 examples/localize_wav.py [FOLDER [SOUND [ARRAY]]]      the defaults are what render_scene.py wrote
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_audio import Localizer, LocalizerSettings, read_sound
from av_common import MicrophoneArray

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
file = Path(sys.argv[2]) if len(sys.argv) > 2 else folder / 'scene.wav'
array = MicrophoneArray.load(sys.argv[3] if len(sys.argv) > 3 else 'config/arrays/two_microphones.yaml')
if not file.exists():
    sys.exit(f'{file} does not exist: name a sound file, or run examples/render_scene.py first')
folder.mkdir(parents=True, exist_ok=True)

samples, rate = read_sound(file)
estimates = Localizer(array, rate, LocalizerSettings(hop_s=0.05)).process(samples, 0)

figure, axes = plt.subplots(figsize=(6.4, 3.2), layout='constrained')
for estimate in estimates:
    for azimuth, variance, confidence in zip(estimate.azimuth, estimate.azimuth_variance, estimate.confidence, strict=True):
        print(f'{estimate.time:6.2f} s  {np.degrees(azimuth):+7.1f} deg +- {np.degrees(np.sqrt(variance)):4.1f}  '
              f'confidence {confidence:.2f}')
        axes.errorbar(estimate.time, np.degrees(azimuth), np.degrees(np.sqrt(variance)), fmt='.', color='C1', alpha=confidence)
truth = folder / 'scene.csv'
if file.name == 'scene.wav' and truth.exists():
    axes.plot(*np.genfromtxt(truth, delimiter=',', skip_header=1).T * [[1.0], [180.0 / np.pi]], 'k--', label='truth')
    axes.legend(frameon=False)
axes.set(xlabel='time (s)', ylabel='azimuth (deg)', title='A pair hears a direction and its mirror image')
figure.savefig(folder / 'localize_wav.png', dpi=75)
