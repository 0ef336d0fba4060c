"""A steady rate of sending."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

STEP = 0.01


def paced(seconds: float, rate: float, meanwhile: Callable[[], None] = lambda: None) -> Iterator[int]:
    """Numbers from 0, at a rate; after a delay as many at once as keep the rate.

    Parameters:
        seconds: duration.
        rate (Hz): of the numbers.
        meanwhile: called in each pause.
    """
    begun, done = time.monotonic(), 0
    while (elapsed := time.monotonic() - begun) < seconds:
        due = min(int(elapsed * rate), done + max(int(rate), 1))
        while done < due and time.monotonic() - begun < seconds:
            yield done
            done += 1
        meanwhile()
        time.sleep(STEP)
