"""A rig that is launched with its page, for screenshots and measurements."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from urllib.error import URLError
from urllib.request import urlopen

START_S, END_S = 120.0, 30.0  # longest time for a launch to start and to end
LAUNCH_FILE = 'rig.launch.py'


@contextmanager
def launched_rig(words: Sequence[str], address: str) -> Iterator[float]:
    """A launch with `view:=true`; gives the time (s) from its start until the page was up. Raises TimeoutError without one.

    Parameters:
        words: arguments of rig.launch.py, or the name of another launch file and its arguments.
        address: of the page.
    """
    file, arguments = (words[0], words[1:]) if words and words[0].endswith('.launch.py') else (LAUNCH_FILE, words)
    begin = time.monotonic()
    rig = subprocess.Popen(['ros2', 'launch', 'av_fusion', file, 'view:=true', *arguments], stdout=subprocess.DEVNULL)
    try:
        while not _is_up(address):
            if time.monotonic() - begin > START_S or rig.poll() is not None:
                raise TimeoutError(f'no page at {address}')
            time.sleep(0.02)
        yield time.monotonic() - begin
    finally:
        rig.send_signal(signal.SIGINT)
        rig.wait(END_S)


def _is_up(address: str) -> bool:
    try:
        with urlopen(address, timeout=1.0) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False
