"""Rigs in namespaces whose sensors are mounted in different ways: each sees its own frames only, and the tutorial holds."""

from __future__ import annotations

import math
import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from machine_load import skip_figures_where_overloaded
from nav_msgs.msg import Odometry
from network_hosts import two_hosts
from rig_process import RigProcess
from ros_domains import TUTORIAL_DOMAIN
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from udp_ports import free_offset
from vision_msgs.msg import Detection2DArray

from av_bags.reader import Bag
from av_common.node import Executor
from av_common.qos import RESULT, STREAM
from av_common.rig import load_rig
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_stamp
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_interfaces.msg import Bearing, GimbalState
from av_vision.detections import Detections
from av_vision.messages import camera_info_message, detections_message

pytestmark = pytest.mark.system
ROOT = Path(__file__).resolve().parent.parent
ARRAY = f'array: {{file: {ROOT}/config/arrays/two_microphones.yaml}}\n'
# A camera on the body, and one on a gimbal whose pan is PAN_DEG.
FIXED = ARRAY + 'camera: {mount: {rpy_deg: [0.0, 0.0, 37.0]}}\n'
MOVING = ARRAY + 'gimbal: {stabilized: false}\ncamera: {mount: {rpy_deg: [0.0, 0.0, 4.0]}}\n'
PAN_DEG = -114.0


class StandIn:
    """Camera, detector, odometry and gimbal of two rigs; keeps the bearings that come back, in degrees."""

    def __init__(self, domain: int, rigs: dict[str, Path]) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node('stand_in', context=self._context)
        self._executor = Executor(context=self._context)
        self._executor.add_node(self.node)
        self.bearings: dict[str, list[float]] = {name: [] for name in rigs}
        self.cameras = {name: load_rig(file).camera.model for name, file in rigs.items()}
        kinds = {'camera/camera_info': (CameraInfo, RESULT), 'detections': (Detection2DArray, RESULT),
                 'odometry': (Odometry, STREAM), 'gimbal/state': (GimbalState, STREAM)}
        self._publishers = {name: {topic: self.node.create_publisher(kind, f'/{name}/{topic}', qos)
                                   for topic, (kind, qos) in kinds.items()} for name in rigs}
        self._pan = math.radians(PAN_DEG)
        for name in rigs:
            self.node.create_subscription(Bearing, f'/{name}/target/bearing', lambda m, name=name: self._keep(name, m), RESULT)
        self.node.create_timer(0.05, self._publish)

    def _keep(self, name: str, message: Bearing) -> None:
        if message.state != Bearing.STATE_NONE:
            self.bearings[name].append(math.degrees(message.azimuth))

    def _publish(self) -> None:
        now = time.time()
        turned = math.cos(0.5 * self._pan), 0.0, 0.0, math.sin(0.5 * self._pan)
        box = Detections(np.array([[304.5, 229.5, 334.5, 249.5]]), np.array([0.9]), ('drone',))
        for name, publishers in self._publishers.items():
            seen = Header(stamp=to_stamp(now - 0.02), frame_id='camera_optical_frame')
            publishers['camera/camera_info'].publish(camera_info_message(seen, self.cameras[name]))
            publishers['detections'].publish(detections_message(seen, box, (1,)))
            odometry = Odometry(header=Header(stamp=to_stamp(now), frame_id='odom'), child_frame_id='base_link')
            odometry.pose.pose.orientation.w = 1.0
            publishers['odometry'].publish(odometry)
            publishers['gimbal/state'].publish(gimbal_message('gimbal_link', now, turned, 1e-6, True))

    def run(self, condition, timeout: float = 90.0) -> None:
        """Spin until the condition holds. Raises AssertionError where it does not."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, self.bearings
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        """Leave the domain."""
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)


def descriptions(tmp_path, given):
    """The rigs' files by namespace, of their texts."""
    files = {name: tmp_path / f'{name}.yaml' for name in given}
    for name, file in files.items():
        file.write_text(given[name])
    return files


def launched(files, *arguments):
    """A launch for each rig, all in one domain, as on machines of one network."""
    rigs: dict[str, RigProcess] = {}
    for name, file in files.items():
        domain = next((rig.domain for rig in rigs.values()), None)
        rigs[name] = RigProcess('source:=file', f'namespace:={name}', f'rig:={file}', 'monitor:=false',
                                *(argument.format(name) for argument in arguments), domain=domain)
    return rigs


