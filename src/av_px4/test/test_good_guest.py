"""The rig beside other programs, after faults, and with a pilot who decides: nothing is sent that nobody asked for."""

from __future__ import annotations

import math

import pytest
from fake_autopilot import HOLD, LAND, OFFBOARD, POSITION, RETURN
from flight_bench import Flight, Program
from px4_layouts import FIRMWARES

TURN = {'yaw_rate': 0.3}
RATE = pytest.approx(-0.3, abs=0.01)    # PX4 counts clockwise
STEERING = ('trajectory_setpoint', 'offboard_control_mode')
OWN = FIRMWARES[1:]                     # firmwares with external modes


def steered(flight, since=-math.inf):
    """Setpoints and heartbeats of the rig."""
    return [message for topic in STEERING for message in flight.of(topic, since)]


def select(flight, mode, seconds=4.0):
    """The pilot selects a mode, as soon as PX4 lets him."""
    flight.pilot = mode
    selected = flight.run(seconds, until=lambda flight: flight.model.nav_state == mode, **TURN)
    flight.pilot = None
    return selected


def in_own_mode(firmware='1.17', **settings):
    """A flight that turns in the rig's own mode."""
    flight = Flight(firmware, **settings)
    assert flight.run(10.0, until=lambda flight: flight.own_mode, **TURN)
    assert select(flight, flight.own_mode), flight.said.message
    flight.run(2.5, **TURN)
    assert flight.model.yaw_rate == RATE
    return flight


def in_offboard(firmware='1.17', **settings):
    """A flight that turns in OFFBOARD, in which the rig was asked to take part."""
    flight = Flight(firmware, offboard=True, **settings)
    assert select(flight, OFFBOARD), flight.said.message
    flight.run(2.5, **TURN)
    assert flight.model.yaw_rate == RATE
    return flight


class TestOthers:
    """A program of the user that flies in OFFBOARD at 2 m/s."""

    @pytest.mark.parametrize(('firmware', 'settings'), [
        ('1.17', {}), ('1.17', {'turn_body': False}), *((firmware, {'offboard': True}) for firmware in FIRMWARES)], ids=str)
    def test_it_flies_as_if_the_rig_was_not_there_and_px4_notices_its_death(self, firmware, settings):
        """Also with pointing enabled, and where the rig was asked to take part in OFFBOARD."""
        flight = Flight(firmware, **settings)
        flight.program = Program()
        flight.run(0.2, **TURN)
        assert select(flight, OFFBOARD)
        flight.run(5.0, **TURN)
        begin = flight.model.position[0]
        flight.run(5.0, **TURN)
        assert (flight.model.position[0] - begin) / 5.0 == pytest.approx(2.0, abs=0.05)
        assert not steered(flight)
        assert flight.value('others') == '/path_follower publishes /fmu/in/trajectory_setpoint'
        flight.program = None
        assert flight.run(1.2, until=lambda flight: flight.model.failsafe, **TURN)
        flight.run(5.0, **TURN)
        assert flight.model.nav_state == RETURN and not steered(flight)

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_a_vehicle_with_another_system_id_is_flown_alike(self, begin):
        """As PX4's multi-vehicle guide starts it: its gimbal is claimed by that id, its modes are its own."""
        flight = begin(model={'system': 3})
        flight.run(1.0, pan=0.5, **TURN)
        assert flight.model.owner == (3, 191) and flight.model.gimbal[1] == pytest.approx(-0.5, abs=0.01)

    def test_with_pointing_not_enabled_nothing_is_sent_in_any_mode(self):
        flight = Flight(offboard=True)
        flight.enabled = False
        for mode in (HOLD, POSITION, OFFBOARD, 23):
            assert select(flight, mode) == (mode in (HOLD, POSITION))
            flight.run(1.0)
        assert not steered(flight) and flight.value('offboard withheld') == 'pointing is not enabled'
        assert flight.value('external mode withheld') == 'pointing is not enabled'

    def test_by_default_no_heartbeat_is_sent_and_the_own_mode_turns(self):
        flight = in_own_mode()
        assert not flight.of('offboard_control_mode')
        assert not select(flight, OFFBOARD)

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_who_comes_while_the_rig_turns_gets_a_vehicle_that_stands(self, begin):
        """The turn is ended by one setpoint; in OFFBOARD the program flies on, PX4 leaves the own mode, and notices its end."""
        flight = begin()
        flight.program, came = Program(), flight.time
        flight.run(1.0, **TURN)
        setpoints = flight.of('trajectory_setpoint', came)
        assert len(setpoints) <= 2 and math.isnan(setpoints[-1].yawspeed)
        assert not flight.of('offboard_control_mode', came + 0.05)
        flight.run(2.0, **TURN)
        assert flight.model.yaw_rate == 0.0
        assert flight.model.nav_state == (OFFBOARD if begin is in_offboard else RETURN)
        flight.program, gone = None, flight.time
        flight.run(2.0, **TURN)
        assert flight.model.nav_state == RETURN and not steered(flight, gone)


