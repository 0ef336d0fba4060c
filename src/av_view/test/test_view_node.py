"""The node between a rig and its viewers: what it subscribes to and when, and what it asks the rig for."""

from __future__ import annotations

import gc
import json
import socket
import subprocess
import threading
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.subscription import Subscription
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from view_messages import seen
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import MarkerArray

pytest.importorskip('websockets.asyncio.server', reason='needs websockets 13')
from websockets.sync.client import connect

from av_common.node import Executor
from av_common.qos import RESULT
from av_common.stamps import to_stamp
from av_interfaces.msg import AudioFrame, AzimuthPosterior, Bearing, FusionState, Track, TrackArray, WorldTrackArray
from av_interfaces.srv import SelectTarget
from av_view.nodes import view_node
from av_view.nodes.view_node import ViewNode
from av_vision.messages import image_message

pytestmark = pytest.mark.system
LONG_S = 20.0


class Rig:
    """A rig that publishes pictures and bearings, offers ~/enable, and is looked at by a view_node of the same process."""

    def __init__(self, *parameters):
        view_node.LINGER_S = 0.5
        values = ('port:=0', *parameters)
        rclpy.init(args=['--ros-args', *(word for one in values for word in ('-p', one))])
        self.node = rclpy.create_node('pointing_node')
        self.enabled = []
        self.node.create_service(SetBool, '~/enable', self.on_enable)
        self.bearings = self.node.create_publisher(Bearing, 'target/bearing', RESULT)
        self.images = self.node.create_publisher(type(image_message(Header(), np.zeros((2, 2, 3), np.uint8))),
                                                 'camera/image_raw', RESULT)
        self.diagnostics = self.node.create_publisher(DiagnosticArray, '/diagnostics', RESULT)
        self.fusion, self.asked = rclpy.create_node('fusion_node'), []
        self.fusion.create_service(SelectTarget, '~/select', self.on_select)
        self.fusion.create_service(Trigger, '~/request_rotation', self.on_turn)
        self.posteriors = self.fusion.create_publisher(AzimuthPosterior, 'fusion/posterior', RESULT)
        self.worlds = self.fusion.create_publisher(WorldTrackArray, '/anywhere/tracks', RESULT)
        self.node.create_timer(0.05, self.publish)
        self.view = ViewNode()
        self.executor = Executor()
        for node in (self.node, self.fusion, self.view):
            self.executor.add_node(node)
        self.azimuth, self.stamps = 0.5, []
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.spin)
        self.thread.start()
        assert wait_for(lambda: self.view.is_active)

    def spin(self):
        while not self.ending.is_set():
            self.executor.spin_once(timeout_sec=0.1)

    def on_enable(self, request, response):
        self.enabled.append(request.data)
        response.success, response.message = True, 'commands move the rig'
        return response

    def on_select(self, request, response):
        self.asked.append(request.id)
        response.success = request.id in (0, 3)
        response.message = '' if response.success else f'target {request.id} is not tracked'
        return response

    def on_turn(self, _request, response):
        self.asked.append('turn')
        response.success, response.message = True, 'a rotation is requested'
        return response

    def publish(self):
        now = self.view.now()
        self.posteriors.publish(AzimuthPosterior(header=Header(stamp=to_stamp(now)), probability=[0.0, 0.5]))
        self.worlds.publish(WorldTrackArray(header=Header(stamp=to_stamp(now))))
        self.bearings.publish(Bearing(header=Header(stamp=to_stamp(now)), state=Bearing.STATE_VISUAL_ACTIVE,
                                      azimuth=self.azimuth, azimuth_variance=0.01, measured=to_stamp(now)))
        self.stamps.append(now)
        self.images.publish(image_message(Header(stamp=to_stamp(now)), np.full((480, 960, 3), 90, np.uint8)))
        self.diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name='pointing_node: status', message='active')]))

    @contextmanager
    def viewer(self, control=False):
        offered = ['rig', self.view._access.token] if control else None
        with connect(f'ws://127.0.0.1:{self.view.server.port}/feed', max_size=None, proxy=None, subprotocols=offered) as viewer:
            viewer.send('{"do": "watch"}')
            yield viewer

    def topics(self):
        return {one.topic_name for one in self.view.entities() if isinstance(one, Subscription)}

    def close(self):
        self.ending.set()
        self.thread.join()
        self.view.close()
        self.view.destroy_node()
        self.node.destroy_node()
        self.fusion.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()
        gc.collect()    # what is left of it would stay on the graph of the next test


