"""How far drones are heard: the bound against the formula of a pair, louder places and weaker drones, and the table."""

from math import erf

import numpy as np
import pytest

from av_evaluation.cli import range as table
from av_evaluation.hearing.reach import ARRAYS, DISTANCES_M, Place, Scene
from av_simulator import find_config
from av_simulator.sound.source import load_profile


class White:
    """White noise of a level (Pa) at 1 m."""

    def __init__(self, level):
        self._level = level

    def stream(self, sample_rate, key, position):
        return self

    def read(self, first, last):
        return self._level * np.random.default_rng(1).normal(size=last - first)


def test_the_bound_of_a_pair_is_that_of_knapp_and_carter(monkeypatch):
    """A white source at 1 m in white noise that the microphones do not share, as strong, at broadside."""
    scene = Scene(White(1.0), Place('noise', 30.0, 0.0), ARRAYS[0])
    monkeypatch.setattr('av_evaluation.hearing.reach.PAIR_RAD', 0.0)
    monkeypatch.setattr('av_evaluation.hearing.reach.WITHIN_RAD', 0.002)
    scene._noise = np.random.default_rng(2).normal(size=scene._noise.shape)
    delay = np.sqrt(3.0 * 3.0 / (8.0 * np.pi**2 * 0.5 * (8000.0**3 - 100.0**3)))    # both ratios are 1
    sigma = 343.2 * delay / 0.2
    assert scene._bound(1.0) == pytest.approx(erf(0.002 / sigma / np.sqrt(2.0)), abs=0.03)


def test_less_is_heard_where_it_is_louder():
    signal = load_profile(find_config('camera_quadrotor', 'drones')).signal
    quiet, loud = (Scene(signal, Place('', level, 0.0), ARRAYS[0]).reach() for level in (30.0, 60.0))
    assert loud.direction < 0.5 * quiet.direction <= quiet.bound * 1.5 and loud.bound < 0.5 * quiet.bound
    assert quiet.judged > loud.judged and set(quiet) <= {0.0, *DISTANCES_M.tolist()}


def test_the_table_names_what_is_wrong(capsys):
    with pytest.raises(SystemExit):
        table.main(['--places', '9'])
    assert "--places: '9', expected an integer of 0 to 3" in capsys.readouterr().err
