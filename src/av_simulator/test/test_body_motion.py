"""Bodies that tilt, against formulas of mechanics that the simulator does not use: equilibrium, kinematics, spectra."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_sim_bridge.vehicle import to_imu
from av_simulator import Circle, Line, RigMotion, Static, open_world
from av_simulator.motion.bodies import Gusts, Kinematics, Mast, Pursuit, Quadrotor, Vibration, turbulence
from av_simulator.rig_dynamics import RigDynamics
from av_simulator.sound import Wind

G = 9.80665
STEP = 1 / 30


def fly(dynamics, seconds, begin=0.0):
    """States at the end of each step."""
    count = round(seconds / STEP)
    return [dynamics.step(begin + k * STEP, begin + (k + 1) * STEP).state(begin + (k + 1) * STEP) for k in range(count)]


def tilt(state):
    """Angle between the body's z axis and the vertical in degrees."""
    return math.degrees(math.acos(state.rotation[2, 2]))


@pytest.mark.parametrize('wind', [(8.0, 0.0, 0.0), (-3.0, 5.0, 0.0)])
def test_a_hover_in_steady_wind_tilts_by_the_drag_over_the_weight(wind):
    motion = RigMotion(trajectory=Static((0.0, 0.0, 5.0)), body=Quadrotor(drag=0.3))
    states = fly(RigDynamics(motion, wind=Wind(wind, gusts=0.0)), 5.0)
    for state in (states[0], states[-1]):
        assert tilt(state) == pytest.approx(math.degrees(math.atan(0.3 * math.hypot(*wind) / G)), abs=0.05)
        assert state.rotation[:2, 2] @ wind[:2] < 0.0    # against the wind
        np.testing.assert_allclose(state.position, [0.0, 0.0, 5.0], atol=0.02)
        np.testing.assert_allclose(state.acceleration, np.zeros(3), atol=0.02)


def test_a_hover_finds_its_tilt_when_the_wind_rises():
    """From calm air, without knowledge of the wind: the place is held in the end."""
    place = Kinematics(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.zeros(3))
    _, body = Quadrotor(drag=0.3).begin(place, np.zeros(3))
    for _ in range(12_000):
        state = body(1 / 300, place, np.array([8.0, 0.0, 0.0]))
    assert math.degrees(math.acos(state.up[2])) == pytest.approx(math.degrees(math.atan(0.3 * 8.0 / G)), abs=0.05)
    np.testing.assert_allclose(state.position, place.position, atol=0.02)


@pytest.mark.parametrize('a', [1.0, 3.0, 5.0])
def test_a_coordinated_acceleration_tilts_by_its_share_of_gravity(a):
    motion = RigMotion(trajectory=lambda t: np.outer(0.5 * a * np.square(t), [1.0, 0.0, 0.0]), body=Quadrotor(drag=0.0))
    for state in fly(RigDynamics(motion), 3.0):
        assert tilt(state) == pytest.approx(math.degrees(math.atan(a / G)), abs=0.05)
        assert math.degrees(math.asin(-state.rotation[2, 0])) > 0.0    # nose down: it accelerates forwards


def test_a_circle_banks_by_its_centripetal_acceleration():
    radius, period = 8.0, 10.0
    motion = RigMotion(trajectory=Circle((0.0, 0.0, 5.0), radius, period), body=Quadrotor(drag=0.0))
    expected = math.degrees(math.atan(radius * (2 * math.pi / period) ** 2 / G))
    states = fly(RigDynamics(motion), 10.0)
    assert np.mean([tilt(state) for state in states[60:]]) == pytest.approx(expected, abs=0.3)
    away = [state.position - motion.trajectory(state.time)[0] for state in states]
    assert np.linalg.norm(away, axis=1).max() < 0.5


def test_thrust_turns_within_the_time_of_a_real_quadrotor():
    """A step of the wanted acceleration: 63 % of the tilt after attitude_lag and the rate's lag."""
    jump = RigMotion(trajectory=lambda t: np.outer(2.0 * np.square(np.maximum(t - 1.0, 0.0)), [1.0, 0.0, 0.0]),
                     body=Quadrotor(drag=0.0))
    times, tilts = zip(*[(state.time, tilt(state)) for state in fly(RigDynamics(jump), 2.0)], strict=True)
    expected = math.degrees(math.atan(4.0 / G))
    reached = np.interp(0.63 * expected, tilts, times) - 1.0
    assert 0.1 < reached < 0.3


def test_the_tilt_stays_within_its_limit():
    motion = RigMotion(trajectory=lambda t: np.outer(20.0 * np.square(t), [1.0, 0.0, 0.0]), body=Quadrotor(max_tilt_deg=25.0))
    assert max(map(tilt, fly(RigDynamics(motion), 2.0))) < 25.5


