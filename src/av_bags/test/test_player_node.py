"""The player holds, continues, and goes to another time of the bag."""

from __future__ import annotations

import time

import pytest
import rclpy
from bag_messages import EPOCH, bag, cdr, flight, odometry, static_frames
from mcap.writer import Writer as McapWriter
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from av_bags.nodes.player_node import PlayerNode
from av_common.node import Executor

pytestmark = pytest.mark.system
LONG_S = 30.0


class Replay:
    """A player and a node that listens to /clock."""

    def __init__(self, bag, **values):
        rclpy.init()
        values = {'bag': str(bag), 'only': 'all', **values}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.player = PlayerNode(parameter_overrides=overrides)
        self.listener = rclpy.create_node('listener')
        self.times = []
        self.listener.create_subscription(Clock, '/clock', self.on_clock, 10)
        self.executor = Executor()
        self.executor.add_node(self.player)
        self.executor.add_node(self.listener)
        self.spin_until(lambda: len(set(self.times)) > 5)

    def on_clock(self, message):
        self.times.append(message.clock.sec + 1e-9 * message.clock.nanosec)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def spin_until(self, condition):
        end = time.monotonic() + LONG_S
        while not condition():
            assert time.monotonic() < end, 'the condition was not met in time'
            self.executor.spin_once(timeout_sec=0.02)

    def pause(self, wanted):
        client = self.listener.create_client(SetBool, '/player_node/pause')
        self.spin_until(client.service_is_ready)
        answer = client.call_async(SetBool.Request(data=wanted))
        self.spin_until(answer.done)
        assert answer.result().success

    def set(self, name, value):
        return self.player.set_parameters([Parameter(name, value=value)])[0].successful

    def go_to(self, position):
        return self.set('position', position)

    def close(self):
        self.player.close()
        for node in (self.player, self.listener):
            node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def replay(tmp_path):
    flight(tmp_path / 'flight.mcap', duration=20.0)
    replay = Replay(tmp_path / 'flight.mcap')
    yield replay
    replay.close()


def test_time_stands_still_while_paused(replay):
    replay.pause(True)
    replay.spin(0.3)
    held, count = replay.times[-1], len(replay.times)
    replay.spin(0.5)
    assert len(replay.times) == count
    replay.pause(False)
    replay.spin_until(lambda: len(replay.times) > count + 5)
    assert held <= replay.times[count] < held + 0.4  # goes on where it held


def test_it_goes_to_another_time_forwards_backwards_and_paused(replay):
    begin = replay.times[0]
    for position in (12.0, 3.0):
        assert replay.go_to(position)
        replay.spin_until(lambda position=position: position <= replay.times[-1] - begin < position + 1.5)
    replay.pause(True)
    assert replay.go_to(8.0)
    replay.spin(0.3)
    replay.pause(False)
    replay.spin_until(lambda: 8.0 <= replay.times[-1] - begin < 9.5)
    assert not replay.go_to(100.0)  # beyond the end
    assert not replay.go_to(-1.0)


def test_it_opens_other_bags_of_its_folder_and_waits_at_their_ends(tmp_path):
    folder, elsewhere = tmp_path / 'bags', tmp_path / 'elsewhere'
    folder.mkdir(), elsewhere.mkdir()
    flight(folder / 'first.mcap', duration=20.0)
    flight(folder / 'second.mcap', duration=3.0)
    flight(elsewhere / 'third.mcap', duration=3.0)
    (folder / 'broken.mcap').write_bytes(b'no bag')
    replay = Replay(folder / 'first.mcap', bags=str(folder), rate=4.0)
    try:
        for wrong in (elsewhere / 'third.mcap', folder / '..' / 'elsewhere' / 'third.mcap', folder / 'broken.mcap',
                      folder / 'none.mcap', folder, ''):
            assert not replay.set('bag', str(wrong)), wrong
        begin = replay.times[0]
        assert replay.go_to(15.0)
        replay.spin_until(lambda: replay.times[-1] > begin + 15.0)
        assert replay.set('bag', str(folder / 'second.mcap'))
        for _ in range(2):  # to its end, and again from its beginning
            replay.spin_until(lambda: replay.times[-1] - begin < 1.0)
            replay.spin_until(lambda: 2.5 < replay.times[-1] - begin < 3.5)
            replay.spin(0.5)
            assert not replay.player.done.done()
            assert replay.go_to(0.0)
    finally:
        replay.close()


def test_without_a_folder_no_other_bag_is_opened(replay, tmp_path):
    flight(tmp_path / 'other.mcap', duration=3.0)
    assert not replay.set('bag', str(tmp_path / 'other.mcap'))


def test_a_bag_that_cannot_be_read_does_not_end_the_present_one(tmp_path):
    """Its directions were recorded with a definition that nothing here can read."""
    flight(tmp_path / 'first.mcap', duration=20.0)
    writer = McapWriter(str(tmp_path / 'other.mcap'))
    writer.start('ros2')
    schema = writer.register_schema('av_interfaces/msg/DoaArray', 'ros2msg', b'float64 x')
    channel = writer.register_channel('/doa', 'cdr', schema)
    writer.add_message(channel, 10**18, bytes(20), 10**18)
    writer.finish()
    replay = Replay(tmp_path / 'first.mcap', bags=str(tmp_path))
    try:
        assert not replay.set('bag', str(tmp_path / 'other.mcap'))
        count = len(replay.times)
        replay.spin_until(lambda: len(replay.times) > count + 20)
    finally:
        replay.close()


def test_a_damaged_transform_is_left_out(tmp_path):
    with bag(tmp_path / 'bag') as write:
        write('/tf_static', EPOCH, static_frames(EPOCH))
        for k in range(40):
            write('/odometry', EPOCH + 0.05 * k, odometry(EPOCH + 0.05 * k))
    file, = (tmp_path / 'bag').glob('*.mcap')
    content = bytearray(file.read_bytes())
    place = content.index(cdr(static_frames(EPOCH))) + 4
    content[place:place + 4] = b'\xff' * 4    # the number of its transforms
    file.write_bytes(content)
    replay = Replay(tmp_path / 'bag')
    replay.close()


def test_times_that_no_clock_shows_end_the_replay(tmp_path):
    with bag(tmp_path / 'bag') as write:
        for k in range(100):
            time_s = 2.0**31 - 2.0 + 0.05 * k
            write('/truth/rig', time_s, odometry(1.0))
    replay = Replay(tmp_path / 'bag')
    try:
        replay.spin_until(replay.player.done.done)
        assert replay.player.refused.counts == {'bag': 1}
    finally:
        replay.close()


def test_the_player_leaps_over_what_lies_between_two_clocks(tmp_path):
    """/clock is set as the recorder's was; the years between take no time."""
    with bag(tmp_path / 'jump') as write:
        for k in range(40):
            time_s = (100.0 if k < 20 else EPOCH) + 0.05 * k
            write('/odometry', time_s, odometry(time_s, x=float(k)))
    replay = Replay(tmp_path / 'jump')
    try:
        replay.spin_until(lambda: replay.times[-1] > EPOCH + 1.5)
        first, second = ([time_s for time_s in replay.times if (time_s < EPOCH) is early] for early in (True, False))
        assert 100.9 < max(first) < 102.0 and EPOCH + 0.9 < min(second) < max(second) < EPOCH + 3.0
        assert replay.player._length == pytest.approx(1.9, abs=0.01)
    finally:
        replay.close()
