"""Frames and signs between PX4 and ROS, against geometry written out by hand: PX4's messages in, the rig's odometry out."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_px4_stage import Rig

from av_common.frames import attitude_of, yaw_of
from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_px4.stage import ODOMETRY_TOPIC, Px4Stage

EPOCH, SETTLED_S = 1.7e9, 1.5    # s, ROS time of PX4's start; until PX4's clock is known


def heading(degrees):
    """Quaternion of a level vehicle, clockwise from north."""
    return np.roll(Rotation.from_euler('z', degrees, degrees=True).as_quat(), 1).tolist()


def odometry(pose, seconds=0.0):
    """The rig's odometry of 100 poses a second; pose: the fields of a VehicleOdometry at a time (s), NED where not said."""
    stage, found = Px4Stage(node_parameters('av_px4', 'px4_node'), SimpleNamespace()), []
    usual = {'position': [0.0] * 3, 'q': heading(0.0), 'velocity': [0.0] * 3, 'angular_velocity': [0.0] * 3, 'pose_frame': 1,
             'velocity_frame': 1, 'reset_counter': 0}
    for time in np.arange(-SETTLED_S, seconds + 0.005, 0.01):
        stamp = round(1e6 * (time + 100.0))
        message = SimpleNamespace(timestamp=stamp, timestamp_sample=stamp, **usual | pose(time))
        now = Instant(time, EPOCH + time)
        found += [out for topic, out in stage.on_vehicle_odometry(message, now) if topic == ODOMETRY_TOPIC and time > -0.005]
    return found


def yaw(message):
    return yaw_of(attitude_of(message.pose.pose.orientation))


def numbers(vector):
    return vector.x, vector.y, vector.z


class TestPose:
    @pytest.mark.parametrize(('clockwise', 'expected'), [
        (0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-90.0, 180.0), (45.0, 45.0)])
    def test_heading_clockwise_from_north_is_yaw_counter_clockwise_from_east(self, clockwise, expected):
        message = odometry(lambda time: {'q': heading(clockwise)})[-1]
        assert math.cos(yaw(message) - math.radians(expected)) == pytest.approx(1.0)

    def test_position_velocity_and_rates(self):
        message = odometry(lambda time: {'q': heading(90.0), 'position': [1.0, 2.0, -3.0], 'velocity': [0.0, 4.0, 1.0],
                                         'angular_velocity': [0.1, 0.2, 0.3]})[-1]
        assert numbers(message.pose.pose.position) == pytest.approx((2.0, 1.0, 3.0))    # east, north, up
        assert numbers(message.twist.twist.linear) == pytest.approx((4.0, 0.0, -1.0))    # it flies east, where it looks
        assert numbers(message.twist.twist.angular) == pytest.approx((0.1, -0.2, -0.3))

    def test_velocity_in_the_body_frame(self):
        message = odometry(lambda time: {'q': heading(33.0), 'velocity': [1.0, 2.0, 3.0], 'velocity_frame': 3})[-1]
        assert numbers(message.twist.twist.linear) == pytest.approx((1.0, -2.0, -3.0))

    @pytest.mark.parametrize('fields', [{'q': [0.0] * 4}, {'q': [math.nan, 0.0, 0.0, 1.0]}, {'q': [2.0, 0.0, 0.0, 0.0]},
                                        {'pose_frame': 2}, {'position': [1e9, 0.0, 0.0]}])
    def test_what_is_no_pose_in_north_east_down_is_refused(self, fields):
        with pytest.raises(ValueError, match='attitude|pose'):
            odometry(lambda time: fields)


class TestContinuity:
    def fly(self, jump_deg=0.0, shift=(0.0, 0.0, 0.0), count=True):
        """A vehicle that turns clockwise at 0.4 rad/s and flies forward at 3 m/s, whose estimator corrects itself after 1 s."""
        truth = []

        def pose(time):
            turned, late = 0.5 + 0.4 * time, time >= 1.0
            place = 3.0 / 0.4 * np.array([math.sin(turned), -math.cos(turned), 0.0])    # NED
            error = Rotation.from_euler('z', late * jump_deg, degrees=True)
            if time > -0.005:
                truth.append((place[1], place[0], -place[2], math.pi / 2 - turned))
            return {'q': heading(math.degrees(turned) + late * jump_deg), 'velocity': [3.0, 0.0, 0.0], 'velocity_frame': 3,
                    'angular_velocity': [0.0, 0.0, 0.4], 'position': error.apply(place) + late * np.array(shift),
                    'reset_counter': 7 + (late and count)}
        found = odometry(pose, 2.0)
        return np.array([(*numbers(message.pose.pose.position), yaw(message)) for message in found]), np.array(truth)

    @pytest.mark.parametrize('jump', [30.0, -170.0, 179.0])
    def test_a_heading_reset_does_not_show(self, jump):
        out, truth = self.fly(jump, shift=(5.0, -2.0, 1.0))
        assert np.abs(np.angle(np.exp(1j * (out - truth)[:, 3]))).max() < 1e-3
        assert np.abs((out - truth)[:, :3]).max() < 1e-2    # velocity carried on over one step of 10 ms of a curve

    def test_without_a_count_a_jump_is_a_motion(self):
        out, _ = self.fly(30.0, count=False)
        assert np.ptp(np.diff(out[:, 3])) > 0.5

    def test_the_held_place_moves_with_the_estimate(self):
        rig = Rig()
        rig.place = (1.0, 2.0, -3.0)
        rig.hand_over()
        rig.run(0.6)
        for place, resets, shift, valid, held in (
                ((5.0, 2.0, -3.0), (0, 0), (0.0, 0.0, 0.0), True, (1.0, 2.0, -3.0)),     # it drifts, and is to come back
                ((6.0, 3.0, -3.0), (1, 0), (1.0, 1.0, 9.0), True, (2.0, 3.0, -3.0)),     # the estimator moved it by (1, 1)
                ((6.0, 3.0, -7.0), (1, 1), (1.0, 1.0, -4.0), True, (2.0, 3.0, -7.0)),    # and down
                ((7.0, 3.0, -7.0), (1, 1), (0.0, 0.0, 0.0), False, (2.0, 3.0, -7.0)),    # lost for a moment
                ((8.0, 3.0, -7.0), (3, 1), (1.0, 0.0, 9.0), True, (8.0, 3.0, -7.0))):    # the first of two shifts was missed
            rig.place, rig.resets, rig.shift, rig.valid = place, resets, shift, valid
            rig.run(0.1)
            assert rig.of('trajectory_setpoint')[-1].position == pytest.approx(held)
