"""The matrix of faults on drawn measurements: what is wrong is told by its name, and bearings hardly lie afterwards."""

from __future__ import annotations

import math

import pytest

from av_evaluation.faults import Faults, faultless, named, title, try_fault


@pytest.mark.parametrize('faults', [
    Faults(swapped=True), Faults(camera_yaw_deg=-22.0), Faults(rolled_deg=90.0), Faults(upside_down=True), Faults(yaw_sign=-1),
    Faults(frozen=True)], ids=title)
def test_a_fault_is_told_by_its_name(faults):
    told = try_fault(faults, 2, 20.0)
    assert told.fault is not None and named(faults, told.fault)
    assert told.first < 15.0 and max(told.after) < 0.05    # from the suspicion on, which soon is certain


@pytest.mark.parametrize('array', ['pair', 'square'])
def test_a_rig_as_described_is_told_nothing(array):
    told = try_fault(Faults(), 1, 20.0, array)
    assert told.fault is None and told.first == math.inf and told.before == (0.0, 0.0)
    assert faultless('circle', 1) == (60.0, {})