class TestConsent:
    """A failsafe ends in PX4 as soon as heartbeats come again; the rig must not be the reason."""

    @pytest.mark.parametrize(('firmware', 'dead'), [('1.17', 0.3), *((firmware, 2.4) for firmware in FIRMWARES)])
    def test_a_new_process_waits_for_the_pilot_in_offboard(self, firmware, dead):
        """Killed and started again, before or after PX4 has noticed."""
        flight = in_offboard(firmware)
        flight.rig = None
        flight.run(dead)
        flight.start()
        came = flight.time
        flight.run(10.0, **TURN)
        assert flight.model.nav_state == RETURN and flight.model.failsafe and not steered(flight, came)
        assert 'select another mode first' in flight.value('offboard withheld')
        assert select(flight, POSITION) and select(flight, OFFBOARD)
        flight.run(2.5, **TURN)
        assert flight.model.yaw_rate == RATE

    @pytest.mark.parametrize(('firmware', 'known'), [('1.17', False), *((firmware, True) for firmware in OWN)])
    def test_a_new_process_waits_for_the_pilot_in_the_own_mode(self, firmware, known):
        """Whether or not it knows what the former one had registered."""
        flight = in_own_mode(firmware)
        former = flight.rig.mode.registration
        flight.rig = None
        flight.run(2.0)
        flight.start(former if known else None)
        came = flight.time
        flight.run(10.0, **TURN)
        assert flight.model.nav_state == RETURN and not steered(flight, came)
        assert select(flight, POSITION)
        flight.run(3.0, **TURN)
        assert select(flight, flight.rig.mode.registration.mode_id), flight.said.message
        flight.run(2.5, **TURN)
        assert flight.model.yaw_rate == RATE

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    @pytest.mark.parametrize(('stall', 'flagged'), [(0.2, True), (0.9, True), (1.5, True), (1.5, False), (3.0, False)])
    @pytest.mark.parametrize('what', ['agent', 'process'])
    def test_after_a_stall_it_goes_on_or_waits_for_the_pilot(self, begin, stall, flagged, what):
        """Of the agent or of the process: PX4 is never in a mode that it left by itself, with or without a flag of failsafe."""
        flight = begin()
        rig, flight.firmware.flagged = flight.rig, flagged
        if what == 'agent':
            flight.linked = False
        else:
            flight.rig = None
        events = len(flight.model.events)
        flight.run(stall, **TURN)
        flight.linked, flight.rig = True, rig
        flight.run(6.0, **TURN)
        assert not [event for event in flight.model.events[events:] if 'the failsafe is over' in event]
        left = flight.model.nav_state == RETURN
        assert left or flight.model.yaw_rate == RATE
        assert stall == 0.9 or left == (stall > 1.0)    # PX4 waits 1 s and 1.2 s, the rig 0.1 s and more

    def test_a_shutdown_in_a_failsafe_ends_no_failsafe(self):
        """PX4 would hold, if the mode that the pilot has selected was unregistered."""
        flight = in_own_mode()
        flight.silent = {'vehicle_local_position'}
        flight.run(4.0, **TURN)
        assert flight.model.nav_state == RETURN
        flight.send(flight.rig.stop(flight.now))
        assert flight.rig.mode.registration
        flight.rig = None
        flight.run(3.0)
        assert flight.model.nav_state == RETURN and flight.model.failsafe

    @pytest.mark.parametrize('firmware', OWN)
    def test_a_shutdown_in_the_own_mode_is_hold(self, firmware):
        """No failsafe: the mode ends, the body stands, and a new process waits for the pilot to select it again."""
        flight = in_own_mode(firmware)
        place = flight.model.position
        flight.send(flight.rig.stop(flight.now))
        flight.rig = None
        flight.run(4.0)
        assert flight.model.nav_state == HOLD and not flight.model.failsafe and flight.model.yaw_rate == 0.0
        assert not flight.model.modes and math.dist(flight.model.position, place) < 0.01
        flight.start()
        flight.run(4.0, **TURN)
        assert flight.model.nav_state == HOLD and flight.model.yaw_rate == 0.0
        assert select(flight, flight.own_mode) and flight.run(3.0, until=lambda flight: flight.model.yaw_rate == RATE, **TURN)

    def test_a_shutdown_in_offboard_stops_the_body_and_px4_takes_over(self):
        """By its failsafe, as COM_OBL_RC_ACT says: nothing else is in charge of OFFBOARD."""
        flight = in_offboard()
        flight.send(flight.rig.stop(flight.now))
        flight.rig, turned = None, flight.model.turned
        flight.run(4.0)
        assert flight.model.failsafe and flight.model.nav_state == RETURN and flight.model.yaw_rate == 0.0
        assert abs(flight.model.turned - turned) < 0.3 * 0.5 + 0.01    # by dead time and lag

    @pytest.mark.parametrize('own', ['agent', 'PX4'])
    def test_the_mode_is_registered_once_whatever_restarts(self, own):
        """In Hold: the agent is away for 6 s, or PX4 starts anew and knows of nothing."""
        flight = Flight()
        assert flight.run(10.0, until=lambda flight: flight.own_mode)
        flight.run(1.0)
        if own == 'agent':
            flight.linked = False
            flight.run(6.0)
            flight.linked = True
        else:
            flight.model.modes.clear()
        flight.run(10.0)
        model = flight.model
        assert model.granted == 2 and model.most_modes == 1 and [mode.nav_state for mode in model.modes.values()] == [23]

    def test_a_killed_process_leaves_no_more_than_the_failsafe_lets_turn(self):
        """From 25 deg/s: PX4 turns on for 1.0 s, then by 0.5 s of the rate."""
        flight, turn = in_offboard(), {'yaw_rate': math.radians(25.0)}
        flight.run(2.0, **turn)
        flight.rig, turned = None, flight.model.turned
        flight.run(4.0)
        assert flight.model.yaw_rate == 0.0 and 25.0 < abs(math.degrees(flight.model.turned - turned)) < 38.0

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_any_failsafe_ends_what_the_pilot_had_handed_over(self, begin):
        """Such as that of a battery: it is over, and the vehicle is back in the mode, but the rig is not."""
        flight = begin()
        model, mode = flight.model, flight.model.nav_state
        model.failsafe, model._check_failsafe = True, lambda: None
        model._enter(RETURN, 'battery')
        flight.run(2.0, **TURN)
        model.failsafe = False
        model._enter(mode, 'the battery was wrong')
        back = flight.time + 0.02
        flight.run(2.0, **TURN)
        assert not steered(flight, back) and model.yaw_rate == 0.0

    def test_offboard_that_was_selected_for_somebody_else_is_not_taken(self):
        """A program outside ROS, over MAVLink, say: the graph does not show it, and the rig was not enabled."""
        flight = Flight(offboard=True)
        flight.enabled = False
        program = Program()
        for _ in range(200):
            program.tick(flight.model)
            flight.run(0.01)
        assert flight.model.select_mode(OFFBOARD)
        flight.enabled = True
        for _ in range(300):
            program.tick(flight.model)
            flight.run(0.01, **TURN)
        assert not steered(flight)
        assert flight.value('offboard withheld').startswith('selected without this rig')


