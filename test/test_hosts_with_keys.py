"""Two rigs as hosts of their own, with keys, in a network that is parted: `ros2 run av_evaluation network_hosts`."""

from __future__ import annotations

import os
import re
import subprocess

import pytest

pytestmark = pytest.mark.system
COMMAND = ['ros2', 'run', 'av_evaluation', 'network_hosts', '--rigs', '2', '--drones', '1', '--delay-ms', '50', '--loss', '5',
           '--before', '12', '--partition', '2', '--after', '3', '--security']
LONGEST_S = 400.0    # on a machine with much else to do; some 45 s without


def test_two_secured_hosts_track_on_both_sides_of_a_partition():
    """Both nodes have positions by the reports of both, few bytes are sent, and who has no keys neither hears nor is heard."""
    environment = {name: value for name, value in os.environ.items() if name != 'CYCLONEDDS_URI'}
    ran = subprocess.run(COMMAND, capture_output=True, text=True, timeout=LONGEST_S, check=False, env=environment)
    print(ran.stdout, ran.stderr)
    if any(reason in ran.stderr for reason in ('permits no network namespaces', 'stopped for', 'too slow')):
        pytest.skip(ran.stderr.strip().splitlines()[-1])
    for rig in ('rig1', 'rig2'):
        missed, sent = re.findall(rf'^{rig} +(.+)$', ran.stdout, re.MULTILINE)
        assert float(missed.split()[0]) < 0.5, 'a drone before the partition'
        at_rest, *rates = map(float, re.findall(r'([\d.]+) kB/s', sent))
        assert len(rates) == 3 and max(at_rest, *rates) < 5.0 and min(rates) > 0.5
    itself, overheard, listeners = map(int, re.search(r'(\d+) messages heard of itself, (\d+) of .* (\d+) listener', ran.stdout)
                                       .groups())
    assert itself > 20 and overheard == 0 and listeners == 1
