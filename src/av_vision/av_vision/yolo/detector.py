"""Detection in one image: candidates of a network, their suppression, and the selection by class and score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_vision.detections import Candidates, Detections, suppress
from av_vision.image import to_bgr8
from av_vision.yolo.letterbox import Region, fitting_size, letterbox, whole_in_tile
from av_vision.yolo.model import DetectorSettings, Model, ModelError

NEAR = 0.25  # share of the image's longer side above which objects may be too large for a network with a large input
NEAR_MODEL = 0.065  # ... above which a network made for near objects is asked as well
MOST_DETECTIONS = 50  # in an image, by falling score


class Detector:
    """A YOLO model with its settings. Raises ModelError when the model cannot be used.

    Parameters:
        model_path: ONNX file.
        settings: options.
    """

    def __init__(self, model_path: str | Path, settings: DetectorSettings | None = None) -> None:
        self.settings = settings = settings or DetectorSettings()
        self.model = Model(model_path, settings)
        self.near = self._near_model(Path(model_path))
        self.threshold = settings.score_threshold or self.model.score_threshold
        names = [settings.rename.get(name, name) for name in self.model.class_names]
        for given, known in ((settings.rename, self.model.class_names), (settings.keep, names)):
            if unknown := sorted(set(given) - set(known)):
                raise ModelError(f'{model_path} has the classes {sorted(set(known))}, not {unknown}: name those that are '
                                 'drones by keep_classes of detector_node, --classes of detect')
        # Classes of one name are merged, so that one object with the classes bird and kite gives one detection.
        self._names = list(dict.fromkeys(names))
        self._classes = [[i for i, other in enumerate(names) if other == name] for name in self._names]
        self.kept = np.array([not settings.keep or name in settings.keep for name in self._names], bool)

    def _near_model(self, path: Path) -> Model:
        """The network of the metadata's `near_model`, a file beside the model; the model itself without."""
        name, model = self.model.metadata.get('near_model', ''), self.model
        if not name or not model.near:
            return model
        if Path(name).name != name:
            raise ModelError(f'{path} has near_model {name!r} in its metadata, expected the name of a file beside it')
        near = Model(path.parent / name, replace(self.settings, input_size=model.near))
        if near.class_names != model.class_names:
            raise ModelError(f'{near.path} has the classes {near.class_names}, expected those of {path}: {model.class_names}')
        return near

    def detect(self, image: NDArray) -> Detections:
        """Detections in one image: BGR (h, w, 3), grey (h, w) or 16-bit; raises ValueError for other arrays."""
        return self.select(self.candidates(image, self.threshold))[0]

    def candidates(self, image: NDArray, floor: float, regions: Sequence[Region] = ()) -> Candidates:
        """Boxes of all names in an image, by falling score.

        Parameters:
            image (h, w[, channels]): BGR, grey or 16-bit.
            floor (0-1): least probability of a box.
            regions: parts of the image to search; by default all of it, and once more at a smaller size for large objects.
        """
        image = to_bgr8(image)
        found = [self._infer(image, region, floor) for region in regions or self.whole(*image.shape[:2])]
        boxes, probabilities = (np.concatenate(part) for part in zip(*found, strict=True))
        # A box whose middle is in the image may reach beyond it, as its object or its padding does: the middle is the bearing.
        middle, size = 0.5 * (boxes[:, :2] + boxes[:, 2:]), np.array(image.shape[1::-1], np.float32)
        inside = ((middle >= 0.0) & (middle <= size)).all(axis=1, keepdims=True)
        boxed = np.where(inside, boxes, np.clip(boxes, 0.0, np.tile(size, 2)))
        candidates = Candidates(boxed.astype(np.float32), probabilities)
        # Exports without duplicates of their own may have one object as two classes.
        selected = suppress(boxes, candidates.scores)
        return Candidates(candidates.boxes[selected], probabilities[selected])

    def select(self, candidates: Candidates, threshold: float = 0.0) -> tuple[Detections, NDArray[np.intp]]:
        """The candidates above a threshold (0-1; 0: the detector's) with the names to report, and their indices."""
        if not len(candidates):
            return Detections(), np.empty(0, np.intp)
        scores, classes = candidates.scores, candidates.probabilities.argmax(axis=1)
        order = np.argsort(-scores, kind='stable')
        reported = (scores[order] > (threshold or self.threshold)) & self.kept[classes[order]]
        selected = order[reported][:MOST_DETECTIONS]
        return Detections(candidates.boxes[selected], scores[selected].astype(np.float32),
                          tuple(self._names[i] for i in classes[selected])), selected

    def whole(self, height: int, width: int) -> list[Region]:
        """The whole image, and a smaller copy for objects too large for the network's input."""
        full = Region('full', 0, 0, width, height, self.model.longest)
        if not self.model.near:
            return [full]
        least = (NEAR if self.near is self.model else NEAR_MODEL) * max(width, height)
        return [full, Region('near', 0, 0, width, height, self.model.near, least)]

    def _infer(self, image: NDArray[np.uint8], region: Region, floor: float) -> tuple[NDArray, NDArray]:
        """Boxes in the image and probabilities of names, of those that are whole in a region and not smaller than its least."""
        model = self.near if region.kind == 'near' else self.model
        size = fitting_size(region.height, region.width, region.longest) if self.model.dynamic_size else self.model.size
        part = image[region.y:region.y + region.height, region.x:region.x + region.width]
        fitted, scale = letterbox(part, *size)
        boxes, probabilities = model.boxes(fitted, (scale * region.height, scale * region.width), floor)
        boxes = self._in_image(boxes, scale, model.box_padding) + np.array([region.x, region.y] * 2, np.float32)
        selected = whole_in_tile(boxes, region, image.shape[1], image.shape[0])
        if region.least:
            selected &= (boxes[:, 2:] - boxes[:, :2] - self.model.box_padding).max(axis=1, initial=0.0) > region.least
        return self._named(boxes[selected], probabilities[selected])

    def _in_image(self, boxes: NDArray, scale: float, padding: NDArray) -> NDArray:
        """Boxes in the image, padded in pixels as the model's, from boxes in an input of `scale` times its size."""
        middle, half = 0.5 * (boxes[:, :2] + boxes[:, 2:]) / scale, 0.5 * (boxes[:, 2:] - boxes[:, :2])
        half = (half - np.minimum(0.5 * padding, half)) / scale + np.minimum(0.5 * self.model.box_padding, half)
        return np.concatenate([middle - half, middle + half], axis=1)

    def _named(self, boxes: NDArray, probabilities: NDArray) -> tuple[NDArray, NDArray]:
        """Largest probability of each name, without boxes of unnamed classes."""
        count = len(self.model.class_names)
        good = probabilities[:, :count].max(axis=1, initial=0.0) == probabilities.max(axis=1, initial=0.0)
        table = np.zeros((np.count_nonzero(good), count), np.float32)
        table[:, :probabilities.shape[1]] = probabilities[good, :count]
        return boxes[good], np.stack([table[:, classes].max(axis=1) for classes in self._classes], axis=1)
