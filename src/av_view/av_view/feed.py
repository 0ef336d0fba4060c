"""What viewers of one rig are sent: the newest of everything, and the rows of diagrams that they have not had yet."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

HISTORY = 600  # rows that a new viewer is sent


@dataclass
class Feed:
    """The newest state, health and picture of a rig, serialised once for all viewers.

    Serial numbers count what was published, so that each viewer knows what it has had.
    """

    state: str = 'null'
    health: str = 'null'
    picture: bytes = b''
    serial: int = 0
    health_serial: int = 0
    picture_serial: int = 0
    rows: deque[str] = field(default_factory=lambda: deque(maxlen=HISTORY))

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
        if picture:
            self.picture = picture
            self.picture_serial += 1

    def put_health(self, health: str) -> None:
        """New health, a message as JSON."""
        self.health = health
        self.health_serial += 1


@dataclass
class Position:
    """What one viewer has had of a feed."""

    serial: int = 0
    health_serial: int = 0
    picture_serial: int = 0

    def take(self, feed: Feed) -> list[str | bytes]:
        """What is new to the viewer, the state last; note it as had. Nothing where nothing is new.

        Parameters:
            feed: of the viewer's rig.
        """
        if (feed.serial, feed.health_serial) == (self.serial, self.health_serial):
            return []
        messages: list[str | bytes] = []
        if feed.picture_serial != self.picture_serial:
            messages.append(feed.picture)
        if feed.health_serial != self.health_serial:
            messages.append(feed.health)
        count = min(feed.serial - self.serial, len(feed.rows))
        rows = ','.join(list(feed.rows)[len(feed.rows) - count:])
        messages.append(f'{{"type":"state","rows":[{rows}],"state":{feed.state}}}')
        self.serial, self.health_serial, self.picture_serial = feed.serial, feed.health_serial, feed.picture_serial
        return messages
