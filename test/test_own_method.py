"""Methods of a package outside the tree: found, used by stages and evaluation, and part of the key of kept results."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import cv2
import numpy as np
import pytest
from tutorials import run, typed, words

from av_audio.directions import to_directions
from av_audio.localizer import Localizer, LocalizerSettings
from av_audio.methods import DOA_METHODS, Direction, peak_of
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_common.track import State
from av_evaluation.cli import evaluate, report
from av_evaluation.cli.report import cases_of
from av_evaluation.runs.cases import Case, run_case
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.settings import TRACKERS, make_tracker
from av_vision.cli import detect
from av_vision.methods import DETECTORS
from av_vision.stage import make_detector

EXAMPLE = Path(__file__).parents[1] / 'examples' / 'own_method'
KINDS = {'av_rig.doa': DOA_METHODS, 'av_rig.trackers': TRACKERS, 'av_rig.detectors': DETECTORS}
OFFERED = {'av_rig.doa': {'loudest_delay': 'own_method:loudest_delay'},
           'av_rig.trackers': {'kalman': 'av_evaluation.experiments.baselines:KalmanTracker',
                               'moving_average': 'av_evaluation.experiments.baselines:MovingAverage',
                               'newest_bearing': 'own_method:NewestBearing'},
           'av_rig.detectors': {'dark_specks': 'own_method:dark_specks'}}


@pytest.fixture
def offered(monkeypatch):
    """The methods of the example and of av_evaluation, as if these packages alone were installed."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    for group, kind in KINDS.items():
        monkeypatch.setattr('av_common.methods.entry_points', lambda group: [
            EntryPoint(name, value, group) for name, value in OFFERED[group].items()])
        monkeypatch.delitem(vars(kind), '_places', raising=False)
        assert kind.names
    yield
    for kind in KINDS.values():
        vars(kind).pop('_places', None)


def far_sound(array, azimuth_deg, rate=48_000, seconds=1.0, seed=3):
    """White noise (n, channels) that arrives from an azimuth in the plane."""
    direction = np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg)), 0.0])
    count = round(rate * seconds)
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, 1.0 / rate)
    return 0.1 * np.stack([np.fft.irfft(spectrum * np.exp(1j * omega * (position @ direction) / 343.0), count)
                           for position in array.positions], axis=1)


@pytest.mark.parametrize('azimuth_deg', [-70.0, -20.0, 15.0, 60.0])
def test_an_estimator_of_another_package_hears_with_both_images(offered, azimuth_deg):
    array = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
    localizer = Localizer(array, 48_000, LocalizerSettings(method='loudest_delay'))
    for estimate in localizer.process(far_sound(array, azimuth_deg), 0):
        images = np.degrees(estimate.azimuth)
        mirrored = np.degrees(np.arctan2(np.sin(np.radians(azimuth_deg)), -np.cos(np.radians(azimuth_deg))))
        assert np.allclose(sorted(images), sorted([azimuth_deg, mirrored]), atol=4.0)
        assert np.allclose(estimate.confidence, 0.9)
        assert estimate.cosine == pytest.approx(np.sin(np.radians(azimuth_deg)), abs=0.06)
        assert 0.0 < estimate.cosine_variance <= np.radians(6.0) ** 2 * 1.3


@pytest.mark.parametrize(('positions', 'azimuth_deg', 'elevation_deg'), [
    ([[0.1, 0.1, 0.0], [-0.1, 0.1, 0.0], [0.0, -0.1, 0.0]], 100.0, 30.0),
    ([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.2]], -150.0, -20.0)])
def test_directions_keep_angles_and_variances_in_arrays_that_resolve_them(positions, azimuth_deg, elevation_deg):
    array = MicrophoneArray(positions)
    variance = np.radians(2.0) ** 2
    peak = peak_of(Direction(np.radians(azimuth_deg), variance, np.radians(elevation_deg), 4.0 * variance), array)
    found = to_directions(array, peak.q, peak.covariance)
    nearest = np.argmin(np.abs(found.angles[1] - np.radians(elevation_deg)))
    assert np.degrees(found.angles[:, nearest]) == pytest.approx([azimuth_deg, elevation_deg], abs=0.1)
    assert np.sqrt(found.variances[:, nearest]) == pytest.approx(np.radians([2.0, 4.0]), rel=0.1)


@pytest.mark.parametrize('wrong', [Direction(np.nan, 0.01), Direction(0.1, 0.0), Direction(0.1, 0.01, 0.0, -0.01),
                                   Direction(0.1, 0.01, confidence=1.5)])
def test_a_direction_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match='finite angles'):
        peak_of(wrong, MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]))


@pytest.mark.parametrize('method', ['newest_bearing', 'kalman', 'moving_average'])
def test_trackers_turn_with_the_rig_and_end(offered, method):
    tracker = make_tracker(node_parameters('av_fusion', 'fusion_node', overrides={'method': method}))
    target, axis = np.radians(70.0), (0.0, 1.0, 0.0)
    assert tracker.estimate(0.0).state == State.NONE
    for k in range(60):
        time, yaw = 0.1 * k, 0.05 * k
        tracker.add_pose(Pose.level(time, yaw, 0.5))
        tracker.add_doas([DoaMeasurement.of_cone(time, Cone(axis, np.sin(target - yaw), 1e-3), 0.9)])
        tracker.add_camera(CameraMeasurement(time, ()))
        track = tracker.estimate(time)
    assert np.degrees(track.azimuth_world) == pytest.approx(70.0, abs=2.0)
    assert track.azimuth == pytest.approx(target - yaw, abs=0.04)
    assert track.state == State.ACOUSTIC_ACTIVE and tracker.targets(track).selected == 1
    assert tracker.estimate(time + 10.0).state == State.NONE


