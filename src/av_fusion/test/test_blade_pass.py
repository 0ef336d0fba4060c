"""The blade-pass frequency of a target: against Bayes' rule on samples, and through a meeting of two targets."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_fusion.identity.blade_pass import BladePassFrequency, fundamental_likelihoods
from av_fusion.measurement.measurements import DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.settings import types_of
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings

SIGMA = math.radians(2.0)


def doa(time, azimuth, frequency):
    """A direction with a fundamental."""
    hypothesis = Hypothesis(azimuth, SIGMA**2, 0.2, SIGMA**2)
    return DoaMeasurement(time, (hypothesis,), 0.9, 0.1, None, math.nan, frequency, (0.03 * frequency) ** 2)


def test_the_frequency_is_found_among_octave_errors():
    """Every fifth fundamental is half or twice the true one."""
    random, known = np.random.default_rng(1), BladePassFrequency()
    assert math.isnan(known.frequency)
    for step in range(100):
        factor = 1.0 if step % 5 else random.choice([0.5, 2.0])
        known.predict(0.1)
        known.update(fundamental_likelihoods([doa(0.0, 0.0, 186.0 * factor * (1.0 + 0.03 * random.normal()))]), np.ones(1), 0.5)
    assert known.frequency == pytest.approx(186.0, rel=0.03)
    types = {'camera': 186.0, 'hexarotor': 133.0, 'racing': 596.0}
    assert known.type_of(types) == 'camera' and known.type_of({}) == ''


@pytest.mark.parametrize('frequency', [math.nan, 0.0, -5.0, math.inf, 1e9])
def test_what_is_no_fundamental_says_nothing(frequency):
    """All frequencies are as likely as before."""
    assert np.all(fundamental_likelihoods([doa(0.0, 0.0, frequency)]) == 1.0)


def test_sound_keeps_names_where_motion_cannot():
    """Two targets of different types approach, are one direction for two seconds, and turn back."""
    random, motion = np.random.default_rng(2), RigMotion()
    targets, names = MultiBernoulliFilter(FilterSettings(), motion), []
    for step in range(200):
        time = 0.1 * step
        motion.add(Pose.level(time, 0.0))
        aside = 0.05 + 0.06 * abs(time - 10.0)
        heard = [doa(time, side * aside + SIGMA * random.normal(), frequency * (1.0 + 0.03 * random.normal()))
                 for side, frequency in zip((1.0, -1.0), (133.0, 307.0), strict=True)]
        targets.update_sound(time, heard[:1] if 9.0 < time < 11.0 else heard)
        if step in (50, 199):
            confirmed = [track for track in targets.tracks if track.existence > 0.5]
            names.append([track.id for track in sorted(confirmed, key=lambda track: track.mixture.primary().azimuth)])
    assert names[0] == names[1] and len(names[1]) == 2


@pytest.mark.parametrize('entry', ['hexarotor', 'hexarotor: fast', ': 133', 'hexarotor: 5', 'hexarotor: nan'])
def test_entries_that_are_no_types_are_refused(entry):
    """The error names the parameter and the entry."""
    with pytest.raises(ValueError, match=r'types: .*expected a name'):
        types_of([entry])
    assert types_of(['hexarotor: 133', '']) == {'hexarotor': 133.0}
