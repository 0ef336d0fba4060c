"""Fuse sound and sight: a drone is heard and seen, and one filter gives its bearing with a standard deviation.

python3 examples/fuse.py [FOLDER [SCENARIO [SECONDS]]]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from av_audio import Localizer
from av_common import State
from av_fusion import CameraMeasurement, Cone, Detection, DoaMeasurement, MultiTargetTracker, Pose
from av_simulator import open_world, steps
from av_vision import Detector, DetectorSettings, bearings_of_boxes, shipped_model

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
scenario, seconds = (sys.argv[2], float(sys.argv[3])) if len(sys.argv) > 3 else ('circle', 4.0)
world = open_world(scenario, seed=1)
array, camera = world.rig.array.geometry, world.rig.camera
localizer, tracker = Localizer(array, world.sample_rate), MultiTargetTracker()
detector = Detector(shipped_model(), DetectorSettings(keep=('drone',)))
tilt, rows, heard = np.radians(8.0), [], 0  # of the camera, upwards
for step in steps(world, seconds, image_rate=5.0):
    for sample in step.truth:
        tracker.add_pose(Pose(sample.time, tuple(sample.rig.attitude_wxyz)))
    for estimate in localizer.process(step.sound, heard):
        if len(estimate.azimuth):
            cone = Cone(tuple(array.basis[:, 0]), estimate.cosine, estimate.cosine_variance)
            tracker.add_doas([DoaMeasurement.of_cone(estimate.time, cone, float(estimate.confidence[0]))])
    for view, image in step.images:
        boxes = detector.detect(image.bgr)
        seen = bearings_of_boxes(camera.model, boxes.centres, boxes.sizes, boxes.scores)
        tracker.add_camera(CameraMeasurement(view.time, tuple(
            Detection(*each) for each in zip(seen.azimuth, seen.azimuth_variance, boxes.scores, seen.elevation + tilt,
                                             seen.elevation_variance, strict=True))))
    heard += len(step.sound)
    track, true = tracker.estimate(step.end), step.truth[-1].bearings[0].azimuth
    if track.state != State.NONE:
        rows.append((step.end, np.degrees(track.azimuth - true), np.degrees(np.sqrt(track.azimuth_variance))))
time, error, sigma = np.array(rows).T
print(f'{scenario}: tracked for {len(rows) / 30:.1f} of {seconds:g} s, RMSE {np.sqrt(np.mean(error**2)):.2f} deg')
figure, axes = plt.subplots(figsize=(6.4, 2.8), layout='constrained')
axes.fill_between(time, -sigma, sigma, alpha=0.3)
axes.plot(time, error)
axes.set(xlabel='time (s)', ylabel='error, sigma (deg)', ylim=(-8.0, 8.0))
folder.mkdir(parents=True, exist_ok=True)
figure.savefig(folder / 'fuse.png', dpi=75)
