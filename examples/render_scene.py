"""Render a scene and hear it: sound, video and true azimuths of a drone that circles the rig.

python3 examples/render_scene.py [FOLDER [SCENARIO [SECONDS]]]
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import soundfile

from av_audio import Localizer
from av_simulator import open_world, steps

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
scenario, seconds = sys.argv[2] if len(sys.argv) > 2 else 'circle', float(sys.argv[3]) if len(sys.argv) > 3 else 4.0
folder.mkdir(parents=True, exist_ok=True)

world = open_world(scenario, seed=1)
camera, localizer = world.rig.camera, Localizer(world.rig.array.geometry, world.sample_rate)
video = cv2.VideoWriter(str(folder / 'scene.mp4'), cv2.VideoWriter.fourcc(*'mp4v'), 15.0, (camera.width, camera.height))
sound, truth, image, heard = [], [], None, 0
for step in steps(world, seconds):
    for estimate in localizer.process(step.sound, heard):  # heard while it is rendered
        true = np.degrees(np.interp(estimate.time, *np.array(truth).T))
        print(f'{estimate.time:5.2f} s  heard at {", ".join(f"{a:+6.1f}" for a in np.degrees(estimate.azimuth))} deg, '
              f'true {true:+6.1f} deg, {estimate.level_dbfs:.0f} dBFS')
    heard += len(step.sound)
    sound.append(step.sound)
    truth += [(sample.time, sample.bearings[0].azimuth) for sample in step.truth]
    for _, rendered in step.images:
        image = rendered.bgr
        video.write(image)
video.release()

sound = np.concatenate(sound)
soundfile.write(folder / 'scene.wav', sound / max(1.0, np.abs(sound).max()), world.sample_rate, 'FLOAT')
np.savetxt(folder / 'scene.csv', truth, delimiter=',', header='time,azimuth', comments='')
cv2.imwrite(str(folder / 'render_scene.png'), cv2.resize(image, (480, 360), interpolation=cv2.INTER_AREA))
