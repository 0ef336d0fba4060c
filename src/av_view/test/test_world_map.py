"""The map, held against samples of the positions it describes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from geometry_msgs.msg import Point
from view_messages import NOW

from av_common.stamps import to_stamp
from av_interfaces.msg import RigPose, WorldTrack, WorldTrackArray
from av_view.rig_state import RigState, ellipse


def message(*tracks, rigs=()):
    made = WorldTrackArray(tracks=tracks, rigs=rigs)
    made.header.stamp = to_stamp(NOW)
    return made


def test_an_ellipse_holds_39_percent_of_the_positions():
    """Within one standard deviation of a normal distribution in the plane: 1 - exp(-1/2)."""
    covariance = np.array([[9.0, 4.0], [4.0, 4.0]])
    long, short, angle = ellipse(covariance)
    x, y = np.random.default_rng(1).multivariate_normal((0.0, 0.0), covariance, 20_000).T
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
    state.take('world', message(track, rigs=rigs))
    part = state.snapshot(NOW)['world']
    assert [rig['name'] for rig in part['rigs']] == ['left']
    (found,) = part['tracks']
    assert (found['x'], found['y'], found['z'], found['rigs']) == (10.0, 20.0, 5.0, ['left', 'right'])
    assert found['ellipse'][:2] == [2.0, 1.0] and abs(found['ellipse'][2]) % 180.0 == 0.0
    assert state.snapshot(NOW + 5.0)['world'] is None


@pytest.mark.parametrize('value', [math.nan, math.inf, -1e300, 1e300])
def test_numbers_that_json_cannot_hold_are_left_out(value):
    state = RigState()
    state.take('world', message(WorldTrack(position=Point(x=value)), WorldTrack(position_covariance=[value] * 9),
                            rigs=[RigPose(position=Point(y=value))]))
    json.dumps(state.snapshot(NOW)['world'], allow_nan=False)
    bad = message()
    bad.header.stamp.sec = -5
    with pytest.raises(ValueError, match='stamp'):
        state.take('world', bad)
