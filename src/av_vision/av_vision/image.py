"""Images of `sensor_msgs` as arrays and back, without cv_bridge: views and one copy, never a loop over pixels."""

from __future__ import annotations

import sys
from array import array

import cv2
import numpy as np
from numpy.typing import NDArray

# encoding -> (dtype, channels, OpenCV conversion to BGR or None)
ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    'bgr8': ('u1', 3, None), '8UC3': ('u1', 3, None), 'rgb8': ('u1', 3, cv2.COLOR_RGB2BGR),
    'bgra8': ('u1', 4, cv2.COLOR_BGRA2BGR), '8UC4': ('u1', 4, cv2.COLOR_BGRA2BGR), 'rgba8': ('u1', 4, cv2.COLOR_RGBA2BGR),
    'mono8': ('u1', 1, None), '8UC1': ('u1', 1, None), 'mono16': ('u2', 1, None), '16UC1': ('u2', 1, None),
    '32FC1': ('f4', 1, None),
    'yuv422': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY), 'uyvy': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2), 'yuyv': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
    'bayer_rggb8': ('u1', 1, cv2.COLOR_BayerBG2BGR), 'bayer_bggr8': ('u1', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': ('u1', 1, cv2.COLOR_BayerGR2BGR), 'bayer_grbg8': ('u1', 1, cv2.COLOR_BayerGB2BGR),
}


def image_from_message(message: object) -> NDArray:
    """The picture of an `Image` or `CompressedImage`: (h, w, 3) BGR uint8, or (h, w) of the encoding's own type.

    The array may share the message's memory. Raises ValueError for an unknown encoding and for data that do not fit.
    """
    if hasattr(message, 'format'):
        return decode_compressed(message.data)
    if message.encoding not in ENCODINGS:
        raise ValueError(f'encoding {message.encoding!r} is not known, expected one of {", ".join(ENCODINGS)}')
    kind, channels, conversion = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder('>' if message.is_bigendian else '<')
    row = message.width * channels * dtype.itemsize
    data = np.frombuffer(message.data, np.uint8)
    if message.width == 0 or message.height == 0 or message.step < row or data.size < message.height * message.step:
        raise ValueError(f'{data.size} bytes in rows of {message.step} hold no {message.width}x{message.height} '
                         f'{message.encoding} image')
    rows = data[:message.height * message.step].reshape(message.height, message.step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, channels)
    pixels = pixels.astype(dtype.newbyteorder('='), copy=False)
    pixels = pixels[:, :, 0] if channels == 1 else pixels
    return pixels if conversion is None else cv2.cvtColor(pixels, conversion)


def decode_compressed(data: bytes | array) -> NDArray:
    """The picture (h, w, 3) or (h, w) in JPEG, PNG or another format of OpenCV; raises ValueError when it is none."""
    encoded = np.frombuffer(data, np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH) if encoded.size else None
    if image is None:
        raise ValueError(f'{encoded.size} bytes of compressed image cannot be decoded')
    return image


def fill_message(message: object, image: NDArray, encoding: str) -> object:
    """Put a picture into an `Image` message (its header stays), and return the message.

    The data go in as one `array.array('B')`: a list or bytes would be checked element by element by rclpy.
    """
    kind, channels, _ = ENCODINGS[encoding]
    if image.dtype != np.dtype(kind) or (image.shape[2] if image.ndim == 3 else 1) != channels:
        raise ValueError(f'an image of shape {image.shape} and type {image.dtype} is not {encoding}')
    message.height, message.width = image.shape[:2]
    message.encoding = encoding
    message.is_bigendian = int(sys.byteorder == 'big')
    message.step = image.shape[1] * channels * image.dtype.itemsize
    message.data = array('B', np.ascontiguousarray(image).tobytes())
    return message


def encoding_of(image: NDArray) -> str:
    """The encoding under which a picture of OpenCV goes out; raises ValueError for a type that has none."""
    channels = image.shape[2] if image.ndim == 3 else 1
    encoding = {('uint8', 1): 'mono8', ('uint8', 3): 'bgr8', ('uint8', 4): 'bgra8', ('uint16', 1): '16UC1',
                ('float32', 1): '32FC1'}.get((image.dtype.name, channels))
    if encoding is None:
        raise ValueError(f'an image of shape {image.shape} and type {image.dtype} has no encoding')
    return encoding


def to_bgr8(image: NDArray) -> NDArray[np.uint8]:
    """Any picture as (h, w, 3) BGR of 8 bits; 16-bit and float ones are stretched from their 1st to their 99th percentile.

    Raises ValueError for an empty array or a shape that is no picture.
    """
    if image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(f'an array of shape {image.shape} is no image, expected (h, w) or (h, w, 1|3|4)')
    if image.dtype != np.uint8:
        finite = np.nan_to_num(image.astype(np.float32))
        low, high = np.percentile(finite[::4, ::4], (1.0, 99.0))
        image = np.clip((finite - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)
    if image.ndim == 2 or image.shape[2] == 1:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGRA2BGR) if image.shape[2] == 4 else image
