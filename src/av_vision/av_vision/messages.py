"""Conversion of images, cameras and detections to ROS messages and back.

Images are decoded as views or with one copy, without cv_bridge. Messages to decode may be objects of any library with the
fields of the ROS messages.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.camera import LENS_MODELS, PinholeCamera
from av_vision.detections import Detections
from av_vision.image import MOST_PIXELS, check_pixels, decode_image

# encoding -> (dtype, channels, OpenCV conversion to BGR or None); of two for the same pixels the first is sent
ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    'bgr8': ('u1', 3, None), '8UC3': ('u1', 3, None), 'rgb8': ('u1', 3, cv2.COLOR_RGB2BGR),
    'bgra8': ('u1', 4, cv2.COLOR_BGRA2BGR), '8UC4': ('u1', 4, cv2.COLOR_BGRA2BGR), 'rgba8': ('u1', 4, cv2.COLOR_RGBA2BGR),
    'mono8': ('u1', 1, None), '8UC1': ('u1', 1, None), 'mono16': ('u2', 1, None), '16UC1': ('u2', 1, None),
    'bgr16': ('u2', 3, None), '16UC3': ('u2', 3, None), 'rgb16': ('u2', 3, cv2.COLOR_RGB2BGR),
    '32FC1': ('f4', 1, None), '32FC3': ('f4', 3, None),
    'yuv422': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY), 'uyvy': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2), 'yuyv': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
    'bayer_rggb8': ('u1', 1, cv2.COLOR_BayerBG2BGR), 'bayer_bggr8': ('u1', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': ('u1', 1, cv2.COLOR_BayerGR2BGR), 'bayer_grbg8': ('u1', 1, cv2.COLOR_BayerGB2BGR),
    'bayer_rggb16': ('u2', 1, cv2.COLOR_BayerBG2BGR), 'bayer_bggr16': ('u2', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg16': ('u2', 1, cv2.COLOR_BayerGR2BGR), 'bayer_grbg16': ('u2', 1, cv2.COLOR_BayerGB2BGR),
}


def image_from_message(message: Any, most_pixels: int = MOST_PIXELS) -> NDArray:
    """The image of an `Image` or `CompressedImage`: (h, w, 3) BGR, or (h, w), in the type of the encoding.

    The array may share memory with the message.

    Parameters:
        message: an uncompressed image, or one compressed as JPEG or PNG.
        most_pixels: maximum number of pixels.

    Raises ValueError for an unknown encoding, for data of a wrong size, and for an image that is too large.
    """
    if hasattr(message, 'format'):
        return decode_image(memoryview(message.data), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH, most_pixels)
    if message.encoding not in ENCODINGS:
        raise ValueError(f'encoding {message.encoding[:40]!r} is not known, expected one of {", ".join(ENCODINGS)}')
    kind, channels, conversion = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder('>' if message.is_bigendian else '<')
    row = message.width * channels * dtype.itemsize
    data = np.frombuffer(message.data, np.uint8)
    if message.width == 0 or message.height == 0 or message.step < row or data.size < message.height * message.step:
        raise ValueError(f'{data.size} bytes in rows of {message.step} hold no {message.width}x{message.height} '
                         f'{message.encoding} image')
    check_pixels(message.width, message.height, most_pixels)
    rows = data[:message.height * message.step].reshape(message.height, message.step)[:, :row]
    pixels: NDArray = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, channels)
    pixels = pixels.astype(dtype.newbyteorder('='), copy=False)
    pixels = pixels[:, :, 0] if channels == 1 else pixels
    try:
        return pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error as error:    # such as an odd width of yuv422
        raise ValueError(f'{message.width}x{message.height} {message.encoding} image: {error.err}') from error


def image_message(header: Header, image: NDArray, encoding: str = '') -> Image:
    """Convert an image to a message.

    Parameters:
        header: time of capture and optical frame.
        image (h, w[, channels]): pixels of a type in ENCODINGS.
        encoding: one of ENCODINGS; empty selects it by the type of the array.

    Raises ValueError when type or channels of the image do not fit the encoding.
    """
    encoding = encoding or encoding_of(image)
    kind, channels, _ = ENCODINGS[encoding]
    if image.dtype != np.dtype(kind) or (image.shape[2] if image.ndim == 3 else 1) != channels:
        raise ValueError(f'an image of shape {image.shape} and type {image.dtype} is not {encoding}')
    height, width = image.shape[:2]
    message = Image(header=header, height=height, width=width, encoding=encoding,
                    is_bigendian=int(sys.byteorder == 'big'), step=width * channels * image.dtype.itemsize)
    # rclpy would check a list or bytes element by element.
    message.data = array('B', np.ascontiguousarray(image).tobytes())
    return message


def encoding_of(image: NDArray) -> str:
    """The encoding of an OpenCV image (h, w[, channels]); raises ValueError for a type without one."""
    channels = image.shape[2] if image.ndim == 3 else 1
    for encoding, (kind, count, conversion) in ENCODINGS.items():
        if (np.dtype(kind), count) == (image.dtype, channels) and conversion in (None, cv2.COLOR_BGRA2BGR):
            return encoding
    raise ValueError(f'an image of shape {image.shape} and type {image.dtype} has no encoding')


def camera_info_message(header: Header, camera: PinholeCamera) -> CameraInfo:
    """The CameraInfo of a camera whose images are not rectified; the inverse of `PinholeCamera.from_camera_info`.

    Parameters:
        header: time of capture and optical frame.
        camera: intrinsics and distortion.
    """
    info = CameraInfo(header=header, width=camera.width, height=camera.height)
    plumb_bob, rational, equidistant = LENS_MODELS
    info.distortion_model = equidistant if camera.equidistant else rational if len(camera.distortion) > 5 else plumb_bob
    info.d = list(camera.distortion or (0.0,) * (4 if camera.equidistant else 5))
    info.k = camera.matrix.ravel().tolist()
    info.r = np.eye(3).ravel().tolist()
    info.p = np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist()
    return info


def detections_message(header: Header, detections: Detections, ids: Sequence[int | str]) -> Detection2DArray:
    """The detections of an image.

    Parameters:
        header: header of the image, repeated in each detection.
        detections: boxes in pixels, scores, class names.
        ids: track number (or origin) of each detection.
    """
    message = Detection2DArray(header=header)
    rows = zip(detections.centres.tolist(), detections.sizes.tolist(), detections.scores.tolist(), detections.class_names,
               ids, strict=True)
    for centre, size, score, name, track in rows:
        hypothesis = ObjectHypothesisWithPose()
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = name, score
        detection = Detection2D(header=header, results=[hypothesis], id=str(track))
        detection.bbox.center.position.x, detection.bbox.center.position.y = centre
        detection.bbox.size_x, detection.bbox.size_y = size
        message.detections.append(detection)
    return message


def header_of(message: Any) -> Header:
    """The header of a message of any library as a std_msgs/Header."""
    header = message.header
    if isinstance(header, Header):
        return header
    return Header(stamp=Time(sec=int(header.stamp.sec), nanosec=int(header.stamp.nanosec)), frame_id=header.frame_id)