@pytest.fixture
def rig(request):
    rig = Rig(*getattr(request, 'param', ('view_control:=true',)))
    yield rig
    rig.close()


def wait_for(condition):
    deadline = time.monotonic() + LONG_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)
    return condition()


def receive(viewer, wanted):
    """The next message for which `wanted` is true, while asking for more."""
    deadline = time.monotonic() + LONG_S
    while time.monotonic() < deadline:
        message = viewer.recv(timeout=LONG_S)
        content = message if isinstance(message, bytes) else json.loads(message)
        if isinstance(content, dict) and content['type'] == 'state':
            viewer.send('{"do": "next"}')
        if wanted(content):
            return content
    raise AssertionError('no such message')


def ask(viewer, **request):
    viewer.send(json.dumps(request))
    return receive(viewer, lambda content: isinstance(content, dict) and content['type'] == 'answer')


def is_rigs(content):
    return isinstance(content, dict) and content['type'] == 'rigs'


def is_health(content):
    return isinstance(content, dict) and content['type'] == 'health' and {'enable', 'select', 'turn'} <= set(content['offers'])


def is_state(content):
    return isinstance(content, dict) and content['type'] == 'state' and content['state']['bearing']


def test_it_subscribes_only_while_somebody_looks(rig):
    assert rig.topics() == {'/diagnostics'}
    with rig.viewer() as viewer:
        state = receive(viewer, is_state)
        assert state['state']['bearing']['azimuth'] == pytest.approx(np.degrees(0.5), abs=0.1)
        picture = receive(viewer, lambda content: isinstance(content, bytes))
        image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (320, 640, 3)  # reduced
        health = receive(viewer, lambda content: isinstance(content, dict) and content['type'] == 'health')
        assert '/pointing_node' in [entry['node'] for entry in health['nodes']] and 'enable' in health['offers']
    assert wait_for(lambda: rig.topics() == {'/diagnostics'})
    with rig.viewer() as viewer:
        assert receive(viewer, is_state)


def test_the_page_opens_on_a_rig_that_exists(rig):
    """Its own while there is one; else another one, which its own subscriptions do not keep alive."""
    left = rig.node.create_publisher(Bearing, '/left/target/bearing', RESULT)
    with rig.viewer() as viewer:
        assert receive(viewer, lambda content: is_rigs(content) and len(content['rigs']) == 2)['rig'] == ''
        rig.node.destroy_publisher(rig.bearings)
        rig.bearings = left
        moved = receive(viewer, lambda content: is_rigs(content) and content['rig'] == '/left')
        assert moved['rigs'] == ['/left']
        assert receive(viewer, is_state)['state']['bearing']['azimuth'] == pytest.approx(np.degrees(0.5), abs=0.1)


def test_the_page_follows_the_topics(rig):
    with rig.viewer() as viewer:
        for azimuth in (-1.0, 2.0):
            rig.azimuth = azimuth
            receive(viewer, lambda content, azimuth=azimuth: is_state(content) and content['state']['bearing']['azimuth']
                    == pytest.approx(np.degrees(azimuth), abs=0.1))


def test_markers_are_made_while_somebody_subscribes(rig):
    received = []
    subscription = rig.node.create_subscription(MarkerArray, 'view/markers', received.append, RESULT)
    assert wait_for(lambda: any(marker.ns == 'bearing' for array in received for marker in array.markers))
    rig.node.destroy_subscription(subscription)
    assert wait_for(lambda: rig.topics() == {'/diagnostics'})


def test_enable_reaches_the_rig_with_the_token_only(rig):
    with rig.viewer() as viewer:
        assert ask(viewer, do='enable', value=True)['done'] is False and rig.enabled == []
    with rig.viewer(control=True) as viewer:
        receive(viewer, is_health)
        given = ask(viewer, do='enable', value=True)
        assert given['done'] and given['words'] == 'commands move the rig' and rig.enabled == [True]
        assert not ask(viewer, do='enable', value='yes')['done'] and rig.enabled == [True]
        assert 'not offered' in ask(viewer, do='record', value=True)['words']
        assert 'expected' in ask(viewer, do='arm')['words']


