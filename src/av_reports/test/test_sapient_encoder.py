"""Messages of SAPIENT, read by a decoder of the wire format that knows no message: numbers of fields are the standard's."""

from __future__ import annotations

import math
import secrets
import struct

import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from report_tracks import NOW, bearing, position
from sapient_peer import FUSION_NODE, NODE, SETTINGS
from wire_decoder import dig, fields

from av_reports.contacts import Place
from av_reports.identifiers import is_ulid, new_ulid
from av_reports.sapient.encoder import bearing_report, envelope, position_report, status_report
from av_reports.sapient.protocol import TaskAck
from av_reports.sapient.registration import registration_message
from av_reports.sapient.validation import faults
from av_reports.settings import SapientSettings

DEGREES_M, TRUE_NORTH, PLATFORM = 1, 1, 4          # RangeBearing
LAT_LNG_DEG_M, WGS84_ELLIPSOID = 1, 1              # Location
OBJECT = new_ulid(NOW)


def sent(**content):
    """Bytes of a valid message."""
    message = envelope(NODE, NOW, **content)
    assert list(faults(message)) == []
    return message.SerializeToString()


def test_the_envelope_has_time_sender_and_receiver():
    refusal = TaskAck(task_id=OBJECT, task_status=TaskAck.TASK_STATUS_REJECTED, reason=['no'])
    data = sent(destination=FUSION_NODE, task_ack=refusal)
    assert fields(dig(data, 1)) == {1: [1_700_000_000], 2: [250_000_000]}
    assert dig(data, 2).decode() == NODE and dig(data, 3).decode() == FUSION_NODE
    assert fields(dig(data, 9)) == {1: [OBJECT.encode()], 2: [2], 5: [b'no']}


def test_a_bearing_has_azimuth_elevation_and_errors_in_degrees_and_no_range():
    report = dig(sent(detection_report=bearing_report(bearing(), OBJECT, NOW)), 7)
    where = fields(dig(report, 5))
    assert set(where) == {1, 2, 4, 5, 7, 8}, 'elevation, azimuth, their errors, units and datum; 3 and 6 are of the range'
    assert [where[number][0] for number in (1, 2, 4, 5)] == pytest.approx([12.0, 300.0, 4.0, 2.0])
    assert where[7] == [DEGREES_M] and where[8] == [TRUE_NORTH]
    assert 6 not in fields(report) and dig(report, 2).decode() == OBJECT and is_ulid(dig(report, 1).decode())
    assert dig(report, 7) == pytest.approx(0.9)
    assert dig(report, 11, 1) == b'Air Vehicle' and dig(report, 11, 3, 1) == b'UAV Rotary Wing'


@pytest.mark.parametrize('name, probability, kind, confidence', [
    ('drone', 0.8, b'Air Vehicle', 0.8), ('mavic', 0.7, b'Air Vehicle', 0.7), ('mavic', math.nan, b'Unknown', None),
    ('bird', 0.6, b'Animal', None), ('', math.nan, b'Unknown', None), ('', 0.9, b'Air Vehicle', 0.9)])
def test_classes_of_the_taxonomy_and_types_of_drones(name, probability, kind, confidence):
    track = bearing(class_id=name, drone_probability=probability)
    report = fields(dig(sent(detection_report=bearing_report(track, OBJECT, NOW)), 7))
    found = fields(report[11][0])
    assert found[1] == [kind] and found.get(2, [None])[0] == (confidence and pytest.approx(confidence))
    assert [dig(info, 2) for info in report.get(10, [])] == ([b'mavic'] if name == 'mavic' else [])


def test_without_an_attitude_the_bearing_counts_from_the_platform_and_unknown_elevation_is_left_out():
    track = bearing(north=False, elevation=math.nan, elevation_sigma=math.inf, azimuth=-0.1)
    where = fields(dig(sent(detection_report=bearing_report(track, OBJECT, NOW)), 7, 5))
    assert set(where) == {2, 5, 7, 8} and where[8] == [PLATFORM] and where[2][0] == pytest.approx(360.0 - math.degrees(0.1))


