"""Progress of a program on standard error, with the remaining time."""

from __future__ import annotations

import sys
import time

PERIOD_S = 0.2  # between changes of the line on a terminal


class Progress:
    """What is done: in place on a terminal, else a line for each run, or for each tenth of one.

    Parameters:
        unit: of what is counted: `runs`, or `s` of one run.
        quiet: whether to print nothing.
    """

    def __init__(self, unit: str = 'runs', quiet: bool = False) -> None:
        self._unit, self._quiet, self._began = unit, quiet, time.monotonic()
        self._first: float | None = None
        self._shown, self._shown_at = 0.0, -PERIOD_S
        self._terminal = sys.stderr.isatty()

    def show(self, done: float, total: float, text: str = '') -> None:
        """Print the progress, where it is due; the first call only sets what was done before.

        Parameters:
            done: so far.
            total: of all.
            text: name of what was done last.
        """
        if self._first is None:
            self._first = done
            if done and not self._quiet:
                print(f'{done:g} of {total:g} {self._unit} were computed before', file=sys.stderr)
            return
        now = time.monotonic()
        due = now >= self._shown_at + PERIOD_S or done >= total if self._terminal else (
            self._unit == 'runs' or done >= self._shown + 0.1 * total)
        if self._quiet or not due:
            return
        self._shown, self._shown_at = done, now
        left = (now - self._began) / max(done - self._first, 1e-9) * (total - done)
        line = f'{done:.0f}/{total:.0f} {self._unit}, {now - self._began:.0f} s, {left:.0f} s left: {text}'
        print(f'\r{line:<78}' if self._terminal else line, end='' if self._terminal and done < total else '\n', file=sys.stderr,
              flush=True)
