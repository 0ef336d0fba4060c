"""The visual oracle (RFlySim TypeID 30): boxes of visible targets, sent to the port of the images."""

import struct
from dataclasses import dataclass

from av_sim_bridge.wire.error import MOST_PIXEL, WireError, check_within

_COUNT = struct.Struct('<i')
_BOX = struct.Struct('<i5f')
MOST_BOXES = 1000  # of an image: a page of JSON, not a flood


@dataclass(frozen=True)
class OracleBox:
    """One target in the image.

    Parameters:
        target_id: number of the vehicle in the simulator.
        score (0 to 1): modelled score of a detector for this target.
        min_x, min_y, max_x, max_y (px): corners of the box.
    """

    target_id: int
    score: float
    min_x: float
    min_y: float
    max_x: float
    max_y: float


def encode_oracle(boxes: list[OracleBox]) -> bytes:
    """The datagram of one report; an empty list reports that no target is visible."""
    return _COUNT.pack(len(boxes)) + b''.join(
        _BOX.pack(box.target_id, box.score, box.min_x, box.min_y, box.max_x, box.max_y) for box in boxes)


def is_oracle(datagram: bytes) -> bool:
    """Whether a datagram of the image port is a report: its size must agree with the count in its first field."""
    if len(datagram) < _COUNT.size:
        return False
    (count,) = _COUNT.unpack_from(datagram)
    return 0 <= count <= MOST_BOXES and len(datagram) == _COUNT.size + count * _BOX.size


def decode_oracle(datagram: bytes) -> list[OracleBox]:
    """Decode one report. Raises WireError."""
    if not is_oracle(datagram):
        raise WireError(f'oracle: {len(datagram)} bytes do not agree with the number of boxes of {_BOX.size} bytes')
    boxes = [OracleBox(*fields) for fields in _BOX.iter_unpack(datagram[_COUNT.size:])]
    for box in boxes:
        check_within([box.min_x, box.min_y, box.max_x, box.max_y], MOST_PIXEL, 'oracle: corner')
        check_within(box.score, 1.0, 'oracle: score')
        if box.score < 0.0:
            raise WireError(f'oracle: score of target {box.target_id} is {box.score:g}, expected 0 to 1')
        if box.min_x > box.max_x or box.min_y > box.max_y:
            raise WireError(f'oracle: the corners of the box of target {box.target_id} are swapped')
    return boxes