@pytest.mark.parametrize('body', [Quadrotor(), Mast(lean_deg=(4.0, -3.0), bend_deg=5.0)])
def test_the_imu_feels_the_derivatives_of_the_pose(body):
    """Specific force R^T (a - g) and angular rate, with both derivatives taken numerically from the poses alone."""
    motion = RigMotion(trajectory=Circle((0.0, 0.0, 5.0), 6.0, 20.0), body=body, yaw_rate_deg=20.0)
    dynamics = RigDynamics(motion, wind=Wind((4.0, 2.0, 0.0), gusts=0.3), seed=3)
    fly(dynamics, 2.0)
    times, positions, rotations, samples = [], [], [], []
    for k in range(30):
        part = dynamics.step(2.0 + k * STEP, 2.0 + (k + 1) * STEP)
        at = 2.0 + k * STEP + np.arange(10) * STEP / 10
        p, r = part.poses(at)
        times += at.tolist()
        positions.append(p), rotations.append(r)
        samples += [to_imu(part.state(time), 0) for time in at]
    position, rotation = np.concatenate(positions), np.concatenate(rotations)
    dt = times[1] - times[0]
    wide = 5    # samples to either side
    acceleration = (position[2 * wide:] - 2 * position[wide:-wide] + position[:-2 * wide]) / (wide * dt) ** 2
    force = np.einsum('kji,kj->ki', rotation[wide:-wide], acceleration + np.array([0.0, 0.0, G]))
    turned = Rotation.from_matrix(np.einsum('kji,kjl->kil', rotation[:-2 * wide], rotation[2 * wide:])).as_rotvec()
    flip = np.array([1.0, -1.0, -1.0])
    felt = np.array([sample.acceleration_frd * flip for sample in samples])
    smooth = np.stack([np.convolve(column, np.ones(wide) / wide, 'valid') for column in felt.T], axis=1)
    rates = np.array([sample.rate_frd * flip for sample in samples[wide:-wide]])
    assert np.abs(smooth[3:-3] - force).max() < 0.25
    assert np.sqrt(np.mean((smooth[3:-3] - force) ** 2)) < 0.05
    assert np.sqrt(np.mean((rates - turned / (2 * wide * dt)) ** 2)) < 0.02


def test_a_mast_swings_at_its_frequency_and_dies_away():
    """Released from a bend: the decrement of a damped oscillator."""
    mast = Mast(height=8.0, bend_deg=6.0, frequency=0.5, damping=0.05)
    foot = Kinematics(np.zeros(3), np.zeros(3), np.zeros(3))
    _, body = mast.begin(foot, np.array([10.0, 0.0, 0.0]))
    east = []
    for _ in range(3000):
        east.append(body(1 / 300, foot, np.zeros(3)).position[0])
    omega, z = 2 * math.pi * 0.5, 0.05
    t = np.arange(1, 3001) / 300
    ringing = omega * math.sqrt(1 - z**2)
    shape = np.exp(-z * omega * t) * (np.cos(ringing * t) + z / math.sqrt(1 - z**2) * np.sin(ringing * t))
    np.testing.assert_allclose(east, 0.75 * 8.0 * math.radians(6.0) * shape, atol=0.01)


def test_a_leaning_mast_leans_and_bends_with_the_wind():
    motion = RigMotion(body=Mast(lean_deg=(5.0, 0.0), bend_deg=4.0))
    calm, = fly(RigDynamics(motion), STEP)
    assert tilt(calm) == pytest.approx(5.0, abs=0.01) and calm.rotation[0, 2] > 0.0
    windy, = fly(RigDynamics(motion, wind=Wind((5.0, 0.0, 0.0), gusts=0.0)), STEP)
    assert tilt(windy) == pytest.approx(6.0, abs=0.05)


@pytest.mark.parametrize('speed', [5.0, 12.0])
def test_gusts_have_drydens_variance_and_time_scale(speed):
    """Stationary: standard deviations, and the autocorrelation exp(-V tau / L) along the wind."""
    gusts, height, dt = Gusts((0.0, speed, 0.0), 0.2, [1]), 6.0, 0.05
    air = np.array([gusts.step(dt, height, np.zeros(3)) for _ in range(60_000)])
    assert air.mean(axis=0) == pytest.approx([0.0, speed, 0.0], abs=0.12 * speed * 0.2)
    sigma = 0.2 * speed
    assert air.std(axis=0) == pytest.approx([sigma, sigma, sigma * turbulence(height)[2]], rel=0.08)
    along = air[:, 1] - air[:, 1].mean()
    lag = round(turbulence(height)[0] / speed / dt)
    assert np.mean(along[lag:] * along[:-lag]) / np.mean(along**2) == pytest.approx(math.exp(-1.0), abs=0.08)


