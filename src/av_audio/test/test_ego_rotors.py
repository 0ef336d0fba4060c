"""Notches against combs whose frequencies are known."""

import numpy as np
import pytest
from flying_rig import FlyingRig
from known_sound import PAIR, RATE, scene

from av_audio import Localizer, LocalizerSettings, NoiseRecording
from av_common.angles import wrap


def azimuth_error(estimate, azimuth):
    """Of the image that is closer to the true azimuth (rad), in degrees."""
    return np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth))))


def test_a_target_is_located_under_ego_rotors_ten_decibels_louder():
    rng = np.random.default_rng(3)
    errors = {'with': [], 'without': []}
    for azimuth in np.radians([-70.0, -30.0, 0.0, 20.0, 50.0, 130.0, 200.0]):
        sound, blade_pass = scene(rng, azimuth, 10.0)
        without = Localizer(PAIR, RATE, LocalizerSettings(hop_s=1.0))
        notched = Localizer(PAIR, RATE, LocalizerSettings(hop_s=1.0))
        notched.blade_pass_hz = blade_pass
        errors['with'].append(azimuth_error(notched.process(sound, 0)[0], azimuth))
        errors['without'].append(azimuth_error(without.process(sound, 0)[0], azimuth))
    assert np.median(errors['with']) < 2.0
    assert np.median(errors['without']) > 2.0 * np.median(errors['with'])


def over_rotors_that_jitter(seed, level_db, recorded):
    """Errors (n,) in degrees and confidences (n,) amid rotors that hiss, whose newest speeds are known or not."""
    rng, found = np.random.default_rng(seed), []
    rig = FlyingRig(PAIR, rng)
    recording = NoiseRecording(rig.alone(rng, 8.0)[0].astype(np.float32), RATE) if recorded else None
    known, unknown = (Localizer(PAIR, RATE, LocalizerSettings(hop_s=0.5), recording) for _ in range(2))
    for _ in range(20):
        azimuth = rng.uniform(-np.pi, np.pi)
        sound, speeds = rig.hears(rng, rng.normal(size=RATE // 2), azimuth, level_db)
        known.blade_pass_hz = speeds[-1]
        estimates = [each.process(sound, each.next_sample + RATE)[0] for each in (known, unknown)]
        found.append([(azimuth_error(one, azimuth), one.confidence[0]) for one in estimates])
    return np.array(found).transpose(1, 2, 0)


def test_known_speeds_take_nothing_from_a_recording():
    """It whitens lines as all else of the rotors; a target is in the bins of notches, too."""
    (errors, confidences), (plain, before) = over_rotors_that_jitter(23, 14.0, True)
    assert np.max(errors) < 20.0 and np.median(errors) < 1.2 * np.median(plain)
    assert np.mean(confidences > 0.9) >= np.mean(before > 0.9) - 0.1


@pytest.mark.parametrize('seed', [24, 25, 28])
def test_notches_leave_a_target_that_is_louder_than_the_lines(seed):
    """A target that hisses is heard above the lines of these rotors, though they are louder in all."""
    (errors, confidences), (plain, before) = over_rotors_that_jitter(seed, 10.0, False)
    assert np.max(plain) < 20.0 and np.max(errors) < 20.0
    assert np.mean(confidences > 0.9) >= np.mean(before > 0.9) - 0.1
