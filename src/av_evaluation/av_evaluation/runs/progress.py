"""How far a long computation is: rewritten in place on a terminal, a line each elsewhere."""

from __future__ import annotations

import sys
import time


class RunProgress:
    """Shows runs done and the time that is left; `show` goes where a report of progress is asked for."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet, self._began, self._first = quiet, time.monotonic(), None
        self._terminal = sys.stderr.isatty()

    def show(self, done: int, total: int, text: str = '') -> None:
        """`done` of `total` runs are there, the last one is called `text`."""
        if self._first is None:
            self._first = done
            if done and not self._quiet:
                print(f'{done} of {total} runs were computed before', file=sys.stderr)
            return
        if self._quiet:
            return
        spent, new = time.monotonic() - self._began, done - self._first
        left = spent / max(new, 1) * (total - done)
        line = f'{done}/{total} runs, {spent:.0f} s, {left:.0f} s left: {text}'
        end = '' if self._terminal and done < total else '\n'
        print(f'\r{line:<78}' if self._terminal else line, end=end, file=sys.stderr, flush=True)
