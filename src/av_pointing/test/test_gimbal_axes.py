"""Pan and tilt follow directions: in the frame of their commands, by the shortest allowed way, within their limits."""

import math

import numpy as np
import pytest
from transforms3d.euler import euler2quat
from transforms3d.quaternions import quat2mat

from av_common.angles import angles_to_direction
from av_common.limited_axis import AxisLimits
from av_pointing.gimbal_axes import GimbalAxes

TILTED = tuple(euler2quat(*np.radians([20.0, -15.0, 70.0]), 'sxyz'))
DT = 1.0 / 30.0


def axes(stabilized=True, pan=(-150.0, 150.0), tilt=(-45.0, 60.0)):
    motion = math.radians(120.0), math.radians(360.0)
    limits = (AxisLimits(*motion, *map(math.radians, ends)) for ends in (pan, tilt))
    made = GimbalAxes(*limits, stabilized, 0.0)
    made.on_attitude(TILTED)
    return made


def settle(gimbal, pan, tilt, seconds=4.0):
    way = []
    for _ in range(round(seconds / DT)):
        gimbal.follow(DT, None if pan is None else math.radians(pan), None if tilt is None else math.radians(tilt))
        way.append((gimbal.pan.position, gimbal.tilt.position))
    return np.degrees(way)


@pytest.mark.parametrize('stabilized', [True, False])
def test_a_direction_is_the_same_from_the_body_and_from_the_world(stabilized):
    gimbal = axes(stabilized)
    body = quat2mat(TILTED).T @ angles_to_direction(math.radians(70.0) + 0.5, 0.2)
    by_body = gimbal.of_body(math.atan2(body[1], body[0]), math.asin(body[2]))
    assert by_body == pytest.approx(gimbal.of_level(0.5, 0.2))
    assert (by_body == pytest.approx((0.5, 0.2))) == stabilized


@pytest.mark.parametrize(('limits', 'pan', 'end'), [
    ((-150.0, 150.0), 100.0, 100.0), ((-150.0, 150.0), 170.0, 150.0), ((-150.0, 150.0), -170.0, -150.0),
    ((-150.0, 150.0), 190.0, -150.0), ((-270.0, 270.0), 170.0, 170.0)])
def test_pan_goes_to_the_nearest_allowed_angle(limits, pan, end):
    assert settle(axes(pan=limits), pan, 0.0)[-1, 0] == pytest.approx(end, abs=0.1)


def test_a_gimbal_with_room_follows_beyond_half_a_turn():
    gimbal = axes(pan=(-270.0, 270.0))
    settle(gimbal, 170.0, 0.0)
    assert settle(gimbal, -170.0, 0.0)[-1, 0] == pytest.approx(190.0, abs=0.1)


def test_neither_limits_nor_rates_are_broken():
    way = settle(axes(), 400.0, 200.0)
    rates = np.abs(np.diff(way, axis=0)) / DT
    assert rates.max() <= 120.0 + 1e-6
    assert np.abs(np.diff(rates, axis=0)).max() / DT <= 360.0 + 1e-6
    assert way[:, 1].max() <= 60.0 + 1e-9


def test_an_axis_without_an_angle_brakes():
    gimbal = axes()
    settle(gimbal, 100.0, 30.0, 0.3)
    way = settle(gimbal, None, None, 1.0)
    assert way[-1] == pytest.approx(way[-5])


def test_straight_up_pan_stands_still():
    gimbal = axes(tilt=(-45.0, 90.0))
    assert settle(gimbal, 100.0, 90.0)[-1] == pytest.approx((0.0, 90.0), abs=0.1)


def test_hold_brakes_or_returns_to_neutral():
    gimbal = axes()
    settle(gimbal, 60.0, 30.0)
    for _ in range(90):
        gimbal.hold(DT, neutral=False)
    assert np.degrees((gimbal.pan.position, gimbal.tilt.position)) == pytest.approx((60.0, 30.0), abs=0.1)
    for _ in range(90):
        gimbal.hold(DT, neutral=True)
    assert np.degrees((gimbal.pan.position, gimbal.tilt.position)) == pytest.approx((0.0, 0.0), abs=0.1)
