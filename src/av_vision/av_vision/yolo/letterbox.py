"""Conversion of images to the size and the tensor layout of a model's input."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

LETTERBOX_GREY = 114  # the grey that YOLO models are trained with


def letterbox(image: NDArray[np.uint8], height: int, width: int) -> tuple[NDArray[np.uint8], float]:
    """A BGR image (h, w, 3) scaled to the top left of a grey image of height x width, and the scale.

    Results of a YOLO network do not depend on the position of the padding, so that a division maps boxes back.

    Parameters:
        image (h, w, 3): BGR image.
        height, width (pixels): size of the result.
    """
    scale = min(height / image.shape[0], width / image.shape[1])
    if scale != 1.0:
        size = max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1)
        method = cv2.INTER_AREA if scale < 0.5 else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, size, interpolation=method), np.uint8)
    if image.shape[:2] == (height, width):
        return image, scale
    canvas = np.full((height, width, 3), LETTERBOX_GREY, np.uint8)
    canvas[:image.shape[0], :image.shape[1]] = image
    return canvas, scale


def fitting_size(image_height: int, image_width: int, longest: int, multiple: int = 32) -> tuple[int, int]:
    """Height and width, multiples of `multiple`, into which an image fits when its longer side becomes `longest`.

    Parameters:
        image_height, image_width (pixels): size of the image.
        longest (pixels): longer side of the scaled image.
        multiple (pixels): both sides of the result are multiples of it.
    """
    scale = longest / max(image_height, image_width)
    height, width = (max(math.ceil(round(side * scale) / multiple), 1) * multiple for side in (image_height, image_width))
    return height, width


def to_tensor(images: list[NDArray[np.uint8]], rgb: bool, scale: float, dtype: DTypeLike) -> NDArray:
    """Convert images to a batch (n, 3, h, w).

    Parameters:
        images: BGR images (h, w, 3) of one size.
        rgb: whether the batch is RGB instead of BGR.
        scale: factor of all values.
        dtype: type of the batch.
    """
    tensor = np.empty((len(images), 3, *images[0].shape[:2]), dtype)
    for image, planes in zip(images, tensor, strict=True):
        # Plane by plane, in half the time of cv2.dnn.blobFromImages.
        for channel, plane in zip(cv2.split(image)[::-1 if rgb else 1], planes, strict=True):
            np.multiply(channel, np.float32(scale), out=plane, casting='unsafe')
    return tensor
