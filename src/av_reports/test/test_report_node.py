"""The node between a rig and those who act: what leaves the machine, what comes back, and that nothing which comes can hurt."""

from __future__ import annotations

import socket
import struct
import threading
import time
import xml.dom.minidom

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Header

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from link_peer import LONG_S, wait_for, without_pauses
from sapient_peer import NODE, FusionNode, task
from wire_decoder import dig

from av_common.node import Executor
from av_common.qos import RESULT
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, Track, TrackArray
from av_interfaces.srv import SelectTarget
from av_reports.nodes.report_node import ReportNode

pytestmark = pytest.mark.system
SURVEYED = ('surveyed.latitude:=51.5', 'surveyed.longitude:=-0.12', 'surveyed.altitude:=30.0')


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch, tmp_path):
    without_pauses(monkeypatch)
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'home'))


class Rig:
    """A tracker with two targets, 3 and 4, of which it follows the first, and a report_node of the same process."""

    def __init__(self, *parameters):
        rclpy.init(args=['--ros-args', *(word for one in parameters for word in ('-p', one))])
        self.node = rclpy.create_node('fusion_node')
        self.selected, self.cues, self.status = [], [], {}
        self.node.create_service(SelectTarget, '~/select', self.on_select)
        self.targets = self.node.create_publisher(TrackArray, 'targets', RESULT)
        self.bearing = self.node.create_publisher(Bearing, 'target/bearing', RESULT)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, RESULT)
        self.node.create_timer(0.05, self.publish)
        self.reports = ReportNode()
        self.executor = Executor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.reports)
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.spin)
        self.thread.start()
        wait_for(lambda: self.reports.is_active)

    def spin(self):
        while not self.ending.is_set():
            self.executor.spin_once(timeout_sec=0.1)

    def on_select(self, request, response):
        self.selected.append(request.id)
        response.success, response.message = request.id != 4, 'target 4 is not to be had'
        return response

    def on_diagnostics(self, message):
        for status in message.status:
            if status.name.startswith('report_node'):
                self.status = {value.key: value.value for value in status.values} | {'message': status.message}

    def publish(self):
        now = self.reports.now()
        self.bearing.publish(Bearing(attitude_known=True))
        tracks = [Track(id=number, existence=0.9, drone_probability=0.9, class_id='drone', azimuth_world=0.1 * number,
                        resolved=True, hemisphere_probability=0.99, last_heard=to_stamp(now),
                        covariance_world=np.array([1e-3, 0, 0, 1e-3], np.float32)) for number in (3, 4)]
        self.targets.publish(TrackArray(header=Header(stamp=to_stamp(now)), tracks=tracks, selected=3))

    def look(self):
        self.node.create_subscription(PointStamped, 'target/cue', self.cues.append, RESULT)

    def close(self):
        self.ending.set()
        self.thread.join()
        self.reports.close()
        self.reports.destroy_node()
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def fusion():
    node = FusionNode()
    yield node
    node.close()


@pytest.fixture
def rig(request, fusion):
    rig = Rig(f'sapient.peer:={fusion.address}', f'sapient.node_id:={NODE}', *SURVEYED, *getattr(request, 'param', ()))
    try:
        fusion.accept()
        yield rig
    finally:
        rig.close()


def follow(object_id):
    return task(command={'follow': {'follow_object_id': object_id}})


def objects(fusion):
    """ULIDs of the targets 3 and 4, which their azimuths tell apart."""
    found = {}
    while len(found) < 2:
        report = fusion.next(7)
        found[round((90.0 - dig(report, 5, 2)) % 360.0 / np.degrees(0.1))] = dig(report, 2).decode()
    return found[3], found[4]


def test_by_default_nothing_leaves_and_nothing_listens():
    rig = Rig()
    try:
        wait_for(lambda: rig.status.get('outputs'))
        assert rig.status['outputs'].startswith('none') and rig.status['message'] == 'active'
        assert not any(thread.name == 'link' for thread in threading.enumerate())
    finally:
        rig.close()


