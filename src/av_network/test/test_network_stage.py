"""The network stage with messages: positions, cues, places of rigs, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from av_common.stamps import to_stamp
from av_interfaces.msg import RigReport, TargetDirection
from av_network import RigSettings
from av_network.stage import FIX, ODOMETRY, SURVEYED, NetworkStage, RigPlace

PLACES = {'left': np.array([-20.0, 0.0, 1.5]), 'right': np.array([20.0, 0.0, 1.5]), 'third': np.array([0.0, 20.0, 1.5])}
DRONE = np.array([3.0, 55.0, 22.0])
START = 10_000.0
FOUND = NavSatFix(status=NavSatStatus(status=0), latitude=48.001, longitude=11.0, altitude=510.0)


def report(rig, time, heading=0.0, **values):
    """A rig's message about the drone, seen; `heading` is what the rig's own heading is short of."""
    d = DRONE - PLACES[rig]
    one = TargetDirection(id=4, existence=0.9, drone_probability=0.8, class_id='drone', seen=True, resolved=True,
                          azimuth=math.atan2(d[1], d[0]) - heading, elevation=math.atan2(d[2], math.hypot(d[0], d[1])),
                          information=np.array([1e4, 0.0, 1e4], np.float32), measured=to_stamp(time))
    for name, value in values.items():
        setattr(one, name, value)
    return RigReport(version=RigReport.VERSION, header=Header(stamp=to_stamp(time), frame_id='base_link'), directions=[one],
                     position=np.full(3, np.nan, np.float32))


def stage_of(names=('left', 'right'), source=SURVEYED, clock_sigma=0.001, **settings):
    stage = NetworkStage(**settings)
    for index, name in enumerate(names):
        stage.join(RigSettings(name, 0.01, clock_sigma if index else 0.0), RigPlace(source, PLACES[name]))
    return stage


def run(stage, names, seconds=5.0, **values):
    for step in range(round(4 * seconds)):
        time = START + 0.25 * step
        for name in names:
            stage.on_report(name, report(name, time, **values), time + 0.02)
        message = stage.output(time + 0.05)
    return message


def test_two_rigs_give_a_position():
    """Within its stated deviation, named after both rigs, with the time of capture."""
    message = run(stage_of(), ('left', 'right'))
    (track,) = message.tracks
    found = np.array([track.position.x, track.position.y, track.position.z])
    covariance = track.position_covariance.reshape(3, 3)
    assert track.positioned and list(track.rigs) == ['left', 'right'] and track.class_id == 'drone'
    assert (found - DRONE) @ np.linalg.solve(covariance, found - DRONE) < 7.8
    assert START + 4.0 < track.measured.sec + 1e-9 * track.measured.nanosec <= START + 4.75
    assert math.isnan(message.latitude) and [rig.name for rig in message.rigs] == ['left', 'right']


def test_one_rig_gives_a_direction():
    """The distance is not known, and the covariance says so."""
    message = run(stage_of(), ('left',))
    (track,) = message.tracks
    line = DRONE - PLACES['left']
    line = line / np.linalg.norm(line)
    covariance = track.position_covariance.reshape(3, 3)
    assert not track.positioned and list(track.rigs) == ['left']
    assert math.sqrt(line @ covariance @ line) > 50.0 and math.sqrt(np.linalg.eigvalsh(covariance)[0]) < 2.0


def test_a_rig_without_the_target_is_told_where_it_is():
    """By its own heading."""
    stage = stage_of(('left', 'right', 'third'))
    run(stage, ('left', 'right'))
    cues = stage.cues(START + 5.0)
    assert set(cues) == {'third'}
    point = cues['third'].point
    assert np.linalg.norm(PLACES['third'] + [point.x, point.y, point.z] - DRONE) < 1.0


def test_a_rig_that_does_not_know_the_side_is_told():
    """Whether the side that it reports is the right one or not; what it reports for certain is not told again."""
    for mirrored in (False, True):
        stage = stage_of(('left', 'right', 'third'))
        for step in range(20):
            time = START + 0.25 * step
            for name in ('left', 'right'):
                stage.on_report(name, report(name, time), time + 0.02)
            unsure = report('third', time, resolved=False)
            if mirrored:
                unsure.directions[0].azimuth = -unsure.directions[0].azimuth
            stage.on_report('third', unsure, time + 0.02)
            stage.output(time + 0.05)
        point = stage.cues(START + 5.0)['third'].point
        assert np.linalg.norm(PLACES['third'] + [point.x, point.y, point.z] - DRONE) < 1.0
    stage = stage_of(('left', 'right', 'third'))
    run(stage, ('left', 'right', 'third'))
    assert not stage.cues(START + 5.0)


def test_a_position_that_is_lost_is_not_reported():
    """A target that no rig reports any more is soon not published, while its track lives."""
    stage = stage_of()
    run(stage, ('left', 'right'))
    assert stage.output(START + 5.5).tracks[0].positioned
    assert not stage.output(START + 8.5).tracks and stage.tracker.states(START + 8.5)


def test_a_rig_that_is_always_too_late_delays_nobody():
    """Its clock is behind, or its link is slow: it is named, and the others' positions are as fresh as without it."""
    stage = stage_of(('left', 'right', 'third'))
    for step in range(40):
        time = START + 0.25 * step
        for name in ('left', 'right'):
            stage.on_report(name, report(name, time), time + 0.02)
        stage.on_report('third', report('third', time - 1.3), time + 0.03)
        message = stage.output(time + 0.05)
    (track,) = message.tracks
    assert track.positioned and list(track.rigs) == ['left', 'right']
    assert track.measured.sec + 1e-9 * track.measured.nanosec == pytest.approx(time, abs=0.26)
    assert stage.queue.late['third'] > 30


