"""What the standard demands, held against the text of its protobuf files."""

from __future__ import annotations

import re
import uuid
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
import sapient_msg
from hypothesis import given, settings
from hypothesis import strategies as st
from report_tracks import NOW, bearing, position
from sapient_msg.bsi_flex_335_v2_0 import sapient_message_pb2
from sapient_peer import NODE, SETTINGS

from av_reports.contacts import Place
from av_reports.identifiers import new_ulid, node_uuid
from av_reports.sapient.encoder import bearing_report, envelope, position_report, status_report
from av_reports.sapient.registration import registration_message
from av_reports.sapient.validation import MOST_FAULTS, faults, parse

FILES = sorted((Path(sapient_msg.__file__).parent / 'bsi_flex_335_v2_0').glob('*.proto'))
PACKAGE = 'sapient_msg.bsi_flex_335_v2_0'
OBJECT = new_ulid(NOW)
MESSAGES = {
    'registration': {'registration': registration_message(SETTINGS)},
    'status': {'status_report': status_report(NOW, True, Place(1.0, 2.0, 3.0), ['no doa'])},
    'bearing': {'detection_report': bearing_report(bearing(), OBJECT, NOW)},
    'position': {'detection_report': position_report(position(), OBJECT, NOW)},
}


def mandatory_by_text():
    """Names of mandatory fields, by the full name of their message."""
    found = {}
    for file in FILES:
        stack = []
        for raw in file.read_text().splitlines():
            line = raw.split('//')[0]
            opened = re.search(r'\b(message|enum|oneof)\s+(\w+)\s*\{', line)
            if opened:
                stack.append((opened[1], opened[2]))
            field = re.search(r'(\w+)\s*=\s*\d+\s*\[\s*\(field_options\)\s*=\s*\{[^}]*is_mandatory:\s*true', line)
            if field:
                messages = '.'.join(name for what, name in stack if what == 'message')
                found.setdefault(f'{PACKAGE}.{messages}', set()).add(field[1])
            if re.match(r'\s*\}', line) and stack:
                stack.pop()
    return found


MANDATORY = mandatory_by_text()


def within(message, path=''):
    """All messages in a message, with the path of their fields."""
    yield path, message
    for field, value in message.ListFields():
        if field.message_type and field.message_type.file.package.startswith('sapient_msg'):
            for element in value if hasattr(value, 'extend') else [value]:
                yield from within(element, f'{path}{field.name}.')


def test_a_node_keeps_the_uuid_it_has_drawn(tmp_path, monkeypatch):
    """Version 4, which is all that the middleware takes; another node has another one, and rubbish is named."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'home'))
    file, first = tmp_path / 'home' / 'av_reports' / 'left.report_node.uuid', node_uuid('/left/report_node')
    assert node_uuid('/left/report_node') == first == file.read_text().strip()
    assert uuid.UUID(first).version == 4 and uuid.UUID(first).variant == uuid.RFC_4122
    assert node_uuid('/right/report_node') != first and len(list(file.parent.iterdir())) == 2
    file.write_text(str(uuid.uuid5(uuid.NAMESPACE_DNS, 'rig')))
    with pytest.raises(ValueError, match='expected a UUID of version 4: delete the file'):
        node_uuid('/left/report_node')


def test_the_texts_were_read():
    assert sum(map(len, MANDATORY.values())) > 90 and MANDATORY[f'{PACKAGE}.TaskAck'] == {'task_id', 'task_status'}


@pytest.mark.parametrize('name', MESSAGES)
def test_each_mandatory_field_is_missed(name):
    whole = envelope(NODE, NOW, **MESSAGES[name])
    assert list(faults(whole)) == []
    for index, (path, part) in enumerate(within(whole)):
        for field in MANDATORY.get(part.DESCRIPTOR.full_name, ()):
            message = sapient_message_pb2.SapientMessage()
            message.CopyFrom(whole)
            list(within(message))[index][1].ClearField(field)
            assert list(faults(message)) == [f'{path}{field} is missing']


@pytest.mark.parametrize('change, fault', [
    (lambda message: setattr(message, 'node_id', 'rig'), 'expected a UUID'),
    (lambda message: setattr(message.detection_report, 'object_id', '01ARZ3NDEKTSV4RRFFQ69G5FAU'), 'expected a ULID'),
    (lambda message: setattr(message.detection_report.range_bearing, 'azimuth', float('nan')), 'expected a finite number'),
    (lambda message: setattr(message.detection_report.range_bearing, 'datum', 0), 'datum is 0'),
    (lambda message: setattr(message.detection_report.range_bearing, 'datum', 77), 'datum is 77'),
    (lambda message: message.detection_report.ClearField('range_bearing'), 'location_oneof is missing'),
    (lambda message: message.ClearField('detection_report'), 'content is missing'),
])
def test_what_is_wrong_is_named(change, fault):
    message = envelope(NODE, NOW, **MESSAGES['bearing'])
    change(message)
    with pytest.raises(ValueError, match=fault):
        parse(message.SerializeToString())


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_any_bytes_are_a_message_or_a_value_error(data):
    try:
        parse(data)
    except ValueError as error:
        assert len(str(error)) < 200 * MOST_FAULTS


@settings(max_examples=100)
@given(st.data())
def test_flipped_bits_of_a_message_are_a_message_or_a_value_error(data):
    whole = bytearray(envelope(NODE, NOW, **MESSAGES['registration']).SerializeToString())
    for _ in range(data.draw(st.integers(1, 5))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    with suppress(ValueError):
        parse(bytes(whole))


def test_nesting_and_numbers_without_measure_are_refused():
    deep = b''
    for _ in range(5000):
        deep = b'\x1a' + varint(len(deep)) + deep
    many = b'\x3a\x00' * 20_000
    message = sapient_message_pb2.SapientMessage(node_id=NODE)
    message.timestamp.FromSeconds(1)
    for content in (deep, many):
        with pytest.raises(ValueError):
            parse(message.SerializeToString() + b'\x42' + varint(len(content)) + content)


def varint(number):
    out = b''
    while number > 127:
        out, number = out + bytes([number & 127 | 128]), number >> 7
    return out + bytes([number])