def test_what_is_seen_counts_from_tau(offered):
    tracker = make_tracker(node_parameters('av_fusion', 'fusion_node', overrides={'method': 'newest_bearing', 'tau': 0.7}))
    tracker.add_camera(CameraMeasurement(1.0, (Detection(0.3, 1e-4, 0.6),)))
    assert tracker.estimate(1.0).state == State.NONE
    tracker.add_camera(CameraMeasurement(1.1, (Detection(0.3, 1e-4, 0.8),)))
    track = tracker.estimate(1.2)
    assert (track.state, track.azimuth) == (State.VISUAL_ACTIVE, pytest.approx(0.3))


def test_a_detector_of_another_package_sees(offered, tmp_path, capsys):
    image = np.full((120, 160, 3), 200, np.uint8)
    image[40:46, 100:112] = 10
    cv2.imwrite(str(tmp_path / 'image.png'), image)
    assert detect.main([str(tmp_path), '--model', 'dark_specks', '--quiet']) == 0
    assert 'drone,0.6,100.0,40.0,12.0,6.0' in capsys.readouterr().out
    detections = make_detector(node_parameters('av_vision', 'detector_node', overrides={'model': 'dark_specks'})).detect(image)
    assert detections.boxes.tolist() == [[100, 40, 112, 46]] and detections.class_names == ('drone',)


@pytest.mark.parametrize(('make', 'known'), [
    (lambda name: LocalizerSettings(method=name), 'ml, phat, plain, music, mvdr, loudest_delay'),
    (lambda name: make_tracker(node_parameters('av_fusion', 'fusion_node', overrides={'method': name})),
     'bayes, gated, kalman, moving_average, newest_bearing'),
    (lambda name: make_detector(node_parameters('av_vision', 'detector_node', overrides={'model': name})),
     'shipped, dark_specks')])
def test_an_unknown_name_is_refused_with_those_installed(offered, make, known):
    with pytest.raises(ValueError, match=known):
        make('magic')


@pytest.mark.parametrize('program', [evaluate, report])
def test_programs_refuse_an_unknown_detector_with_those_installed(offered, program, tmp_path, capsys):
    inputs = ['circle'] if program is evaluate else ['--quick']
    assert program.main([*inputs, '--model', 'magic', '--out', str(tmp_path)]) == 2
    assert 'shipped, dark_specks' in capsys.readouterr().err


@pytest.mark.parametrize('changed', ['one/method.py', 'one/weights.bin', 'helper.py'])
def test_the_code_of_a_method_is_part_of_the_key(monkeypatch, tmp_path, changed):
    """A package without __init__.py, its weights, another module of its distribution; also where parameters name it."""
    for name, text in (('one/method.py', 'def make(parameters, gimbal): pass'), ('one/weights.bin', '1'), ('helper.py', ''),
                       ('lab-1.dist-info/METADATA', 'Metadata-Version: 2.1\nName: lab\nVersion: 1'),
                       ('lab-1.dist-info/top_level.txt', 'helper\none\n'),
                       ('lab-1.dist-info/entry_points.txt', '[av_rig.trackers]\nchanging = one.method:make\n')):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(vars(TRACKERS), '_places', raising=False)
    parameters = tmp_path / 'params.yaml'
    parameters.write_text('/**/fusion_node: {ros__parameters: {method: changing}}\n')
    cases = [Case('circle', 1, ('changing',)), Case('circle', parameters=(str(parameters),)), Case('circle', 1, ('fused',))]
    before = [case.key for case in cases]
    (tmp_path / changed).write_text('x = 12345')
    assert [case.key == key for case, key in zip(cases, before, strict=True)] == [False, False, True]
    vars(TRACKERS).pop('_places')


def test_an_installed_package_is_in_the_table(tmp_path):
    """As a reader does: pip install, evaluate, the methods' rows are in the table and the report."""
    site, copy = tmp_path / 'site', shutil.copytree(EXAMPLE, tmp_path / 'own_method')  # a build leaves files there
    subprocess.run([sys.executable, '-m', 'pip', 'install', '-q', '--no-deps', '--no-build-isolation', '--no-index',
                    '--target', str(site), str(copy)], check=True, cwd=tmp_path)
    environment = {'PYTHONPATH': f'{site}{os.pathsep}{os.environ.get("PYTHONPATH", "")}'}
    run(typed('own_method.md', 'loudest_delay newest_bearing fused') + ' --duration 4 --quiet', tmp_path, **environment)
    metrics = json.loads((tmp_path / 'results/own_method/metrics.json').read_text())
    assert {'gcc_phat', 'loudest_delay', 'newest_bearing', 'fused'} <= set(metrics)
    assert 'loudest_delay' in (tmp_path / 'results/own_method/report.html').read_text()
    seeing = typed('own_method.md', 'evaluate .*--model dark_specks')
    run(f'{seeing} --duration 1 --methods sight --quiet', tmp_path, **environment)


def test_the_report_has_the_methods_of_another_package(offered, tmp_path, monkeypatch):
    """As the page types it, for two seconds of one experiment."""
    def short(*arguments):
        return {'tripod': [replace(case, duration=2.0) for case in cases_of(*arguments)['tripod']]}
    monkeypatch.setattr(report, 'cases_of', short)
    monkeypatch.setattr(report, 'compute', lambda groups, _: (
        {name: [run_case(case) for case in group] for name, group in groups.items()}, {}))
    monkeypatch.chdir(tmp_path)
    Path('results/report_own').mkdir(parents=True)
    assert report.main(words(typed('own_method.md', 'evaluation report'))[4:]) == 0
    page = (tmp_path / 'results/report_own/report.html').read_text()
    assert 'loudest_delay' in page and 'newest_bearing' in page