def test_no_cue_without_recent_measurements():
    """A prediction tells nobody where to look."""
    stage = stage_of(('left', 'right', 'third'))
    run(stage, ('left', 'right'))
    assert stage.tracker.states(START + 7.0) and not stage.cues(START + 7.0)


def test_positions_by_odometry_and_by_satellites():
    """Odometry counts from the rig's place; a fix is placed by the datum; before either, nothing is used."""
    stage = stage_of(source=ODOMETRY)
    run(stage, ('left', 'right'), 1.0)
    assert stage.rigs['left'].unplaced
    moved = report('left', START + 2.0)
    moved.position[0] = 2.0
    stage.on_report('left', moved, START + 2.0)
    assert math.isnan(stage.output(START + 2.0).rigs[0].position.x), 'a position with unknown parts is not used'
    moved.position[1:] = 0.0
    stage.on_report('left', moved, START + 2.0)
    assert stage.output(START + 2.0).rigs[0].position.x == -18.0
    stage.on_report('left', report('left', START + 2.5), START + 2.5)
    assert math.isnan(stage.output(START + 2.5).rigs[0].position.x), 'without odometry, its place is not known any more'
    datum = (48.0, 11.0, 500.0)
    stage = stage_of(source=FIX, datum=datum)
    with pytest.raises(ValueError, match='left has no fix'):
        stage.on_fix('left', NavSatFix(), START)
    stage.on_fix('left', FOUND, START)
    place = stage.output(START).rigs[0].position
    assert [place.x, place.y, place.z] == pytest.approx([0.0, 111.2, 10.0], abs=0.1)


@pytest.mark.parametrize('later', [10.1, -3600.0])
def test_a_place_by_satellites_is_not_used_for_ever(later):
    """A rig that has lost them may be elsewhere; nor does a clock that is set back make its place last."""
    datum = (48.0, 11.0, 500.0)
    stage = stage_of(source=FIX, datum=datum)
    for time in (START, START + later):
        stage.on_fix('left', FOUND, time)
        stage.on_report('left', report('left', time), time)
        assert math.isfinite(stage.output(time + 0.1).rigs[0].position.x) and not stage.rigs['left'].unplaced
    stage.output(START + 2.0 * later)
    stage.on_report('left', report('left', START + 2.0 * later), START + 2.0 * later)
    assert math.isnan(stage.output(START + 2.0 * later).rigs[0].position.x) and stage.rigs['left'].unplaced == 1


@pytest.mark.parametrize('values', [{'latitude': 91.0}, {'longitude': math.nan}, {'altitude': 1e300}, {'altitude': math.inf}])
def test_a_fix_that_is_not_on_the_globe_is_refused(values):
    stage = stage_of(source=FIX, datum=(48.0, 11.0, 500.0))
    wrong = NavSatFix(status=FOUND.status, **{'latitude': 48.0, 'longitude': 11.0, 'altitude': 500.0, **values})
    with pytest.raises(ValueError, match='left has no fix'):
        stage.on_fix('left', wrong, START)
    assert math.isnan(stage.output(START).rigs[0].position.x)


@pytest.mark.parametrize('values', [
    {'azimuth': math.nan}, {'elevation': math.inf}, {'azimuth': 1e30}, {'measured': to_stamp(0.0)},
    {'measured': to_stamp(START + 99.0)},
    {'information': np.full(3, np.nan, np.float32)}, {'information': np.array([-1, 0, 1], np.float32)},
    {'information': np.array([math.inf, 0, 1], np.float32)}, {'information': np.zeros(3, np.float32)},
    {'existence': 0.1}, {'existence': math.nan}])
def test_impossible_tracks_are_left_out(values):
    """They neither raise nor become targets."""
    assert not run(stage_of(), ('left', 'right'), **values).tracks


def test_singular_or_huge_information_is_not_believed():
    """A single angle, a correlation of 1 or more, or no error at all gives a finite position."""
    for information in ([1e4, 1e4, 1e4], [1e4, 3e4, 1e4], [1e30, 0.0, 1e30], [1e17, 1e17, 1e17], [1e4, 0.0, 0.0]):
        message = run(stage_of(), ('left', 'right'), information=np.array(information, np.float32))
        for track in message.tracks:
            assert np.all(np.linalg.eigvalsh(track.position_covariance.reshape(3, 3)) > 0.0)


