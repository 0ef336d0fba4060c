"""Messages of the rig as plain data: azimuths of a compass, unknown values, and what is left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from std_msgs.msg import Header

from av_common.stamps import to_stamp
from av_interfaces.msg import Track, TrackArray
from av_reports.contacts import Selection
from av_reports.messages import bearing_tracks

TIME = 1000.0


def targets(**values):
    track = Track(**{
        'id': 3, 'existence': 0.9, 'drone_probability': 0.8, 'class_id': 'drone', 'azimuth': 0.5, 'azimuth_world': 0.2,
        'elevation_world': math.radians(60.0), 'covariance_world': np.array([4e-4, 0.0, 0.0, 9e-4], np.float32),
        'hemisphere_probability': 0.95, 'resolved': True, 'last_heard': to_stamp(TIME - 0.3), **values})
    return TrackArray(header=Header(stamp=to_stamp(TIME)), tracks=[track], selected=3)


def test_azimuths_are_clockwise_from_north_from_a_known_heading_or_from_ahead():
    message = targets()
    world, = bearing_tracks(message, None, True)
    assert world.azimuth == pytest.approx(math.pi / 2 - 0.2) and world.north
    surveyed, = bearing_tracks(message, math.radians(10.0), True)
    assert surveyed.azimuth == pytest.approx((math.radians(10.0) - 0.5) % math.tau)
    ahead, = bearing_tracks(message, None, False)
    assert ahead.azimuth == pytest.approx(math.tau - 0.5) and not ahead.north


def test_the_error_of_the_azimuth_grows_with_the_elevation():
    track, = bearing_tracks(targets(), None, True)
    assert track.azimuth_sigma == pytest.approx(0.02 / 0.5, rel=1e-3) and track.elevation_sigma == pytest.approx(0.03, rel=1e-3)
    steep, = bearing_tracks(targets(elevation_world=math.pi / 2), None, True)
    assert steep.azimuth_sigma <= math.pi


def test_what_is_unknown_is_nan_and_what_is_meaningless_is_left_out():
    pair, = bearing_tracks(targets(covariance_world=np.array([4e-4, 0, 0, math.inf], np.float32)), None, True)
    assert math.isnan(pair.elevation) and pair.azimuth_sigma == pytest.approx(0.02, rel=1e-3)
    for bad in ({'azimuth_world': math.nan}, {'covariance_world': np.full(4, math.inf, np.float32)}, {'existence': math.nan},
                {'covariance_world': np.full(4, -1.0, np.float32)}):
        assert list(bearing_tracks(targets(**bad), None, True)) == []


def test_times_are_utc():
    track, = bearing_tracks(targets(last_seen=to_stamp(TIME - 0.1)), None, True, to_utc=1e9)
    assert (track.time, track.measured) == pytest.approx((1e9 + TIME, 1e9 + TIME - 0.1)) and track.selected


@pytest.mark.parametrize('values, taken', [
    ({}, True), ({'existence': 0.4}, False), ({'resolved': False}, False), ({'drone_probability': 0.3}, False),
    ({'drone_probability': math.nan}, True), ({'last_heard': to_stamp(TIME - 5.0)}, False),
    ({'last_heard': to_stamp(0.0)}, False),
])
def test_what_is_reported(values, taken):
    track, = bearing_tracks(targets(**values), None, True)
    assert Selection().takes(track, TIME) is taken
    assert Selection(0.0, 1e4, False, True).takes(track, TIME)
