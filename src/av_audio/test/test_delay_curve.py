"""Calibration: agreement despite outliers, curves that rise, verdicts, and the guided recording."""

import csv

import numpy as np
import pytest
import soundfile

from av_audio import calibrate
from av_audio.calibration import DEGREE, Verdict, judge
from av_audio.cli.guided_recording import record
from av_common.angles import wrap
from av_common.microphone_array import MicrophoneArray

NOMINAL = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'head')
RADIUS = 0.0875
TURNED = np.radians(4.0)
FRONT = (-np.pi / 2.0, np.pi / 2.0)
CIRCLE = (-np.pi, np.pi)


def sphere_path(azimuths):
    """Path difference of a rigid sphere with ears on both sides, turned by TURNED (Woodworth, 1938)."""
    aside = np.arcsin(np.sin(azimuths - TURNED))
    return RADIUS * (aside + np.sin(aside))


def recording(rng, count, outliers=0.0, azimuths=CIRCLE, noise=0.002):
    """Azimuths and measured paths, of which a share is anything."""
    azimuths = rng.uniform(*azimuths, count)
    paths = sphere_path(azimuths) + noise * rng.normal(size=count)
    wrong = rng.uniform(size=count) < outliers
    paths[wrong] = rng.uniform(-0.28, 0.28, np.count_nonzero(wrong))
    return azimuths, paths, wrong


def error_deg(calibration):
    """RMS error of angles up to 70 degrees from broadside, on both sides."""
    azimuths = np.radians(np.linspace(-70.0, 70.0, 57)) + TURNED
    curve, array = calibration.array.delay_curve, calibration.array
    axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
    found = axis - np.arccos(np.clip(curve.true_cosine(sphere_path(azimuths) / array.aperture), -1.0, 1.0))
    return np.degrees(np.sqrt(np.mean(wrap(found - azimuths) ** 2)))


@pytest.mark.parametrize('azimuths', [FRONT, CIRCLE], ids=['front', 'circle'])
@pytest.mark.parametrize('share', [0.1, 0.3, 0.45])
def test_outliers_hardly_change_the_result(azimuths, share):
    clean, dirty, residuals = [], [], []
    for seed in range(5):
        clean.append(error_deg(calibrate(NOMINAL, *recording(np.random.default_rng(seed), 200, 0.0, azimuths)[:2])))
        true_azimuths, paths, wrong = recording(np.random.default_rng(seed), 200, share, azimuths)
        calibration = calibrate(NOMINAL, true_azimuths, paths)
        dirty.append(error_deg(calibration))
        residuals.append(np.degrees(np.sqrt(np.mean(calibration.residuals[~wrong & ~calibration.outliers] ** 2))))
        assert abs(calibration.baseline - RADIUS * (np.pi / 2.0 + 1.0)) < 0.01
        far = wrong & (np.abs(paths - sphere_path(true_azimuths)) > 0.05)
        assert np.mean(calibration.outliers[far]) > 0.9 and np.mean(calibration.outliers[~wrong]) < 0.05
    noise_deg = np.degrees(0.002 / (2.0 * RADIUS))    # of an angle about broadside
    assert np.mean(clean) < 0.5 and np.mean(dirty) < 0.5
    assert np.mean(residuals) < 1.5 * noise_deg


def test_estimates_that_scatter_are_averaged(monkeypatch):
    """Errors are below those of least squares by all parameters of the curve to the right ones alone, which all count alike."""
    monkeypatch.setattr('av_audio.calibration._left_out', lambda azimuths, paths: np.zeros(len(paths)))
    errors, bounds = [], []
    for seed in range(40):
        azimuths, paths, wrong = recording(np.random.default_rng(seed), 60, 0.3, noise=0.01)
        errors.append(error_deg(calibrate(NOMINAL, azimuths, paths)))
        bounds.append(np.degrees(0.01 / (2.0 * RADIUS)) * np.sqrt((DEGREE + 2) / np.count_nonzero(~wrong)))
    assert np.mean(np.square(errors)) < np.mean(np.square(bounds))


