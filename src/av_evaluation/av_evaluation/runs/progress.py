"""Progress of a long computation on standard error."""

from __future__ import annotations

import sys
import time


class RunProgress:
    """Prints finished runs and the remaining time: in place on a terminal, else a line for each run.

    Parameters:
        quiet: whether to print nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._quiet, self._began = quiet, time.monotonic()
        self._first: int | None = None
        self._terminal = sys.stderr.isatty()

    def show(self, done: int, total: int, text: str = '') -> None:
        """Print the progress; the first call only sets what was computed before.

        Parameters:
            done: number of finished runs.
            total: number of runs.
            text: name of the run that finished last.
        """
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
