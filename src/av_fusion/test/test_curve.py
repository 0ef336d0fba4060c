"""A likelihood over the cosine with several peaks: against closed forms, and what the stage makes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import Vector3

from av_common.parameters import node_parameters
from av_common.stamps import to_stamp
from av_fusion.measurement.converter import fixed_rotations
from av_fusion.stage import make_fusion_stage
from av_fusion.tracks.curve import Curve
from av_interfaces.msg import Doa, DoaArray, DoaOdds

COSINES = np.linspace(-1.0, 1.0, 129)


class Flat:
    """A component whose cosine has a variance in each mode, to first order."""

    def __init__(self, variances):
        self._variances = np.array(variances)

    def variances(self, row):
        return self._variances


@pytest.mark.parametrize('fraction', [1.0, 0.2])
def test_a_likelihood_of_one_gaussian_is_a_measurement_with_its_noise(fraction):
    """The posterior of normal densities: mean and variance by the information of both."""
    means, variances, place, noise = np.array([0.1, 0.15]), np.array([0.02, 0.005]), 0.3, 0.004
    curve = Curve.of(means, variances, np.exp(-0.5 * (COSINES - place) ** 2 / noise))
    found = curve.deviation(Flat(variances), (1.0, 0.0), fraction)
    gain = variances / found.totals
    after = noise / fraction
    assert gain * found.innovations == pytest.approx(variances / (variances + after) * (place - means), rel=0.02)
    assert (1.0 - gain) * variances == pytest.approx(variances * after / (variances + after), rel=0.02)
    expected = np.sqrt(after / (variances + after)) * np.exp(-0.5 * (place - means) ** 2 / (variances + after))
    assert curve.fits(fraction) == pytest.approx(expected, rel=0.02)


def test_of_two_peaks_the_one_counts_that_is_predicted():
    odds = np.exp(-0.5 * (COSINES - 0.5) ** 2 / 0.001) + np.exp(-0.5 * (COSINES + 0.5) ** 2 / 0.001)
    variances = np.array([0.01])
    for mean in (0.45, -0.45):
        found = Curve.of(np.array([mean]), variances, odds).deviation(Flat(variances), (1.0, 0.0), 1.0)
        assert mean + variances / found.totals * found.innovations == pytest.approx(math.copysign(0.5, mean), abs=0.01)


def test_a_narrow_prediction_between_two_cosines_is_not_moved_to_one_of_them():
    variances = np.array([1e-6])
    curve = Curve.of(np.array([0.123]), variances, np.exp(-0.5 * (COSINES - 0.3) ** 2 / 0.01))
    found = curve.deviation(Flat(variances), (1.0, 0.0), 1.0)
    assert abs(variances / found.totals * found.innovations)[0] < 1e-4
    assert curve.fits(1.0) == pytest.approx(math.exp(-0.5 * 0.177**2 / 0.01), rel=0.05)


def test_a_likelihood_that_is_the_same_everywhere_changes_nothing():
    variances = np.array([0.05])
    curve = Curve.of(np.array([0.2]), variances, np.ones(129))
    found = curve.deviation(Flat(variances), (1.0, 0.0), 1.0)
    assert abs(found.innovations * variances / found.totals)[0] < 1e-9 and curve.fits(1.0) == pytest.approx(1.0)


def test_at_end_fire_where_the_cosine_has_no_slope_nothing_is_divided_by_zero():
    variances = np.array([1e-4])
    curve = Curve.of(np.array([0.98]), variances, np.exp(-0.5 * (COSINES - 0.9) ** 2 / 1e-4))
    found = curve.deviation(Flat([0.0]), (0.0, 0.0), 1.0)
    assert (found.totals > variances).all() and np.isfinite(found.innovations).all()


def make_stage():
    rotations = fixed_rotations({'microphones': np.eye(3), 'camera': np.eye(3)})
    return make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), rotations)


def window(stamp, cosine, confidence=0.9):
    """Both images of a cosine; the axis points to the left."""
    azimuth = math.asin(cosine)
    message = DoaArray(window=0.5, axis=Vector3(y=1.0))
    message.header.stamp, message.header.frame_id = to_stamp(stamp), 'microphones'
    message.hypotheses = [Doa(direction=Vector3(x=math.cos(one), y=math.sin(one)), azimuth=one, azimuth_variance=1e-3,
                              elevation_variance=math.inf, cosine=cosine, cosine_variance=1e-3, confidence=confidence,
                              drone_probability=0.9) for one in (azimuth, math.pi - azimuth)]
    return message


def odds_at(stamp, *places, height=20.0):
    """Odds with a peak at each of some cosines."""
    message = DoaOdds()
    message.header.stamp = to_stamp(stamp)
    message.odds = sum(height * np.exp(-0.5 * (COSINES - place) ** 2 / 1e-3) for place in places).astype(np.float32)
    return message


def after_an_echo(late=0.0, contested=False):
    """Cosine of the bearing, and its variance: two seconds at 0.2, then echoes at 0.8 that are the higher peak for a second.

    Parameters:
        late (s): stamps of the odds after those of the directions; None without odds.
        contested: whether the odds have a second publisher.
    """
    stage = make_stage()
    stage.refuse_contested({'doa/odds': ['one', 'other']} if contested else {})
    for step in range(60):
        t = 100.0 + 0.05 * step
        echo = t >= 102.0
        if echo and late is not None:
            stage.on_odds(odds_at(t + late, 0.2, 0.8))
        output = stage.on_doa(window(t, 0.8 if echo else 0.2), t + 0.1)
    return math.sin(output.bearing.azimuth), output.bearing.azimuth_variance


def test_a_target_at_the_lower_peak_goes_on_being_measured():
    """By the highest peak alone the target is lost or led away; with the odds it is where it was, and as certain."""
    cosine, variance = after_an_echo()
    assert abs(cosine - 0.2) < 0.03 and variance < math.radians(3.0) ** 2
    without, uncertain = after_an_echo(None)
    assert abs(without - 0.2) > 0.3 or uncertain > 4.0 * variance


def test_odds_of_another_window_are_not_used():
    assert after_an_echo(0.013) == after_an_echo(None)


@pytest.mark.parametrize('value', [math.nan, math.inf, -1.0, 1e12])
def test_impossible_odds_are_refused_by_value(value):
    message = odds_at(100.0, 0.2)
    message.odds[7] = value
    with pytest.raises(ValueError, match='odds from'):
        make_stage().on_odds(message)


def test_odds_of_a_second_publisher_are_not_used():
    assert after_an_echo(contested=True) == after_an_echo(None)
