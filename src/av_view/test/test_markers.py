"""Markers, held against geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from view_messages import CAMERA, NOW, bearing, heard, pose
from visualization_msgs.msg import Marker

from av_fusion.measurement.measurements import Cone, DoaMeasurement
from av_interfaces.msg import Track, TrackArray, WorldTrack, WorldTrackArray
from av_view.markers import REACH, markers, world_markers
from av_view.rig_state import RigState


def named(array, name):
    return [marker for marker in array.markers if marker.ns == name]


def points(marker):
    return np.array([(point.x, point.y, point.z) for point in marker.points])


def test_nothing_known_clears_what_was_shown():
    made = markers(RigState().snapshot(NOW), (), 'base_link').markers
    assert [marker.action for marker in made] == [Marker.DELETEALL]


def test_the_bearing_is_an_arrow_with_a_sector():
    state = RigState()
    state.cameras['camera'] = CAMERA
    state.on_bearing(bearing(azimuth=math.radians(30.0), azimuth_variance=math.radians(5.0) ** 2), NOW)
    made = markers(state.snapshot(NOW), (), 'body')
    (arrow,), (sector,) = named(made, 'bearing'), named(made, 'sigma')
    assert points(arrow)[1] == pytest.approx(REACH * np.array([math.cos(math.radians(30.0)), 0.5, 0.0]), abs=0.02)
    azimuths = np.degrees(np.arctan2(*points(sector)[points(sector).any(axis=1)][:, [1, 0]].T))
    assert (azimuths.min(), azimuths.max()) == pytest.approx((25.0, 35.0), abs=0.1)
    assert {marker.header.frame_id for marker in made.markers} == {'body'}
    assert len({marker.id for marker in made.markers}) == len(made.markers)


def test_a_cone_has_its_angle_to_the_axis_everywhere():
    axis = (0.0, math.cos(0.3), math.sin(0.3))
    doa = DoaMeasurement.of_cone(NOW, Cone(axis, 0.4, 0.01), 0.9)
    state = RigState()
    state.on_doa(heard()[0], [doa])
    (circle,) = named(markers(state.snapshot(NOW), state.sound, 'body'), 'cones')
    assert points(circle) @ np.array(axis) == pytest.approx(REACH * 0.4, abs=1e-9)
    assert points(circle)[0] == pytest.approx(points(circle)[-1])
    assert not named(markers(state.snapshot(NOW + 5.0), state.sound, 'body'), 'cones'), 'nothing is heard any more'


def test_truth_and_tracks_are_where_they_are():
    state = RigState()
    state.on_truth('rig', pose(1.0, 2.0, 0.0, yaw=math.pi / 2), NOW)
    state.on_truth('target', pose(1.0, 22.0, 0.0), NOW)
    state.on_doa(*heard())
    message = TrackArray(tracks=[Track(id=3, class_id='drone', azimuth=math.pi / 2, range=5.0)], selected=3)
    message.header.stamp.sec = int(NOW)
    state.take('tracks', message)
    made = markers(state.snapshot(NOW), state.sound, 'body')
    assert points(named(made, 'truth')[0])[0] == pytest.approx([20.0, 0.0, 0.0], abs=0.05)
    assert points(named(made, 'tracks')[0])[1] == pytest.approx([0.0, 5.0, 0.0], abs=1e-6)
    assert named(made, 'names')[0].text == '#3 drone' and len(named(made, 'sound')) == 2


def test_an_ellipsoid_has_the_covariance_of_the_position():
    turn = Rotation.from_euler('xyz', (0.3, -0.5, 1.2))
    covariance = turn.as_matrix() @ np.diag([9.0, 1.0, 0.25]) @ turn.as_matrix().T
    known = WorldTrack(id=5, position=Point(x=1.0, y=2.0, z=3.0), position_covariance=covariance.ravel(), positioned=True)
    unknown = [WorldTrack(id=6, position_covariance=[value] * 9, positioned=True) for value in (math.nan, 1e308)]
    (marker,) = world_markers(WorldTrackArray(header=Header(frame_id='map'), tracks=[known, *unknown, WorldTrack(id=7)]))
    q, half = marker.pose.orientation, 0.5 * np.array([marker.scale.x, marker.scale.y, marker.scale.z])
    axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    assert axes @ np.diag(half**2) @ axes.T == pytest.approx(covariance, abs=1e-6)
    assert (marker.pose.position.x, marker.header.frame_id, marker.type) == (1.0, 'map', Marker.SPHERE)
