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

    def put_state(self, state: str, row: str) -> None:
        """A new state.

        Parameters:
            state: as JSON.
            row: of diagrams, as JSON.
        """
        self.state = state
        self.rows.append(row)
        self.serial += 1

    def put_health(self, health: str) -> None:
        """New health, a message as JSON."""
        self.health = health
        self.health_serial += 1

    def put_picture(self, picture: bytes) -> None:
        """A new picture, as JPEG."""
        self.picture = picture
        self.picture_serial += 1


@dataclass
class Position:
    """What one viewer has had of a feed."""

    serial: int = 0
    health_serial: int = 0
    picture_serial: int = 0

    def take(self, feed: Feed) -> list[str | bytes]:
        """The messages that are new to the viewer, and note them as had.

        Parameters:
            feed: of the viewer's rig.
        """
        messages: list[str | bytes] = []
        if feed.picture_serial != self.picture_serial:
            messages.append(feed.picture)
        if feed.health_serial != self.health_serial:
            messages.append(feed.health)
        if feed.serial != self.serial:
            count = min(feed.serial - self.serial, len(feed.rows))
            rows = ','.join(list(feed.rows)[len(feed.rows) - count:])
            messages.append(f'{{"type":"state","rows":[{rows}],"state":{feed.state}}}')
        self.serial, self.health_serial, self.picture_serial = feed.serial, feed.health_serial, feed.picture_serial
        return messages