def test_a_cluster_of_reflections_is_an_outlier():
    azimuths, paths, _ = recording(np.random.default_rng(1), 300)
    paths[::3] = 0.12 + 0.003 * np.random.default_rng(2).normal(size=100)    # a wall
    assert error_deg(calibrate(NOMINAL, azimuths, paths)) < 0.5


def test_the_scatter_about_the_curve_is_kept():
    azimuths, paths, _ = recording(np.random.default_rng(4), 400, 0.1, noise=0.004)
    calibration = calibrate(NOMINAL, azimuths, paths)
    sigma = calibration.array.delay_curve.sigma * calibration.baseline
    assert np.median(sigma) == pytest.approx(0.004, rel=0.2)
    assert sigma.min() > 0.002 and sigma.max() < 0.008


def test_the_scatter_is_kept_where_it_is():
    """Front and back differ beside the ears only, as at a head."""
    rng = np.random.default_rng(6)
    azimuths, paths, _ = recording(rng, 400)
    aside = np.sin(azimuths - TURNED)
    paths += 0.03 * np.sign(np.cos(azimuths - TURNED)) * np.sign(aside) * (np.abs(aside) > np.sin(np.radians(70.0)))
    calibration = calibrate(NOMINAL, azimuths, paths)
    curve, broadside = calibration.array.delay_curve, np.linspace(-0.6, 0.6, 9)
    assert np.all(curve.sigma_at(broadside) * calibration.baseline < 0.005)
    assert np.all(curve.sigma_at([-0.97, 0.97]) * calibration.baseline > 0.015)


@pytest.mark.parametrize('seed', range(20))
def test_the_curve_rises_whatever_was_measured(seed):
    rng = np.random.default_rng(seed)
    azimuths, paths, _ = recording(rng, int(rng.integers(12, 80)), rng.uniform(0.0, 0.5), noise=rng.uniform(0.0, 0.03))
    try:
        curve = calibrate(NOMINAL, azimuths, paths).array.delay_curve
    except ValueError as error:
        assert 'estimates agree' in str(error) or 'angles that span' in str(error)
    else:
        assert np.all(np.diff(curve.measured) > 0.0)


def test_verdicts():
    rng = np.random.default_rng(3)
    azimuths, paths, _ = recording(rng, 300, 0.2)
    assert judge(calibrate(NOMINAL, azimuths, paths)).verdict == Verdict.GOOD
    aside = np.abs(np.sin(azimuths - TURNED)) < np.sin(np.radians(65.0))
    usable = judge(calibrate(NOMINAL, azimuths[aside], paths[aside]))
    assert usable == (Verdict.USABLE, 'usable beyond 20 deg from end-fire')
    one_side = np.sin(azimuths) > np.sin(np.radians(-20.0))
    assert 'no angles between' in judge(calibrate(NOMINAL, azimuths[one_side], paths[one_side])).words
    small = MicrophoneArray([[0.0, 0.04, 0.0], [0.0, -0.04, 0.0]])
    assert 'where the array file has 80' in judge(calibrate(small, azimuths, paths)).words


@pytest.mark.parametrize(('wrong', 'words'), [(lambda azimuths, paths, rng: (azimuths, -paths), 'exchanged'),
                                              (lambda azimuths, paths, rng: (rng.permutation(azimuths), paths), 'agree')],
                         ids=['channels exchanged', 'times wrong'])
def test_what_contradicts_itself_is_not_used(wrong, words):
    rng = np.random.default_rng(4)
    azimuths, paths, _ = recording(rng, 200)
    try:
        judgement = judge(calibrate(NOMINAL, *wrong(azimuths, paths, rng)))
    except ValueError as error:
        assert words in str(error)
    else:
        assert judgement.verdict == Verdict.DO_NOT_USE


