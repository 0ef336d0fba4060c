"""The gimbal against its lag's formula and its limits, and the camera on it against rotations of scipy."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_common.frames import FLU_TO_OPTICAL
from av_common.rig import GimbalMount, load_rig
from av_sim_bridge.vehicle import VehicleState
from av_simulator import World, find_config, open_world
from av_simulator.motion.axes import COMMAND_LIFETIME, ENCODER_SIGMA, SimulatedGimbal
from av_simulator.motion.bodies import Mast, Quadrotor

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
MOUNT = GimbalMount(pan_limits_deg=(-90.0, 90.0), tilt_limits_deg=(-30.0, 40.0), max_rate_deg=60.0, lag=0.2)


def moved(gimbal, pan_deg, tilt_deg, seconds, commanded=math.inf):
    """Times and angles in degrees while commands come every 1/30 s until `commanded`."""
    times, angles = [], []
    for k in range(round(30 * seconds)):
        if k / 30 <= commanded:
            gimbal.command(math.radians(pan_deg), math.radians(tilt_deg), k / 30, LEVEL)
        gimbal.step(np.linspace(k / 30, (k + 1) / 30, 11))
        times.append((k + 1) / 30)
        angles.append(np.degrees(gimbal.angles(times[-1])))
    return np.array(times), np.array(angles)


def test_a_small_step_follows_the_lag():
    times, angles = moved(SimulatedGimbal(MOUNT), 8.0, -5.0, 1.5)
    answer = 1.0 - np.exp(-times / 0.2)
    np.testing.assert_allclose(angles, np.outer(answer, [8.0, -5.0]), atol=0.02)


def test_a_large_step_moves_at_the_highest_rate():
    times, angles = moved(SimulatedGimbal(MOUNT), 80.0, 0.0, 3.0)
    np.testing.assert_allclose(angles[times < 1.1, 0], 60.0 * times[times < 1.1], atol=0.1)
    assert angles[-1, 0] == pytest.approx(80.0, abs=0.1)


def test_angles_stay_within_their_limits():
    _, angles = moved(SimulatedGimbal(MOUNT), 170.0, -85.0, 4.0)
    assert angles[-1] == pytest.approx([90.0, -30.0], abs=0.1)
    assert (np.abs(angles[:, 0]) <= 90.0 + 1e-9).all() and (angles[:, 1] >= -30.0 - 1e-9).all()


def test_without_commands_the_gimbal_holds_where_it_is():
    times, angles = moved(SimulatedGimbal(MOUNT), 80.0, 20.0, 2.0, commanded=0.3)
    held = angles[times > 0.3 + COMMAND_LIFETIME + 0.04]
    assert np.ptp(held, axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 25.0 < held[0, 0] < 35.0


def tilted_world(stabilized, body, rig='rig_gimbal'):
    scenario = open_world('gusty').scenario
    rig = load_rig(find_config(rig))
    rig = dataclasses.replace(rig, gimbal=dataclasses.replace(rig.gimbal, stabilized=stabilized))
    return World(dataclasses.replace(scenario, rig=dataclasses.replace(scenario.rig, body=body, yaw_rate_deg=30.0)), rig)


@pytest.mark.parametrize('body', [Quadrotor(), Mast(lean_deg=(12.0, -7.0))])
def test_a_stabilized_camera_stays_level_as_the_body_tilts(body):
    world, tilts = tilted_world(True, body), []
    for _ in range(45):
        world.dynamics.look(math.radians(40.0), math.radians(25.0), world.time)
        world.advance(1600)
        state = world.rig_state(world.time)
        tilts.append(math.degrees(math.acos(state.rotation[2, 2])))
        _, rotation = world.camera_pose(world.time)
        if world.time > 1.0:
            sight, right = rotation[:, 2], rotation[:, 0]
            heading = math.atan2(state.rotation[1, 0], state.rotation[0, 0])
            expected = [math.cos(heading + math.radians(40.0)), math.sin(heading + math.radians(40.0))]
            assert sight[2] == pytest.approx(math.sin(math.radians(25.0)), abs=2e-3)
            assert right[2] == pytest.approx(0.0, abs=1e-9)
            np.testing.assert_allclose(sight[:2] / np.linalg.norm(sight[:2]), expected, atol=5e-3)
    assert max(tilts) > 4.0


def test_a_camera_that_is_not_stabilized_tilts_with_the_body():
    """And is where mounts and angles put it, by scipy's rotations."""
    world = tilted_world(False, Mast(lean_deg=(12.0, -7.0)))
    for _ in range(30):
        world.dynamics.look(0.5, 0.2, world.time)
        world.advance(1600)
    state, rig = world.rig_state(world.time), world.rig
    pan, tilt = world.dynamics.gimbal.angles(world.time)
    assert (pan, tilt) == pytest.approx((0.5, 0.2), abs=1e-3)
    body = Rotation.from_quat(state.attitude_wxyz[[1, 2, 3, 0]])
    turned = body * Rotation.from_euler('ZY', [pan, -tilt])
    position, rotation = world.camera_pose(world.time)
    np.testing.assert_allclose(rotation, turned.as_matrix() @ FLU_TO_OPTICAL.T, atol=1e-6)
    np.testing.assert_allclose(position, state.position + body.apply(rig.gimbal.mount.position)
                               + turned.apply(rig.camera.mount.position), atol=1e-6)


def test_the_report_is_the_orientation_with_the_encoders_error():
    """From the gimbal's frame to the body's, of a rig that an autopilot has tilted."""
    world, errors = tilted_world(True, Quadrotor()), []
    attitude = Rotation.from_euler('ZYX', [50.0, 15.0, -20.0], degrees=True)
    for number in range(60):
        world.dynamics.follow(VehicleState(0.0, np.zeros(3), attitude_wxyz=attitude.as_quat()[[3, 0, 1, 2]]))
        world.dynamics.look(-0.4, 0.3, world.time)
        world.advance(1600)
        if number >= 30:
            sample = world.gimbal_sample(number, world.time)
            expected = attitude.inv() * Rotation.from_euler('ZY', [math.radians(50.0) - 0.4, -0.3])
            errors.append((expected.inv() * Rotation.from_quat(sample.orientation_wxyz[[1, 2, 3, 0]])).as_rotvec())
            assert (sample.time, sample.variance) == (world.time, ENCODER_SIGMA**2)
    assert np.std(errors) == pytest.approx(ENCODER_SIGMA, rel=0.25)


def test_a_rig_without_a_gimbal_reports_none_and_ignores_looks():
    world = open_world('circle')
    world.dynamics.look(1.0, 0.5, 0.0)
    world.advance(1600)
    assert world.gimbal_sample(1, world.time) is None
    _, rotation = world.camera_pose(world.time)
    np.testing.assert_allclose(rotation, world.rig_state(world.time).rotation @ world.rig.camera.optical_to_body)


def test_a_turning_gimbal_blurs_the_image():
    world = tilted_world(True, Quadrotor())
    blurs = []
    for _ in range(10):
        world.dynamics.look(1.5, 0.0, world.time)
        world.advance(1600)
        blurs.append(world.view(0, world.time).image_motion[0])
    fx = world.rig.camera.model.fx
    assert max(np.abs(blurs)) == pytest.approx(fx * math.radians(120.0 + 30.0), rel=0.1)
