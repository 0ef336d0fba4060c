"""The stage without node or middleware: messages and times of arrival in, messages out."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import Bearing, PointingCommand
from av_px4.stage import MODE_MESSAGES, MOTORS_TOPIC, NO_MODE, ODOMETRY_TOPIC, STATE_TOPIC, Px4Stage

HOLD, OFFBOARD = 4, 14
LEVEL = [1.0, 0.0, 0.0, 0.0]


class Message(SimpleNamespace):
    """A message of px4_msgs: whatever fields it is given."""


MESSAGES = SimpleNamespace(
    VehicleCommand=Message, OffboardControlMode=Message, TrajectorySetpoint=Message, VehicleControlMode=Message,
    UnregisterExtComponent=lambda **fields: Message(name=[0] * 25, **fields),
    RegisterExtComponentRequest=lambda **fields: Message(name=[0] * 25, **fields), ArmingCheckReply=Message)


def parameters(**overrides):
    """Those of px4_node."""
    return node_parameters('av_px4', 'px4_node', overrides=overrides)


class Rig:
    """A stage, a vehicle that hovers and a target; `run` advances both by steps of 20 ms."""

    def __init__(self, gimbal=None, **changes):
        self.stage = Px4Stage(parameters(**{'offboard': True, 'external_mode': False} | changes), MESSAGES, gimbal)
        self.time, self.sent, self.nav_state, self.silent, self.offset, self.epoch = 100.0, [], HOLD, set(), 0.0, 1.7e9
        self.attitude, self.armed, self.failsafe, self.activated = LEVEL, 2, False, 0
        self.place, self.resets, self.shift, self.valid = [0.0, 0.0, -2.0], (0, 0), (0.0, 0.0, 0.0), True
        self.stage.start(self.now)

    @property
    def now(self):
        return Instant(self.time, self.epoch + self.time)

    def hand_over(self):
        """The pilot selects OFFBOARD once the rig has offered it."""
        self.run(1.0)
        self.nav_state = OFFBOARD

    def run(self, seconds, frame='', **command):
        for step in range(round(seconds * 50)):
            self.time += 0.02
            self.vehicle(step)
            if 'rig' not in self.silent:
                stamp = to_stamp(self.now.ros)
                bearing, pointing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE), PointingCommand(
                    **{'mode': PointingCommand.MODE_TRACK, 'move_gimbal': True, 'move_body': True} | command)
                bearing.header.stamp = bearing.measured = pointing.header.stamp = stamp
                pointing.header.frame_id = frame
                self.take('bearing', bearing)
                self.take('command', pointing)
            self.sent += [(self.time, *out) for out in self.stage.on_time(self.now)]

    def vehicle(self, step):
        stamp = round(1e6 * (self.time + self.offset))
        self.take('vehicle_odometry', Message(
            timestamp=stamp, timestamp_sample=stamp, position=[0.0, 0.0, -2.0], velocity=[0.0] * 3, angular_velocity=[0.0] * 3,
            pose_frame=1, velocity_frame=1, q=self.attitude, reset_counter=0))
        x, y, z = self.place
        self.take('vehicle_local_position', Message(
            xy_valid=self.valid, z_valid=True, x=x, y=y, z=z, xy_reset_counter=self.resets[0], z_reset_counter=self.resets[1],
            delta_xy=self.shift[:2], delta_z=self.shift[2]))
        if step % 25 == 0:
            self.take('vehicle_status', Message(
                nav_state=self.nav_state, arming_state=self.armed, failsafe=self.failsafe, system_id=7,
                nav_state_user_intention=self.nav_state, nav_state_timestamp=self.activated))

    def take(self, name, message):
        if name not in self.silent:
            self.sent += [(self.time, *out) for out in getattr(self.stage, f'on_{name}')(message, self.now)]

    def point(self, seconds, frame='', **command):
        """Run, and acknowledge each command."""
        for _ in range(round(seconds * 50)):
            self.run(0.02, frame, **command)
            self.acknowledge()

    def acknowledge(self):
        commands = [message for _, topic, message in self.sent if topic == 'vehicle_command']
        self.take('vehicle_command_ack', Message(target_system=7, target_component=191, command=commands[-1].command, result=0))

    def of(self, topic, since=0.0):
        return [message for time, name, message in self.sent if name == topic and time >= since]


def test_nothing_turns_the_body_before_the_pilot_hands_over_and_then_it_turns_to_the_left():
    rig = Rig()
    rig.run(1.0, yaw_rate=0.3)
    assert not rig.of('trajectory_setpoint') and len(rig.of('offboard_control_mode')) >= 40
    rig.nav_state = OFFBOARD
    rig.run(1.0, yaw_rate=0.3)
    setpoint = rig.of('trajectory_setpoint')[-1]
    assert setpoint.yawspeed == pytest.approx(-0.3) and setpoint.position == [0.0, 0.0, -2.0] and math.isnan(setpoint.yaw)


@pytest.mark.parametrize('silent', ['rig', 'bearing', 'command', 'vehicle_odometry', 'vehicle_local_position'])
def test_without_an_input_the_body_stands_still(silent):
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    rig.silent = {silent}
    rig.run(1.0, yaw_rate=0.3)
    assert all(math.isnan(setpoint.yawspeed) for setpoint in rig.of('trajectory_setpoint', since=rig.time - 0.1))


def test_commands_of_two_publishers_turn_nothing():
    """Which is genuine cannot be seen from what they say."""
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    rig.stage.contested = {'pointing/command': ['/pointing_node', '/other']}
    rig.run(1.0, yaw_rate=0.3)
    assert all(math.isnan(setpoint.yawspeed) for setpoint in rig.of('trajectory_setpoint', since=rig.time - 0.5))
    rig.stage.contested = {}
    rig.run(1.0, yaw_rate=0.3)
    assert rig.of('trajectory_setpoint')[-1].yawspeed == pytest.approx(-0.3)


def test_bearings_of_two_publishers_are_no_new_measurement():
    """All state new measurements."""
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    rig.silent = {'rig'}
    rig.stage.contested = {'target/bearing': ['/fusion_node', '/other']}
    for _ in range(50):
        rig.run(0.02)
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE)
        bearing.header.stamp = to_stamp(rig.now.ros)
        bearing.measured = to_stamp(rig.now.ros)
        command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3)
        command.header.stamp = to_stamp(rig.now.ros)
        rig.take('bearing', bearing)
        rig.take('command', command)
    assert rig.stage.decision.reason == 'no fresh measurement'


@pytest.mark.parametrize('begin', [1.7e9, 0.1])
def test_a_bearing_without_a_measurement_turns_nothing(begin):
    """Its `measured` is 0; not even when simulated time has just begun."""
    rig = Rig()
    rig.epoch, rig.silent = begin - rig.time, {'rig'}
    for _ in range(5):
        rig.run(0.02)
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE)
        bearing.header.stamp = to_stamp(rig.now.ros)
        rig.take('bearing', bearing)
        assert math.isinf(rig.stage._guard_inputs().bearing_age)


@pytest.mark.parametrize('frozen', ['measured', 'command'])
def test_what_is_published_again_and_again_turns_nothing_after_0_3_s(frozen):
    """Predictions with moving stamps, and one command repeated for ever."""
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    last = to_stamp(rig.now.ros)
    rig.silent, began = {'rig'}, rig.time
    for _ in range(100):
        rig.run(0.02)
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE, measured=to_stamp(rig.now.ros))
        command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3)
        bearing.header.stamp = command.header.stamp = to_stamp(rig.now.ros)
        if frozen == 'measured':
            bearing.measured = last
        else:
            command.header.stamp = last
        rig.take('bearing', bearing)
        rig.take('command', command)
    moving = [time - began for time, topic, message in rig.sent
              if topic == 'trajectory_setpoint' and not math.isnan(message.yawspeed)]
    assert moving[-1] <= 0.3 + 1e-6


def test_a_command_that_waited_in_a_queue_is_not_fresh():
    rig = Rig()
    rig.hand_over()
    rig.run(1.0)
    late = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3)
    late.header.stamp = to_stamp(rig.now.ros - 0.3)
    assert not rig.stage.on_command(late, rig.now)


def test_a_command_that_comes_again_does_not_undo_the_end_of_pointing():
    """As of a network that sends a message twice: turned on, ended, and the first one again."""
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    rig.silent = {'rig'}
    turn, end = (PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=moves, yaw_rate=0.3) for moves in (True, False))
    turn.header.stamp, end.header.stamp = to_stamp(rig.now.ros + 0.01), to_stamp(rig.now.ros + 0.02)
    for message in (turn, end, turn):
        rig.run(0.02)
        rig.take('command', message)
    assert rig.stage.decision.reason == 'the body is not to move'


def test_a_process_that_stood_still_sends_no_last_setpoint():
    """The pilot may have taken over meanwhile, and PX4 1.16 obeys setpoints in any mode."""
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    rig.time += 5.0
    assert not any(topic == 'trajectory_setpoint' for topic, _ in rig.stage.stop(rig.now))


def test_the_last_messages_end_the_turn_and_say_so():
    rig = Rig()
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.3)
    last = dict(rig.stage.stop(rig.now))
    assert math.isnan(last['trajectory_setpoint'].yawspeed)
    assert {pair.key: pair.value for pair in last[STATE_TOPIC].values}['body'] == 'not started'
    assert not any(topic == 'trajectory_setpoint' for topic, _ in rig.stage.stop(rig.now))


def test_the_gimbal_is_claimed_pointed_once_it_is_acknowledged_and_given_back():
    rig = Rig()
    rig.run(0.1, pan=0.5)
    claim = rig.of('vehicle_command')
    assert [message.command for message in claim] == [1001] and claim[0].source_component == 191
    rig.acknowledge()
    rig.run(0.5, pan=0.5)
    assert rig.stage.gimbal.state == 'owned' and rig.of('vehicle_command')[-1].param2 < 0.0    # yaw is to the right
    last = [out for out in rig.stage.stop(rig.now) if out.topic == 'vehicle_command']
    assert [message.param1 for _, message in last] == [-3.0]


@pytest.mark.parametrize('silent', ['bearing', ''])
@pytest.mark.parametrize(('mode', 'moves'), [(PointingCommand.MODE_LOOK, True), (PointingCommand.MODE_HOLD, False),
                                            (PointingCommand.MODE_SEARCH, False)])
def test_the_gimbal_looks_also_without_a_target_and_stands_still_in_hold_and_search(mode, moves, silent):
    """Pointing is as careful with a cue as with a bearing; after a claim the gimbal may be elsewhere than in the command."""
    rig = Rig()
    rig.silent = {silent}
    rig.run(0.1, mode=mode)
    rig.acknowledge()
    rig.run(0.5, mode=mode, pan=0.5)
    assert any(message.command == 1000 for message in rig.of('vehicle_command')) == moves
    assert any(message.command == 1000 and message.param2 < -10.0 for message in rig.of('vehicle_command')) == moves


def test_without_a_target_the_gimbal_moves_no_further_than_the_newest_command():
    """As it returns with on_stale: neutral."""
    rig = Rig()
    rig.silent = {'bearing'}

    def look(pans):
        for pan in pans:
            rig.run(0.02, mode=PointingCommand.MODE_LOOK, pan=pan)
            rig.acknowledge()
    look([0.5] * 50)
    assert rig.of('vehicle_command')[-1].param2 == pytest.approx(-math.degrees(0.5), abs=0.1)
    look([0.4, 0.3])
    rig.silent = {'rig'}
    rig.run(0.5)
    ended = rig.of('vehicle_command')[-1].param2
    assert -math.degrees(0.5) < ended < -math.degrees(0.3) + 0.1
    rig.run(0.5)
    assert rig.of('vehicle_command')[-1].param2 == ended
    rig.silent = {'bearing'}
    look([0.0] * 50)
    assert rig.of('vehicle_command')[-1].param2 == pytest.approx(0.0, abs=0.1)


def test_commands_in_the_bodys_frame_are_levelled_by_the_newest_attitude():
    rig = Rig()
    rig.run(0.1)
    rig.acknowledge()
    rig.attitude = [math.cos(0.1), 0.0, math.sin(0.1), 0.0]
    for _ in range(50):
        rig.run(0.02)
        rig.acknowledge()
    assert rig.of('vehicle_command')[-1].param1 == pytest.approx(math.degrees(0.2), abs=0.1)


def test_the_pose_is_the_odometry_of_the_rig():
    rig = Rig()
    rig.run(0.4)
    odometry = rig.of(ODOMETRY_TOPIC)[-1]
    assert odometry.header.frame_id == 'odom' and odometry.pose.pose.position.z == pytest.approx(2.0)


def test_when_px4_sets_its_clock_no_pose_gets_a_wrong_stamp():
    rig = Rig()
    rig.run(2.0)
    rig.offset = 5000.0    # time synchronisation regained, or lost
    rig.run(1.5)
    late = [time for time, topic, message in rig.sent
            if topic == ODOMETRY_TOPIC and abs(to_seconds(message.header.stamp) - 1.7e9 - time) > 0.01]
    assert not late and rig.stage.clock.restarts == 1
    assert rig.of(ODOMETRY_TOPIC, since=rig.time - 0.1)


def test_the_state_is_sent_when_it_changes():
    rig = Rig()
    rig.run(1.0)
    before = len(rig.of(STATE_TOPIC))
    rig.run(1.0)
    assert len(rig.of(STATE_TOPIC)) == before
    rig.nav_state = OFFBOARD
    rig.run(1.0)
    values = {pair.key: pair.value for pair in rig.of(STATE_TOPIC)[-1].values}
    assert values['nav_state'] == '14' and values['armed'] == 'True'


@pytest.mark.parametrize(('silent', 'changes', 'why'), [
    ('vehicle_status', {}, 'no fresh vehicle_status'), ('vehicle_odometry', {}, 'no fresh attitude'),
    ('vehicle_local_position', {}, 'no fresh position'), ('', {'turn_body': False}, 'turn_body is false'), ('', {}, ''),
    ('rig', {}, 'pointing is not enabled')])
def test_the_state_says_why_offboard_is_not_offered(silent, changes, why):
    rig = Rig(**changes)
    rig.silent = {silent}
    rig.run(1.0)
    state = rig.of(STATE_TOPIC)[-1]
    values = {pair.key: pair.value for pair in state.values}
    assert (values['offboard offered'], values['offboard withheld']) == (str(not why), why)
    assert bool(rig.of('offboard_control_mode', since=rig.time - 0.1)) == (not why)
    assert state.message.endswith(f'OFFBOARD is not offered: {why}' if why else 'nav_state 4)')


def test_by_default_offboard_is_not_spoken_of():
    rig = Rig(offboard=False)
    rig.run(1.0)
    assert 'OFFBOARD' not in rig.of(STATE_TOPIC)[-1].message and not rig.of('offboard_control_mode')


def test_the_state_says_that_px4_reads_no_heartbeat():
    rig = Rig()
    rig.stage.unused.add('offboard_control_mode')
    rig.run(1.0)
    assert 'PX4 does not read offboard_control_mode' in rig.of(STATE_TOPIC)[-1].message


def test_a_message_of_another_firmware_is_refused():
    for nav_state, arming_state in ((200, 2), (4, 6)):
        with pytest.raises(ValueError, match='px4_msgs'):
            Rig().stage.on_vehicle_status(Message(nav_state=nav_state, arming_state=arming_state), Instant(0.0, 0.0))


def test_an_external_mode_needs_messages_that_the_firmware_has():
    old = SimpleNamespace(**{name: kind for name, kind in vars(MESSAGES).items() if name not in MODE_MESSAGES})
    assert Px4Stage(parameters(), old).mode_withheld == NO_MODE
    assert Px4Stage(parameters(), MESSAGES).mode_withheld == 'not registered yet'


def esc(rpm, online):
    return Message(esc_count=len(rpm), esc_online_flags=online, esc=[Message(esc_rpm=speed) for speed in rpm] + [Message()] * 2)


def test_the_motors_speeds_are_those_that_are_measured_and_else_those_that_are_commanded():
    rig = Rig(**{'motors.full_rpm': 1000.0 * 60.0 / math.tau})
    commands = Message(control=[0.0, 0.5, 1.0, math.nan, math.nan])
    rig.take('actuator_motors', commands)
    assert list(rig.of(MOTORS_TOPIC)[-1].data) == [0.0, 500.0, 1000.0]
    rig.take('esc_status', esc([6000, -6000, 3000, 2_000_000_000], 0b1011))
    speeds = list(rig.of(MOTORS_TOPIC)[-1].data)
    assert speeds[:2] == pytest.approx([200.0 * math.pi] * 2) and all(map(math.isnan, speeds[2:]))
    rig.run(0.2)
    rig.take('actuator_motors', commands)
    assert len(rig.of(MOTORS_TOPIC)) == 2
    rig.run(0.5)
    rig.take('actuator_motors', commands)
    assert len(rig.of(MOTORS_TOPIC)) == 3


def test_controllers_without_telemetry_do_not_hide_what_is_commanded():
    """PX4 sends esc_status all the same, with none of them online."""
    rig = Rig(**{'motors.full_rpm': 6000.0})
    for _ in range(20):
        rig.run(0.02)
        rig.take('esc_status', esc([0] * 4, 0))
        rig.take('actuator_motors', Message(control=[0.5] * 4))
    sent = rig.of(MOTORS_TOPIC)
    assert len(sent) == 20 and all(list(message.data) == pytest.approx([100.0 * math.pi] * 4) for message in sent)


@pytest.mark.parametrize('armed', [0, 1, 3, 4, 5])
def test_on_the_ground_the_gimbal_points_and_nothing_turns(armed):
    """PX4 1.14 has states of arming that later ones do not: initial, in error, shutting down."""
    rig = Rig()
    rig.armed = armed
    rig.hand_over()
    rig.point(1.0, pan=0.5, yaw_rate=0.3)
    assert rig.of('vehicle_command')[-1].param2 == pytest.approx(-math.degrees(0.5), abs=0.1)
    assert rig.stage.decision.reason == 'not armed'
    assert all(math.isnan(setpoint.yawspeed) for setpoint in rig.of('trajectory_setpoint'))


def test_without_the_speed_at_full_command_commands_tell_nothing():
    rig = Rig()
    rig.take('actuator_motors', Message(control=[0.5] * 4))
    assert not rig.of(MOTORS_TOPIC)
