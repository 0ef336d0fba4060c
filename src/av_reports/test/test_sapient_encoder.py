"""Messages of SAPIENT, read by a decoder of the wire format that knows no message: numbers of fields are the standard's."""

from __future__ import annotations

import math
import secrets
import struct

import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from report_tracks import NOW, bearing, position
from sapient_peer import FUSION_NODE, NODE, accepted, task
from wire_decoder import dig, fields

from av_reports import Place
from av_reports.sapient.stage import SapientStage
from av_reports.settings import SapientSettings

DEGREES_M, TRUE_NORTH, PLATFORM = 1, 1, 4          # RangeBearing
LAT_LNG_DEG_M, WGS84_ELLIPSOID = 1, 1              # Location
BASE_32 = '0123456789ABCDEFGHJKMNPQRSTVWXYZ'       # Crockford's


def reported(track):
    """The DetectionReport of a track."""
    data, = accepted().on_tracks([track], NOW).messages
    return dig(data, 7)


def test_the_envelope_has_time_sender_and_receiver():
    data, = accepted(SapientSettings(NODE)).on_message(task(task_id='01ARZ3NDEKTSV4RRFFQ69G5FAV'), None, NOW).messages
    assert fields(dig(data, 1)) == {1: [1_700_000_000], 2: [250_000_000]}
    assert dig(data, 2).decode() == NODE and dig(data, 3).decode() == FUSION_NODE
    answer = fields(dig(data, 9))
    assert answer[1] == [b'01ARZ3NDEKTSV4RRFFQ69G5FAV'] and answer[2] == [2] and b'obey_tasks' in answer[5][0]


def test_a_bearing_has_azimuth_elevation_and_errors_in_degrees_and_no_range():
    report = reported(bearing())
    where = fields(dig(report, 5))
    assert set(where) == {1, 2, 4, 5, 7, 8}, 'elevation, azimuth, their errors, units and datum; 3 and 6 are of the range'
    assert [where[number][0] for number in (1, 2, 4, 5)] == pytest.approx([12.0, 300.0, 4.0, 2.0])
    assert where[7] == [DEGREES_M] and where[8] == [TRUE_NORTH]
    assert 6 not in fields(report) and dig(report, 7) == pytest.approx(0.9)
    assert dig(report, 11, 1) == b'Air Vehicle' and dig(report, 11, 3, 1) == b'UAV Rotary Wing'


@pytest.mark.parametrize('name, probability, kind, confidence', [
    ('drone', 0.8, b'Air Vehicle', 0.8), ('mavic', 0.7, b'Air Vehicle', 0.7), ('mavic', math.nan, b'Unknown', None),
    ('bird', 0.6, b'Animal', None), ('', math.nan, b'Unknown', None), ('', 0.9, b'Air Vehicle', 0.9)])
def test_classes_of_the_taxonomy_and_types_of_drones(name, probability, kind, confidence):
    report = fields(reported(bearing(class_id=name, drone_probability=probability)))
    found = fields(report[11][0])
    assert found[1] == [kind] and found.get(2, [None])[0] == (confidence and pytest.approx(confidence))
    assert [dig(info, 2) for info in report.get(10, [])] == ([b'mavic'] if name == 'mavic' else [])


def test_without_an_attitude_the_bearing_counts_from_the_platform_and_unknown_elevation_is_left_out():
    where = fields(dig(reported(bearing(north=False, elevation=math.nan, elevation_sigma=math.inf, azimuth=-0.1)), 5))
    assert set(where) == {2, 5, 7, 8} and where[8] == [PLATFORM] and where[2][0] == pytest.approx(360.0 - math.degrees(0.1))


def test_what_may_be_in_front_or_behind_is_reported_with_less_confidence():
    report = reported(bearing(front_back=0.6, resolved=False))
    assert dig(report, 7) == pytest.approx(0.54)
    assert [b'front_back_probability', b'0.600'] in [[dig(info, 1), dig(info, 2)] for info in fields(report)[8]]


def test_a_position_has_errors_in_the_units_of_its_coordinates_and_a_velocity():
    report = reported(position())
    where = fields(dig(report, 6))
    assert 5 not in fields(report)
    assert [where[number][0] for number in (1, 2, 3)] == pytest.approx([-0.12, 51.5, 80.0])
    # a degree of latitude at 51.5 deg has 111,258 m and one of longitude 69,440 m (NGA's table of lengths)
    assert [where[number][0] for number in (4, 5, 6)] == pytest.approx([2.0 / 69440.0, 3.0 / 111258.0, 1.0], rel=1e-3)
    assert where[7] == [LAT_LNG_DEG_M] and where[8] == [WGS84_ELLIPSOID]
    speed = fields(dig(report, 19))
    assert [speed[number][0] for number in range(1, 7)] == pytest.approx([1.0, -2.0, 0.5, 0.1, 0.2, 0.3])


@pytest.mark.parametrize('problems, error, system', [((), False, 1), (('no doa',), False, 2), (('no targets',), True, 3)])
def test_a_status_report_tells_state_place_and_problems(problems, error, system):
    data, = accepted().on_time(Place(51.5, -0.12, 30.0), problems, error, NOW).messages
    report = dig(data, 6)
    assert dig(report, 2) == system and dig(report, 3) == 1 and dig(report, 5) == b'default'
    assert [dig(report, 7, number) for number in (2, 1, 3)] == pytest.approx([51.5, -0.12, 30.0])
    assert [dig(one, 3).decode() for one in fields(report).get(11, [])] == list(problems)


@pytest.mark.parametrize('positions', [False, True])
@pytest.mark.parametrize('obey', [False, True])
def test_the_registration_says_what_is_reported_and_which_tasks_are_taken(positions, obey):
    data, = SapientStage(SapientSettings(NODE, positions=positions, obey_tasks=obey)).on_connected(NOW).messages
    registration = dig(data, 4)
    assert dig(registration, 2) == b'BSI Flex 335 v2.0' and dig(registration, 3) == b'audio-visual rig'
    assert [dig(node, 1) for node in fields(registration)[1]] == [6, 4], 'acoustic, camera'
    assert fields(dig(registration, 6, 1)) == {1: [4], 3: [10.0]}, 'seconds'
    kind = fields(dig(registration, 7, 10, 1))
    assert kind == ({1: [LAT_LNG_DEG_M], 3: [WGS84_ELLIPSOID]} if positions else {2: [DEGREES_M], 4: [TRUE_NORTH]})
    commands = fields(dig(registration, 7, 11)).get(3, [])
    assert [dig(command, 4) for command in commands] == [1, *([] if not obey else [6] if positions else [6, 9])], (
        'requests, look at, follow')
    assert len(registration) < 4096


def test_ulids_hold_their_time_before_80_random_bits(monkeypatch):
    monkeypatch.setattr(secrets, 'randbits', lambda bits: 2**bits - 1)
    report, number = reported(bearing()), 0
    for letter in dig(report, 1).decode():
        number = number * 32 + BASE_32.index(letter)
    assert number.to_bytes(16, 'big') == struct.pack('>Q', round(NOW * 1000))[2:] + b'\xff' * 10
    assert len(dig(report, 2)) == 26, 'of the object'
