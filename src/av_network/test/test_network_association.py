"""Packing of candidates against exhaustive search, and the order of reports."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from av_network.packing import best_packing, log_odds
from av_network.report import Report
from av_network.report_queue import ReportQueue


def exhaustive(scores, members):
    best = 0.0
    for chosen in itertools.product([False, True], repeat=len(scores)):
        names = [name for index, used in enumerate(chosen) if used for name in members[index]]
        if len(names) == len(set(names)):
            best = max(best, sum(score for score, used in zip(scores, chosen, strict=True) if used))
    return best


@pytest.mark.parametrize('seed', range(10))
def test_packing_is_the_best(seed):
    """Random candidates of two or three of eight tracks."""
    random = np.random.default_rng(seed)
    members = [set(random.choice(8, random.integers(2, 4), replace=False).tolist()) for _ in range(9)]
    scores = random.normal(2.0, 3.0, 9).tolist()
    best = best_packing(scores, members)
    assert sum(np.array(scores)[best]) == pytest.approx(exhaustive(scores, members))
    for index, odds in enumerate(log_odds(scores, members)):
        rest = [k for k in range(9) if k != index]
        without = exhaustive([scores[k] for k in rest], [members[k] for k in rest])
        assert odds == (pytest.approx(exhaustive(scores, members) - without) if best[index] else -np.inf)


def test_nothing_to_pack():
    """No candidates, or none that is worth it."""
    assert best_packing([], []).shape == (0,)
    assert not best_packing([-1.0], [{1}]).any()


def report(rig, time):
    return Report(rig, time, np.zeros(3), ())


def test_reports_come_in_the_order_of_capture():
    """A rig's late report is waited for, as long as that rig is not silent."""
    queue = ReportQueue(0.5)
    for rig, time in (('a', 1.0), ('b', 1.05), ('a', 1.25), ('a', 1.5)):
        assert queue.put(report(rig, time), time)
    assert [each.time for each in queue.ready(1.5)] == [1.0, 1.05]
    assert queue.put(report('b', 1.3), 1.3)
    assert [each.time for each in queue.ready(1.52)] == [1.25, 1.3]
    assert [each.time for each in queue.ready(2.01)] == [1.5]


def test_what_is_too_late_is_counted():
    """A report from before the last one that was used, and one that came twice."""
    queue = ReportQueue(0.2)
    queue.put(report('a', 1.0), 1.0)
    assert not queue.put(report('a', 1.0), 1.0)
    assert list(queue.ready(2.0))
    assert not queue.put(report('b', 0.9), 0.9)
    assert queue.late == {'a': 1, 'b': 1}
