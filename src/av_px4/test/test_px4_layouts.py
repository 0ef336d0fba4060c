"""Layouts by hash, and topics by version: what PX4 is asked, and what follows from its answers and from the graph."""

from __future__ import annotations

import math

import pytest
from px4_layouts import FIRMWARES, definitions

from av_px4.layouts import ANSWER_S, SILENT_S, TRIES, LayoutCheck, layout_hash, mismatch, offered_versions, version_of

NESTED = {'Outer': '# a comment\nuint32 MESSAGE_VERSION = 1\nuint64 timestamp # us\n\nfloat32[3]  position\n'
                   'Inner[2] parts # two\nuint8 NUMBER=3\n', 'Inner': 'bool on\n  char[25]\tname\n'}
FIELDS = 'uint64 timestamp\nfloat32[3] position\nInner[2] parts\nbool on\nchar[25] name\n'


def fnv1a(text):
    """Written again, byte by byte, from RFC 9923."""
    value = 2166136261
    for character in text:
        value = (value ^ ord(character)) * 16777619 % 2**32
    return value


@pytest.mark.parametrize(('text', 'known'), [('', 0x811C9DC5), ('a', 0xE40C292C), ('foobar', 0xBF9CF968)])
def test_the_reference_is_right(text, known):
    assert fnv1a(text) == known


def test_the_hash_is_of_types_and_names_alone():
    assert layout_hash('Outer', NESTED.__getitem__) == fnv1a(FIELDS)


def test_firmwares_differ_where_their_messages_do():
    def hashes(kind):
        return [layout_hash(kind, lambda name, firmware=firmware: definitions(firmware)[name].replace('; ', '\n'))
                for firmware in FIRMWARES if kind in definitions(firmware)]
    assert len(set(hashes('VehicleStatus'))) == 4 and len(set(hashes('TrajectorySetpoint'))) == 1
    assert len(set(hashes('VehicleCommand'))) == 2 and len(set(hashes('ArmingCheckReply'))) == 2


def checked(answers, topics=('out/a', 'out/b', 'in/c')):
    """A check that asked PX4, which answers with (success, hash) or not at all."""
    check, time, asked = LayoutCheck(lambda kind: 7), 0.0, []
    for topic in topics:
        check.add(topic, 'Kind')
    check.begin()
    for _ in range(100):
        time += 0.05
        topic = check.question(time)
        if topic is not None:
            asked.append(topic)
            if topic in answers:
                check.answer(topic, *answers[topic])
    return check, asked


def test_one_topic_after_the_other_and_what_differs_is_not_used():
    check, asked = checked({'out/a': (True, 7), 'out/b': (True, 8), 'in/c': (False, 0)})
    assert asked == ['out/a', 'out/b', 'in/c']
    assert [check.may_use(topic) for topic in asked] == [True, False, True]
    assert not check.problem('out/a') and 'out/b is not used: the fields of Kind' in check.problem('out/b')


def test_until_px4_has_answered_nothing_is_used_and_after_some_silence_everything():
    check = LayoutCheck(lambda kind: 7)
    check.add('out/a', 'Kind')
    assert not check.may_use('out/a') and not check.problem('out/a')
    check.mute = True    # PX4 1.14 cannot be asked
    assert check.may_use('out/a')
    check, asked = checked({})
    assert asked == ['out/a'] * TRIES and check.mute and check.may_use('out/a') and TRIES * ANSWER_S < 2.0


def test_answers_that_nobody_asked_for_change_nothing():
    check, _ = checked({'out/a': (True, 7), 'out/b': (True, 7), 'in/c': (True, 7)})
    check.answer('out/a', True, 8)
    assert check.may_use('out/a')


def test_after_a_silence_all_are_asked_for_again_and_meanwhile_the_former_answers_hold():
    check, _ = checked({'out/a': (True, 7), 'out/b': (True, 8), 'in/c': (True, 7)})
    check.begin()
    assert [check.may_use(topic) for topic in ('out/a', 'out/b', 'in/c')] == [True, False, True]
    assert check.question(100.0) == 'out/a'
    check.answer('out/a', True, 8)
    assert not check.may_use('out/a') and check.question(100.1) == 'out/b'


NAMES = ('/fmu/out/vehicle_status_v1', '/fmu/out/vehicle_status_v1_extra', '/fmu/out/vehicle_status_flags',
         '/fmu/out/vehicle_attitude', '/fmu/out/vehicle_local_position', '/fmu/out/vehicle_local_position_v1')
PLACE, PLACE_1 = NAMES[-2:]
ALIVE, SILENT = 0.1, SILENT_S + 0.1


class VehicleLocalPosition:
    """Of PX4 1.16, which has no version of it."""


class VehicleLocalPosition1:
    """Of PX4 1.17."""

    MESSAGE_VERSION = 1


@pytest.mark.parametrize(('base', 'found'), [
    ('vehicle_status', {1: NAMES[0]}), ('vehicle_attitude', {0: NAMES[3]}), ('vehicle_local_position', {0: PLACE, 1: PLACE_1}),
    ('vehicle', {})])
def test_with_and_without_a_suffix(base, found):
    assert offered_versions(f'/fmu/out/{base}', NAMES) == found


def test_the_version_of_px4_msgs():
    assert (version_of(VehicleLocalPosition), version_of(VehicleLocalPosition1)) == (0, 1)


@pytest.mark.parametrize('kind', [VehicleLocalPosition, VehicleLocalPosition1])
@pytest.mark.parametrize('old', [ALIVE, SILENT, math.inf])
@pytest.mark.parametrize('new', [ALIVE, SILENT, math.inf])
def test_a_version_that_sends_is_right_and_one_that_sends_alone_is_named(kind, old, new):
    """Whatever else is offered. Where neither sends, nobody is to blame here."""
    problem = mismatch(kind, {0: PLACE, 1: PLACE_1}, {PLACE: old, PLACE_1: new})
    own, other = (old, new) if kind is VehicleLocalPosition else (new, old)
    if own == ALIVE or other != ALIVE:
        assert not problem
    else:
        topic, version = (PLACE_1, 1) if kind is VehicleLocalPosition else (PLACE, 0)
        assert f'{topic} is version {version}' in problem and 'is silent' in problem and 'px4_msgs' in problem


@pytest.mark.parametrize('age', [ALIVE, math.inf])
def test_another_version_alone_is_named_whether_it_sends_or_not(age):
    problem = mismatch(VehicleLocalPosition, {1: PLACE_1}, {PLACE_1: age})
    assert 'version 1 of VehicleLocalPosition, the installed px4_msgs has version 0' in problem


def test_what_is_not_offered_is_no_mismatch():
    assert not mismatch(VehicleLocalPosition, {}, {})
