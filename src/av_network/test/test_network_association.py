"""Packing of hypotheses against exhaustive search, where directions meet, and the order of reports."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from av_network.observation import Observation, Report, RigState, Sighting
from av_network.packing import best_packing, log_odds
from av_network.pairing import Lines, lines_of, meetings, supports
from av_network.report_queue import ReportQueue
from av_network.trust import RigTrust


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


def test_directions_meet_at_their_target():
    """Two that come from one place; one from behind, beyond the range, or far from the other line does not meet."""
    target = np.array([5.0, 60.0, 20.0])

    def seen(rig, place, at=target, sign=1.0):
        d = sign * (at - place)
        angles = np.array([np.arctan2(d[1], d[0]), np.arctan2(d[2], np.hypot(d[0], d[1]))])
        return Observation(rig, place, Sighting(1, *angles, np.eye(2) * 1e-4, 0.0), RigState(0.0, 0.0, 1e-6, 1e-3, 0.0))

    left, right = np.array([-20.0, 0.0, 1.5]), np.array([20.0, 0.0, 1.5])
    others = [seen(1, right), seen(1, right, sign=-1.0), seen(1, right, target + np.array([0.0, 0.0, 15.0]))]
    one, lines = (lines_of(each) for each in ([seen(0, left)], others))
    places, _, apart = meetings(one, lines, 400.0)
    assert np.allclose(places[0, 0], target) and apart[0, 0] < 1e-9
    assert apart[0, 1] == np.inf and apart[0, 2] > 9.0
    assert meetings(one, lines, 50.0)[2][0, 0] == np.inf
    # 3 m higher, by errors of 10 mrad and by 8 m/s for 0.5 s.
    above = lines_of([seen(1, right, target + np.array([0.0, 0.0, 3.0]))])
    sharp, moved = (meetings(one, each, 400.0)[2][0, 0] for each in (above, above._replace(times=above.times + 0.5)))
    assert sharp > 4.0 and 0.25 < moved < 0.5


def test_a_place_is_probable_where_directions_of_several_rigs_pass():
    """The density of a direction that passes 1 m off, at 60 m with 10 mrad, over that of others, by hand; none from behind."""
    lines = Lines(np.zeros((2, 3)), np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), np.full(2, 1e-4), np.zeros(2), np.zeros(2),
                  np.zeros(2))
    place, nowhere = np.array([[60.0, 1.0, 0.0]]), np.array([[0.0, 60.0, 0.0]])
    expected = np.log(1.0 / (2.0 * np.pi * 1e-4 * 0.4)) - 0.5 / 0.36
    for rigs in ([0, 0], [0, 1]):
        assert supports(place, np.zeros(1), lines, np.array(rigs), 0.4) == pytest.approx([expected], rel=1e-3)
    assert supports(nowhere, np.zeros(1), lines, np.array([0, 1]), 0.4) == pytest.approx([0.0])


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


def test_a_rig_that_comes_back_is_waited_for():
    """Reports take 0.2 s, and some are lost: all are used but the first, of which nobody knew, and the first after 10 s."""
    queue, used = ReportQueue(0.5), []
    there = [k for k in range(100) if k not in (4, 5, *range(20, 60))]
    events = [(0.25 * k, 'a', 0.25 * k) for k in range(100)] + [(0.25 * k + 0.3, 'b', 0.25 * k + 0.1) for k in there]
    for now, rig, captured in [*sorted(events), (30.0, 'a', 30.0)]:
        queue.put(report(rig, captured), captured)
        used += [each.time for each in queue.ready(now) if each.rig == 'b']
    assert queue.late == {'b': 2}
    assert used == pytest.approx([0.25 * k + 0.1 for k in there if k not in (0, 60)])


def test_a_rig_is_trusted_while_it_is_more_probably_right():
    """Against the posterior odds by hand; directions of one track count once a second, and one that agrees is used again."""
    trust = RigTrust()
    for k in range(5):
        trust.note(1, {7: False}, 1.0, float(k))
    assert 0 in trust and 1 in trust, 'one track that nobody else has is no proof: 4.08 - 5 * 0.64'
    for k in range(40):
        trust.note(0, {7: False}, 1.0, 5.0 + 0.01 * k)
        trust.note(1, {7: False}, 1.0, 5.0 + 0.05 * k)
    assert 0 in trust and 1 not in trust
    trust.note(0, dict.fromkeys(range(100, 108), False), 1.0, 6.0)
    assert 0 not in trust, 'many new ones at once'
    for time in (10.0, 11.0):
        trust.note(1, {8: True}, 1.0, time)
    assert 1 in trust


def test_tracks_that_nobody_else_has_are_no_evidence_where_the_others_have_as_many():
    """Few of all rigs' tracks are on targets yet: 20 of a rig that are not say nothing; one that is speaks for it."""
    trust = RigTrust()
    for rig, share in ((0, 0.05), (1, 0.3)):
        trust.note(rig, dict.fromkeys(range(20), False), share, 0.0)
    assert 0 in trust and 1 not in trust