def test_exchanged_sides_and_radians_are_named():
    """By the sign of paths, also with outliers and at few places; azimuths in radians span hardly anything in degrees."""
    rng = np.random.default_rng(5)
    for azimuths, paths, _ in (recording(rng, 200, 0.2), recording(rng, 60)):
        with pytest.raises(ValueError, match='left and right are exchanged: give the channels'):
            calibrate(NOMINAL, -azimuths, paths)
        with pytest.raises(ValueError, match='are the azimuths in degrees'):
            calibrate(NOMINAL, np.radians(azimuths), paths)


class Hiss:
    """A device whose left channel holds the azimuth that was asked for last."""

    sample_rate, channels = 1000, 2

    def __init__(self):
        self.asked, self.stopped, self._buffer = [], False, None

    def start(self, buffer):
        self._buffer = buffer

    def stop(self):
        self.stopped = True

    def ask(self, text):
        self._buffer.write(np.full((300, 2), -1.0))    # before the person is there
        self.asked.append(float(text.split(' to ')[1].split()[0]))


def test_a_person_is_guided(tmp_path, monkeypatch):
    source = Hiss()
    buffer_wait = 'av_audio.cli.guided_recording.RingBuffer.wait'

    def arrive(buffer, timeout):
        buffer.write(np.full((400, 2), source.asked[-1] / 200.0))
        return True

    monkeypatch.setattr(buffer_wait, arrive)
    record(source, [-90.0, 0.0, 45.0], 2.0, tmp_path / 'walk.wav', tmp_path / 'walk.csv', source.ask)
    sound, rate = soundfile.read(tmp_path / 'walk.wav')
    rows = list(csv.DictReader((tmp_path / 'walk.csv').open()))
    assert source.stopped and rate == 1000 and sound.shape == (6000, 2)
    for row in rows:
        azimuth = float(row['azimuth_deg'])
        assert sound[min(5999, round(float(row['time']) * rate)), 0] == pytest.approx(azimuth / 200.0, abs=1e-3)
    assert [float(row['azimuth_deg']) for row in rows] == [-90.0, -90.0, 0.0, 0.0, 45.0, 45.0]


@pytest.mark.parametrize('seed', range(6))
def test_a_curve_that_does_not_beat_the_straight_line_is_not_used(seed):
    """Free microphones in strong reflections, which differ from place to place: a fit to some is wrong at others."""
    rng = np.random.default_rng(seed)
    places = np.radians(np.arange(-90.0, 91.0, 15.0))
    azimuths = np.repeat(places, 20)
    paths = 0.2 * np.sin(azimuths) + np.repeat(rng.normal(0.0, 0.025, len(places)), 20) + rng.normal(0.0, 0.003, len(azimuths))
    judgement = judge(calibrate(NOMINAL, azimuths, paths))
    truth = np.radians(rng.uniform(-75.0, 75.0, 400))
    array = calibrate(NOMINAL, azimuths, paths).array
    heard = np.arcsin(np.clip(array.delay_curve.true_cosine(0.2 * np.sin(truth) / array.aperture), -1.0, 1.0))
    if np.degrees(np.abs(heard - truth).mean()) > 1.0:  # without the curve it would be 0
        assert judgement.verdict == Verdict.DO_NOT_USE, judgement


def test_a_head_at_few_places_is_still_worth_its_calibration():
    rng = np.random.default_rng(9)
    azimuths = np.repeat(np.radians(np.arange(-90.0, 91.0, 15.0)), 12) + TURNED
    paths = sphere_path(azimuths) + 0.003 * rng.normal(size=len(azimuths))
    calibration = calibrate(NOMINAL, azimuths, paths)
    assert judge(calibration).verdict in (Verdict.GOOD, Verdict.USABLE)
    assert np.abs(calibration.left_out).mean() < 0.5 * np.abs(calibration.before).mean()
