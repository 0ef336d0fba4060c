"""The rig's yaw against the integral of a rate with limited acceleration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_sim_bridge.vehicle import VehicleState
from av_simulator import RigMotion, open_world
from av_simulator.motion.axes import COMMAND_LIFETIME
from av_simulator.motion.bodies import MOST_SPEED
from av_simulator.rig_dynamics import RigDynamics

MOTION = RigMotion(yaw_deg=15.0, max_yaw_rate_deg=60.0, max_yaw_acceleration_deg=120.0)


def turn(dynamics, commands, duration, step=1 / 30):
    """Yaw and rate in degrees at fine instants; commands: {time: rate in deg/s}."""
    times, yaws, rates = [], [], []
    for number in range(round(duration / step)):
        start = number * step
        for at in [at for at in commands if start - step < at <= start]:
            dynamics.command(np.deg2rad(commands[at]), start)
        motion = dynamics.step(start, start + step)
        fine = start + (np.arange(20) + 0.5) * step / 20
        times.append(fine)
        yaws.append(np.arctan2(*motion.poses(fine)[1][:, 1::-1, 0].T))
        rates.append([motion.state(time).rate_flu[2] for time in fine])
    return np.concatenate(times), np.rad2deg(np.unwrap(np.concatenate(yaws))), np.rad2deg(np.concatenate(rates))


def test_yaw_is_the_integral_of_the_rate():
    times, yaw, rate = turn(RigDynamics(MOTION), {0.0: 40.0, 0.3: 40.0, 0.6: -50.0, 0.9: -50.0}, 1.2)
    integral = 15.0 + np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(times))])
    np.testing.assert_allclose(yaw, integral, atol=0.02)
    assert np.abs(rate[20:] - rate[:-20]).max() <= 120.0 / 30 + 0.11


def test_rates_are_limited_and_end_with_the_commands():
    _, _, rate = turn(RigDynamics(MOTION), {0.0: 200.0, 0.15: 200.0, 0.3: 200.0, 0.45: 200.0}, 2.5)
    assert rate.max() == pytest.approx(60.0, abs=0.1)
    assert rate[-1] == pytest.approx(0.0, abs=1e-9)


def test_without_commands_the_rig_brakes_after_a_fifth_of_a_second():
    times, _, rate = turn(RigDynamics(MOTION), {0.0: 20.0}, 1.5)
    assert rate[np.searchsorted(times, COMMAND_LIFETIME - 0.01)] == pytest.approx(20.0)
    assert np.abs(rate[times > 0.4]).max() < 1e-9 and COMMAND_LIFETIME <= 0.2


def test_the_scenario_turns_the_rig_until_somebody_commands():
    dynamics = RigDynamics(RigMotion(yaw_rate_deg=10.0))
    _, yaw, _ = turn(dynamics, {}, 2.0)
    assert yaw[-1] == pytest.approx(20.0, abs=0.1)
    dynamics.command(0.0, 2.0)
    dynamics.step(2.0, 2.1)
    assert dynamics.step(2.1, 2.2).state(2.2).rate_flu[2] == pytest.approx(0.0, abs=1e-9)


def test_yaw_answers_as_px4_was_flown():
    """After 0.10 s of dead time, 1 - exp(-t / 0.40 s) of what was commanded; after the last command it dies away likewise."""
    dynamics = RigDynamics(RigMotion(yaw_dead_time=0.1, yaw_lag=0.4, max_yaw_acceleration_deg=7200.0))
    times, _, rate = turn(dynamics, dict.fromkeys(np.arange(60) / 30, 20.0), 4.0)
    rising = (times > 0.11) & (times < 2.0)
    np.testing.assert_allclose(rate[rising], 20.0 * (1.0 - np.exp(-(times[rising] - 0.1) / 0.4)), atol=0.1)
    assert np.abs(rate[times < 0.1]).max() < 1e-9
    end = 59 / 30 + COMMAND_LIFETIME + 0.1
    falling = times > end + 0.01
    np.testing.assert_allclose(rate[falling], 20.0 * np.exp(-(times[falling] - end) / 0.4), atol=0.2)


def test_an_autopilot_says_where_the_rig_is():
    """Poses given at 30 Hz are passed through at the end of each step, evenly in between, on the shortest turn."""
    dynamics = RigDynamics(MOTION)
    angles = np.column_stack([np.linspace(170, 200, 31), 5 * np.ones(31), np.linspace(0, 20, 31)])
    attitudes = Rotation.from_euler('ZYX', angles, degrees=True)
    last = None
    for number, attitude in enumerate(attitudes):
        begin, end = number / 30, (number + 1) / 30
        given = VehicleState(end, np.array([number * 0.1, 1.0, 2.0]), attitude_wxyz=attitude.as_quat()[[3, 0, 1, 2]])
        dynamics.follow(given)
        motion = dynamics.step(begin, end)
        positions, rotations = motion.poses([begin, (begin + end) / 2, end])
        np.testing.assert_allclose(positions[2], given.position, atol=1e-9)
        np.testing.assert_allclose(rotations[2], given.rotation, atol=1e-9)
        if last is not None:
            np.testing.assert_allclose(positions[0], last.position, atol=1e-9)
            np.testing.assert_allclose(rotations[0], last.rotation, atol=1e-9)
            np.testing.assert_allclose(motion.state(end).velocity, [3.0, 0.0, 0.0], atol=1e-9)
            assert np.linalg.norm(motion.state(end).rate_flu) < np.deg2rad(60.0)
        last = given
    resting = dynamics.step(end, end + 0.1).poses([end + 0.05])
    np.testing.assert_allclose(resting[0][0], last.position, atol=1e-9)


@pytest.mark.parametrize('scenario', ['fog_woodland', 'occluded_room'])
def test_poses_that_jump_hold_nothing_up(scenario):
    """However far and often: the rig goes there at a speed that its sound allows, in steps that take no longer than others."""
    world = open_world(scenario)
    world.advance(1600)
    for number in range(12):
        far = 1e6 * (-1) ** number * np.array([1.0, -1.0, 1.0])
        attitude = np.array([np.cos(number), 0.0, 0.0, np.sin(number)])
        world.dynamics.follow(VehicleState(0.0, far, attitude_wxyz=attitude))
        before = world.rig_state(world.time).position
        assert np.isfinite(world.advance(1600)).all()
        assert np.linalg.norm(world.rig_state(world.time).position - before) <= MOST_SPEED / 30 + 1e-6
