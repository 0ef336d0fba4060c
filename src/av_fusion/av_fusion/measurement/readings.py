"""What the senses say as plain numbers, of a message or straight from its bytes: making the message takes ten times as long."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from av_common.stamps import to_seconds
from av_fusion.measurement.poses import pose_of, read_odometry

# By the second byte of a message in CDR: its byte order. Values as in struct; the last but pads the others to its size.
_FORMS = [{codes: struct.Struct(order + codes) for codes in ('I', 'f', 'fI', 'ff', 'iI', 'd', '5d', '3d5fH?x')}
          for order in '><']


class Reading(NamedTuple):
    """How a message becomes plain numbers: from its bytes (raises ValueError when they are none), or from an object."""

    read: Callable[[bytes], Any]
    of: Callable[[Any], Any]


class Direction(NamedTuple):
    """One hypothesis of a DoaArray, its unit vector in the array's frame; the fields of av_interfaces/Doa in their order."""

    x: float
    y: float
    z: float
    azimuth: float
    elevation: float
    azimuth_variance: float
    elevation_variance: float
    confidence: float
    group: int
    end_fire: bool


class Heard(NamedTuple):
    """A DoaArray: stamp in s, the array's frame, the window's length in s."""

    time: float
    frame: str
    window: float
    directions: list[Direction]


class Box(NamedTuple):
    """A Detection2D: the box's centre and size in pixels, its name, and scores of classes."""

    x: float
    y: float
    width: float
    height: float
    name: str
    scores: list[tuple[str, float]]


class Seen(NamedTuple):
    """A Detection2DArray: stamp in s, the camera's frame."""

    time: float
    frame: str
    boxes: list[Box]


class Clarity(NamedTuple):
    """A Visibility: stamp of the picture in s, share of a target's contrast that reaches the camera."""

    time: float
    share: float


def heard_of(message: Any) -> Heard:
    """Of a DoaArray message of any library."""
    return Heard(to_seconds(message.header.stamp), message.header.frame_id, message.window, [
        Direction(h.direction.x, h.direction.y, h.direction.z, h.azimuth, h.elevation, h.azimuth_variance,
                  h.elevation_variance, h.confidence, h.ambiguity_group, h.end_fire) for h in message.hypotheses])


def seen_of(message: Any) -> Seen:
    """Of a Detection2DArray message of any library."""
    return Seen(to_seconds(message.header.stamp), message.header.frame_id, [
        Box(d.bbox.center.position.x, d.bbox.center.position.y, d.bbox.size_x, d.bbox.size_y, d.id,
            [(result.hypothesis.class_id, result.hypothesis.score) for result in d.results]) for d in message.detections])


def clarity_of(message: Any) -> Clarity:
    """Of a Visibility message of any library."""
    return Clarity(to_seconds(message.header.stamp), message.visibility)


def read_heard(data: bytes) -> Heard:
    """Of a DoaArray in CDR. Raises ValueError when the bytes are none."""
    return _read(data, 'av_interfaces/DoaArray', _heard)


def read_seen(data: bytes) -> Seen:
    """Of a Detection2DArray in CDR. Raises ValueError when the bytes are none."""
    return _read(data, 'vision_msgs/Detection2DArray', _seen)


def read_clarity(data: bytes) -> Clarity:
    """Of a Visibility in CDR. Raises ValueError when the bytes are none."""
    return _read(data, 'av_interfaces/Visibility', _clarity)


HEARD, SEEN, CLARITY = Reading(read_heard, heard_of), Reading(read_seen, seen_of), Reading(read_clarity, clarity_of)
POSE = Reading(read_odometry, pose_of)


def _heard(cdr: _Cdr) -> Heard:
    time, frame = cdr.header()
    (window,) = cdr.take('f')
    cdr.text()  # the method
    _, count = cdr.take('fI')  # the level before
    return Heard(time, frame, window, [Direction._make(row) for row in cdr.rows('3d5fH?x', count)])


def _seen(cdr: _Cdr) -> Seen:
    time, frame = cdr.header()
    (count,) = cdr.take('I')
    return Seen(time, frame, [_box(cdr) for _ in range(count)])


def _box(cdr: _Cdr) -> Box:
    cdr.header()
    scores = []
    (count,) = cdr.take('I')
    for _ in range(count):
        scores.append((cdr.text(), *cdr.take('d')))
        cdr.at += 8 * (7 + 36)  # the pose and its covariance
    x, y, _, width, height = cdr.take('5d')
    return Box(x, y, width, height, cdr.text(), scores)


def _clarity(cdr: _Cdr) -> Clarity:
    time, _ = cdr.header()
    share, _ = cdr.take('ff')  # the range after
    return Clarity(time, share)


def _read(data: bytes, kind: str, content: Callable[[_Cdr], Any]) -> Any:
    try:
        cdr = _Cdr(data)
        found = content(cdr)
        cdr.end()
    except (struct.error, ValueError, LookupError) as error:
        raise ValueError(f'{len(data)} bytes are no {kind}: {error}') from error
    return found


class _Cdr:
    """A message in CDR from front to end (OMG DDSI-RTPS 10.2: values are aligned to their size, counted from byte 4).

    Raises struct.error, ValueError or LookupError where the bytes are not what is asked for.
    """

    def __init__(self, data: bytes) -> None:
        if data[0]:
            raise ValueError(f'its encapsulation is {data[:2]!r}')
        self._data, self._forms, self.at = data, _FORMS[data[1]], 4

    def take(self, codes: str) -> tuple:
        """The numbers of one of the forms, which is aligned to its last."""
        form = self._forms[codes]
        at = self.at + ((4 - self.at) % 8 if codes[-1] == 'd' else -self.at % 4)
        self.at = at + form.size
        return form.unpack_from(self._data, at)

    def rows(self, codes: str, count: int) -> list[tuple]:
        """Rows of numbers, aligned to 8 and padded to a multiple of it but for the last row's last byte."""
        if not count:
            return []
        form, begin = self._forms[codes], self.at + (4 - self.at) % 8
        self.at = begin + form.size * count - 1
        return list(form.iter_unpack(bytes(self._data[begin:self.at]) + b'\0'))

    def text(self) -> str:
        """A string."""
        (length,) = self.take('I')
        begin, self.at = self.at, self.at + length
        return str(self._data[begin:self.at - 1], 'utf-8') if length else ''

    def header(self) -> tuple[float, str]:
        """The stamp in s and the frame of a std_msgs/Header."""
        seconds, nanoseconds = self.take('iI')
        return seconds + 1e-9 * nanoseconds, self.text()

    def end(self) -> None:
        """Raises ValueError unless all was read and nothing is left but padding."""
        if not 0 <= len(self._data) - self.at <= 3:
            raise ValueError(f'they should be {self.at}')
