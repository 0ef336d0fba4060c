"""Detectors by name, and how one of another package takes part: image in, boxes and scores out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_common.files import check_file
from av_common.methods import Methods
from av_vision.detections import Candidates
from av_vision.image import to_bgr8
from av_vision.yolo.detector import Detector
from av_vision.yolo.letterbox import Region
from av_vision.yolo.model import DetectorSettings

DETECTORS = Methods('av_rig.detectors', {'shipped': 'av_vision.stage:make_detector'}, 'model', 'an ONNX file or ')
# Boxes (n, 4) as x1, y1, x2, y2 in pixels and scores (n,) of 0 to 1, of an image (height, width, 3), BGR.
ImageMethod = Callable[[NDArray[np.uint8]], tuple[Any, Any]]


def is_model_file(name: str) -> bool:
    """Whether a detector is named by a file. Raises ValueError for an unknown name, with those that are installed."""
    if name not in DETECTORS.names and (Path(name).suffix or os.path.isfile(name)):  # noqa: PTH113  Path's raises for some names
        return True
    DETECTORS.check(name)
    return False


def check_model(name: str) -> None:
    """Raise ValueError or OSError for a name that is neither that of a file that is there nor of an installed detector."""
    if is_model_file(name):
        check_file(name, kind='model')


class ForeignDetector(Detector):
    """A detector of another package in the place of a YOLO model. Each image stands alone; all boxes are of one class.

    Parameters:
        method: finds the objects in an image.
        settings: of the detector; those of a network are not used.
        name: class of what is found.
    """

    def __init__(self, method: ImageMethod, settings: DetectorSettings, name: str) -> None:
        self.settings, self._method, self._names = settings, method, [name]
        self.threshold = settings.score_threshold or 0.25
        self.kept = np.ones(1, bool)
        self.model: Any = SimpleNamespace(metadata={}, near=0, longest=0, box_padding=np.zeros(2, np.float32), provider='',
                                          columns='')

    def candidates(self, image: NDArray, floor: float, regions: Sequence[Region] = ()) -> Candidates:
        """See `Detector`; all of the image is searched.

        Raises ValueError where the method gives other shapes or values.
        """
        image = to_bgr8(image)
        boxes, scores = (np.asarray(one, np.float32) for one in self._method(image))
        boxes = boxes.reshape(-1, 4)
        if scores.shape != (len(boxes),) or not (np.isfinite(boxes).all() and ((scores >= 0.0) & (scores <= 1.0)).all()):
            raise ValueError(f'boxes of shape {boxes.shape} and scores of shape {scores.shape}, expected (n, 4) and (n,), '
                             'finite, scores of 0 to 1')
        boxes = np.clip(boxes, 0.0, np.array([image.shape[1], image.shape[0]] * 2, np.float32))
        kept = (boxes[:, 2:] > boxes[:, :2]).all(axis=1) & (boxes > 1.0).any(axis=1)    # else in shares of the image
        if len(boxes) and not kept.any():
            raise ValueError(f'no box is in the image of {image.shape[1]} x {image.shape[0]}, expected x1, y1, x2, y2 '
                             'in pixels')
        boxes, scores = boxes[kept], scores[kept]
        order = np.argsort(-scores, kind='stable')
        order = order[scores[order] >= floor]
        return Candidates(boxes[order], scores[order, np.newaxis])
