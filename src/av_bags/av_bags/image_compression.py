"""Compresses images for recording."""

from __future__ import annotations

from array import array

import cv2
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from av_vision.messages import encoding_of, image_from_message


def compress(data: bytes, quality: int) -> bytes:
    """Compress a serialised Image to a serialised CompressedImage with the format string of image_transport.

    Parameters:
        data: an Image in CDR; 8-bit pixels become JPEG, 16-bit pixels lossless PNG.
        quality: quality of JPEG, 1 to 100.

    Raises ValueError for pixels of other types, which neither format can hold, and for unreadable images.
    """
    message = deserialize_message(data, Image)
    image = image_from_message(message)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'images of encoding {message.encoding} cannot be compressed; record them raw')
    kind, name = 'jpeg' if image.dtype == np.uint8 else 'png', encoding_of(image)
    _, encoded = cv2.imencode(f'.{kind}', image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(serialize_message(CompressedImage(
        header=message.header, format=f'{name}; {kind} compressed {name}', data=array('B', encoded.tobytes()))))