class TestPilot:
    """He is obeyed at once, and what he has is what he selected."""

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    @pytest.mark.parametrize(('firmware', 'mode'), [
        ('1.16', HOLD), ('1.16', POSITION), ('1.16', RETURN), ('1.16', LAND), ('1.18', POSITION)])
    def test_when_he_selects_another_mode_nothing_is_sent_any_more(self, begin, firmware, mode):
        """PX4 1.16 would obey it in any mode."""
        flight = begin(firmware)
        flight.model.change_mode(mode, 'the pilot')
        left = flight.time + 0.1
        flight.run(2.0, **TURN)
        assert not flight.of('trajectory_setpoint', left) and flight.model.setpoints_in_foreign_modes == 0

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_modes_that_change_faster_than_status_comes(self, begin):
        """He takes over for a moment, by his sticks say, and hands over again: each counts."""
        flight = begin()
        mode = flight.model.nav_state
        for away in (0.01, 0.03, 0.1, 0.3):
            flight.model.change_mode(POSITION, 'the pilot')
            left = flight.time
            flight.run(away, **TURN)
            assert not flight.of('trajectory_setpoint', left + 0.02)
            assert flight.model.select_mode(mode)
            flight.run(2.5, **TURN)
            assert flight.model.yaw_rate == RATE and flight.model.nav_state == mode

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_who_selects_the_mode_that_he_has_changes_nothing(self, begin):
        flight = begin()
        assert flight.model.select_mode(flight.model.nav_state)
        flight.run(2.0, **TURN)
        assert flight.model.yaw_rate == RATE and not flight.model.failsafe

    @pytest.mark.parametrize('missing', ['status', 'local_position', 'command_ack', 'odometry'])
    def test_what_goes_stale_stops_it_and_moves_it_when_it_is_back_and_he_wants_it(self, missing):
        flight = in_offboard()
        flight.silent = {f'vehicle_{missing}'}
        flight.run(4.0, **TURN)
        assert flight.model.yaw_rate == 0.0
        flight.silent = set()
        assert select(flight, HOLD) and select(flight, OFFBOARD)
        flight.run(2.5, **TURN)
        assert flight.model.yaw_rate == RATE

    @pytest.mark.parametrize('begin', [in_own_mode, in_offboard])
    def test_pointing_that_is_disabled_in_flight_holds_the_vehicle(self, begin):
        """To let it go would be a fault for PX4, which would return; the body stands within 0.1 s of commands."""
        flight = begin()
        flight.enabled = False
        flight.run(0.1)
        assert math.isnan(flight.of('trajectory_setpoint')[-1].yawspeed)
        flight.run(5.0)
        assert flight.model.nav_state not in (RETURN, HOLD) and flight.model.yaw_rate == 0.0
        assert math.dist(flight.model.position, (0.0, 0.0, -2.0)) < 0.01

    @pytest.mark.parametrize('firmware', FIRMWARES)
    def test_no_history_arms_or_changes_the_mode(self, firmware):
        flight = Flight(firmware, offboard=True)
        flight.run(3.0, pan=0.3, **TURN)
        assert {message.command for message in flight.of('vehicle_command')} == {1000, 1001}