def test_bearings_are_reported_and_tasks_refused(rig, fusion):
    status = fusion.next(6)
    assert dig(status, 7, 2) == 51.5
    first, _ = objects(fusion)
    fusion.send(follow(first))
    answer = fusion.next(9)
    assert dig(answer, 2) == 2 and b'obey_tasks' in dig(answer, 5) and rig.selected == []
    wait_for(lambda: rig.status.get('sapient registered') == 'True' and int(rig.status['sapient tasks refused']) == 1)
    assert rig.status['message'] == 'active' and rig.status['sapient peer'] == fusion.address


@pytest.mark.parametrize('rig', [('sapient.obey_tasks:=true',)], indirect=True)
def test_tasks_are_obeyed_where_that_is_allowed(rig, fusion):
    first, second = objects(fusion)
    fusion.send(follow(first))
    assert dig(fusion.next(9), 2) == 1 and rig.selected == [3]
    fusion.send(follow(second))
    refused = fusion.next(9)
    assert dig(refused, 2) == 2 and dig(refused, 5) == b'target 4 is not to be had'
    east = {'look_at': {'range_bearing': {'azimuth': 90.0, 'elevation': 30.0, 'coordinate_system': 1, 'datum': 1}}}
    fusion.send(task(command=east))
    assert dig(fusion.next(9), 5) == b'nothing on this rig takes cues'
    rig.look()
    wait_for(lambda: rig.reports.count_subscribers('target/cue'))
    fusion.send(task(command=east))
    wait_for(lambda: len(rig.cues) > 2)
    cue = rig.cues[-1]
    assert (cue.point.x, cue.point.y, cue.point.z) == pytest.approx((1000 * np.cos(np.pi / 6), 0.0, 500.0), abs=1e-3)
    assert cue.header.frame_id == 'world'
    fusion.peer.close()    # nobody watches over the task any longer
    wait_for(lambda: rig.selected[-1] == 0 and rig.status.get('sapient task') == 'none')
    seen = len(rig.cues)
    time.sleep(0.3)
    assert len(rig.cues) <= seen + 1


@pytest.mark.parametrize('rig', [('sapient.obey_tasks:=true',)], indirect=True)
def test_an_attacker_gets_nowhere(rig, fusion):
    """Rubbish, a flood, lengths without measure, half messages: the node lives, counts, and reports to who comes next."""
    rng = np.random.default_rng(1)
    for rubbish in (rng.bytes(10_000), b'\xff' * 64, struct.pack('<I', 100) + b'half', b''):
        fusion.peer.sendall(rubbish)
        fusion.peer.close()
        fusion.accept()
        assert dig(fusion.next(7), 5, 2) is not None
    for _ in range(200):
        fusion.send(rng.bytes(int(rng.integers(1, 2000))))
    wait_for(lambda: int(rig.status.get('sapient unusable messages', 0)) > 0)
    fusion.peer.close()
    fusion.accept()
    assert fusion.next(7)
    assert rig.reports.is_active and rig.selected in ([], [0])


def test_tak_and_files_get_the_same(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.settimeout(LONG_S)
        url = f'udp://127.0.0.1:{receiver.getsockname()[1]}'
        rig = Rig(f'cot.url:={url}', f'log.folder:={tmp_path}', *SURVEYED)
        try:
            events = {}
            while len(events) < 2:
                event = xml.dom.minidom.parseString(receiver.recv(4000)).documentElement
                events[event.getAttribute('uid')] = event
            sensor, = [found for event in events.values() for found in event.getElementsByTagName('sensor')]
            assert float(sensor.getAttribute('azimuth')) == pytest.approx(90.0 - np.degrees(0.3), abs=0.1)
            wait_for(lambda: int(rig.status.get('log written', 0)) >= 2)
        finally:
            rig.close()
    table, = tmp_path.glob('*.csv')
    assert len(table.read_text().splitlines()) >= 3
