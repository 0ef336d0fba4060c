"""Figures of runs whose errors are known beforehand."""

from __future__ import annotations

import json
import math
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation, Slerp

from av_bags import topics
from av_common.stamps import to_stamp
from av_common.track import State
from av_evaluation.metrics.results import metrics_of
from av_evaluation.metrics.run_log import RunLog, Series
from av_evaluation.runs.evaluation import SENSES, describe, evaluate_run


def circle_log(error_deg: float = 2.0) -> RunLog:
    """A target that circles a turning rig; the bearing has a constant error, sight covers the first half."""
    log = RunLog()
    for k in range(200):
        t = 1000.0 + 0.1 * k
        world, yaw = 0.3 * 0.1 * k, 0.1 * 0.1 * k
        body = world - yaw
        log.target.add(t, 10.0 * math.cos(world), 10.0 * math.sin(world), 3.0)
        log.rig.add(t, 0.0, 0.0, 0.0, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
        log.fused.add(t, body + math.radians(error_deg), 0.05, State.VISUAL_ACTIVE if k < 100 else State.ACOUSTIC_ACTIVE,
                      k > 20, 0.1)
        log.sound.add(t, math.pi - body, body + math.radians(5.0), 0.9, 0.02)
        log.sight.add(t, body if k < 100 else math.nan, 0.9 if k < 100 else 0.0, 0.05)
    return log


def figures_of(log: RunLog) -> dict[str, SimpleNamespace]:
    """Figures of the bearings as they were published, by sense."""
    metrics = metrics_of([evaluate_run('', log, SENSES, filtered=False)])
    return {name: SimpleNamespace(**figures) for name, figures in metrics.items()}


def test_known_errors_come_out():
    """RMSE, coverage and time to resolve of a synthetic run."""
    fused, sound, sight = figures_of(circle_log()).values()
    assert fused.rmse_deg == pytest.approx(2.0, abs=0.01) and fused.median_deg == pytest.approx(2.0, abs=0.01)
    assert fused.coverage == 1.0 and fused.outliers == 0.0 and fused.hemisphere_errors < 0.05
    assert sound.rmse_deg <= 5.0 + 1e-6
    assert sight.rmse_deg == pytest.approx(0.0, abs=1e-3) and sight.coverage == pytest.approx(0.5, abs=0.03)
    assert fused.time_to_resolve_s == pytest.approx(2.1, abs=0.01)
    assert fused.latency_ms == pytest.approx(100.0)
    assert fused.within == 1.0 and figures_of(circle_log(5.0))['fused'].within == 0.0    # sigma is 2.9 deg


def test_what_is_held_errs_by_how_far_the_target_went_on():
    """At the fused bearings' times: sound of 20 ms by a sample of 0.1 s, sight from its end on by ever more."""
    _, sound, sight = figures_of(circle_log()).values()
    step, blind = math.degrees(0.03), 100
    assert sound.held_rmse_deg <= 5.0 + step + 1e-6
    held = [step] * (blind - 1) + [k * step for k in range(1, blind + 1)]    # of the sight of image 99, from image 100 on
    assert sight.held_rmse_deg == pytest.approx(math.sqrt(np.mean(np.square(held))), rel=0.01)


def test_gaps_cost_coverage():
    """A bearing missing for a third of the time covers two thirds."""
    log = circle_log()
    gappy = RunLog()
    gappy.sight.add(1000.0, 0.0, 0.9, 0.0)
    for time, azimuth in zip(log.fused['time'], log.fused['azimuth'], strict=True):
        lost = 1005.0 < time < 1011.6
        gappy.fused.add(time, math.nan if lost else azimuth, 0.1, State.NONE if lost else State.ACOUSTIC_ACTIVE, 1, 0.1)
    assert figures_of(gappy)['fused'].coverage == pytest.approx(2.0 / 3.0, abs=0.03)


def test_sight_without_detections_has_no_coverage():
    """Detections below the gate: coverage 0; no images or sound: no figure."""
    log = circle_log()
    blind = RunLog()
    for row in zip(*(log.sight[name] for name in ('time', 'azimuth', 'score', 'delay')), strict=True):
        blind.sight.add(row[0], row[1], 0.4 * row[2], row[3])
    blind.target, blind.rig, blind.fused = log.target, log.rig, log.fused
    result = evaluate_run('blind', blind, ('fused', 'sight', 'sound'))
    assert result.methods['sight'].coverage == 0.0 and not len(result.methods['sight'].error_deg)
    assert result.methods['fused'].coverage == 1.0 and set(result.missing) == {'sound'}


def test_an_empty_run_and_one_without_truth_make_a_table(tmp_path):
    """Without measurements and truth the table has dashes, and a plot is written."""
    assert 'coverage' in describe(RunLog(), tmp_path / 'empty')
    log = RunLog()
    log.fused.add(1.0, 0.1, 0.1, State.ACOUSTIC_ACTIVE, 1, 0.1)
    assert figures_of(log)['fused'].rmse_deg is None
    assert '2.00°' in describe(circle_log(), tmp_path / 'full')
    assert (tmp_path / 'full' / 'bearing.png').stat().st_size > 10_000
    assert json.loads((tmp_path / 'full' / 'metrics.json').read_text())['fused']['coverage'] == 1.0


def test_the_log_is_saved_as_tables(tmp_path):
    """What was logged can be read back, to the microsecond and a billionth."""
    log = circle_log()
    log.save(tmp_path)
    table = np.genfromtxt(tmp_path / 'fused.csv', delimiter=',', names=True)
    assert np.allclose(table['time'], log.fused['time'], atol=1e-6) and np.allclose(table['azimuth'], log.fused['azimuth'])
    names = {'target.csv', 'rig.csv', 'sound.csv', 'sight.csv', 'fused.csv'}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_series_refuses_rows_of_another_width():
    """A row with a value missing is an error, not a shifted table."""
    series = Series('a', 'b')
    with pytest.raises(ValueError, match='expected'):
        series.add(1.0)
    series.add(1.0, 2.0)
    assert np.array_equal(series['b'], [2.0])


@pytest.mark.parametrize('folder', ['.', 'missing'])    # a folder that cannot be written costs memory, and no rows
def test_a_log_with_a_folder_holds_every_row_and_little_memory(tmp_path, folder):
    plain, filed = RunLog(), RunLog(tmp_path / folder)
    tracemalloc.start()
    try:
        for k in range(90_000):     # an hour of 25 bearings a second
            filed.fused.add(0.04 * k, k % 7, k % 5, 1.0, 0.0, 0.1)
        used = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert folder == 'missing' or used < 300_000
    for k in range(90_000):
        plain.fused.add(0.04 * k, k % 7, k % 5, 1.0, 0.0, 0.1)
    for name in ('time', 'azimuth', 'sigma', 'state', 'resolved', 'delay'):
        np.testing.assert_array_equal(plain.fused[name], filed.fused[name])
    assert len(plain.fused) == len(filed.fused) == 90_000
    newest = filed.newest().fused['time']
    assert len(newest) >= 1000
    np.testing.assert_array_equal(newest, plain.fused['time'][-len(newest):])
    assert not list(tmp_path.iterdir())


def test_the_truth_is_in_the_body_that_tilts():
    """The azimuth of the direction in the body's frame, by rotations of scipy, not the heading's difference."""
    log, place = RunLog(), np.array([4.0, 3.0, 6.0])
    attitudes = Rotation.from_euler('ZYX', [[50.0, 20.0, -15.0], [62.0, 10.0, 25.0]], degrees=True)
    for t, attitude in enumerate(attitudes):
        log.rig.add(t, 1.0, 1.0, 1.0, *attitude.as_quat()[[3, 0, 1, 2]])
        log.target.add(t, *place)
    for t, attitude in enumerate(attitudes):
        east, north, _ = attitude.inv().apply(place - 1.0)
        assert log.true_azimuth([float(t)])[0] == pytest.approx(np.arctan2(north, east), abs=1e-6)
    between = Slerp([0.0, 1.0], attitudes)(0.3).inv().apply(place - 1.0)
    assert log.true_azimuth([0.3])[0] == pytest.approx(np.arctan2(between[1], between[0]), abs=1e-6)
    assert np.degrees(log.heading([0.0, 1.0])) == pytest.approx([50.0, 62.0])
    assert np.isnan(log.true_azimuth([1.5])[0])


@pytest.mark.parametrize('quaternion', [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)])
def test_a_true_pose_that_is_none_spoils_no_figure_of_the_others(quaternion):
    """As from a peer that sends anything: the monitor goes on with the poses before and after."""
    log = RunLog()
    for step in range(4):
        for name in (topics.TRUE_TARGET, topics.TRUE_RIG):
            message = Odometry()
            message.header.stamp, message.pose.pose.orientation.w = to_stamp(100.0 + step), 1.0
            message.pose.pose.position.x = 10.0 if name == topics.TRUE_TARGET else 0.0
            log.on_truth(name, message, 100.0 + step)
    bad = Odometry()
    bad.header.stamp = to_stamp(101.5)
    bad.pose.pose.orientation.w, bad.pose.pose.orientation.x = quaternion[:2]
    with pytest.raises(ValueError, match='unit quaternion'):
        log.on_truth(topics.TRUE_RIG, bad, 101.5)
    bad.pose.pose.position.y = math.inf
    with pytest.raises(ValueError, match='finite'):
        log.on_truth(topics.TRUE_TARGET, bad, 101.5)
    assert log.true_azimuth([101.4])[0] == pytest.approx(0.0)