def test_length_scales_are_those_of_the_specification():
    """MIL-F-8785C at 100 ft: L_u = 100 / (0.177 + 0.0823)^1.2 ft, L_w = 100 ft, sigma_u / sigma_w = 1 / 0.2593^0.4."""
    horizontal, vertical, share = turbulence(30.48)
    assert (horizontal / 0.3048, vertical / 0.3048) == pytest.approx((505.3, 100.0), rel=1e-3)
    assert 1.0 / share == pytest.approx(1.716, rel=1e-3)


def test_vibration_shakes_without_moving():
    steady = RigMotion(trajectory=Static((1.0, 2.0, 3.0)))
    shaken = dataclasses.replace(steady, vibration=Vibration(angle_deg=0.3, acceleration=3.0, frequency=40.0))
    motion = RigDynamics(shaken).step(0.0, 1.0)
    times = np.arange(300) / 300
    states = [motion.state(time) for time in times]
    turned = np.array([Rotation.from_matrix(state.rotation).as_rotvec(degrees=True) for state in states])
    assert np.abs(turned).max() == pytest.approx(0.3, rel=0.1) and np.abs(turned.mean(axis=0)).max() < 0.01
    assert np.std([state.acceleration[0] for state in states]) == pytest.approx(3.0 / math.sqrt(2.0), rel=0.05)
    assert np.abs(np.array([state.position for state in states]) - [1.0, 2.0, 3.0]).max() < 1e-3


@pytest.mark.parametrize('body', [Quadrotor(), RigMotion().body])
def test_a_pursuit_keeps_its_distance_and_its_limits(body):
    pursuit = Pursuit(distance=8.0, height=1.0, max_speed=9.0, max_acceleration=3.0)
    target = Line((20.0, 0.0, 6.0), (4.0, 1.0, 0.0))
    dynamics = RigDynamics(RigMotion(trajectory=Static((0.0, 0.0, 2.0)), body=body, pursuit=pursuit), [target])
    states = fly(dynamics, 30.0)
    for state in states[600:]:
        away = target(state.time)[0] - state.position
        assert math.hypot(*away[:2]) == pytest.approx(8.0, abs=0.5) and away[2] == pytest.approx(-1.0, abs=0.3)
        np.testing.assert_allclose(state.velocity, [4.0, 1.0, 0.0], atol=0.2)
    assert max(np.linalg.norm(state.velocity) for state in states) < 10.0
    assert max(np.linalg.norm(state.acceleration) for state in states) < 6.0


def test_motion_does_not_depend_on_the_division_into_steps():
    """Body, gusts and yaw: the same samples in steps of any multiple of 1/300 s."""
    motion = RigMotion(body=Quadrotor(), yaw_rate_deg=10.0, yaw_lag=0.4)
    ends = []
    for steps in (60, 20, 10):
        dynamics = RigDynamics(motion, wind=Wind((6.0, 0.0, 0.0)), seed=2)
        for k in range(steps):
            state = dynamics.step(2.0 * k / steps, 2.0 * (k + 1) / steps).state(2.0 * (k + 1) / steps)
        ends.append(np.concatenate([state.position, state.attitude_wxyz]))
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=1e-6)


@pytest.mark.parametrize('changes', [
    {'body': Quadrotor(drag=5.0, max_tilt_deg=80.0, attitude_lag=0.01)}, {'body': Quadrotor(attitude_lag=2.0)},
    {'body': Mast(height=200.0, frequency=10.0, bend_deg=45.0, damping=0.0, lean_deg=(45.0, 45.0))},
    {'pursuit': Pursuit(distance=1.0, max_speed=60.0, max_acceleration=50.0), 'body': Quadrotor()},
    {'vibration': Vibration(5.0, 100.0, 0.1)}])
def test_extreme_bodies_in_a_storm_stay_finite(changes):
    """What the bounds of scenarios allow is rendered: sound limits the rig's speed."""
    scenario = open_world('circle').scenario
    scenario = dataclasses.replace(scenario, rig=dataclasses.replace(scenario.rig, **changes),
                                   noise=dataclasses.replace(scenario.noise, wind=Wind((60.0, 60.0, 0.0), gusts=3.0)))
    world = open_world(scenario)
    for _ in range(30):
        assert np.isfinite(world.advance(1600)).all()
    assert np.isfinite(world.rig_state(world.time).position).all()
