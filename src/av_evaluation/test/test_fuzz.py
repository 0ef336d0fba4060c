"""No sequence of messages, valid or not, leads to a command beyond its limits, or to a motion on old inputs."""

from __future__ import annotations

import pytest

from av_evaluation.attack import judges
from av_evaluation.cli.fuzz import fuzz

pytestmark = pytest.mark.filterwarnings('ignore:.*:RuntimeWarning')    # of absurd numbers


def test_invalid_messages_neither_crash_nor_break_a_limit():
    """`ros2 run av_evaluation fuzz` runs 10,000 of these sequences."""
    assert fuzz(0, 300, 20) == []


def test_a_motion_that_outlasts_its_inputs_is_found(monkeypatch):
    """The body may move for 0.4 s after them; where a tenth of a second is asked for, sequences break."""
    monkeypatch.setattr(judges, 'MOTION_LIFETIME_S', 0.1)
    assert any('after the newest' in broken.reason for broken in fuzz(0, 30, 40))