def bearings_of(files, rigs):
    """The newest thirty bearings of each rig, in degrees."""
    stand_in = StandIn(next(iter(rigs.values())).domain, files)
    try:
        stand_in.run(lambda: all(len(found) > 40 for found in stand_in.bearings.values()))
        assert not any(stand_in.node.get_publishers_info_by_topic(topic) for topic in ('/tf', '/tf_static'))
        assert {name: len(stand_in.node.get_publishers_info_by_topic(f'/{name}/tf_static')) for name in files} == \
            dict.fromkeys(files, 1)
    finally:
        stand_in.close()
    return {name: np.array(found[10:]) for name, found in stand_in.bearings.items()}


def test_rigs_of_one_domain_see_their_own_frames_and_record_them(tmp_path):
    """A fixed camera, and one on a gimbal; the frames of both have the same names."""
    files = descriptions(tmp_path, {'left': FIXED, 'right': MOVING})
    rigs = launched(files, f'record:={tmp_path}/{{}}.mcap')
    found = bearings_of(files, rigs)
    for rig in rigs.values():
        rig.interrupt()
        rig.finish()
    assert found['left'] == pytest.approx(37.0, abs=0.2)
    assert found['right'] == pytest.approx(PAN_DEG + 4.0, abs=0.2)
    for name, azimuth in (('left', 37.0), ('right', PAN_DEG + 4.0)):
        with Bag(tmp_path / f'{name}.mcap') as bag:
            assert {topic for topic in bag.topics if topic.endswith('tf_static')} == {f'/{name}/tf_static'}
            log = Replay(bag, ReplaySettings(stage='doa', namespace=name, rig=str(files['right']))).run()
        assert np.degrees(log.sight['azimuth']) == pytest.approx(azimuth, abs=0.2)


def test_the_tutorial_of_two_computers(tmp_path, monkeypatch):
    """Two hosts, the variables and the launches of the tutorial; files and a stand-in are in the place of hardware."""
    files = descriptions(tmp_path, {'left': FIXED, 'right': FIXED.replace('37.0', '-120.0')})
    text = (ROOT / 'docs' / 'tutorials' / 'two_rigs.md').read_text()
    for name, value in re.findall(r'(\w+)=(\S+)', re.search(r'^export (ROS_DOMAIN_ID.*)$', text, re.MULTILINE)[1]):
        monkeypatch.setenv(name, value.replace('$PWD', str(ROOT)))
    command = re.search(r'^ros2 launch av_fusion rig.launch.py (.*namespace:=left)$', text, re.MULTILINE)[1].split()
    domain, rigs = int(os.environ['ROS_DOMAIN_ID']), {}
    assert domain == TUTORIAL_DOMAIN
    with two_hosts() as hosts:
        for host, (name, file) in zip(hosts, files.items(), strict=True):
            arguments = [word.replace('hardware', 'file').replace('left', name) for word in command]
            rigs[name] = host.run(lambda arguments=arguments, file=file: RigProcess(
                *arguments, f'rig:={file}', 'monitor:=false', domain=domain))
        found = hosts[0].run(bearings_of, files, rigs)
        for rig in rigs.values():
            rig.interrupt()
            rig.finish()
    assert found['left'] == pytest.approx(37.0, abs=0.2)
    assert found['right'] == pytest.approx(-120.0, abs=0.2)


def test_the_tutorial(tmp_path, monkeypatch):
    """Its commands as they are, in a folder with its file; only the ports are others, and it ends."""
    text = (ROOT / 'docs' / 'tutorials' / 'second_rig.md').read_text()
    (tmp_path / 'right.yaml').write_text(re.search(r'```yaml\n(# right.yaml.*?)```', text, re.DOTALL)[1])
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r'^ros2 launch av_fusion rig.launch.py (namespace:=.*?) *(?:#.*)?$', text, re.MULTILINE)
    assert len(commands) == 2
    begin, rigs = str(time.time() + 10.0), []
    for command in commands:
        arguments = [word.replace('$begin', begin) for word in command.split() if not word.startswith('port_offset')]
        rigs.append(RigProcess(*arguments, f'port_offset:={free_offset()}', 'oracle:=true', 'duration:=25',
                               domain=rigs[0].domain if rigs else None))
    for rig in rigs:
        assert rig.finish() == 0, rig.output
        assert not rig.leftovers()
    skip_figures_where_overloaded()
    for rig in rigs:
        assert rig.value('median') < 4.0, rig.output
