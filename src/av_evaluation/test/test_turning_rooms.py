"""Rooms in which a rig turns: geometry of the responses, and what counts as the wrong side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.acoustics import speed_of_sound
from av_common.angles import wrap
from av_evaluation.experiments.turning_rooms import PLACES, TurningRoom, is_other_side
from av_evaluation.hearing.signals import RATE

pytest.importorskip('pyroomacoustics')


@pytest.fixture(scope='module')
def room():
    return TurningRoom(np.random.default_rng(3))


def first_arrivals(responses):
    """Times (s) at which each response first exceeds half of its maximum."""
    return np.array([np.argmax(np.abs(one) > 0.5 * np.abs(one).max()) for one in responses]) / RATE


def test_the_direct_sound_arrives_from_the_source(room):
    """On the circle the first arrival is earliest where it is nearest to the source, by the radius over the speed of sound."""
    arrivals = first_arrivals(room.responses)
    wave = -2.0 / PLACES * np.fft.rfft(arrivals)[1]
    assert abs(wrap(-np.angle(wave) - room.azimuth)) < math.radians(5.0)
    assert abs(wave) == pytest.approx(0.5 * room.spacing / speed_of_sound(20.0), abs=2.0 / RATE)


def test_a_turn_moves_the_delay_between_the_microphones(room):
    """Facing the source both hear it at once; with the source on the left, the left one first."""
    click = np.zeros(2 * room.responses.shape[1])
    click[room.responses.shape[1]] = 1.0
    for side, expected in ((0.0, 0.0), (0.5 * math.pi, -room.spacing / speed_of_sound(20.0))):
        yaw = room.azimuth - side
        left, right = first_arrivals(room.heard(click, yaw, yaw).T)
        assert left - right == pytest.approx(expected, abs=2.0 / RATE)


@pytest.mark.parametrize(('azimuth_deg', 'truth_deg', 'wrong'), [
    (30.0, 35.0, False), (150.0, 35.0, True), (-10.0, -170.0, True), (100.0, 35.0, True), (91.0, 88.0, False)])
def test_the_other_side_is_that_of_the_mirror_image(azimuth_deg, truth_deg, wrong):
    assert is_other_side(math.radians(azimuth_deg), math.radians(truth_deg)) is wrong
