"""A listener mix is distinguished from audio with directions."""

import numpy as np

from av_sim_bridge.receiving.direction_check import DirectionCheck

RATE = 48_000


def check_delays(delays, gains=(1.0, 1.0)):
    """Check 12 s of noise whose second channel is late by delays (n,) in samples, one every 0.1 s."""
    random = np.random.default_rng(1)
    check = DirectionCheck(RATE)
    for delay in delays:
        source = random.standard_normal(4800 + 64)
        check.add(np.column_stack([gains[0] * source[32:-32], gains[1] * source[32 - delay:len(source) - 32 - delay]])
                  + 0.01 * random.standard_normal((4800, 2)))
    return check


def test_a_moving_source_is_fine():
    assert check_delays(np.round(20 * np.sin(np.linspace(0, 6, 120))).astype(int)).problem == ''


def test_a_mix_with_levels_only_is_noticed():
    check = check_delays([0] * 120, gains=(1.0, 0.4))
    assert 'listener mix' in check.problem
    assert check.spread_s < 1e-6


def test_a_source_that_the_rig_keeps_straight_ahead_is_fine():
    random = np.random.default_rng(2)
    check, frequencies = DirectionCheck(RATE), np.fft.rfftfreq(4800, 1 / RATE)
    for delay in random.normal(0.0, 2e-6, 120):    # 0.2 degrees for microphones 0.2 m apart
        source = np.fft.rfft(random.standard_normal(4800))
        check.add(np.fft.irfft(source[:, None] * np.exp(-2j * np.pi * frequencies[:, None] * [0.0, delay]), axis=0))
    assert check.problem == ''


def test_a_source_at_rest_aside_is_fine():
    assert check_delays([15] * 120).problem == ''


def test_nothing_is_said_too_early_or_about_silence():
    assert check_delays([0] * 50).problem == ''
    check = DirectionCheck(RATE)
    check.add(np.zeros((48_000 * 12, 2)))
    assert check.problem == ''
