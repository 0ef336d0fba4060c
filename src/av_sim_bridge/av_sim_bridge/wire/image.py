"""Fragmentation of images into datagrams, with RFlySim's old or new header, and their reassembly."""

import struct
from collections import OrderedDict, deque
from dataclasses import dataclass, field

from av_sim_bridge.wire.error import WireError, check_time

OLD_MAGIC = 1234567890  # RFlySim's
NEW_MAGIC = 1234567893  # RFlySim's
MOST_PAYLOAD = 60_000  # bytes, RFlySim's
MOST_FRAGMENTS = 256  # of an image: 15 MB
MOST_PARTIAL = 4  # incomplete images in memory
_OLD = struct.Struct('<4i1d')   # magic, packet length with header, sequence, packet count, time
_NEW = struct.Struct('<6i1d')   # magic, packet length with header, sequence, packet count, frame id, reserved, time


@dataclass(frozen=True)
class Fragment:
    """One part of an encoded image.

    Parameters:
        sequence: index of the fragment, 0 to count - 1.
        count: number of fragments of the image.
        time (s): capture time on the sender's clock.
        payload: part of the encoded image.
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
        time (s): capture time on the sender's clock.
        data: content of the JPEG or PNG file.
    """

    time: float
    data: bytes


def encode_image(image: EncodedImage) -> list[bytes]:
    """The datagrams of one image, with the old header."""
    pieces = [image.data[start:start + MOST_PAYLOAD] for start in range(0, len(image.data), MOST_PAYLOAD)]
    return [_OLD.pack(OLD_MAGIC, _OLD.size + len(piece), sequence, len(pieces), image.time) + piece
            for sequence, piece in enumerate(pieces)]


def decode_fragment(datagram: bytes) -> Fragment:
    """Decode one datagram with either header. Raises WireError."""
    if len(datagram) < _OLD.size:
        raise WireError(f'image: {len(datagram)} bytes, shorter than a header')
    (magic,) = struct.unpack_from('<i', datagram)
    if magic == OLD_MAGIC:
        _, length, sequence, count, time = _OLD.unpack_from(datagram)
        frame_id, size = None, _OLD.size
    elif magic == NEW_MAGIC and len(datagram) >= _NEW.size:
        _, length, sequence, count, frame_id, _, time = _NEW.unpack_from(datagram)
        size = _NEW.size
    else:
        raise WireError(f'image: magic {magic}, expected {OLD_MAGIC} or {NEW_MAGIC} with a complete header')
    if len(datagram) == size:
        raise WireError('image: packet without payload')
    if length != len(datagram):
        raise WireError(f'image: {len(datagram)} bytes, but the header states {length}')
    if not (0 < count <= MOST_FRAGMENTS and 0 <= sequence < count):
        raise WireError(f'image: packet {sequence} of {count}, expected at most {MOST_FRAGMENTS} packets')
    check_time(time, 'image')
    return Fragment(sequence, count, time, datagram[size:], frame_id)


@dataclass
class ImageAssembler:
    """Assembles images from fragments. The number and the size of incomplete images in memory are bounded.

    Parameters:
        most_bytes (bytes): maximum size of an encoded image, and of all incomplete images together.
        incomplete: count of images that were discarded because a fragment was missing.
    """

    most_bytes: int = 4_000_000
    incomplete: int = 0
    _partial: OrderedDict = field(default_factory=OrderedDict)
    _finished: deque = field(default_factory=lambda: deque(maxlen=16))

    def add(self, fragment: Fragment) -> EncodedImage | None:
        """Add one fragment; returns the image if it is complete. Raises WireError for a contradiction."""
        key = (fragment.frame_id, fragment.time)
        if key in self._finished:    # repeated, or too late
            return None
        pieces = self._partial.setdefault(key, {})
        if pieces and next(iter(pieces.values())).count != fragment.count:
            raise WireError(f'image: {fragment.count} packets contradict the number in earlier packets of the same image')
        if fragment.sequence in pieces:
            return None
        pieces[fragment.sequence] = fragment
        if _size(pieces) > self.most_bytes:
            self._give_up([key])
            raise WireError(f'image: more than {self.most_bytes} bytes')
        if len(pieces) < fragment.count:
            self._give_up(list(self._partial)[:-MOST_PARTIAL])
            while sum(map(_size, self._partial.values())) > self.most_bytes:
                self._give_up([next(other for other in self._partial if other != key)])
            return None
        del self._partial[key]
        self._finished.append(key)
        self._give_up([older for older in self._partial if older[1] < fragment.time])
        return EncodedImage(fragment.time, b''.join(pieces[n].payload for n in range(fragment.count)))

    def _give_up(self, keys: list) -> None:
        for key in keys:
            del self._partial[key]
            self._finished.append(key)
            self.incomplete += 1


def _size(pieces: dict[int, Fragment]) -> int:
    return sum(len(fragment.payload) for fragment in pieces.values())
