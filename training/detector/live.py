"""How often and how late the detector looks beside the whole rig: a live run of the simulator and all nodes."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path

from measure import Row

SECONDS = 30


def beside_the_rig(model: Path, classes: tuple[str, ...], cores: int) -> list[Row]:
    """Rows of a run of the demo on some processor cores; raises RuntimeError when there is no workspace to start it from.

    The rate is that of images which gave detections, or of which the absence of any says something.
    """
    with tempfile.TemporaryDirectory() as folder:
        arguments = [f'duration:={SECONDS}', f'out:={folder}', f'model:={model.resolve()}']
        arguments += [f'classes:={",".join(classes)}'] if classes else []
        on_cores = set(sorted(os.sched_getaffinity(0))[:cores])
        try:
            subprocess.run(['ros2', 'launch', 'av_fusion', 'rig.launch.py', *arguments], stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL, timeout=4 * SECONDS, check=False,
                           preexec_fn=lambda: os.sched_setaffinity(0, on_cores))
            sight = json.loads((Path(folder) / 'metrics.json').read_text())['senses']['sight']
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RuntimeError(f'the rig did not run: {error}; build the workspace and source tools/ros_env.sh') from error
    where = f'live beside the rig on {cores} core{"s" if cores > 1 else ""}'
    aims = ('15', '120 ms') if cores > 1 else ('8', '')
    return [(f'{where}: looks a second', aims[0], f'{sight["rate_hz"]:.1f}'),
            ('... from capture to detections, median', aims[1], f'{sight["delay_median_ms"]:.0f} ms')]
