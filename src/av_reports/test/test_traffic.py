"""Targets as PX4's traffic, against the definition of ADSB_VEHICLE (MAVLink 246)."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from report_tracks import position

from av_reports.traffic import transponder_report


def messages():
    """Stands for px4_msgs.msg: a message whose callsign is an array of 9, as rosidl makes it."""
    return SimpleNamespace(TransponderReport=lambda **fields: SimpleNamespace(callsign=np.zeros(9, np.uint8), **fields))


def test_a_target_is_an_aircraft_without_a_country():
    report = transponder_report(messages(), position(5, velocity=(3.0, 0.0, -0.5)), 7_000_000, 45.0)
    assert (report.lat, report.lon, report.altitude) == (51.5, -0.12, 35.0) and report.timestamp == 7_000_000
    assert report.heading == pytest.approx(math.pi / 2) and report.hor_velocity == 3.0 and report.ver_velocity == -0.5
    assert report.icao_address == 0xF00005 and report.emitter_type == 14 and report.altitude_type == 1 and report.tslc == 0
    assert bytes(report.callsign) == b'AV000005\0' and report.flags == 1 | 2 | 4 | 8 | 16


def test_numbers_stay_within_their_fields():
    report = transponder_report(messages(), position(2**32 - 1, measured=0.0, velocity_sigma=(math.inf,) * 3), 0, 0.0)
    assert 0xF00000 <= report.icao_address < 2**24 and report.tslc == 255 and report.callsign[-1] == 0
    assert report.flags == 1 | 2 | 16
