"""Identifiers: ULIDs of messages and objects, UUIDs of nodes."""

from __future__ import annotations

import re
import secrets
import uuid
from contextlib import suppress

from av_common.files import ros_home

ALPHABET = '0123456789ABCDEFGHJKMNPQRSTVWXYZ'  # Crockford's base 32
ULID = re.compile(f'[0-7][{ALPHABET}]{{25}}')
RANDOM_BITS = 80  # of the specification
FORGET_S = 60.0  # after this time without its track an object is another one


def new_ulid(time: float) -> str:
    """A ULID: 48 bits of time (s, UTC since 1970) in ms, 80 random bits, as 26 characters. Source: github.com/ulid/spec."""
    milliseconds = min(max(int(time * 1000.0), 0), 2**48 - 1)
    number = milliseconds << RANDOM_BITS | secrets.randbits(RANDOM_BITS)
    return ''.join(ALPHABET[number >> shift & 31] for shift in range(125, -1, -5))


def is_ulid(text: str) -> bool:
    """Whether a text is a ULID."""
    return ULID.fullmatch(text.upper()) is not None


def is_uuid(text: str, version: int | None = None) -> bool:
    """Whether a text is a UUID in its usual form with four hyphens.

    Parameters:
        text: the text.
        version: that it must have; None for any.
    """
    try:
        found = uuid.UUID(text)
    except ValueError:
        return False
    return str(found) == text.lower() and version in (None, found.version)


def node_uuid(name: str) -> str:
    """The random UUID (version 4) of a node, which is drawn once and kept in a file in ROS_HOME (~/.ros).

    Parameters:
        name: full name of the ROS node.

    Raises OSError where it cannot be written or read, ValueError for a file with anything else.
    """
    file = ros_home() / 'av_reports' / f'{name.strip("/").replace("/", ".") or "report_node"}.uuid'
    file.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError), file.open('x') as new:
        new.write(f'{uuid.uuid4()}\n')
    text = file.read_text().strip()
    if not is_uuid(text, 4):
        raise ValueError(f'{file} has {text!r:.50}, expected a UUID of version 4: delete the file for a new one')
    return text.lower()


class ObjectIds:
    """ULIDs of tracks: each keeps its own while it is seen, also across connections."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[str, float]] = {}  # ULID and time of the last report, by the track's id

    def ulid(self, track: int, time: float) -> str:
        """The ULID of a track that is reported now.

        Parameters:
            track: the track's id.
            time (s): UTC since 1970.
        """
        self._known = {key: entry for key, entry in self._known.items() if abs(time - entry[1]) <= FORGET_S}
        ulid = self._known[track][0] if track in self._known else new_ulid(time)
        self._known[track] = (ulid, time)
        return ulid

    def track(self, ulid: str) -> int | None:
        """The id of the track with a ULID; None for an unknown one."""
        return next((track for track, (known, _) in self._known.items() if known == ulid.upper()), None)
