"""Registration of the mode that a pilot selects, and what ends it; others that steer."""

from __future__ import annotations

import pytest

from av_px4.external_mode import REFUSED_S, SETTLE_S, Configure, ExternalMode, Registration
from av_px4.handover import VehicleStatus, others_that_steer, steers

HOVER = VehicleStatus(4, True, False)


def registered(time=0.0, mode_id=23, version=1):
    """A mode that PX4 took at `time`."""
    mode = ExternalMode()
    mode.start(time - SETTLE_S)
    request = mode.step(time, True)
    mode.on_reply(time, request, 'AV Track', version, True, 2, mode_id)
    for k in range(3 if version == 1 else 0):    # configurations
        assert isinstance(mode.step(time + 0.11 * k, True), Configure)
    return mode


def steps(mode, begin, end, status=HOVER):
    """What is sent, by time."""
    times = [round(begin + 0.1 * k, 1) for k in range(round(10 * (end - begin)))]
    return {time: step for time in times if (step := mode.step(time, True, status))}


class TestExternalMode:
    def test_asks_until_it_is_answered(self):
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        requests = [mode.step(0.1 * k, True) for k in range(110)]
        asked = [request for request in requests if request]
        assert len(asked) == 3 and isinstance(asked[0], int) and len(set(asked)) == 3

    def test_asks_only_while_px4_is_heard_and_for_a_second_before(self):
        """What is sent into a stall would arrive in a crowd, and each of it be granted."""
        mode = ExternalMode()
        mode.start(0.0)
        assert not any(mode.step(0.1 * k, False) for k in range(100))
        asked = [0.1 * k for k in range(100, 120) if mode.step(0.1 * k, True)]
        assert asked == pytest.approx([9.9 + SETTLE_S])

    def test_is_active_while_px4_asks(self):
        mode = registered()
        for k in range(100):
            assert mode.on_question(0.3 * k, True, 1 << 2)
            assert mode.step(0.3 * k + 0.4, True) is None and mode.active_mode(0.3 * k) == 23

    def test_a_client_that_starts_again_keeps_what_is_registered(self):
        """As px4_node does that was deactivated in a failsafe, in which a mode is not ended."""
        mode = registered(version=2)
        mode.start(1.0, mode.registration)
        mode.on_question(1.5, True)
        selected = VehicleStatus(23, True, False)
        assert set(steps(mode, 2.0, 3.0, selected).values()) == {Configure(mode.registration)}

    def test_silence_ends_it_and_it_asks_again_once_the_old_one_is_ended(self):
        mode = registered()
        mode.on_question(1.0, True)
        mode.on_question(5.5, True)
        assert mode.active_mode(7.0) == 23 and mode.active_mode(7.6) is None
        assert mode.step(7.6, False) is None and mode.registration is None
        sent = steps(mode, 7.6, 12.0)
        assert list(sent) == [8.6, 9.6] and sent[8.6] == Registration(2, 23)
        assert isinstance(sent[9.6], int)

    @pytest.mark.parametrize(('status', 'ended'), [
        (VehicleStatus(23, True, False), False), (VehicleStatus(5, True, True, intended=23), False),
        (VehicleStatus(5, True, True, intended=14), True), (VehicleStatus(4, True, False), True),
        (VehicleStatus(23, False, False), True)])
    def test_the_mode_that_the_pilot_has_selected_is_not_ended_in_flight(self, status, ended):
        """PX4 would change to Hold, also out of a failsafe."""
        mode = ExternalMode()
        mode.start(0.0, Registration(0, 23))
        assert bool(steps(mode, 0.0, 10.0, status)) == ended

    def test_what_a_former_process_registered_is_ended_first(self):
        mode, former = ExternalMode(), Registration(0, 24)
        mode.start(0.0, former)
        sent = list(steps(mode, 0.0, 4.5).values())
        assert sent[0] == former and [type(step) for step in sent[1:]] == [int]

    def test_what_is_granted_twice_is_ended_once(self):
        """The reply to the first request was late, and PX4 has granted both."""
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        first, second = mode.step(0.0, True), mode.step(5.0, True)
        mode.on_reply(5.1, first, 'AV Track', 1, True, 0, 23)
        mode.on_reply(5.2, second, 'AV Track', 1, True, 1, 24)
        assert [step for step in steps(mode, 5.3, 8.3).values() if not isinstance(step, Configure)] == [
            Registration(1, 24)]
        assert mode.registration == Registration(0, 23)

    def test_px4_started_anew_and_no_longer_counts_it(self):
        mode = registered()
        for k in range(40):
            can_run = mode.on_question(0.3 * k, True, 0)
        assert can_run is False                        # it still answers, in case that it was only slow
        assert mode.active_mode(12.0) is None

    @pytest.mark.parametrize(('fields', 'problem'), [
        ({'success': False}, 'refused'), ({'api_version': 3}, 'version 3'), ({'mode_id': 5}, 'mode 5'),
        ({'mode_id': -1}, 'mode -1'), ({'mode_id': 14}, 'mode 14')])
    def test_what_is_no_mode_of_ours_is_refused_once(self, fields, problem):
        """And ended, where PX4 has granted it; a version that is not spoken is not asked for again."""
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        reply = {'request_id': mode.step(0.0, True), 'name': 'AV Track', 'api_version': 1, 'success': True,
                 'arming_check_id': 0, 'mode_id': 23, **fields}
        mode.on_reply(0.0, **reply)
        assert problem in mode.problem and mode.active_mode(0.0) is None
        sent = steps(mode, 0.1, 30.0)
        ended = [time for time, step in sent.items() if isinstance(step, Registration)]
        assert len(ended) == reply['success'] and all(time <= 2.1 for time in ended)
        asked = [time for time, step in sent.items() if isinstance(step, int)]
        assert asked == [] if 'api_version' in fields else asked[0] >= REFUSED_S

    def test_a_refusal_while_armed_holds_until_it_is_disarmed(self):
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        mode.on_reply(0.0, mode.step(0.0, True, HOVER), 'AV Track', 1, False, -1, -1, armed=True)
        assert not steps(mode, 0.1, 60.0) and 'armed' in mode.problem
        assert steps(mode, 60.0, 62.0, VehicleStatus(4, False, False))

    @pytest.mark.parametrize('version', [1, 2])
    def test_it_says_what_it_sends_after_each_selection(self, version):
        """Version 2 until PX4 replies, version 1, to which there is no reply, three times."""
        mode = registered(version=version)
        own, confirm = VehicleStatus(23, True, False), version == 2
        for begin in (1.0, 5.0):
            mode.on_question(begin, True)
            assert not steps(mode, begin, begin + 0.5)
            sent = steps(mode, begin + 0.5, begin + 1.5, own)
            assert (len(sent) > 5 if confirm else len(sent) == 3) and {type(step) for step in sent.values()} == {Configure}
            if confirm:
                mode.on_configured(24, 0)
                assert steps(mode, begin + 1.5, begin + 1.7, own)
                mode.on_configured(23, 0)
            assert not steps(mode, begin + 1.7, begin + 2.0, own)

    def test_a_vehicle_that_takes_no_positions_cannot_run_the_mode(self):
        mode = registered(version=2)
        mode.on_configured(23, 2)
        assert mode.on_question(0.5, True) is False and 'refuses position setpoints' in mode.problem

    def test_replies_to_others_are_ignored(self):
        mode = ExternalMode()
        mode.start(-SETTLE_S)
        number = mode.step(0.0, True)
        mode.on_reply(0.0, number + 1, 'AV Track', 1, True, 0, 23)
        mode.on_reply(0.0, number, 'Other', 1, True, 0, 23)
        assert mode.registration is None and mode.on_question(0.0, True) is None


