"""Messages of the rig in, what is reported out: azimuths of a compass, unknown values, and what is left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from av_common.freshness import Instant
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, FusionState, Track, TrackArray, WorldTrack, WorldTrackArray
from av_reports import Place
from av_reports.stage import MOST_TRACKS, SILENT_S, ReportSettings, ReportStage

TIME = 1000.0


def targets(**values):
    track = Track(**{
        'id': 3, 'existence': 0.9, 'drone_probability': 0.8, 'class_id': 'drone', 'azimuth': 0.5, 'azimuth_world': 0.2,
        'elevation_world': math.radians(60.0), 'covariance_world': np.array([4e-4, 0.0, 0.0, 9e-4], np.float32),
        'hemisphere_probability': 0.95, 'resolved': True, 'last_heard': to_stamp(TIME - 0.3), **values})
    return TrackArray(header=Header(stamp=to_stamp(TIME)), tracks=[track])


def bearings(message, attitude_known=True, **settings):
    """What is reported of a rig's targets."""
    stage = ReportStage(ReportSettings(**settings))
    stage.on_bearing(Bearing(attitude_known=attitude_known))
    stage.on_targets(message, Instant(0.0, TIME), 0.0)
    return stage.situation(Instant(0.1, TIME), 0.0).tracks


def positions(message, **settings):
    """What is reported of the targets of a network."""
    stage = ReportStage(ReportSettings(positions=True, **settings))
    stage.on_network_tracks(message, Instant(0.0, TIME), 0.0)
    return stage.situation(Instant(0.1, TIME), 0.0).tracks


def test_azimuths_are_clockwise_from_north_from_a_known_heading_or_from_ahead():
    message = targets()
    world, = bearings(message, heading=math.radians(10.0))
    assert world.azimuth == pytest.approx(math.pi / 2 - 0.2) and world.north
    surveyed, = bearings(message, attitude_known=False, heading=math.radians(10.0))
    assert surveyed.azimuth == pytest.approx((math.radians(10.0) - 0.5) % math.tau)
    ahead, = bearings(message, north=False)
    assert ahead.azimuth == pytest.approx(math.tau - 0.5) and not ahead.north


def test_the_error_of_the_azimuth_grows_with_the_elevation():
    track, = bearings(targets())
    assert track.azimuth_sigma == pytest.approx(0.02 / 0.5, rel=1e-3) and track.elevation_sigma == pytest.approx(0.03, rel=1e-3)
    steep, = bearings(targets(elevation_world=math.pi / 2))
    assert steep.azimuth_sigma <= math.pi


def test_what_is_unknown_is_nan_and_what_is_meaningless_is_left_out():
    pair, = bearings(targets(covariance_world=np.array([4e-4, 0, 0, math.inf], np.float32)))
    assert math.isnan(pair.elevation) and pair.azimuth_sigma == pytest.approx(0.02, rel=1e-3)
    for bad in ({'azimuth_world': math.nan}, {'covariance_world': np.full(4, math.inf, np.float32)}, {'existence': math.nan},
                {'covariance_world': np.full(4, -1.0, np.float32)}):
        assert bearings(targets(**bad)) == ()
    odd, = bearings(targets(hemisphere_probability=math.nan, drone_probability=7.0, elevation_world=100.0, class_id='x' * 5000))
    assert odd.front_back == 0.5 and math.isnan(odd.drone_probability) and math.isnan(odd.elevation) and len(odd.class_id) == 64


def test_times_are_utc_and_stay_as_they_arrived():
    """Also where the clocks, read one after the other, seem to go back, and behind a bag, whose clock stands still."""
    stage = ReportStage(ReportSettings(north=False))
    stage.on_targets(targets(last_seen=to_stamp(TIME - 0.1)), Instant(0.0, TIME), 1e9)
    for number, drift in enumerate((0.0, -1e-5, 1.2)):
        track, = stage.situation(Instant(0.2 * number, TIME), 1e9 + drift).tracks
        assert (track.time, track.measured) == pytest.approx((1e9 + TIME, 1e9 + TIME - 0.1), abs=1e-6)


@pytest.mark.parametrize('values, taken', [
    ({}, True), ({'existence': 0.4}, False), ({'resolved': False}, False), ({'drone_probability': 0.3}, False),
    ({'drone_probability': math.nan}, True), ({'last_heard': to_stamp(TIME - 5.0)}, False),
    ({'last_heard': to_stamp(0.0)}, False),
])
def test_what_is_reported(values, taken):
    assert bool(bearings(targets(**values))) is taken
    assert bool(bearings(targets(**values), only_drones=False)) is (taken or values.get('drone_probability') == 0.3)


def network(**values):
    track = WorldTrack(**{
        'id': 7, 'existence': 0.9, 'drone_probability': 0.8, 'class_id': 'drone', 'position': Point(x=0.0, y=1000.0, z=50.0),
        'position_covariance': np.diag([4.0, 9.0, 1.0]).ravel(), 'velocity': Vector3(x=3.0, y=-1.0, z=0.5), 'positioned': True,
        'velocity_covariance': np.diag([0.04, 0.09, 0.01]).ravel(), 'rigs': ['left', 'right'], 'measured': to_stamp(TIME - 0.1),
        **values})
    return WorldTrackArray(header=Header(stamp=to_stamp(TIME), frame_id='map'), latitude=51.5, longitude=-0.12, altitude=30.0,
                           tracks=[track])