def test_the_future_is_refused_beyond_the_uncertainty_of_the_clock():
    """The first rig has the reference clock: 0.1 s for the step of a timer. The other one's is known within 0.05 s."""
    stage = stage_of(clock_sigma=0.05)
    for name, ahead in (('left', 0.09), ('right', 0.29)):
        stage.on_report(name, report(name, START + ahead), START)
        with pytest.raises(ValueError, match=rf'stamp of {name} \+0.32 s from its arrival'):
            stage.on_report(name, report(name, START + 0.32), START)


def test_stamps_of_another_clock_and_too_many_tracks_are_refused():
    """With the rig's name in the error."""
    stage = stage_of()
    with pytest.raises(ValueError, match='stamp of left'):
        stage.on_report('left', report('left', START), START + 60.0)
    message = report('left', START)
    message.directions = message.directions * 51
    with pytest.raises(ValueError, match='51 targets of left'):
        stage.on_report('left', message, START)
    message.directions = message.directions[:2]
    with pytest.raises(ValueError, match='several directions of one target of left'):
        stage.on_report('left', message, START)


def test_probabilities_that_are_none_are_not_passed_on():
    """From one rig, as a direction, and from two, as a position."""
    for names in (('left',), ('left', 'right')):
        (track,) = run(stage_of(), names, existence=1e30, drone_probability=7.0).tracks
        assert track.existence <= 1.0 and math.isnan(track.drone_probability)


def test_what_a_target_is_stays_known_when_the_rig_that_knew_it_follows_something_else():
    """Far from the target; the others have never told what they see."""
    names = ('left', 'right', 'third')
    stage = stage_of(names)
    for step in range(40):
        time = START + 0.25 * step
        for name in names:
            values = {'drone_probability': 0.1 if name == 'left' else math.nan}
            if name == 'left' and step >= 20:
                values |= {'azimuth': -2.0, 'drone_probability': math.nan}
            stage.on_report(name, report(name, time, **values), time + 0.02)
        message = stage.output(time + 0.05)
    (track,) = [each for each in message.tracks if each.positioned]
    assert list(track.rigs) == ['right', 'third'] and track.drone_probability == pytest.approx(0.1)


def test_tracks_are_in_the_order_of_their_ids_and_of_one_rig_at_most_as_many_as_it_may_have():
    """A rig makes ids up, and has directions before two rigs have a target."""
    stage = stage_of(('left', 'right', 'third'))
    for step in range(40):
        time = START + 0.25 * step
        for name in ('left', 'right'):
            stage.on_report(name, report(name, time), time)
        made_up = report('third', time)
        made_up.directions = [report('third', time, id=100 + (50 * step + k if k else 0), azimuth=-2.0 + 0.01 * k).directions[0]
                              for k in range(50)]
        stage.on_report('third', made_up, time)
        tracks = stage.output(time).tracks
        assert [track.id for track in tracks] == sorted(track.id for track in tracks) and len(tracks) <= 52


def test_no_rig_reports_faster_than_it_may():
    """In whatever order."""
    stage = stage_of()
    for step in range(1000):
        stage.on_report('left', report('left', START - 0.001 * step), START)
    assert len(list(stage.queue.ready(START + 9.0))) == 25 and stage.queue.late == {'left': 975}


def test_a_clock_that_is_set_back_starts_anew():
    """Ids are not used again."""
    stage = stage_of()
    first = run(stage, ('left', 'right')).tracks[0].id
    for step in range(20):
        time = START - 500.0 + 0.25 * step
        for name in ('left', 'right'):
            stage.on_report(name, report(name, time), time + 0.02)
        message = stage.output(time + 0.05)
    assert message.tracks[0].id > first


def test_a_rig_joins_while_the_network_runs():
    """A target of one rig gets a position when a second one joins by odometry; its track keeps headings and clocks apart."""
    stage = stage_of(('left',))
    assert not run(stage, ('left',)).tracks[0].positioned
    stage.join(RigSettings('right', 0.05, 0.01), RigPlace(ODOMETRY, np.zeros(3)))
    with pytest.raises(ValueError, match='right takes part already'):
        stage.join(RigSettings('right'), RigPlace(ODOMETRY, np.zeros(3)))
    for step in range(20, 50):
        time = START + 0.25 * step
        for name in ('left', 'right'):
            message = report(name, time)
            message.position = PLACES[name].astype(np.float32)
            stage.on_report(name, message, time + 0.02)
        world = stage.output(time + 0.05)
    (track,) = [one for one in world.tracks if one.positioned]
    found = np.array([track.position.x, track.position.y, track.position.z])
    assert np.linalg.norm(found - DRONE) < 3.0 and list(track.rigs) == ['left', 'right']
    assert [rig.name for rig in world.rigs] == ['left', 'right'] and world.rigs[1].heading_sigma < 0.06
