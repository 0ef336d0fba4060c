"""Pictures made small for a bag."""

from __future__ import annotations

import cv2
import numpy as np

from av_bags.definitions import rig_types
from av_vision.image import encoding_of, image_from_message

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


def compress(data: bytes, quality: int) -> memoryview:
    """A serialised Image as a serialised CompressedImage, described as image_transport does.

    Pictures of 8 bits become JPEG, those of 16 bits PNG without loss. Raises ValueError for floats, which neither
    format holds, and for what is no picture.
    """
    types = rig_types()
    message = types.deserialize_cdr(data, IMAGE)
    picture = image_from_message(message)
    if picture.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'pictures of encoding {message.encoding} cannot be compressed; record them raw')
    kind = 'jpeg' if picture.dtype == np.uint8 else 'png'
    _, encoded = cv2.imencode(f'.{kind}', picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    name = encoding_of(picture)
    small = types.types[COMPRESSED](message.header, f'{name}; {kind} compressed {name}', encoded.reshape(-1))
    return types.serialize_cdr(small, COMPRESSED)
