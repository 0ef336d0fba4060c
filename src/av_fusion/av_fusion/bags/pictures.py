"""Pictures made small for a bag."""

from __future__ import annotations

import cv2
import numpy as np

from av_fusion.bags.definitions import rig_types
from av_vision.image import encoding_of, image_from_message

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


def compress(data: bytes, quality: int) -> memoryview:
    """A serialised Image as a serialised CompressedImage: JPEG of 8 bits, lossless PNG of 16, named as image_transport does.

    Raises ValueError for what is no picture, and for floats, which neither format holds.
    """
    types = rig_types()
    message = types.deserialize_cdr(data, IMAGE)
    picture = image_from_message(message)
    if picture.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'pictures of encoding {message.encoding} cannot be compressed; record them raw')
    kind = 'jpeg' if picture.dtype == np.uint8 else 'png'
    _, encoded = cv2.imencode(f'.{kind}', picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    name = encoding_of(picture)
    small = types.types[COMPRESSED](header=message.header, format=f'{name}; {kind} compressed {name}', data=encoded.reshape(-1))
    return types.serialize_cdr(small, COMPRESSED)
