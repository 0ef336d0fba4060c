"""Detect drones in a video: one line for each image, and the last image with its boxes.

python3 examples/detect_video.py [FOLDER [VIDEO]]      the default is what render_scene.py wrote
"""

import sys
from pathlib import Path

import cv2

from av_vision import Detector, DetectorSettings, TemporalDetector, draw, shipped_model

folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'results/examples')
file = Path(sys.argv[2]) if len(sys.argv) > 2 else folder / 'scene.mp4'
if not file.exists():
    sys.exit(f'{file} does not exist: name a video, or run examples/render_scene.py first')
folder.mkdir(parents=True, exist_ok=True)
video = cv2.VideoCapture(str(file))
rate = video.get(cv2.CAP_PROP_FPS) or 30.0

# Boxes of one image alone would come from `Detector.detect`; here their scores are fused over all images of an object.
detector = TemporalDetector(Detector(shipped_model(), DetectorSettings(keep=('drone',))))
number, drawn = 0, None
while True:
    there, image = video.read()
    if not there:
        break
    detections, tracks = detector.detect(image, number / rate)
    for box, score, track in zip(detections.boxes, detections.scores, tracks, strict=True):
        print(f'{number / rate:6.2f} s  drone {track} at {box.round().astype(int).tolist()}, score {score:.2f}')
    if len(detections) or drawn is None:
        drawn = draw(image, detections, tracks)
    number += 1
print(f'{number} images')
if drawn is None:
    sys.exit(f'{file}: no image can be read')
cv2.imwrite(str(folder / 'detect_video.png'), cv2.resize(drawn, (480, 360), interpolation=cv2.INTER_AREA))
