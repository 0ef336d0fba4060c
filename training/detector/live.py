"""How often and how late the detector looks beside the whole rig: a live run of the simulator and all nodes."""

from __future__ import annotations

import csv
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from measure import Row

SECONDS = 30
STARTED = 15.0  # s until all processes run


def beside_the_rig(model: Path, classes: tuple[str, ...], cores: int) -> list[Row]:
    """Rows of a run of the demo on some processor cores; raises RuntimeError when there is no workspace to start it from.

    With one core the simulator, which stands for the world, has the other ones. The rate is that of images which gave
    detections, or of which the absence of any says something.
    """
    with tempfile.TemporaryDirectory() as folder:
        arguments = [f'duration:={SECONDS}', f'out:={folder}', f'model:={model.resolve()}']
        arguments += [f'classes:={",".join(classes)}'] if classes else []
        try:
            with subprocess.Popen(['ros2', 'launch', 'av_fusion', 'rig.launch.py', *arguments], stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL) as launch:
                try:
                    _confine(launch.pid, cores)
                    launch.wait(4 * SECONDS)
                finally:
                    launch.terminate()
            rate, delay = looks(Path(folder) / 'sight.csv')
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RuntimeError(f'the rig did not run: {error}; build the workspace and source tools/ros_env.sh') from error
    where = f'live beside the rig on {cores} cores' if cores > 1 else 'live beside the rig on 1 core, simulator on others'
    aims = ('15', '120 ms') if cores > 1 else ('8', '')
    return [(f'{where}: looks a second', aims[0], f'{rate:.1f}'),
            ('... from capture to detections, median', aims[1], f'{1e3 * delay:.0f} ms')]


def looks(file: Path) -> tuple[float, float]:
    """Looks a second, and the median time (s) from capture to detections, by the monitor's log of a run."""
    with file.open() as rows:
        time, delay = np.array([(row['time'], row['delay']) for row in csv.DictReader(rows)], float).reshape(-1, 2).T
    return (len(time) - 1) / np.ptp(time) if len(time) > 1 else 0.0, float(np.median(delay)) if len(delay) else np.nan


def _confine(launch: int, cores: int) -> None:
    """Give the processes of a rig that starts some of the cores, and the simulator the others, or the same."""
    own = sorted(os.sched_getaffinity(0))
    others = own[cores:] if cores == 1 and len(own) > 1 else own[:cores]
    began = time.monotonic()
    while time.monotonic() < began + STARTED:
        time.sleep(0.5)
        for process in psutil.Process(launch).children(recursive=True):
            try:
                line = ' '.join(process.cmdline())
                for thread in process.threads():
                    os.sched_setaffinity(thread.id, others if '/simulator' in line or 'spawn_main' in line else own[:cores])
            except (psutil.Error, OSError):
                continue  # it has just ended
