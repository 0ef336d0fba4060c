"""No sequence of measurements, valid or not, leads to a command beyond its limits."""

from __future__ import annotations

from av_evaluation.experiments.fuzz import fuzz


def test_invalid_measurements_neither_crash_nor_break_a_limit():
    """`ros2 run av_evaluation fuzz` runs 100,000 of these sequences."""
    assert fuzz(0, 500) == []


def test_a_predicted_target_stands_in_the_order_of_ids():
    """The followed drone is lost, and a bystander with a later id is tracked."""
    assert fuzz(3422, 1) == []


def test_an_elevation_of_absurd_variance_is_unknown():
    """A detection of 1e300 rad^2, whose track was published with an infinite covariance."""
    assert fuzz(3032, 1) == []
