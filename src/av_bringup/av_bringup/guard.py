"""A small process beside a launch that ends the launch's other processes when the launch itself is killed.

`python3 -I -S guard.py NAME=VALUE PID`: started by the launch, of which PID is the process. The processes to end are all whose
environment held NAME=VALUE at their start, and so their children, whether they run, hang or are stopped. VALUE is the folder of
the run, which is removed at the end. Only the standard library is imported, so that the program starts within some 20 ms.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path

PERIOD_S = 0.05     # between two looks at the processes, a small part of PATIENCE_S
PATIENCE_S = 1.0    # time between the request to end and the kill; a node needs it to stop what moves and to close its files
GIVE_UP_S = 5.0  # after the request: what is left then cannot be ended, such as a process in a driver


def main(mark: str, launch: int) -> None:
    """Wait for the end of the launch or for a signal of it, then for the end of its processes.

    Parameters:
        mark: NAME=VALUE in the environment of the launch's processes.
        launch: process id of the launch.
    """
    asked = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.append(True))
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    while os.getppid() == launch and not (asked and not find_processes(mark)):
        time.sleep(PERIOD_S)
    if os.getppid() != launch:
        end_processes(mark)
    shutil.rmtree(mark.partition('=')[2], ignore_errors=True)


def end_processes(mark: str) -> None:
    """Send SIGTERM to all processes of the launch, and SIGKILL to those that remain after PATIENCE_S."""
    begin, asked = time.monotonic(), set()
    while (processes := find_processes(mark)) and time.monotonic() - begin < GIVE_UP_S:
        for process in processes:
            if time.monotonic() - begin > PATIENCE_S:
                send(process, signal.SIGKILL)
            elif process not in asked:
                send(process, signal.SIGTERM)
                asked.add(process)
        time.sleep(PERIOD_S)


def send(process: int, number: signal.Signals) -> None:
    """Send a signal to a process that may have ended meanwhile."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, number)


def find_processes(mark: str) -> list[int]:
    """Ids of the processes that carry the mark and have not ended, without this one."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            if (mark.encode() in (folder / 'environ').read_bytes().split(b'\0')
                    and (folder / 'stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'):
                found.append(int(folder.name))
        except OSError:
            continue  # ended meanwhile, or another user's
    return [process for process in found if process != os.getpid()]


if __name__ == '__main__':
    main(sys.argv[1], int(sys.argv[2]))
