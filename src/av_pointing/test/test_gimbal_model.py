"""The model of a gimbal that reports nothing."""

import math

import numpy as np
import pytest

from av_common.rig import GimbalMount
from av_pointing.gimbal_stage import SIGMA, GimbalModel


def test_the_model_has_lag_rate_and_limits():
    model = GimbalModel(GimbalMount(max_rate_deg=90.0, lag=0.1, pan_limits_deg=(-100.0, 100.0)))
    model.command(10.0, 0.0, 0.0)
    model.at(10.0)
    model.command(10.0, math.radians(120.0), 0.5)
    pan = [model.at(10.0 + 0.02 * step)[0] for step in range(200)]
    rates = np.diff(pan) / 0.02
    assert rates.max() == pytest.approx(math.radians(90.0))
    assert pan[-1] == pytest.approx(math.radians(100.0))
    assert model.at(14.0)[1] == pytest.approx(0.5)


def test_the_model_knows_less_while_it_moves_and_before_its_first_command():
    model = GimbalModel(GimbalMount())
    assert model.at(1.0)[2] > 20.0 * SIGMA**2
    model.command(1.5, 1.0, 0.0)
    assert model.at(2.0) == pytest.approx((1.0, 0.0, SIGMA**2))
    model.command(2.1, -1.0, 0.0)
    assert model.at(2.2)[2] > 20.0 * SIGMA**2


def test_the_model_follows_a_clock_that_is_set_back_and_measured_angles():
    model = GimbalModel(GimbalMount())
    model.command(100.0, 0.0, 0.0)
    model.at(100.0)
    model.correct(100.0, 0.5, 0.1)
    assert model.at(100.0)[:2] == (0.5, 0.1)
    model.command(20.0, 0.2, 0.0)
    assert model.at(25.0)[0] == pytest.approx(0.2, abs=0.31)
