"""Tracks to report, for tests."""

from __future__ import annotations

import math

from av_reports import BearingTrack, PositionTrack

NOW = 1_700_000_000.25


def bearing(number=3, **values):
    return BearingTrack(**{
        'id': number, 'time': NOW - 0.1, 'measured': NOW - 0.2, 'existence': 0.9, 'drone_probability': 0.8, 'class_id': 'drone',
        'azimuth': math.radians(300.0), 'azimuth_sigma': math.radians(2.0), 'elevation': math.radians(12.0),
        'elevation_sigma': math.radians(4.0), **values})


def position(number=5, **values):
    return PositionTrack(**{
        'id': number, 'time': NOW - 0.1, 'measured': NOW - 0.2, 'existence': 0.95, 'class_id': 'drone', 'latitude': 51.5,
        'longitude': -0.12, 'altitude': 80.0, 'covariance': ((4.0, 1.0, 0.0), (1.0, 9.0, 0.0), (0.0, 0.0, 1.0)),
        'velocity': (1.0, -2.0, 0.5), 'velocity_sigma': (0.1, 0.2, 0.3), **values})
