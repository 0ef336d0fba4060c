"""A second look at what a network for small objects found: an enlarged window around each, shown to the near network."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from av_vision.score_fusion import logit
from av_vision.yolo.letterbox import to_tensor
from av_vision.yolo.model import Model, ModelError, parsed

SIDE = 128                   # pixels of a window as input of the network
CONTEXT, LEAST_SIDE = 3.0, 24.0  # side of a window in sizes of its object; at least so many pixels of the image
CENTRAL = 1.0 / 6.0          # of the window's side, distance from its middle up to which a box is about the same object
MOST, LEAST = 4, 0.05        # windows of an image, and probability from which a candidate gets one


@dataclass(frozen=True)
class SecondLook:
    """Combination of the log-odds of two networks: gain * first + weight * second + shift (logistic regression).

    Parameters:
        gain, weight: of the first and of the second network.
        shift (log-odds): constant.
    """

    gain: float
    weight: float
    shift: float

    @classmethod
    def of_model(cls, model: Model) -> SecondLook | None:
        """From `second_look` of the metadata, [gain, weight, shift], None without; raises ModelError for other values."""
        text = model.metadata.get('second_look')
        if text is None:
            return None
        given = parsed(text)
        good = isinstance(given, (list, tuple)) and len(given) == 3 and all(
            isinstance(one, (int, float)) and abs(one) <= 20.0 for one in given)
        if not good:
            raise ModelError(f'{model.path} has second_look {text[:80]!r} in its metadata, expected [gain, weight, shift]')
        return cls(*map(float, given))  # type: ignore[misc,arg-type]

    def combined(self, first: NDArray, second: NDArray) -> NDArray[np.float32]:
        """Probabilities of both networks (any shape) as one."""
        odds = self.gain * logit(first) + self.weight * logit(second) + self.shift
        return np.asarray(1.0 / (1.0 + np.exp(-odds)), np.float32)


def windows(image: NDArray[np.uint8], boxes: NDArray, padding: NDArray) -> NDArray[np.uint8]:
    """Windows (n, SIDE, SIDE, 3) around boxes (n, 4), which are wider and higher than their objects by `padding` (2,) pixels.

    What is outside of the image repeats its edge.
    """
    made = np.empty((len(boxes), SIDE, SIDE, 3), np.uint8)
    for k, box in enumerate(boxes):
        size = float(np.maximum(box[2:] - box[:2] - padding, 4.0).max())
        side = round(max(CONTEXT * size, LEAST_SIDE))
        left, top = np.rint(0.5 * (box[:2] + box[2:] - side)).astype(int)
        rows = np.clip(np.arange(top, top + side), 0, image.shape[0] - 1)
        columns = np.clip(np.arange(left, left + side), 0, image.shape[1] - 1)
        how = cv2.INTER_AREA if side > SIDE else cv2.INTER_LINEAR
        made[k] = cv2.resize(image[rows[:, None], columns], (SIDE, SIDE), interpolation=how)
    return made


def second_probabilities(model: Model, made: NDArray[np.uint8]) -> NDArray[np.float32]:
    """What a network says of the middle of windows (n, SIDE, SIDE, 3): largest probability (n, classes) of a box there."""
    outputs = model.run(to_tensor(list(made), model.layout.rgb, model.layout.scale, model.dtype))
    found = np.zeros((len(made), len(model.class_names)), np.float32)
    for k, output in enumerate(outputs):
        boxes, probabilities = model.layout.decode(output, (SIDE, SIDE), 0.0)
        off = np.abs(0.5 * (boxes[:, :2] + boxes[:, 2:]) - 0.5 * SIDE).max(axis=1)
        found[k] = probabilities[off < CENTRAL * SIDE].max(axis=0, initial=0.0)
    return found
