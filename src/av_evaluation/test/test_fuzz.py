"""No sequence of messages, however senseless, leads to a command that may not be obeyed."""

from __future__ import annotations

from av_evaluation.experiments.fuzz import fuzz


def test_senseless_messages_neither_crash_nor_break_a_limit():
    """`ros2 run av_evaluation fuzz` runs 100,000 of these sequences."""
    assert fuzz(0, 500) == []
