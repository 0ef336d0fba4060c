"""What viewers of one rig are sent: the newest of everything, and the rows of diagrams that they have not had yet."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple

# Rows in an update: the few that a viewer may have missed, or all for one that is new or was away.
RECENT, HISTORY = 10, 600
# What the columns of a row are; azimuths in degrees, confidences 0..1, delay in s, SNR in dB.
COLUMNS = ('time', 'sound', 'mirror', 'sight', 'fused', 'sigma', 'truth', 'sound_confidence', 'sight_confidence', 'state',
           'delay', 'snr')


class Update(NamedTuple):
    """Messages to one viewer in the order in which they are sent; empty for nothing.

    Parameters:
        picture: JPEG.
        health: JSON.
        state: JSON, with rows.
    """

    picture: bytes = b''
    health: str = ''
    state: str = ''


@dataclass
class Feed:
    """The newest state, health and picture of a rig, serialised once for all viewers.

    Serial numbers count what was published, so that each viewer knows what it has had.
    """

    state: str = 'null'
    health: str = ''
    picture: bytes = b''
    serial: int = 0
    health_serial: int = 0
    picture_serial: int = 0
    rows: deque[str] = field(default_factory=lambda: deque(maxlen=HISTORY))
    _messages: dict[int, str] = field(default_factory=dict)

    def put(self, state: str, row: str, picture: bytes = b'') -> None:
        """A new state, with a picture where that is new, too.

        Parameters:
            state: as JSON.
            row: of diagrams, as JSON.
            picture: as JPEG; empty for none.
        """
        self.state = state
        self.rows.append(row)
        self.serial += 1
        self._messages.clear()
        if picture:
            self.picture = picture
            self.picture_serial += 1

    def put_health(self, health: str) -> None:
        """New health, a message as JSON, which goes with the next state."""
        self.health = health
        self.health_serial += 1

    def message(self, missed: int) -> str:
        """The state with the newest rows, of which the last has the number `serial`; one text for all viewers.

        Parameters:
            missed: number of rows that a viewer has not had.
        """
        count = RECENT if 0 <= missed <= RECENT else HISTORY
        if count not in self._messages:
            rows = ','.join(islice(self.rows, max(len(self.rows) - count, 0), None))
            self._messages[count] = f'{{"type":"state","serial":{self.serial},"rows":[{rows}],"state":{self.state}}}'
        return self._messages[count]


@dataclass
class Position:
    """What one viewer has had of a feed."""

    serial: int = 0
    health_serial: int = 0
    picture_serial: int = 0

    def take(self, feed: Feed) -> Update:
        """What is new to the viewer; note it as had. Nothing where the state is not new.

        Parameters:
            feed: of the viewer's rig.
        """
        if feed.serial == self.serial:
            return Update()
        update = Update(feed.picture if feed.picture_serial != self.picture_serial else b'',
                        feed.health if feed.health_serial != self.health_serial else '',
                        feed.message(feed.serial - self.serial))
        self.serial, self.health_serial, self.picture_serial = feed.serial, feed.health_serial, feed.picture_serial
        return update


def row_of(snapshot: dict[str, Any]) -> list[float | str | None]:
    """The values of COLUMNS in a snapshot, for diagrams against time."""
    bearing, sound, sight, truth = (snapshot[name] for name in ('bearing', 'sound', 'sight', 'truth'))
    azimuths = [image['azimuth'] for group in (sound['groups'][:1] if sound else ()) for image in group['images']]
    boxes = [box for box in sight['boxes'] if None not in (box['azimuth'], box['score'])] if sight else []
    best = max(boxes, key=lambda box: box['score'], default={'azimuth': None, 'score': 0.0})
    known = bearing is not None and bearing['state'] != 'none'
    return [snapshot['time'], *[*azimuths, None, None][:2], best['azimuth'], *([bearing['azimuth'], bearing['sigma']] if known
            else [None, None]), truth[0]['azimuth'] if truth else None, sound and sound['confidence'], best['score'],
            bearing['state'] if bearing else 'none', snapshot['delay'], snapshot['snr']]
