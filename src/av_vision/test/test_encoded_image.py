"""Files of untrusted origin: OpenCV's own are read, and bombs are refused by their headers before memory is taken."""

import contextlib
import resource
import struct
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from av_vision import image_from_message

IMAGE = np.random.default_rng(0).integers(0, 256, (30, 44, 3), np.uint8)


def encode(kind, image=IMAGE, *options):
    return cv2.imencode(kind, image, list(options))[1].tobytes()


def decode(data, most=100_000_000):
    """The image of a compressed message."""
    return image_from_message(SimpleNamespace(format='of any kind', data=data), most)


def png(width, height, colour=2, bits=8, data=b''):
    """A PNG that claims a size."""
    def chunk(name, content):
        return struct.pack('>I', len(content)) + name + content + struct.pack('>I', zlib.crc32(name + content))
    header = struct.pack('>2I5B', width, height, bits, colour, 0, 0, 0)
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', header) + chunk(b'IDAT', data) + chunk(b'IEND', b'')


def resized(jpeg, width, height):
    """A JPEG whose frame header claims another size."""
    place = jpeg.index(b'\xff\xc0') + 5
    return jpeg[:place] + struct.pack('>2H', height, width) + jpeg[place + 4:]


@pytest.mark.parametrize('data', [
    encode('.png'), encode('.png', IMAGE[..., 0]), encode('.png', IMAGE[..., 0].astype(np.uint16)), encode('.jpg'),
    encode('.jpg', IMAGE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), encode('.jpg', IMAGE[..., 0]),
    encode('.jpg', IMAGE, cv2.IMWRITE_JPEG_RST_INTERVAL, 1, cv2.IMWRITE_JPEG_OPTIMIZE, 1)])
def test_what_opencv_writes_is_read(data):
    assert decode(data, 44 * 30).shape[:2] == (30, 44)
    with pytest.raises(ValueError, match=r'44x30 pixels, expected 1 to 1319 pixels'):
        decode(data, 44 * 30 - 1)


def test_a_thumbnail_is_not_the_image():
    """Its frame header lies inside another segment, and bytes between segments are skipped, as libjpeg does."""
    thumbnail, jpeg = resized(encode('.jpg', IMAGE[:8, :8]), 60_000, 60_000), encode('.jpg')
    segment = b'\xff\xff\xe1' + struct.pack('>H', len(thumbnail) + 2) + thumbnail
    assert decode(jpeg[:2] + segment + b'stray' + jpeg[2:]).shape == IMAGE.shape


@pytest.mark.parametrize('data', [
    png(12_000, 12_000, data=zlib.compress(bytes(1_000_000))), png(2**31 - 1, 2**31 - 1), png(0, 100), png(100, 0),
    png(20_000, 1), resized(encode('.jpg'), 65_535, 65_535), resized(encode('.jpg'), 0, 30), resized(encode('.jpg'), 30, 0)])
def test_bombs_take_no_memory(data):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match='image of .* pixels, expected 1 to 600000 pixels'):
        decode(data, 600_000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 5_000    # KiB


def test_a_chunk_that_claims_gigabytes_takes_no_memory():
    data = bytearray(encode('.png'))
    data[33:37] = struct.pack('>I', 2**32 - 2**16)    # the length of what follows the header
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match='expected a complete header'):
        decode(bytes(data))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 5_000    # KiB


def test_a_jpeg_of_many_scans_is_refused():
    jpeg = encode('.jpg')
    scan = jpeg[jpeg.index(b'\xff\xda'):-2]
    with pytest.raises(ValueError, match='more than 32 scans'):
        decode(jpeg[:-2] + 1000 * scan + jpeg[-2:])


def test_a_jpeg_of_many_segments_is_refused():
    """A hundred thousand empty ones would take OpenCV a third of a second."""
    jpeg = encode('.jpg')
    assert decode(jpeg[:2] + b'\xff\xe1\x00\x02' * 200 + jpeg[2:]).shape == IMAGE.shape
    with pytest.raises(ValueError, match='expected a complete header of JPEG'):
        decode(jpeg[:2] + b'\xff\xe1\x00\x02' * 1000 + jpeg[2:])


@pytest.mark.parametrize('kind', ['.bmp', '.webp', '.tiff', '.ppm'])
def test_other_formats_are_refused(kind):
    with pytest.raises(ValueError, match='expected a complete header of JPEG, or a whole PNG'):
        decode(encode(kind))


def test_damage_raises_nothing_but_value_errors():
    rng = np.random.default_rng(1)
    files = [encode('.png'), encode('.jpg'), encode('.jpg', IMAGE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), png(44, 30)]
    for _ in range(2000):
        data = bytearray(files[rng.integers(len(files))])
        for place in rng.integers(0, min(len(data), 700), rng.integers(1, 6)):
            data[place] = rng.integers(256)
        if rng.random() < 0.3:
            del data[rng.integers(len(data)):]
        with contextlib.suppress(ValueError):
            assert decode(bytes(data), 10_000).size <= 10_000 * 4


@pytest.mark.parametrize('rest', [b'', b'\xff' * 2_000_000, b'\xff\x00' * 1_000_000, b'\xff\xe0\x00\x02' * 500_000,
                                  bytes(2_000_000)], ids=['empty', 'fill', 'stuffed', 'segments', 'zeros'])
def test_a_header_without_end_is_given_up(rest):
    with pytest.raises(ValueError, match='expected a complete header of JPEG, or a whole PNG'):
        decode(b'\xff\xd8' + rest)
