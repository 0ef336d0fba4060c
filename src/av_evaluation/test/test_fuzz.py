"""No sequence of messages, valid or not, leads to a command beyond its limits, or to a motion on old or contested inputs."""

from __future__ import annotations

import pytest

from av_evaluation.cli import fuzz
from av_evaluation.cli.fuzz import faults

pytestmark = pytest.mark.filterwarnings('ignore:.*:RuntimeWarning')    # of absurd numbers


def test_no_sequence_breaks_a_promise():
    """A release is checked with many more: `ros2 run av_evaluation fuzz`."""
    assert faults(range(150)) == {}


def test_a_motion_that_outlasts_its_inputs_is_found(monkeypatch):
    """The body may move for 0.3 s after them; where a tenth of a second is asked for, sequences break."""
    monkeypatch.setattr(fuzz, 'STANDS_S', 0.1)
    assert any('turns 0.' in fault for fault in faults(range(30)).values())


def test_a_motion_without_support_is_found(monkeypatch):
    """Where nothing that arrives is noted, each turn is one on nothing."""
    monkeypatch.setattr(fuzz.Witness, 'note', lambda *_: None)
    assert any('no measurement can be used' in fault for fault in faults(range(30)).values())
