"""Topics by version: that of px4_msgs is used, also beside those that an agent still offers for another firmware."""

from __future__ import annotations

import math

import pytest

from av_px4.layouts import SILENT_S, mismatch, offered_versions, version_of

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
