"""Frames and signs between PX4 and ROS, against geometry written out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from transforms3d.euler import euler2quat

from av_px4.commands import pitch_yaw
from av_px4.odometry import ContinuousPose, HeldPosition, Pose, pose_from_px4

QUADRANTS = [(40.0, 25.0), (130.0, 25.0), (-130.0, -20.0), (-40.0, -20.0)]   # pan (left +), tilt (up +) in deg


def px4_pose(heading_deg=0.0, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0), **frames):
    """A level vehicle, heading clockwise from north."""
    return pose_from_px4(position, euler2quat(0.0, 0.0, math.radians(heading_deg)), velocity, rate, **frames)


class TestPose:
    @pytest.mark.parametrize(('heading', 'yaw'), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-90.0, 180.0), (45.0, 45.0)])
    def test_heading_clockwise_from_north_is_yaw_counter_clockwise_from_east(self, heading, yaw):
        assert math.cos(px4_pose(heading).yaw - math.radians(yaw)) == pytest.approx(1.0)

    def test_position_and_velocity(self):
        pose = px4_pose(90.0, position=(1.0, 2.0, -3.0), velocity=(0.0, 4.0, 1.0), rate=(0.1, 0.2, 0.3))
        assert pose.position == pytest.approx([2.0, 1.0, 3.0])               # east, north, up
        assert pose.velocity_flu == pytest.approx([4.0, 0.0, -1.0])          # it flies east, where it looks, and sinks
        assert pose.rate_flu == pytest.approx([0.1, -0.2, -0.3])

    def test_velocity_in_the_body_frame(self):
        pose = px4_pose(33.0, velocity=(1.0, 2.0, 3.0), velocity_frame=3)
        assert pose.velocity_flu == pytest.approx([1.0, -2.0, -3.0])

    @pytest.mark.parametrize('attitude', [(0, 0, 0, 0), (math.nan, 0, 0, 1), (2, 0, 0, 0)])
    def test_what_is_no_attitude_is_refused(self, attitude):
        with pytest.raises(ValueError, match='attitude'):
            pose_from_px4((0, 0, 0), attitude, (0, 0, 0), (0, 0, 0))

    def test_a_pose_in_another_frame_is_refused(self):
        with pytest.raises(ValueError, match='pose_frame is 2'):
            px4_pose(pose_frame=2)


class TestGimbal:
    @pytest.mark.parametrize(('pan', 'tilt'), QUADRANTS)
    def test_signs_in_all_quadrants(self, pan, tilt):
        """To the left is negative yaw for MAVLink, up is positive pitch; and where the gimbal then looks is where it should."""
        pitch, yaw, *_ = pitch_yaw(math.radians(pan), math.radians(tilt), True).params
        assert (pitch, yaw) == pytest.approx((tilt, -pan))


class TestContinuity:
    def fly(self, jump_deg=0.0, shift=(0.0, 0.0, 0.0), at=1.0, count=True):
        """A vehicle that turns at 0.4 rad/s and flies forward at 3 m/s, whose estimator corrects itself once."""
        continuous, out, truth = ContinuousPose(), [], []
        for time in np.arange(0.0, 2.0, 0.01):
            yaw, late = 0.5 + 0.4 * time, time >= at
            place = 3.0 / 0.4 * np.array([math.sin(yaw), -math.cos(yaw), 0.0])
            turned = yaw + late * math.radians(jump_deg)
            c, s = math.cos(turned - yaw), math.sin(turned - yaw)
            estimated = np.array([c * place[0] - s * place[1], s * place[0] + c * place[1], place[2]]) + late * np.array(shift)
            pose = Pose(estimated, euler2quat(0.0, 0.0, turned), np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.4]))
            moved = continuous.add(time, pose, 7 + (late and count))
            out.append((*moved.position, moved.yaw))
            truth.append((*place, yaw))
        return np.array(out), np.array(truth), continuous

    @pytest.mark.parametrize('jump', [30.0, -170.0, 179.0])
    def test_a_heading_reset_does_not_show(self, jump):
        out, truth, continuous = self.fly(jump, shift=(5.0, -2.0, 1.0))
        assert continuous.resets == 1
        assert np.abs(np.angle(np.exp(1j * (out - truth)[:, 3]))).max() < 1e-3
        assert np.abs((out - truth)[:, :3]).max() < 1e-2   # velocity carried on over one step of 10 ms of a curve

    def test_without_a_count_a_jump_is_a_motion(self):
        out, _, continuous = self.fly(30.0, count=False)
        assert continuous.resets == 0 and np.ptp(np.diff(out[:, 3])) > 0.5

    def test_the_held_place_moves_with_the_estimate(self):
        place = HeldPosition()
        assert place.hold() is None
        place.update(np.array([1.0, 2.0, -3.0]), (0, 0), np.zeros(3), True)
        assert place.hold() == pytest.approx([1.0, 2.0, -3.0])
        place.update(np.array([5.0, 2.0, -3.0]), (0, 0), np.zeros(3), True)   # the vehicle drifts: it is to come back
        assert place.hold() == pytest.approx([1.0, 2.0, -3.0])
        place.update(np.array([6.0, 3.0, -3.0]), (1, 0), np.array([1.0, 1.0, 9.0]), True)  # the estimator moved it by (1, 1)
        assert place.hold() == pytest.approx([2.0, 3.0, -3.0])
        place.update(np.array([8.0, 3.0, -3.0]), (3, 0), np.array([1.0, 0.0, 9.0]), True)  # the first of two shifts was missed
        assert place.hold() == pytest.approx([8.0, 3.0, -3.0])
        place.update(np.array([6.0, 3.0, -3.0]), (3, 0), np.zeros(3), True)
        place.release()
        assert place.hold() == pytest.approx([6.0, 3.0, -3.0])
        place.release()
        place.update(np.array([6.0, 3.0, -3.0]), (1, 0), np.zeros(3), False)
        assert place.hold() is None
