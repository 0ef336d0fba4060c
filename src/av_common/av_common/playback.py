"""One beginning for the files that a launch plays as one recording: sound and video share their clock.

The launch writes its players into the folder of the run. A player whose listeners have subscribed says that it is ready and
waits for the others; whoever finds all of them ready sets the beginning, a moment ahead. A player that starts late, or again,
joins in. One that was started by hand plays for itself.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from av_common.launched import run_folder

PLAN, BEGINNING = 'playback.json', 'playback.begin'
LEAD_S = 0.25         # from the agreement to the beginning: more than the time in which each player asks again
LAUNCH_WAIT_S = 30.0  # for listeners, and for the other players of the launch: a detector may start slowly


class Player(NamedTuple):
    """A file that is played.

    Parameters:
        node: name of the node that plays it.
        offset (s): when the file begins, after the beginning of the recording.
        listeners: names of the nodes that shall hear or see its beginning.
    """

    node: str
    offset: float
    listeners: Sequence[str]


def plan_playback(folder: Path, players: Sequence[Player]) -> None:
    """Write which nodes of a launch play one recording into the folder of its run."""
    plan = {player.node: {'offset': player.offset, 'listeners': list(player.listeners)} for player in players}
    (folder / PLAN).write_text(json.dumps(plan), encoding='utf-8')


class Playback:
    """The beginning of the file that a node plays.

    Parameters:
        node: the node's name.
    """

    def __init__(self, node: str) -> None:
        self._node, folder = node, run_folder()
        plan: Mapping[str, dict] = {}
        with suppress(OSError, ValueError):
            plan = json.loads((folder / PLAN).read_text(encoding='utf-8')) if folder else {}
        self._folder = folder if node in plan else None
        self._others = [other for other in plan if other != node]
        self._offset = float(plan[node]['offset']) if self._folder else 0.0
        self._listeners = frozenset(plan[node]['listeners']) if self._folder else frozenset()
        self._asked = float('nan')    # monotonic time (s) of the first question

    def begin(self, subscribers: Collection[str], now: float) -> float | None:
        """When the file begins, on the clock of `now` (s); None while listeners or other players are not ready: ask again.

        Parameters:
            subscribers: names of the nodes that have subscribed to what is played.
            now (s): the present time on the clock that all players share.
        """
        agreed = self._agreed()
        if agreed is not None:
            return agreed + self._offset
        since = time.monotonic()
        if self._asked != self._asked:
            self._asked = since
        heard, late = self._listeners <= set(subscribers), since - self._asked > LAUNCH_WAIT_S
        if not late and not (heard and subscribers):
            return None
        if self._folder is None:
            return now
        self._file(self._node).touch()
        if late or all(self._file(other).exists() for other in self._others):
            self._agree(now + LEAD_S)
        return None

    def _file(self, node: str) -> Path:
        assert self._folder is not None
        return self._folder / f'playback.{node}.ready'

    def _agreed(self) -> float | None:
        with suppress(OSError, ValueError):
            return float((self._folder / BEGINNING).read_text()) if self._folder else None
        return None

    def _agree(self, begin: float) -> None:
        """Set the beginning, unless another player was faster."""
        assert self._folder is not None
        own = self._folder / f'{BEGINNING}.{os.getpid()}'
        own.write_text(repr(begin))
        with suppress(FileExistsError):
            os.link(own, self._folder / BEGINNING)
        own.unlink()
