"""What viewers of one rig are sent, and its limits: the newest of everything, and rows of diagrams that they have not had."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

LONGEST_TEXT, LONGEST_NAME = 400, 40  # characters of a text, or a name, that comes from a message
MOST_BOXES, MOST_TRACKS, MOST_GROUPS = 50, 50, 8
STALE_S = 1.0  # age from which a measurement is no longer shown
PICTURE_STALE_S = 3.0  # the same of a picture: cameras may be slow
# Rows in an update: the few that a viewer may have missed, or all for one that is new or was away.
RECENT, HISTORY = 10, 600
# What the columns of a row are; azimuths in degrees, confidences 0..1, delay in s, level in dB.
COLUMNS = ('time', 'sound', 'mirror', 'sight', 'fused', 'sigma', 'truth', 'sound_confidence', 'sight_confidence', 'state',
           'delay', 'level')


@dataclass
class Feed:
    """The newest state, health and picture of a rig, serialised once for all viewers, with serial numbers of the states.

    Attributes:
        serial: of the newest state; a viewer is known by that of the state it has had, 0 for none.
    """

    serial: int = 0
    _state: str = 'null'
    # With the serial number of the state that brings it to viewers, in the order in which they are sent.
    _newest: dict[str, tuple[int, str | bytes]] = field(default_factory=lambda: {'picture': (0, b''), 'health': (0, '')})
    _rows: deque[str] = field(default_factory=lambda: deque(maxlen=HISTORY))

    def put(self, state: str, row: str, picture: bytes = b'') -> None:
        """A new state, with a picture where that is new, too.

        Parameters:
            state: as JSON.
            row: of diagrams, as JSON.
            picture: as JPEG; empty for none.
        """
        self.serial += 1
        self._state = state
        self._rows.append(row)
        if picture:
            self._newest['picture'] = self.serial, picture

    def put_health(self, health: str) -> None:
        """New health, a message as JSON, which goes with the next state."""
        self._newest['health'] = self.serial + 1, health

    def news(self, had: int) -> list[str | bytes]:
        """Messages with what is new to a viewer that had a state: picture, health, state with rows. None without a new state.

        Parameters:
            had: serial number of that state.
        """
        if had == self.serial:
            return []
        count = min(RECENT if self.serial - had <= RECENT else HISTORY, len(self._rows))
        rows = ','.join(islice(self._rows, len(self._rows) - count, None))
        return [*(message for serial, message in self._newest.values() if serial > had),
                f'{{"type":"state","serial":{self.serial},"rows":[{rows}],"state":{self._state}}}']


def row_of(snapshot: dict[str, Any]) -> list[float | str | None]:
    """The values of COLUMNS in a snapshot, for diagrams against time."""
    bearing, sound, sight, truth = (snapshot[name] for name in ('bearing', 'sound', 'sight', 'truth'))
    azimuths = [image['azimuth'] for group in (sound['groups'][:1] if sound else ()) for image in group['images']]
    boxes = [box for box in sight['boxes'] if None not in (box['azimuth'], box['score'])] if sight else []
    best = max(boxes, key=lambda box: box['score'], default={'azimuth': None, 'score': 0.0})
    known = bearing is not None and bearing['state'] != 'none'
    return [snapshot['time'], *[*azimuths, None, None][:2], best['azimuth'], *([bearing['azimuth'], bearing['sigma']] if known
            else [None, None]), truth[0]['azimuth'] if truth else None, sound and sound['confidence'], best['score'],
            bearing['state'] if bearing else 'none', snapshot['delay'], sound and sound['level']]


def number(value: float, digits: int = 2) -> float | None:
    """A rounded number; None for one that is not finite.

    Parameters:
        value: the number.
        digits: after the point.
    """
    return round(float(value), digits) if math.isfinite(value) else None


def degrees(angle: float) -> float | None:
    """An angle (rad) in degrees; None where it is not finite."""
    return number(math.degrees(angle), 1)
