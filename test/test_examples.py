"""The examples run without ROS, are short, draw their pictures, and find what is there."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
from rclpy.serialization import serialize_message

from av_bags.writer import BagWriter
from av_interfaces.msg import Bearing

EXAMPLES = Path(__file__).parents[1] / 'examples'
WITHOUT_ROS = """
import runpy, sys
for name in ('rclpy', 'av_interfaces', 'std_msgs', 'nav_msgs', 'rosidl_runtime_py',
             'ament_index_python', 'launch'):
    sys.modules[name] = None
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name='__main__')
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('examples')


def run(name, folder, *arguments):
    """What an example prints; its picture must be there."""
    done = subprocess.run([sys.executable, '-c', WITHOUT_ROS, f'examples/{name}.py', str(folder), *map(str, arguments)],
                          cwd=EXAMPLES.parent, env={**os.environ, 'MPLBACKEND': 'agg'}, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (folder / f'{name}.png').stat().st_size > 5000
    return done.stdout


def numbers(pattern, text):
    return [[float(value) for value in found] for found in re.findall(pattern, text)]


def test_there_are_ten_and_none_is_long():
    programs = sorted(EXAMPLES.glob('*.py'))
    assert len(programs) == 10
    assert all(len(program.read_text().splitlines()) < 50 for program in programs)
    assert len((EXAMPLES / 'own_method/own_method.py').read_text().splitlines()) < 50


def test_a_scene_is_rendered_heard_localised_and_seen(folder):
    heard = numbers(r'heard at +([-+.\d]+), +([-+.\d]+) deg, true +([-+.\d]+)', run('render_scene', folder, 'circle', 1.5))
    assert len(heard) > 8 and all(min(abs(first - true), abs(second - true)) < 2.0 for first, second, true in heard)
    localised = numbers(r'([\d.]+) s +([-+.\d]+) deg', run('localize_wav', folder))
    assert len(localised) > 30 and sum(abs(azimuth - 6.0 * time) < 2.0 for time, azimuth in localised) > 0.4 * len(localised)
    seen = run('detect_video', folder)
    assert seen.count('drone 1 at') > 15 and '22 images' in seen


def test_sound_and_sight_are_fused(folder):
    ((seconds, rmse),) = numbers(r'tracked for ([\d.]+) of [\d.]+ s, RMSE ([\d.]+) deg', run('fuse', folder, 'circle', 2))
    assert seconds > 1.5 and rmse < 1.5


def test_a_turn_tells_front_from_back(folder):
    rows = numbers(r'([\d.]+) s +heading +([-\d]+) deg +target at +([-+.\d]+) deg.*?to +(\d+) %', run('front_back', folder))
    assert rows[3][0] == 1.5 and rows[3][3] < 70.0   # before the turn
    assert abs(rows[-1][2] - 150.0) < 5.0 and rows[-1][3] > 95.0


def test_a_head_is_calibrated(folder):
    text = run('calibrate', folder)
    assert abs(float(re.search(r'baseline +([\d.]+) mm', text)[1]) - 1e3 * 0.0875 * (1.0 + 0.5 * 3.14159)) < 3.0
    assert float(re.search(r'RMS ([\d.]+) deg', text)[1]) < 1.0 and (folder / 'head.yaml').exists()


def test_two_rigs_know_the_position(folder):
    rows = numbers(r'at \[ *([-\d.]+) +([-\d.]+) +([-\d.]+) *\] m \+- ([\d.]+), true \[ *([-\d.]+) +([-\d.]+) +([-\d.]+) *\]',
                   run('triangulate', folder))
    assert len(rows) >= 4
    for *found, sigma, east, north, up in rows:    # the right rig's heading is found as the drone comes nearer
        assert math.dist(found, (east, north, up)) < 3.0 * sigma
    assert math.dist(rows[-1][:3], rows[-1][4:]) < 2.0


def test_a_bag_is_read(folder):
    message = Bearing(state=Bearing.STATE_ACOUSTIC_ACTIVE, azimuth=0.5, azimuth_variance=0.01)
    with BagWriter(folder / 'some.mcap') as writer:
        writer.add_topic('/rig/target/bearing', 'av_interfaces/msg/Bearing')
        for k in range(20):
            writer.write('/rig/target/bearing', int(1e9 + 1e8 * k), serialize_message(message))
    text = run('read_bag', folder, folder / 'some.mcap')
    assert '20 messages  av_interfaces/msg/Bearing' in text and '100 % of 20 messages' in text


def test_a_folder_is_made_for_results(tmp_path):
    soundfile.write(tmp_path / 'noise.wav', 0.1 * np.random.default_rng(1).normal(size=(48_000, 2)), 48_000)
    assert 'confidence' in run('localize_wav', tmp_path / 'new', tmp_path / 'noise.wav')


def test_methods_are_compared(folder):
    rows = dict(re.findall(r'^(\w+) +([\d.]+) deg', run('compare_methods', folder), re.MULTILINE))
    assert {'ml', 'phat', 'music', 'mvdr'} <= set(rows) and all(float(median) < 1.0 for median in rows.values())


def test_directions_are_drawn(folder):
    azimuths = re.findall(r'quadrotor_square: +([-+.\d]+) deg', run('plot_directions', folder))
    assert [float(azimuth) for azimuth in azimuths] == [pytest.approx(35.0, abs=2.0)]
