"""Output of a simulation to files: sound as WAV, images as video and PNG, true states as CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import soundfile
from scipy.constants import zero_Celsius

from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.rendering.camera_effects import COUNTS_PER_K
from av_simulator.rendering.view import RenderedImage, View
from av_simulator.run import Step, TruthSample
from av_simulator.world import World
from av_vision.image import to_bgr8
from av_vision.sources.files import name_for_opencv

_RIG = ['x', 'y', 'z', 'yaw', 'yaw_rate']
_TARGET = ['x', 'y', 'z', 'vx', 'vy', 'vz', 'azimuth', 'elevation', 'distance']
_BOX = ['min_x', 'min_y', 'max_x', 'max_y', 'visible_fraction', 'transmission', 'score']


class FileRecorder:
    """Writes the steps of a world to a folder.

    The files are `sound.wav` (float, all microphones), `video.mp4`, `truth.csv` (m, rad, s, world ENU; azimuth and
    elevation in the body frame) and `boxes.csv` (px, one row for each target of each image). With `everything` there are
    also `frames/NNNNNN_{rgb,depth,segmentation,thermal}.png`: depth in mm (65535: sky, or farther), segmentation in target
    ids, thermal in hundredths of a kelvin. Raises ValueError or OSError for a folder in which they cannot be.

    Parameters:
        folder: folder of the files, created if needed.
        world: the simulated world, for rig, targets and sample rate.
        image_rate (Hz): rate of the video, 0 for none.
        everything: whether the PNGs of all layers are written.
    """

    def __init__(self, folder: Path, world: World, image_rate: float, everything: bool = False):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._everything = folder, everything
        camera, array = world.rig.camera, world.rig.array.geometry
        video = name_for_opencv((folder / 'video.mp4').absolute())    # FFmpeg takes `a:b` for a protocol
        self._sound = soundfile.SoundFile(folder / 'sound.wav', 'w', world.sample_rate, array.channels, 'FLOAT')
        self._video = None
        if image_rate:
            code = cv2.VideoWriter.fourcc(*'mp4v')
            self._video = cv2.VideoWriter(video, code, image_rate, (camera.width, camera.height))
            if not self._video.isOpened():
                raise OSError(f'{video} cannot be written with {image_rate:g} images a second: OpenCV has no MPEG-4 encoder '
                              'here, or none for this rate')
        numbers = range(len(world.scenario.targets))
        self._files = [(folder / name).open('w', newline='') for name in ('truth.csv', 'boxes.csv')]
        self._truth, self._boxes = map(csv.writer, self._files)
        self._truth.writerow(['time', *(f'rig_{name}' for name in _RIG),
                              *(f'target{number}_{name}' for number in numbers for name in _TARGET)])
        self._boxes.writerow(['time', 'frame', 'target', *_BOX])
        if everything:
            (folder / 'frames').mkdir(exist_ok=True)

    def write(self, step: Step) -> None:
        """Append one step."""
        self._sound.write(step.sound)
        for sample in step.truth:
            self._truth.writerow(_rounded(_truth_row(sample)))
        for view, image in step.images:
            if self._video is not None:
                self._video.write(to_bgr8(image.bgr))
            self._boxes.writerows(_box_rows(view, image))
            if self._everything:
                self._write_frames(view, image)

    def close(self) -> None:
        """Finish the files."""
        self._sound.close()
        _undate(Path(self._sound.name))
        if self._video is not None:
            self._video.release()
        for file in self._files:
            file.close()

    def _write_frames(self, view: View, image: RenderedImage) -> None:
        layers = {'rgb': image.bgr, 'segmentation': image.segmentation, 'depth': image.depth_mm, 'thermal': None}
        if image.thermal is not None:
            layers['thermal'] = (image.thermal + zero_Celsius) * COUNTS_PER_K
        for name, layer in layers.items():
            if layer is not None:
                kind = image.bgr.dtype if name == 'rgb' else np.uint8 if name == 'segmentation' else np.uint16
                file = self._folder / 'frames' / f'{view.index:06d}_{name}.png'
                pixels = np.clip(layer, 0, np.iinfo(kind).max).astype(kind)
                file.write_bytes(cv2.imencode('.png', pixels)[1].tobytes())    # which a full disk makes raise


def _undate(wav: Path) -> None:
    """Clear the date in the PEAK chunk of libsndfile's float files, so that the same run gives the same bytes."""
    with wav.open('r+b') as file:
        chunk = file.read(512).find(b'PEAK')
        if chunk >= 0:
            file.seek(chunk + 12)
            file.write(bytes(4))


def _truth_row(sample: TruthSample) -> list[float]:
    rig = sample.rig
    forward = rig.rotation[:, 0]
    row = [sample.time, *rig.position, np.arctan2(forward[1], forward[0]), rig.rate_flu[2]]
    for target, bearing in zip(sample.targets, sample.bearings, strict=True):
        row += [*target.position, *target.velocity, bearing.azimuth, bearing.elevation, bearing.distance]
    return row


def _box_rows(view: View, image: RenderedImage) -> list[list]:
    return [[f'{view.time:.6f}', view.index, truth.target_id - FIRST_TARGET, *(truth.box or [''] * 4),
             *_rounded([truth.visible_fraction, truth.transmission, truth.score])]
            for truth in image.truth]


def _rounded(values: list[float]) -> list[str]:
    return [f'{value:.6f}' for value in values]
