"""Triangulate with two rigs: each knows directions only, one of them by a wrong heading; together they know the position.

python3 examples/triangulate.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_network import NetworkTracker, Report, RigSettings, Sighting

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
folder.mkdir(parents=True, exist_ok=True)
places = {'left': np.array([0.0, 0.0, 1.5]), 'right': np.array([40.0, 0.0, 1.5])}  # m: east, north, up
heading_error = {'left': 0.0, 'right': np.radians(2.0)}
random, sigma = np.random.default_rng(1), np.radians(0.5)
tracker = NetworkTracker([RigSettings('left', heading_sigma=1e-3, clock_sigma=0.0), RigSettings('right', clock_sigma=0.0)])

rows = []
for time in np.arange(0.0, 30.0, 0.25):
    drone = np.array([20.0 + 25.0 * np.cos(0.2 * time), 60.0 + 25.0 * np.sin(0.2 * time), 20.0])
    for name, place in places.items():
        away = drone - place
        azimuth = np.arctan2(away[1], away[0]) + heading_error[name] + sigma * random.standard_normal()
        elevation = np.arctan2(away[2], np.hypot(away[0], away[1])) + sigma * random.standard_normal()
        seen = Sighting(1, azimuth, elevation, sigma**2 * np.eye(2), time)
        tracker.use(Report(name, time, place, (seen,)))
    for state in tracker.states(time):
        if state.positioned:
            rows.append((*drone[:2], *state.mean[:2]))
            if time % 3.0 == 0.0:
                spread = np.sqrt(np.trace(state.covariance[:3, :3]))
                print(f'{time:4.0f} s  at {state.mean[:3].round(1)} m +- {spread:.1f}, true {drone.round(1)}')

found = np.array(rows)
figure, axes = plt.subplots(figsize=(4.8, 4.2), layout='constrained')
axes.plot(found[:, 0], found[:, 1], 'k.', markersize=3, label='truth')
axes.plot(found[:, 2], found[:, 3], '.', label='found')
axes.plot(*np.array(list(places.values()))[:, :2].T, '^', markersize=9, label='rigs')
axes.set(xlabel='east (m)', ylabel='north (m)', aspect='equal')
axes.legend(frameon=False)
figure.savefig(folder / 'triangulate.png', dpi=75)