def test_a_target_is_selected_and_a_turn_is_asked_for_with_the_token_only(rig):
    with rig.viewer() as viewer:
        for request in ({'do': 'select', 'value': 3}, {'do': 'turn'}):
            assert ask(viewer, **request)['done'] is False and rig.asked == []
    with rig.viewer(control=True) as viewer:
        receive(viewer, is_health)
        assert ask(viewer, do='select', value=3)['done'] and rig.asked == [3]
        assert ask(viewer, do='select', value=4)['words'] == 'target 4 is not tracked'
        assert ask(viewer, do='turn')['words'] == 'a rotation is requested' and rig.asked[-1] == 'turn'
        for value in (-1, 2**32, 1.5, '3', None, True, [3]):
            assert 'expected' in ask(viewer, do='select', value=value)['words']


def test_marks_are_published_and_shown(rig):
    heard = []
    rig.node.create_subscription(Log, 'marks', heard.append, RESULT)
    with rig.viewer(control=True) as viewer, rig.viewer() as guest:
        receive(viewer, is_state)
        assert wait_for(lambda: rig.node.count_publishers('/marks')), rig.view.refused.counts
        assert ask(guest, do='mark', value='no')['done'] is False
        assert ask(viewer, do='mark', value='  gust ' + 'x' * 1000)['done']
        assert wait_for(lambda: heard) and heard[0].msg.startswith('gust x') and len(heard) == 1
        assert abs(heard[0].stamp.sec - time.time()) < LONG_S
        state = receive(viewer, lambda content: is_state(content) and content['state']['marks'])
        assert state['state']['marks'][0][1].startswith('gust')


def test_the_posterior_and_the_map_reach_the_page(rig):
    with rig.viewer() as viewer:
        state = receive(viewer, lambda content: is_state(content) and content['state']['posterior']
                        and content['state']['world'])['state']
        assert state['posterior'] == [0.0, 1.0] and state['world'] == {'tracks': [], 'rigs': []}


def test_ten_megabyte_messages_are_shortened_or_refused(rig):
    """Each of them comes while somebody looks; what viewers are sent stays small, and goes on."""
    header = Header(stamp=to_stamp(rig.view.now()))
    large = {'marks': Log(stamp=header.stamp, msg='x' * 10_000_000),
             'fusion/posterior': AzimuthPosterior(header=header, probability=[0.1] * 2_500_000),
             'fusion/state': FusionState(header=header, reason='x' * 10_000_000),
             'targets': TrackArray(header=header, tracks=[Track(id=1, class_id='x' * 10_000_000)]),
             'audio/frames': AudioFrame(header=header, sample_rate=48_000, channels=2, samples=[0.1] * 2_500_000),
             'camera/image_raw': image_message(header, np.zeros((1500, 2500, 3), np.uint8)),
             '/diagnostics': DiagnosticArray(status=[DiagnosticStatus(name='fusion_node: status', message='x' * 10_000_000)])}
    publishers = [(rig.fusion.create_publisher(type(message), topic, RESULT), message) for topic, message in large.items()]
    with rig.viewer() as viewer:
        receive(viewer, is_state)
        for publisher, message in publishers:
            publisher.publish(message)
        assert wait_for(lambda: {'marks', 'fusion/state', 'targets', '/diagnostics'} <= set(rig.view.refused.counts))
        rig.azimuth = -2.0
        state = receive(viewer, lambda content: is_state(content) and content['state']['bearing']['azimuth'] < 0.0)
        assert len(json.dumps(state)) < 100_000


def test_bags_are_listed_and_only_those_of_the_folder_are_opened(tmp_path):
    (tmp_path / 'bags').mkdir()
    for name in ('bags/walk.mcap', 'secret.mcap'):
        (tmp_path / name).touch()
    rig = Rig('view_control:=true', f'bags:={tmp_path}/bags')
    player = rclpy.create_node('player_node')
    player.declare_parameter('bag', '')
    rig.executor.add_node(player)
    try:
        with rig.viewer(control=True) as viewer, rig.viewer() as guest:
            receive(viewer, is_state)
            assert ask(guest, do='bags')['done'] is False
            assert ask(viewer, do='bags')['bags'] == ['walk.mcap']
            for name in ('../secret.mcap', f'{tmp_path}/secret.mcap', None, ''):
                assert 'no bag' in ask(viewer, do='open', value=name)['words']
            assert wait_for(lambda: ask(viewer, do='open', value='walk.mcap')['done'])
            assert player.get_parameter('bag').value == str(tmp_path / 'bags' / 'walk.mcap')
    finally:
        rig.close()
        player.destroy_node()


