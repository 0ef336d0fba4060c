import math
import os
import re
import signal
import subprocess

import bag_messages as make
import numpy as np
import pytest
from ros_domains import free_domain

from av_bags.reader import Bag
from av_bags.writer import BagWriter
from av_common.track import State
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_simulator import find_config

pytestmark = pytest.mark.system


def launch(*arguments, timeout=120.0):
    """`ros2 launch av_fusion replay.launch.py` in a domain of its own; returns exit code and output."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(free_domain()), 'PYTHONUNBUFFERED': '1'}
    process = subprocess.Popen(
        ['ros2', 'launch', 'av_fusion', 'replay.launch.py', *arguments], stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True, env=environment, start_new_session=True)
    try:
        output = process.communicate(timeout=timeout)[0]
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, output


def bearings(path):
    """Time in s, azimuth in rad and its sigma of the bearings of a bag."""
    with Bag(path) as bag:
        rows = [bag.decode(topic, data) for topic, _, data in bag.messages(['/target/bearing'])]
    return np.array([(row.header.stamp.sec + 1e-9 * row.header.stamp.nanosec, row.azimuth, np.sqrt(row.azimuth_variance))
                     for row in rows if row.state != State.NONE])


@pytest.mark.parametrize('aside', [None, math.radians(80.0)])
def test_live_and_offline_replay_agree(tmp_path, aside):
    """With one camera, and with a second one that sees the target when it has left the view of the first."""
    flight = make.flight(tmp_path / 'flight', duration=16.0, aside=aside)
    rig = str(find_config('rig' if aside is None else 'rig_two_cameras'))
    with Bag(flight) as bag, BagWriter(tmp_path / 'offline.mcap') as out:
        Replay(bag, ReplaySettings(stage='doa', rig=rig)).run(out)
    code, output = launch(f'bag:={flight}', 'only:=doa', 'rate:=2.0', f'rig:={rig}', f'record:={tmp_path / "live.mcap"}')
    assert code == 0, output
    assert re.search(r'coverage +100\.0 %', output)
    live, offline = bearings(tmp_path / 'live.mcap'), bearings(tmp_path / 'offline.mcap')
    if aside is not None:  # by sound alone sigma is 1 deg
        left = offline[(offline[:, 0] > make.EPOCH + 4.0) & (offline[:, 0] < make.EPOCH + 8.0)]
        truth = 0.3 + 2 * math.pi / 40.0 * (left[:, 0] - make.EPOCH)
        assert np.degrees(np.sqrt(np.mean((left[:, 1] - truth) ** 2))) < 0.3
    with Bag(tmp_path / 'live.mcap') as bag:
        assert bag.topics['/doa'].count == 160
        assert bag.topics['/detections'].count == 200
        assert aside is None or bag.topics['/second_camera/detections'].count == 200
        assert bag.topics['/tf_static'].count == 1
    assert len(live) > 0.8 * len(offline)
    # The first second apart: what has come by then is a matter of microseconds.
    live = live[live[:, 0] > offline[0, 0] + 1.0]
    nearest = np.abs(live[:, :1] - offline[None, :, 0]).argmin(axis=1)
    difference = np.abs(np.angle(np.exp(1j * (live[:, 1] - offline[nearest, 1]))))
    assert np.median(difference) < 0.2 * np.median(offline[:, 2])
    assert np.mean(difference < 2.0 * offline[nearest, 2] + np.radians(0.5)) > 0.95


def test_a_bag_that_cannot_be_played_ends_the_launch_with_its_reason(tmp_path):
    (tmp_path / 'text.mcap').write_text('this is no bag')
    code, output = launch(f'bag:={tmp_path / "text.mcap"}')
    assert code != 0
    assert 'text.mcap is no bag: its content is neither mcap nor sqlite3' in output