def test_what_may_be_in_front_or_behind_is_reported_with_less_confidence():
    report = dig(sent(detection_report=bearing_report(bearing(front_back=0.6, resolved=False), OBJECT, NOW)), 7)
    assert dig(report, 7) == pytest.approx(0.54)
    assert [b'front_back_probability', b'0.600'] in [[dig(info, 1), dig(info, 2)] for info in fields(report)[8]]


def test_a_position_has_errors_in_the_units_of_its_coordinates_and_a_velocity():
    report = dig(sent(detection_report=position_report(position(), OBJECT, NOW)), 7)
    where = fields(dig(report, 6))
    assert 5 not in fields(report)
    assert [where[number][0] for number in (1, 2, 3)] == pytest.approx([-0.12, 51.5, 80.0])
    # a degree of latitude at 51.5 deg has 111,258 m and one of longitude 69,440 m (NGA's table of lengths)
    assert [where[number][0] for number in (4, 5, 6)] == pytest.approx([2.0 / 69440.0, 3.0 / 111258.0, 1.0], rel=1e-3)
    assert where[7] == [LAT_LNG_DEG_M] and where[8] == [WGS84_ELLIPSOID]
    speed = fields(dig(report, 19))
    assert [speed[number][0] for number in range(1, 7)] == pytest.approx([1.0, -2.0, 0.5, 0.1, 0.2, 0.3])


def test_the_last_report_of_an_object_says_so():
    assert dig(sent(detection_report=bearing_report(bearing(), OBJECT, NOW, lost=True)), 7, 4) == b'lost'


@pytest.mark.parametrize('given, system', [({'problems': ()}, 1), ({'problems': ('no doa',)}, 2),
                                           ({'problems': ('no targets',), 'error': True}, 3),
                                           ({'problems': (), 'goodbye': True}, 5)])
def test_a_status_report_tells_state_place_and_problems(given, system):
    report = dig(sent(status_report=status_report(NOW, True, Place(51.5, -0.12, 30.0), **given)), 6)
    assert dig(report, 2) == system and dig(report, 3) == 1 and dig(report, 5) == b'default'
    assert [dig(report, 7, number) for number in (2, 1, 3)] == pytest.approx([51.5, -0.12, 30.0])
    assert [dig(one, 3).decode() for one in fields(report).get(11, [])] == list(given['problems'])


@pytest.mark.parametrize('positions', [False, True])
@pytest.mark.parametrize('obey', [False, True])
def test_the_registration_says_what_is_reported_and_which_tasks_are_taken(positions, obey):
    settings = SapientSettings(NODE, positions=positions, obey_tasks=obey)
    registration = dig(sent(registration=registration_message(settings)), 4)
    assert dig(registration, 2) == b'BSI Flex 335 v2.0' and dig(registration, 3) == b'audio-visual rig'
    assert [dig(node, 1) for node in fields(registration)[1]] == [6, 4], 'acoustic, camera'
    assert fields(dig(registration, 6, 1)) == {1: [4], 3: [10.0]}, 'seconds'
    kind = fields(dig(registration, 7, 10, 1))
    assert kind == ({1: [LAT_LNG_DEG_M], 3: [WGS84_ELLIPSOID]} if positions else {2: [DEGREES_M], 4: [TRUE_NORTH]})
    commands = fields(dig(registration, 7, 11)).get(3, [])
    assert [dig(command, 4) for command in commands] == [1, *([] if not obey else [6] if positions else [6, 9])], (
        'requests, look at, follow')
    assert len(registration) < 4096


def test_ulids_are_ordered_by_time_and_decode_to_it(monkeypatch):
    monkeypatch.setattr(secrets, 'randbits', lambda bits: 2**bits - 1)
    text = new_ulid(NOW)
    digits = '0123456789ABCDEFGHJKMNPQRSTVWXYZ'
    number = 0
    for letter in text:
        number = number * 32 + digits.index(letter)
    assert number.to_bytes(16, 'big') == struct.pack('>Q', round(NOW * 1000))[2:] + b'\xff' * 10
    assert new_ulid(1.0) < new_ulid(2.0) < text and SETTINGS.node_id == NODE
