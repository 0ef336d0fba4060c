"""What the standard demands, held against the text of its protobuf files: a node names what a message lacks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
import sapient_msg
from hypothesis import given, settings
from hypothesis import strategies as st
from report_tracks import NOW, bearing, position
from sapient_msg.bsi_flex_335_v2_0 import sapient_message_pb2
from sapient_peer import NODE, SETTINGS, accepted

from av_reports import Place
from av_reports.sapient.stage import SapientStage

FILES = sorted((Path(sapient_msg.__file__).parent / 'bsi_flex_335_v2_0').glob('*.proto'))
PACKAGE = 'sapient_msg.bsi_flex_335_v2_0'
LONGEST = 400    # characters of what is said of a message
MESSAGES = {
    'registration': SapientStage(SETTINGS).on_connected(NOW),
    'status': accepted().on_time(Place(1.0, 2.0, 3.0), ('no doa',), False, NOW),
    'bearing': accepted().on_tracks([bearing()], NOW),
    'position': accepted().on_tracks([position()], NOW),
}


def sent(name):
    """A message of this node, which is valid."""
    data, = MESSAGES[name].messages
    return sapient_message_pb2.SapientMessage.FromString(data)


def fault(data):
    """What a node says of a message that it is sent; empty where nothing is wrong."""
    stage = accepted()
    stage.on_message(data, None, NOW)
    return stage.complaint(NOW).rpartition('spoken here: ')[2]


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


def test_the_texts_were_read():
    assert sum(map(len, MANDATORY.values())) > 90 and MANDATORY[f'{PACKAGE}.TaskAck'] == {'task_id', 'task_status'}


@pytest.mark.parametrize('name', MESSAGES)
def test_each_mandatory_field_is_missed(name):
    whole = sent(name)
    assert fault(whole.SerializeToString()) == ''
    for index, (path, part) in enumerate(within(whole)):
        for field in MANDATORY.get(part.DESCRIPTOR.full_name, ()):
            message = sent(name)
            list(within(message))[index][1].ClearField(field)
            assert fault(message.SerializeToString()) == f'{path}{field} is missing'


@pytest.mark.parametrize('change, said', [
    (lambda message: setattr(message, 'node_id', 'rig'), 'expected a UUID'),
    (lambda message: setattr(message.detection_report, 'object_id', '01ARZ3NDEKTSV4RRFFQ69G5FAU'), 'expected a ULID'),
    (lambda message: setattr(message.detection_report.range_bearing, 'azimuth', float('nan')), 'expected a finite number'),
    (lambda message: setattr(message.detection_report.range_bearing, 'datum', 0), 'datum is 0'),
    (lambda message: setattr(message.detection_report.range_bearing, 'datum', 77), 'datum is 77'),
    (lambda message: message.detection_report.ClearField('range_bearing'), 'location_oneof is missing'),
    (lambda message: message.ClearField('detection_report'), 'content is missing'),
])
def test_what_is_wrong_is_named(change, said):
    message = sent('bearing')
    change(message)
    assert said in fault(message.SerializeToString())


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_a_message_or_are_named(data):
    assert len(fault(data)) < LONGEST


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_flipped_bits_of_a_message_are_a_message_or_are_named(data):
    whole = bytearray(sent('registration').SerializeToString())
    for _ in range(data.draw(st.integers(1, 5))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert len(fault(bytes(whole))) < LONGEST


def test_nesting_and_numbers_without_measure_are_refused():
    deep = b''
    for _ in range(5000):
        deep = b'\x1a' + varint(len(deep)) + deep
    many = b'\x3a\x00' * 20_000
    message = sapient_message_pb2.SapientMessage(node_id=NODE)
    message.timestamp.FromSeconds(1)
    for content in (deep, many):
        assert fault(message.SerializeToString() + b'\x42' + varint(len(content)) + content)


def varint(number):
    out = b''
    while number > 127:
        out, number = out + bytes([number & 127 | 128]), number >> 7
    return out + bytes([number])