def test_positions_of_a_network_are_on_the_earth():
    track, = positions(network())
    assert track.latitude - 51.5 == pytest.approx(1000.0 / 111258.0, rel=1e-4) and track.longitude == pytest.approx(-0.12)
    assert track.altitude == pytest.approx(80.0 + 1000.0**2 / (2 * 6.37e6), abs=0.01)    # the earth falls away by d^2 / 2R
    assert np.array(track.covariance) == pytest.approx(np.diag([4.0, 9.0, 1.0]), abs=1e-2)
    assert track.velocity == pytest.approx((3.0, -1.0, 0.5), abs=1e-3)
    assert track.velocity_sigma == pytest.approx((0.2, 0.3, 0.1))


def test_positions_that_are_none_are_left_out_or_refused():
    for values in ({'positioned': False}, {'position': Point(x=math.nan)}, {'position': Point(x=1e300, z=-1e300)},
                   {'velocity': Vector3(x=1e300)}, {'position_covariance': np.diag([1e300, 1.0, 1.0]).ravel()},
                   {'existence': math.inf},
                   {'position_covariance': np.diag([4.0, -9.0, 1.0]).ravel()}):
        assert positions(network(**values)) == ()
    odd, = positions(network(drone_probability=math.inf, class_id='x' * 5000))
    assert math.isnan(odd.drone_probability) and len(odd.class_id) == 64
    flat, = positions(network(position_covariance=np.diag([4.0, 0.0, 0.0]).ravel()))
    assert flat.sigma == pytest.approx((2.0, 0.0, 0.0), abs=1e-2)
    nowhere = network()
    nowhere.latitude = math.nan
    with pytest.raises(ValueError, match="origin of 'map'"):
        positions(nowhere)


def test_a_fix_is_a_place():
    def placed():
        stage.on_fix(fix, Instant(0.0, TIME))
        return stage.situation(Instant(0.1, TIME), 0.0).place

    fix = NavSatFix(status=NavSatStatus(status=NavSatStatus.STATUS_FIX), latitude=51.5, longitude=-0.12, altitude=30.0,
                    position_covariance=np.diag([2.25, 2.25, 9.0]).ravel(),
                    position_covariance_type=NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN)
    stage = ReportStage(ReportSettings())
    assert placed() == (51.5, -0.12, 30.0, 1.5, False)
    fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_UNKNOWN
    assert math.isnan(placed().sigma)
    lost = NavSatStatus(status=NavSatStatus.STATUS_NO_FIX)
    for name, value in (('latitude', math.nan), ('latitude', 91.0), ('longitude', 1e300), ('status', lost)):
        setattr(fix, name, value)
        with pytest.raises(ValueError, match='no fix'):
            placed()
        fix.latitude, fix.longitude = 51.5, -0.12


def test_of_very_many_targets_the_likeliest_are_reported():
    stage = ReportStage(ReportSettings(north=False))
    message = targets()
    message.tracks = [targets(id=number, existence=0.5 + 1e-4 * number).tracks[0] for number in range(1, 1001)]
    stage.on_targets(message, Instant(0.0, TIME), 0.0)
    assert {track.id for track in stage.situation(Instant(0.1, TIME), 0.0).tracks} == set(range(1001 - MOST_TRACKS, 1001))
    assert stage.situation(Instant(SILENT_S + 0.1, TIME), 0.0).silent


def test_without_a_heading_nothing_is_reported_and_the_reason_is_given():
    stage = ReportStage(ReportSettings())
    stage.on_targets(targets(), Instant(0.0, TIME), 0.0)
    situation = stage.situation(Instant(0.1, TIME), 0.0)
    assert situation.tracks == () and 'heading is not known' in situation.problems[0] and situation.place is None
    stage.on_bearing(Bearing(attitude_known=True))
    stage.on_targets(targets(), Instant(0.2, TIME), 0.0)
    stage.on_state(FusionState(missing=['doa']))
    assert stage.situation(Instant(0.3, TIME), 0.0).problems == ('no doa',)
    assert len(stage.situation(Instant(0.3, TIME), 0.0).tracks) == 1


def test_a_place_of_the_receiver_ages_and_a_surveyed_one_does_not():
    fix = NavSatFix(status=NavSatStatus(status=NavSatStatus.STATUS_FIX), latitude=51.5)
    stage = ReportStage(ReportSettings())
    stage.on_fix(fix, Instant(0.0, TIME))
    assert stage.situation(Instant(9.9, TIME), 0.0).place.latitude == 51.5
    assert stage.situation(Instant(10.1, TIME), 0.0).place is None
    surveyed = ReportStage(ReportSettings(place=Place(1.0, 2.0, 3.0)))
    surveyed.on_fix(fix, Instant(0.0, TIME))
    assert surveyed.situation(Instant(99.0, TIME), 0.0).place == Place(1.0, 2.0, 3.0)
