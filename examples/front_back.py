"""Tell front from back by a turn: two microphones hear a drone behind the rig, which turns.

python3 examples/front_back.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_fusion import Cone, DoaMeasurement, MultiTargetTracker, Pose

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
folder.mkdir(parents=True, exist_ok=True)
random, sigma, axis = np.random.default_rng(1), np.radians(3.0), (0.0, 1.0, 0.0)  # the microphones are left and right
drone = np.radians(150.0)  # in the world; the rig faces 0 deg at first

tracker, rows = MultiTargetTracker(), []
for time in np.arange(0.0, 6.0, 0.1):
    yaw = np.radians(-20.0) * np.clip(time - 2.0, 0.0, 2.0)  # from 2 s to 4 s, to the right, at 20 deg/s
    tracker.add_pose(Pose.level(time, yaw, np.radians(-20.0) if 2.0 <= time < 4.0 else 0.0))
    cosine = np.cos(np.pi / 2 - (drone - yaw)) + sigma * random.standard_normal()
    tracker.add_doas([DoaMeasurement.of_cone(time, Cone(axis, float(np.clip(cosine, -1.0, 1.0)), sigma**2), 0.95)])
    track = tracker.estimate(time)
    rows.append((time, np.degrees(track.azimuth_world), track.hemisphere_probability, np.degrees(yaw)))
    if round(10 * time) % 5 == 0:
        print(f'{time:4.1f} s  heading {rows[-1][3]:4.0f} deg  target at {rows[-1][1]:+7.1f} deg in the world, '
              f'side sure to {100 * track.hemisphere_probability:3.0f} %{", resolved" if track.resolved else ""}')

time, azimuth, sure, yaw = np.array(rows).T
figure, (above, below) = plt.subplots(2, 1, figsize=(6.4, 3.8), sharex=True, layout='constrained')
above.plot(time, azimuth, '.', label='estimate')
above.axhline(150.0, color='k', linestyle='--', label='truth')
above.plot(time, yaw, color='gray', label='heading of the rig')
above.set(ylabel='azimuth in the\nworld (deg)', ylim=(-50.0, 190.0))
above.legend(frameon=False, ncol=3)
below.plot(time, 100.0 * sure)
below.set(xlabel='time (s)', ylabel='side is sure to (%)', ylim=(45.0, 103.0))
figure.savefig(folder / 'front_back.png', dpi=75)
