"""Images made small for a bag."""

from __future__ import annotations

from array import array

import cv2
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from av_vision.messages import encoding_of, image_from_message


def compress(data: bytes, quality: int) -> bytes:
    """A serialised Image as a serialised CompressedImage, described as image_transport does.

    Images of 8 bits become JPEG of `quality` (1 to 100), those of 16 bits PNG without loss. Raises ValueError for
    floats, which neither format holds, and for what is no image.
    """
    message = deserialize_message(data, Image)
    image = image_from_message(message)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'images of encoding {message.encoding} cannot be compressed; record them raw')
    kind, name = 'jpeg' if image.dtype == np.uint8 else 'png', encoding_of(image)
    _, encoded = cv2.imencode(f'.{kind}', image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(serialize_message(CompressedImage(
        header=message.header, format=f'{name}; {kind} compressed {name}', data=array('B', encoded.tobytes()))))
