"""The packages for a robot run alone: packages and libraries that only a workstation needs are hidden."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import rclpy
import soundfile
from ament_index_python.packages import get_package_prefix
from pulse import PulseCard
from rig_process import RigProcess

from av_common.node import Executor
from av_common.qos import RESULT
from av_interfaces.msg import Bearing, DoaArray, FusionState, PointingCommand

pytestmark = pytest.mark.system

ROBOT = {'av_interfaces', 'av_common', 'av_bringup', 'av_audio', 'av_vision', 'av_fusion', 'av_pointing', 'av_px4'}
DESK = {'av_bags', 'av_evaluation', 'av_sim_bridge', 'av_simulator', 'av_view'}
LIBRARIES = {'dask', 'distributed', 'matplotlib', 'mcap', 'mcap_ros2', 'mujoco', 'rosbags', 'websockets'}
TOPICS = {'doa': DoaArray, 'target/bearing': Bearing, 'fusion/state': FusionState, 'pointing/command': PointingCommand}
NODES = ('rig_frames_node', 'audio_node', 'camera_node', 'doa_node', 'detector_node', 'fusion_node', 'pointing_node')

HIDE = f'''
import sys


class Hidden:
    """Modules of these names cannot be imported."""

    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {sorted(DESK | LIBRARIES)}:
            raise ModuleNotFoundError(f'{{name}} is hidden by test_robot_set.py', name=name)


sys.meta_path.insert(0, Hidden())
'''
# Prints what launch_file.start raises for each of the arguments in argv[2:], as JSON.
ASK = '''
import importlib.util, json, sys

spec = importlib.util.spec_from_file_location('launch_file', sys.argv[1])
launch_file = importlib.util.module_from_spec(spec)
spec.loader.exec_module(launch_file)
complaints = {}
for words in sys.argv[2:]:
    arguments = {name: default or '' for name, (default, _, _) in launch_file.ARGUMENTS.items()}
    arguments |= {'source': 'hardware'} if 'source' in arguments else {}
    arguments |= {'AV_RIG_RUN': sys.prefix, **dict(word.split(':=', 1) for word in words.split())}
    try:
        launch_file.start(arguments)
    except Exception as error:
        complaints[words] = f'{type(error).__name__}: {error}'
print(json.dumps(complaints))
'''


@pytest.fixture
def robot(tmp_path_factory, monkeypatch):
    """The environment of a machine with the robot's packages only."""
    prefixes = {name: get_package_prefix(name) for name in DESK}
    if {get_package_prefix(name) for name in ROBOT} & set(prefixes.values()):
        pytest.skip('all packages share one install folder (--merge-install): none can be hidden')
    for name in ('AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH', 'PYTHONPATH', 'LD_LIBRARY_PATH'):
        entries = [entry for entry in os.environ.get(name, '').split(os.pathsep) if not DESK & set(Path(entry).parts)]
        monkeypatch.setenv(name, os.pathsep.join(entries))
    hook = tmp_path_factory.mktemp('hook')
    (hook / 'sitecustomize.py').write_text(HIDE)
    monkeypatch.setenv('PYTHONPATH', f'{hook}{os.pathsep}{os.environ["PYTHONPATH"]}')


def missing_for_microphones():
    """Missing prerequisites of capturing from a virtual sound card, '' if there are none."""
    try:
        import sounddevice  # noqa: F401
    except (ImportError, OSError) as error:   # OSError: without PortAudio
        return f'sounddevice: {error}'
    return PulseCard.missing()


@pytest.fixture
def microphones(tmp_path, monkeypatch):
    """A virtual sound card that plays the same noise in both channels: a source straight ahead."""
    if missing_for_microphones():
        pytest.skip(f'not installed: {missing_for_microphones()}')
    for name in ('PULSE_SERVER', 'PULSE_RUNTIME_PATH', 'PULSE_STATE_PATH', 'ALSA_CONFIG_PATH', 'HOME'):
        monkeypatch.setenv(name, '')  # to be restored afterwards
    noise = np.random.default_rng(1).normal(0.0, 0.1, 120 * 48_000)
    soundfile.write(tmp_path / 'noise.wav', np.stack([noise, noise], axis=1), 48_000)
    card = PulseCard(tmp_path)
    card.plug()
    card.play(tmp_path / 'noise.wav')
    yield card
    card.unplug()


