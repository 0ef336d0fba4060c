"""Positions on the ellipsoid, against published values and the ellipsoid's own definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.geodesy import enu_to_geodetic, from_ecef, geodetic_to_enu, to_ecef


@pytest.mark.parametrize('place, position', [
    ((0.0, 0.0, 0.0), (6378137.0, 0.0, 0.0)),             # the semi-major axis
    ((90.0, 0.0, 0.0), (0.0, 0.0, 6356752.3142)),         # the semi-minor axis of TR8350.2
    ((0.0, 90.0, 100.0), (0.0, 6378237.0, 0.0)),
])
def test_on_the_axes_it_is_the_ellipsoid(place, position):
    assert to_ecef(*place) == pytest.approx(np.array(position), abs=1e-3)
    assert from_ecef(position) == pytest.approx(place, abs=1e-4)


def test_there_and_back_all_over_the_earth():
    rng = np.random.default_rng(1)
    for latitude, longitude, altitude in rng.uniform([-90, -180, -400], [90, 180, 12_000], (300, 3)):
        point = to_ecef(latitude, longitude, altitude)
        across, height = math.hypot(point[0], point[1]), point[2]
        back = from_ecef(point)
        assert to_ecef(*back) == pytest.approx(point, abs=1e-6)
        assert back == pytest.approx((latitude, longitude, altitude), abs=1e-6)
        assert (across / 6378137.0)**2 + (height / 6356752.314245)**2 == pytest.approx(1.0, abs=1e-2)


def test_offsets_are_to_the_east_north_and_up_and_small_ones_have_their_length():
    origin = (51.5, -0.12, 30.0)
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = 100.0
        latitude, longitude, altitude = place = enu_to_geodetic(offset, origin)
        assert (longitude - origin[1], latitude - origin[0], altitude - origin[2])[axis] > 0.0
        assert geodetic_to_enu(place, origin) == pytest.approx(offset, abs=1e-6)
    latitude, longitude, _ = enu_to_geodetic((100.0, 100.0, 0.0), (origin[0], 0.0, 0.0))
    lengths = (100.0 / 69440.0, 100.0 / 111258.0)    # NGA's lengths of a degree at 51.5 deg
    assert (longitude, latitude - origin[0]) == pytest.approx(lengths, rel=1e-3)
