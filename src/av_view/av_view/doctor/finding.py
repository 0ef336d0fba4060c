"""What a check has found, in words, and the command that mends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal['ok', 'warning', 'error', 'unknown']
MARKS: dict[Level, str] = {'ok': 'ok     ', 'warning': 'warning', 'error': 'ERROR  ', 'unknown': '?      '}


@dataclass(frozen=True)
class Finding:
    """One fact about the machine.

    Parameters:
        area: what was looked at, such as `microphones`.
        level: `error` where the rig will not work, `warning` where it works badly, `unknown` where nothing could be found out.
        words: the fact.
        remedy: what to do about it, most often a command; empty where there is nothing to do.
    """

    area: str
    level: Level
    words: str
    remedy: str = ''

    def lines(self) -> str:
        """For a terminal."""
        return f'{MARKS[self.level]}  {self.area}: {self.words}' + (f'\n             -> {self.remedy}' if self.remedy else '')
