"""Simulated bodies that are driven as fast as allowed until measurements end: they turn on by what is promised, hardly less."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.stopping import SOONEST, STOP_WITHIN, TURNS_ON, YawAnswer, fastest_stoppable

FINE_S = 0.001


def turn_after_the_stop(answer, limit, acceleration, period, silent=1.0):
    """Turn (rad) after STOP_WITHIN, and the largest rate (rad/s), of a body whose measurements end at `silent` s.

    It is commanded once a period what is allowed, up to `limit` (rad/s); it is integrated in steps of FINE_S.
    """
    turning = rate = body = turned = largest = 0.0
    sent, steps = [], round(period / FINE_S)
    for k in range(round((silent + 8.0) / FINE_S)):
        time = k * FINE_S
        if k % steps == 0:
            turning += (answer.gain * rate - turning) * (1.0 - math.exp(-period / answer.lag))
            left = STOP_WITHIN - max(time - silent, 0.0) - period
            wanted = min(fastest_stoppable(turning, left, period, acceleration, answer), limit)
            wanted = 0.0 if left < 0.0 else wanted
            rate = min(max(wanted, rate - acceleration * period), rate + acceleration * period)
        sent.append(rate)
        shows = k - round(answer.dead_time / FINE_S)
        body += (answer.gain * (sent[shows] if shows >= 0 else 0.0) - body) * FINE_S / answer.lag
        largest = max(largest, body)
        turned += body * FINE_S if time > silent + STOP_WITHIN else 0.0
    return turned, largest


@pytest.mark.parametrize('limit_deg', [10.0, 20.0, 30.0])
@pytest.mark.parametrize('period', [0.01, 0.02, 0.033])
def test_px4_turns_on_by_what_is_promised_from_up_to_30_deg_a_second(limit_deg, period):
    turned, largest = turn_after_the_stop(YawAnswer(), math.radians(limit_deg), math.radians(900.0), period, 3.0)
    assert largest > 0.98 * math.radians(limit_deg)
    assert turned < 1.02 * TURNS_ON
    assert turned > 0.85 * TURNS_ON or limit_deg < 25.0


def test_any_vehicle_is_driven_that_long_at_least():
    """It turns on by that, or by what a stop at the age SOONEST leaves."""
    random = np.random.default_rng(2)
    for _ in range(40):
        answer = YawAnswer(random.uniform(0.0, 0.3), random.uniform(0.1, 1.0), random.uniform(0.6, 1.2))
        limit, acceleration = math.radians(random.uniform(15.0, 90.0)), math.radians(random.uniform(300.0, 900.0))
        period = random.uniform(0.01, 0.03)
        turned, largest = turn_after_the_stop(answer, limit, acceleration, round(period, 3), 6.0)
        spare = STOP_WITHIN - answer.dead_time - SOONEST
        least = largest * (answer.lag * math.exp(-max(spare, 0.0) / answer.lag) + max(-spare, 0.0))
        assert turned < 1.05 * max(TURNS_ON, least) + math.radians(0.5)


def test_what_turns_too_fast_already_gets_nothing():
    assert fastest_stoppable(1.0, 0.0, 0.02, 15.0, YawAnswer()) == 0.0