def test_what_people_tune_is_shown_and_set_within_its_bounds_and_nothing_else(rig):
    bounds = rclpy.node.FloatingPointRange(from_value=1.0, to_value=360.0)
    rig.node.declare_parameter('yaw_rate_deg', 45.0, rclpy.node.ParameterDescriptor(
        description='how fast', floating_point_range=[bounds]))
    rig.node.declare_parameter('other', 1.0)
    rig.fusion.declare_parameter('tau', 0.5)
    rig.fusion.declare_parameter('confirm_threshold', 0.95, rclpy.node.ParameterDescriptor(read_only=True))
    with rig.viewer(control=True) as viewer:
        assert wait_for(lambda: len(ask(viewer, do='tuning').get('parameters', ())) == 2)
        found = {one['name']: one for one in ask(viewer, do='tuning')['parameters']}
        assert set(found) == {'tau', 'yaw_rate_deg'}
        assert found['yaw_rate_deg'] == {'node': 'pointing_node', 'name': 'yaw_rate_deg', 'value': 45.0, 'bounds': [1.0, 360.0],
                                         'words': 'how fast'}
        assert ask(viewer, do='set', node='pointing_node', name='yaw_rate_deg', value=20)['done']
        assert rig.node.get_parameter('yaw_rate_deg').value == 20.0
        for value in (400.0, 'much', None, [1.0], 10**400):
            assert not ask(viewer, do='set', node='pointing_node', name='yaw_rate_deg', value=value)['done']
        for node, name in (('pointing_node', 'other'), ('/other/pointing_node', 'yaw_rate_deg'), ('', ''), (7, 7)):
            assert 'not set here' in ask(viewer, do='set', node=node, name=name, value=2.0)['words']
        assert rig.node.get_parameter('yaw_rate_deg').value == 20.0 and rig.node.get_parameter('other').value == 1.0


def test_boxes_come_with_the_picture_they_were_found_in(rig):
    """A detector that is 0.3 s late: the picture waits for it. One that has ended: the newest picture, without boxes."""
    detections = rig.fusion.create_publisher(Detection2DArray, 'detections', RESULT)
    stamps, late = [], 0.3
    rig.stamps = stamps

    def detect():
        if stamps and rig.view.now() - stamps[0] >= late:
            message = seen(100.0 + stamps[0] % 500, 100.0)
            message.header.stamp = to_stamp(stamps.pop(0))
            detections.publish(message)
    timer = rig.fusion.create_timer(0.02, detect)
    with rig.viewer() as viewer:
        for _ in range(20):
            state = receive(viewer, lambda content: is_state(content) and (content['state']['picture'] or {}).get('boxes'))
            picture, now = state['state']['picture'], state['state']['time']
            taken = picture['boxes'][0]['x'] * 960 + 20.0 - 100.0  # modulo 500, by the box
            assert abs((now - picture['age'] - taken + 250.0) % 500 - 250.0) < 0.1
        rig.fusion.destroy_timer(timer)
        assert receive(viewer, lambda content: is_state(content) and content['state']['picture']
                       and not content['state']['picture']['detected'])['state']['picture']['boxes'] == []


@pytest.mark.parametrize('rig', [()], indirect=True)
def test_by_default_it_is_read_only(rig):
    with rig.viewer() as viewer:
        assert 'read-only' in ask(viewer, do='enable', value=True)['words'] and rig.enabled == []


def test_a_private_address_that_cannot_be_written_leaves_no_server_behind(tmp_path, monkeypatch):
    (tmp_path / 'home').touch()
    with socket.create_server(('127.0.0.1', 0)) as free:
        port = free.getsockname()[1]
    rclpy.init(args=['--ros-args', '-p', f'port:={port}', '-p', 'view_control:=true', '-p', 'autostart:=false'])
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'home'))
    node = ViewNode()
    node.configure()
    for _ in range(2):
        with pytest.raises(FileExistsError):
            node.activate()
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_port_in_use_ends_the_process_and_names_the_argument():
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        ended = subprocess.run(['ros2', 'run', 'av_view', 'view_node', '--ros-args', '-p', f'port:={port}'],
                               capture_output=True, text=True, timeout=20.0, check=False)
    assert f'port {port}' in ended.stderr and f'-p port:={port + 1}' in ended.stderr