TOPIC = '/fmu/in/trajectory_setpoint'


@pytest.mark.parametrize(('publishers', 'own', 'said'), [
    ([], 0, ''), (['/px4_node'], 1, ''), (['/px4_node', '/px4_node'], 1, f'another /px4_node publishes {TOPIC}'),
    (['/px4_node'], 0, f'another /px4_node publishes {TOPIC}'), (['/follower', '/px4_node'], 1, f'/follower publishes {TOPIC}'),
    (['/_CREATED_BY_BARE_DDS_APP_'], 0, f'a program outside ROS publishes {TOPIC}'),
    (['/b', '/a', '/b'], 0, f'/a publishes {TOPIC}, /b publishes {TOPIC}')])
def test_others_are_named(publishers, own, said):
    assert others_that_steer('/px4_node', {TOPIC: own}, {TOPIC: publishers}) == said


@pytest.mark.parametrize(('names', 'steering'), [
    (('offboard_control_mode', 'trajectory_setpoint', 'goto_setpoint_v1', 'vehicle_rates_setpoint', 'actuator_motors',
      'vehicle_attitude_setpoint_v1', 'fixed_wing_lateral_setpoint'), True),
    (('vehicle_command', 'setpoint_config', 'vehicle_visual_odometry', 'trajectory_setpoint_v'), False)])
def test_inputs_that_steer_are_known_by_their_names(names, steering):
    assert all(steers(name) == steering for name in names)
