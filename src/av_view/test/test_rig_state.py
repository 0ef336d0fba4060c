"""Messages in, a snapshot out, held against geometry."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from geometry_msgs.msg import Point
from rcl_interfaces.msg import Log
from view_messages import CAMERA, NOW, bearing, camera, heard, pose, seen
from vision_msgs.msg import Detection2DArray

from av_common.stamps import to_stamp
from av_interfaces.msg import (
    AzimuthPosterior,
    Bearing,
    DoaArray,
    FusionState,
    PointingCommand,
    RigPose,
    Track,
    TrackArray,
    WorldTrack,
    WorldTrackArray,
)
from av_view import COLUMNS, RigState, row_of


def test_without_messages_everything_is_unknown():
    snapshot = RigState().snapshot(NOW)
    assert snapshot['bearing'] is None and snapshot['sound'] is None and snapshot['tracks'] == []
    assert len(row_of(snapshot)) == len(COLUMNS)
    json.dumps(snapshot, allow_nan=False)


def test_a_bearing_in_degrees():
    state = RigState()
    state.cameras['camera'] = CAMERA
    state.on_bearing(bearing(), NOW)
    part = state.snapshot(NOW)['bearing']
    assert (part['azimuth'], part['sigma']) == pytest.approx((5.7, 1.1), abs=0.06)
    assert part['state'] == 'sound' and part['elevation'] is None and part['range'] is None
    assert state.snapshot(NOW)['delay'] == pytest.approx(0.2)
    assert state.snapshot(NOW)['heading'] == pytest.approx(math.degrees(0.4), abs=0.06)


@pytest.mark.parametrize('later', [5.0, -50.0])
def test_a_bearing_that_comes_no_more_is_not_shown_as_the_present_one(later):
    """Also that of a bag in whose place one of an earlier time is played, without targets and pictures."""
    state = RigState()
    state.on_bearing(bearing(), NOW)
    state.take('fusion', FusionState(header=bearing().header, reason='heard'))
    state.on_picture(NOW - 0.1, (640, 480), None)
    assert state.snapshot(NOW + 0.5)['fusion']['reason'] == 'heard' and state.snapshot(NOW + 0.5)['picture']
    snapshot = state.snapshot(NOW + later)
    assert not any(snapshot[part] for part in ('bearing', 'fusion', 'delay', 'picture'))


def test_sound_and_truth_that_come_no_more_are_not_shown_as_the_present_ones():
    """As of microphones that were unplugged, and of a bag in whose place another one, of another time, is played."""
    state = RigState()
    state.on_spectrum([-40.0], NOW)
    for name in ('rig', 'target', 'target_2'):
        state.on_truth(name, pose(10.0, 0.0, 5.0), NOW)
    snapshot = state.snapshot(NOW + 0.5)
    assert (snapshot['spectrum'], len(snapshot['truth'])) == ([-40.0], 2)
    for time in (NOW + 5.0, NOW - 50.0):
        snapshot = state.snapshot(time)
        assert (snapshot['spectrum'], snapshot['truth']) == ([], [])
    for name in ('rig', 'target'):
        state.on_truth(name, pose(20.0, 0.0, 5.0), NOW - 50.0)
    assert len(state.snapshot(NOW - 50.0)['truth']) == 1, 'that of the bag before is gone'


def test_a_bearing_without_a_target_shows_nothing():
    state = RigState()
    state.cameras['camera'] = CAMERA
    state.on_bearing(bearing(state=Bearing.STATE_NONE, azimuth=math.nan, azimuth_variance=math.inf), NOW)
    part = state.snapshot(NOW)['bearing']
    state.on_picture(NOW - 0.1, (640, 480), None)
    picture = state.snapshot(NOW)['picture']
    assert part['state'] == 'none' and picture['band'] == picture['line'] == [] and part['azimuth'] is None
    assert row_of(state.snapshot(NOW))[COLUMNS.index('fused')] is None


def test_boxes_are_shares_of_the_picture_with_their_azimuths():
    state = RigState()
    state.cameras['camera'] = CAMERA
    detections = seen(319.5, 239.5)
    state.take('detections', detections)
    assert state.snapshot(NOW)['picture'] is None
    state.on_picture(NOW - 0.1, (640, 480), detections)
    (box,), (direction,) = (state.snapshot(NOW)[part]['boxes'] for part in ('picture', 'sight'))
    assert (box['x'], box['width'], direction['azimuth']) == pytest.approx((0.468, 0.0625, 0.0), abs=1e-3)
    assert box['name'] == 'drone' and box['score'] == direction['score'] == 0.8
    assert state.snapshot(NOW + 5.0)['sight'] is None and state.snapshot(NOW + 5.0)['picture'] is None


def test_what_each_camera_sees_is_named():
    """The second one looks to the left."""
    state = RigState()
    state.cameras |= {'camera': CAMERA, 'second_camera': camera(math.pi / 2)}
    for topic in ('detections', 'second_camera/detections'):
        state.take(topic, seen(319.5, 239.5))
    first, second = state.snapshot(NOW)['sight']['boxes']
    assert (first['camera'], second['camera']) == ('camera', 'second_camera')
    assert (first['azimuth'], second['azimuth']) == pytest.approx((0.0, 90.0), abs=0.1)
    assert [one['azimuth'] for one in state.snapshot(NOW)['cameras']] == pytest.approx([0.0, 90.0], abs=0.1)


def test_what_is_drawn_on_a_picture_is_of_its_time():
    """The rig turns past a target: the bearing at the time of the picture is drawn, not the newest one."""
    state = RigState()
    state.cameras['camera'] = CAMERA
    for number in range(20):
        time = NOW - 1.0 + 0.05 * number
        state.on_bearing(bearing(azimuth=0.02 * number, stamp=time), time)
        message, measurements = heard((0.02 * number, math.pi - 0.02 * number))
        message.header.stamp = to_stamp(time)
        state.on_doa(message, measurements)
    for number in (4, 15):
        state.on_picture(NOW - 1.0 + 0.05 * number, (640, 480), None)
        picture = state.snapshot(NOW)['picture']
        assert picture['line'] == picture['heard'][0] == CAMERA.meridian(0.02 * number)
        assert picture['boxes'] == [] and not picture['detected']
        assert picture['age'] == pytest.approx(1.0 - 0.05 * number, abs=0.01)
    state.on_picture(NOW - 2.5, (640, 480), None)
    assert state.snapshot(NOW)['picture']['line'] == []


def test_truth_is_seen_from_the_rig():
    state = RigState()
    state.on_truth('target', pose(10.0, 10.0, 5.0), NOW)
    assert state.snapshot(NOW)['truth'] == []
    state.on_truth('rig', pose(10.0, 0.0, 5.0, yaw=math.pi / 2), NOW)
    assert state.snapshot(NOW)['truth'] == [{'azimuth': 0.0, 'elevation': 0.0, 'range': 10.0}]


def test_rows_hold_what_diagrams_show():
    state = RigState()
    state.cameras['camera'] = CAMERA
    state.on_doa(*heard())
    state.on_bearing(bearing(), NOW)
    detections = seen(319.5, 239.5)
    detections.detections += seen(0.0, 239.5, score=0.3).detections
    state.take('detections', detections)
    row = dict(zip(COLUMNS, row_of(state.snapshot(NOW)), strict=True))
    assert (row['sound'], row['mirror'], row['sight']) == pytest.approx((5.7, 174.3, 0.0), abs=0.06)
    assert row['state'] == 'sound' and row['sight_confidence'] == 0.8 and row['truth'] is None and row['level'] == -40.0


def test_tracks_with_their_names():
    state = RigState()
    track = Track(id=7, class_id='bird', azimuth=0.2, covariance_world=[0.01, 0.0, 0.0, 0.01], range=42.0, existence=0.9)
    message = TrackArray(tracks=[track], selected=7)
    message.header.stamp = to_stamp(NOW)
    state.take('tracks', message)
    (part,) = state.snapshot(NOW)['tracks']
    assert part['name'] == 'bird' and part['selected'] and part['range'] == 42.0


def posterior(*probability, stamp=NOW):
    message = AzimuthPosterior(probability=probability)
    message.header.stamp = to_stamp(stamp)
    return message


def test_the_posterior_is_relative_to_its_peak_while_it_is_recent():
    state = RigState()
    state.on_posterior(posterior(0.0, 0.2, 0.1))
    assert state.snapshot(NOW)['posterior'] == [0.0, 1.0, 0.5]
    assert state.snapshot(NOW + 5.0)['posterior'] == []
    state.on_posterior(posterior(0.0, 0.0))
    assert state.snapshot(NOW)['posterior'] == []
    for wrong in (posterior(math.nan, 1.0), posterior(-0.1, 1.0), posterior(*[0.1] * 10_000)):
        with pytest.raises(ValueError, match='sectors'):
            state.on_posterior(wrong)
    assert state.snapshot(NOW)['posterior'] == []


def test_marks_are_kept_and_those_of_a_later_time_wait_for_it():
    state = RigState()
    for number in range(100):
        state.on_mark(Log(stamp=to_stamp(NOW + number), msg=f'{number} ' + 'x' * 1000))
    marks = state.snapshot(NOW + 90.0)['marks']
    assert marks[-1][0] == NOW + 90.0 and marks[-1][1].startswith('90 x') and len(marks[-1][1]) < 100
    assert len(state.snapshot(NOW + 1000.0)['marks']) < 100


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 1e38])
def test_numbers_that_json_cannot_hold_are_unknown(value):
    state = RigState()
    state.cameras['camera'] = CAMERA
    fields = {name: value for name in Bearing.get_fields_and_field_types() if isinstance(getattr(Bearing(), name), float)}
    state.on_bearing(bearing(**{**fields, 'azimuth': 0.0}), NOW)
    with pytest.raises(ValueError, match='azimuth'):
        state.on_bearing(bearing(azimuth=math.nan), NOW)
    state.on_doa(*heard((value, value), value, value, value))
    state.take('fusion', FusionState(header=heard()[0].header, sound_confidence=value, visibility=value,
                                     front_probability=value))
    state.on_command(PointingCommand(pan=value, move_gimbal=True, header=heard()[0].header))
    state.take('detections', seen(value, value, value, value, value))
    state.on_picture(NOW - 0.1, (640, 480), seen(value, value, value, value, value))
    state.on_spectrum([0.0], NOW)
    state.on_truth('rig', pose(0.0, 0.0, 0.0), NOW)
    state.on_truth('target', pose(value, value, 0.0), NOW)
    message = TrackArray(tracks=[Track(azimuth=value, elevation_world=value, range=value, covariance_world=[value] * 4)])
    message.header.stamp = to_stamp(NOW)
    state.take('tracks', message)
    snapshot = state.snapshot(NOW)
    json.dumps([snapshot, row_of(snapshot)], allow_nan=False)
    assert snapshot['bearing']['sigma'] is None


@pytest.mark.parametrize(('kind', 'take'), [
    (DoaArray, lambda state, message: state.on_doa(message, ())), (PointingCommand, RigState.on_command),
    (Detection2DArray, lambda state, message: state.take('detections', message))])
def test_impossible_stamps_are_refused(kind, take):
    message = kind()
    message.header.stamp.sec = -5
    state = RigState()
    with pytest.raises(ValueError, match='stamp'):
        take(state, message)
    state.snapshot(NOW)


def test_undefined_states_and_modes_are_refused():
    state = RigState()
    with pytest.raises(ValueError, match='99'):
        state.on_bearing(bearing(state=99), NOW)
    with pytest.raises(ValueError, match='99'):
        state.on_command(PointingCommand(mode=99))
    assert state.snapshot(NOW)['bearing'] is None


def world(*tracks, rigs=()):
    made = WorldTrackArray(tracks=tracks, rigs=rigs)
    made.header.stamp = to_stamp(NOW)
    return made


def test_an_ellipse_holds_39_percent_of_the_positions():
    """Within one standard deviation of a normal distribution in the plane: 1 - exp(-1/2)."""
    covariance, state = np.array([[9.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 1.0]]), RigState()
    state.take('world', world(WorldTrack(position_covariance=covariance.ravel(), positioned=True)))
    long, short, angle = state.snapshot(NOW)['world']['tracks'][0]['ellipse']
    x, y = np.random.default_rng(1).multivariate_normal((0.0, 0.0), covariance[:2, :2], 20_000).T
    turn = math.radians(angle)
    along, across = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
    assert np.mean((along / long) ** 2 + (across / short) ** 2 < 1.0) == pytest.approx(1.0 - math.exp(-0.5), abs=0.015)
    assert np.std(along) == pytest.approx(long, rel=0.02) and np.std(across) == pytest.approx(short, rel=0.02)


def test_tracks_and_rigs_have_their_places_while_they_are_recent():
    state = RigState()
    covariance = [4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 9.0]
    track = WorldTrack(id=3, class_id='drone', position=Point(x=10.0, y=20.0, z=5.0), position_covariance=covariance,
                       positioned=True, rigs=['left', 'right'])
    rigs = [RigPose(name='left', position=Point(x=1.0)), RigPose(name='lost', position=Point(x=math.nan))]
    state.take('world', world(track, rigs=rigs))
    part = state.snapshot(NOW)['world']
    assert [rig['name'] for rig in part['rigs']] == ['left']
    (found,) = part['tracks']
    assert (found['x'], found['y'], found['z'], found['rigs']) == (10.0, 20.0, 5.0, ['left', 'right'])
    assert found['ellipse'][:2] == [2.0, 1.0] and abs(found['ellipse'][2]) % 180.0 == 0.0
    assert state.snapshot(NOW + 5.0)['world'] is None


@pytest.mark.parametrize('value', [math.nan, math.inf, -1e300, 1e300])
def test_places_that_json_cannot_hold_are_left_out(value):
    state = RigState()
    state.take('world', world(WorldTrack(position=Point(x=value)), WorldTrack(position_covariance=[value] * 9),
                            rigs=[RigPose(position=Point(y=value))]))
    json.dumps(state.snapshot(NOW)['world'], allow_nan=False)
    bad = world()
    bad.header.stamp.sec = -5
    with pytest.raises(ValueError, match='stamp'):
        state.take('world', bad)
