"""Images cut into datagrams, with RFlySim's old or new header, and their reassembly."""

import struct
from collections import OrderedDict, deque
from dataclasses import dataclass, field

import numpy as np

from av_sim_bridge.wire.error import WireError

OLD_MAGIC = 1234567890
NEW_MAGIC = 1234567893
MOST_PAYLOAD = 60_000
MOST_FRAGMENTS = 256
_OLD = struct.Struct('<4i1d')   # magic, packet length with header, sequence, packet count, time
_NEW = struct.Struct('<6i1d')   # magic, packet length with header, sequence, packet count, frame id, reserved, time


@dataclass(frozen=True)
class Fragment:
    """One part of an encoded image.

    Parameters:
        sequence: 0 to count - 1.
        count: fragments of the image.
        time (s): capture on the sender's clock.
        payload: bytes of the image.
        frame_id: number of the image in RFlySim's new header, None in the old one.
    """

    sequence: int
    count: int
    time: float
    payload: bytes
    frame_id: int | None = None


@dataclass(frozen=True)
class EncodedImage:
    """A complete image as the sender encoded it (JPEG or PNG).

    Parameters:
        time (s): capture on the sender's clock.
        data: the file.
        frame_id: number of the image in RFlySim's new header, None in the old one.
    """

    time: float
    data: bytes
    frame_id: int | None = None


def encode_image(image: EncodedImage) -> list[bytes]:
    """Datagrams of one image: the new header where it has a frame id, the old one otherwise."""
    pieces = [image.data[start:start + MOST_PAYLOAD] for start in range(0, len(image.data), MOST_PAYLOAD)]
    return [_header(image, sequence, len(pieces), len(piece)) + piece for sequence, piece in enumerate(pieces)]


def _header(image: EncodedImage, sequence: int, count: int, payload: int) -> bytes:
    if image.frame_id is None:
        return _OLD.pack(OLD_MAGIC, _OLD.size + payload, sequence, count, image.time)
    return _NEW.pack(NEW_MAGIC, _NEW.size + payload, sequence, count, image.frame_id, 0, image.time)


def decode_fragment(datagram: bytes) -> Fragment:
    """Decode one datagram with either header. Raises WireError."""
    if len(datagram) < _OLD.size:
        raise WireError(f'image: {len(datagram)} bytes are shorter than a header')
    (magic,) = struct.unpack_from('<i', datagram)
    if magic == OLD_MAGIC:
        _, length, sequence, count, time = _OLD.unpack_from(datagram)
        frame_id, size = None, _OLD.size
    elif magic == NEW_MAGIC and len(datagram) >= _NEW.size:
        _, length, sequence, count, frame_id, _, time = _NEW.unpack_from(datagram)
        size = _NEW.size
    else:
        raise WireError(f'image: magic {magic}, {OLD_MAGIC} or {NEW_MAGIC} with a whole header expected')
    if len(datagram) == size:
        raise WireError('image: packet without payload')
    if length != len(datagram):
        raise WireError(f'image: {len(datagram)} bytes, header says {length}')
    if not (0 < count <= MOST_FRAGMENTS and 0 <= sequence < count):
        raise WireError(f'image: packet {sequence} of {count}, 0..{MOST_FRAGMENTS - 1} expected')
    if not (np.isfinite(time) and time >= 0):
        raise WireError(f'image: time {time} s')
    return Fragment(sequence, count, time, datagram[size:], frame_id)


@dataclass
class ImageAssembler:
    """Puts fragments together; keeps at most `most_partial` unfinished images, so that memory is bounded.

    `incomplete` counts images that were given up because a fragment never came, `duplicates` repeated fragments,
    `reordered` fragments that came out of order (harmless).
    """

    most_partial: int = 4
    incomplete: int = 0
    duplicates: int = 0
    reordered: int = 0
    _partial: OrderedDict = field(default_factory=OrderedDict)
    _finished: deque = field(default_factory=lambda: deque(maxlen=16))

    def add(self, fragment: Fragment) -> EncodedImage | None:
        """Take one fragment; the image where it was the last one missing. Raises WireError."""
        key = (fragment.frame_id, fragment.time)
        if key in self._finished:
            self.duplicates += 1
            return None
        pieces = self._partial.setdefault(key, {})
        if pieces and next(iter(pieces.values())).count != fragment.count:
            raise WireError(f'image: {fragment.count} packets, earlier ones of the same image say otherwise')
        if fragment.sequence in pieces:
            self.duplicates += 1
            return None
        self.reordered += fragment.sequence < max(pieces, default=-1)
        pieces[fragment.sequence] = fragment
        if len(pieces) < fragment.count:
            self._give_up(list(self._partial)[:-self.most_partial])
            return None
        del self._partial[key]
        self._finished.append(key)
        self._give_up([older for older in self._partial if older[1] < fragment.time])
        return EncodedImage(fragment.time, b''.join(pieces[n].payload for n in range(fragment.count)),
                            fragment.frame_id)

    def _give_up(self, keys: list) -> None:
        for key in keys:
            del self._partial[key]
            self._finished.append(key)
            self.incomplete += 1