class Listener:
    """Counts the rig's messages, from a process without hidden packages."""

    def __init__(self, domain):
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node('listener', context=self._context)
        self._executor = Executor(context=self._context)
        self._executor.add_node(self._node)
        self.counts, self.moving = Counter(), 0
        for topic, kind in TOPICS.items():
            self._node.create_subscription(kind, topic, lambda message, topic=topic: self.take(topic, message), RESULT)

    def take(self, topic, message):
        self.counts[topic] += 1
        if topic == 'pointing/command':
            self.moving += message.move_gimbal or message.move_body

    def listen(self, rig, enough, seconds=120.0):
        """Receive until there are `enough` messages of each topic, or the rig has ended; the limit is for a slow machine."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and rig.running_now and min(self.counts[topic] for topic in TOPICS) < enough:
            self._executor.spin_once(timeout_sec=0.2)

    def close(self):
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


def launch_file(name):
    return str(Path(get_package_prefix('av_fusion')) / 'share' / 'av_fusion' / 'launch' / name)


def complaints(name, *arguments):
    """What the launch file's `start` raises in the present environment, by argument."""
    command = [sys.executable, '-c', ASK, launch_file(name), *arguments]
    run = subprocess.run(command, text=True, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_the_rig_runs_on_its_microphones_without_what_a_desk_needs(robot, microphones):
    """No camera, no monitor: directions, bearings and commands come, nothing moves, and all processes live to the end."""
    rig = RigProcess('source:=hardware')
    listener = Listener(rig.domain)
    try:
        listener.listen(rig, enough=20)
        assert all(listener.counts[topic] >= 20 for topic in TOPICS), (listener.counts, rig.output)
        assert not listener.moving    # noise may have a bearing, but pointing is not enabled
        assert all(len(rig.processes(f'/{node}')) == 1 for node in NODES), rig.output
        assert not rig.processes('monitor_node')
    finally:
        listener.close()
    rig.interrupt()
    rig.finish()
    assert 'is hidden by' not in rig.output and 'process has died' not in rig.output, rig.output
    assert not rig.leftovers()


def test_without_a_monitor_the_launch_ends_the_run(robot):
    rig = RigProcess('source:=hardware', 'duration:=5')
    assert rig.finish() == 0, rig.output
    assert '[fusion_node-3]: process started' in rig.output and 'while the rig was running' not in rig.output
    assert not rig.leftovers()


def test_a_missing_package_is_named_with_the_argument_that_needs_it(robot):
    wanted = {'source:=sim': 'av_simulator', 'source:=udp': 'av_sim_bridge', 'record:=flight.mcap': 'av_bags',
              'out:=results': 'av_evaluation', 'monitor:=true': 'av_evaluation',
              'view:=true': 'av_view', 'px4:=true': 'px4_msgs'}
    found = complaints('rig.launch.py', *wanted)
    for argument, package in wanted.items():
        assert found[argument].startswith(
            f'MissingPackageError: {argument} needs the package {package}, which is not installed'), found
    assert complaints('replay.launch.py', 'bag:=flight.mcap') == {
        'bag:=flight.mcap': 'MissingPackageError: bag:=flight.mcap needs the package av_bags, which is not installed'}


def test_a_missing_package_ends_the_launch_with_one_line(robot):
    rig = RigProcess('source:=udp')
    assert rig.finish(timeout=60.0) != 0
    lines = [line for line in rig.output.splitlines() if 'av_sim_bridge' in line]
    assert len(lines) == 1 and 'source:=udp needs the package av_sim_bridge' in lines[0], rig.output


def test_what_nothing_asks_for_is_not_missed(robot):
    assert not complaints('rig.launch.py', 'source:=hardware', 'source:=hardware monitor:=false duration:=5', 'source:=file')


def test_out_and_a_monitor_switched_off_contradict_each_other():
    assert 'monitor:=false' in complaints('rig.launch.py', 'out:=results monitor:=false')['out:=results monitor:=false']
