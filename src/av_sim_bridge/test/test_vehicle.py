"""NED/FRD to ENU/FLU and back: every sign, by statements about the world that everybody agrees on."""

import numpy as np
import pytest
from fake_rflysim import short_truth_datagram
from scipy.spatial.transform import Rotation

from av_sim_bridge.vehicle import GRAVITY, VehicleState, from_truth, to_imu, to_truth
from av_sim_bridge.wire.truth import VehicleTruth, decode_truth, encode_truth

NORTH, EAST, UP = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def truth(position=(0, 0, 0), velocity=(0, 0, 0), euler_deg=(0, 0, 0), acceleration=(0, 0, 0), rate=(0, 0, 0)):
    """Roll, pitch, yaw in degrees, as aerospace has them: right wing down, nose up, clockwise from north."""
    roll, pitch, yaw = np.deg2rad(np.array(euler_deg, float))
    quaternion = Rotation.from_euler('ZYX', [yaw, pitch, roll]).as_quat()[[3, 0, 1, 2]]
    return VehicleTruth(1, 3, 1.0, *(np.array(value, float) for value in (position, velocity)),
                        np.array([roll, pitch, yaw]), quaternion, np.zeros(8), np.array(acceleration, float),
                        np.array(rate, float))


@pytest.mark.parametrize(('ned', 'enu'), [((1, 0, 0), NORTH), ((0, 1, 0), EAST), ((0, 0, 1), -UP)])
def test_positions_and_velocities(ned, enu):
    state = from_truth(truth(position=ned, velocity=ned))
    np.testing.assert_allclose(state.position, enu)
    np.testing.assert_allclose(state.velocity, enu)


@pytest.mark.parametrize(('euler_deg', 'forward', 'left', 'up'), [
    ((0, 0, 0), NORTH, -EAST, UP),                 # heading north, west is to the left
    ((0, 0, 90), EAST, NORTH, UP),                 # heading east
    ((0, 0, 180), -NORTH, EAST, UP),
    ((0, 90, 0), UP, -EAST, -NORTH),               # nose up: the top looks back to the south
    ((90, 0, 0), NORTH, UP, EAST),                 # right wing down: the left one points up, the top to the east
])
def test_attitudes(euler_deg, forward, left, up):
    np.testing.assert_allclose(from_truth(truth(euler_deg=euler_deg)).rotation, np.column_stack([forward, left, up]),
                               atol=1e-12)


def test_turn_rates_and_accelerations():
    state = from_truth(truth(euler_deg=(0, 0, 90), rate=(1, 2, 3), acceleration=(1, 2, 3)))
    np.testing.assert_allclose(state.rate_flu, [1, -2, -3])                      # clockwise is negative
    np.testing.assert_allclose(state.acceleration, EAST - 2 * NORTH - 3 * UP, atol=1e-12)


@pytest.mark.parametrize('short', [False, True])
def test_round_trip_through_the_wire(rng, short):
    attitude = Rotation.from_rotvec([0.1, -0.3, 2.0]).as_quat()[[3, 0, 1, 2]]
    state = VehicleState(12.5, *rng.normal(size=(3, 3)), attitude, rng.normal(size=3), np.arange(8.0))
    sent = to_truth(state, 2)
    back = from_truth(decode_truth(short_truth_datagram(
        2, sent.time, sent.position_ned, sent.velocity_ned, sent.euler_rad, sent.motor_rpm) if short else encode_truth(sent)))
    for name in ('position', 'velocity', 'rotation', 'rotor_rpm'):
        np.testing.assert_allclose(getattr(back, name), getattr(state, name), atol=1e-5, err_msg=name)
    if not short:
        np.testing.assert_allclose(back.acceleration, state.acceleration, atol=1e-5)
        np.testing.assert_allclose(back.rate_flu, state.rate_flu, atol=1e-5)


def test_an_imu_at_rest_feels_gravity_upwards():
    sample = to_imu(VehicleState(0.0, np.zeros(3), rate_flu=np.array([0.0, 0.0, 0.5])), 1)
    np.testing.assert_allclose(sample.acceleration_frd, [0.0, 0.0, -GRAVITY])
    np.testing.assert_allclose(sample.rate_frd, [0.0, 0.0, -0.5])
