"""Notches against combs whose frequencies are known."""

import numpy as np
from known_sound import PAIR, RATE, scene

from av_audio.ego_rotors import notch
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import wrap

FREQUENCIES = np.arange(165.0, 4600.0, 2.0)


def azimuth_error(estimate, azimuth):
    """Of the image that is closer to the true azimuth (rad), in degrees."""
    return np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth))))


def test_a_notch_covers_the_harmonics_and_little_else():
    free = notch(FREQUENCIES, [180.0])
    for order in range(1, 25):
        assert not free[np.argmin(np.abs(FREQUENCIES - order * 180.0))]
        assert free[np.argmin(np.abs(FREQUENCIES - (order + 0.5) * 180.0))]
    assert notch(FREQUENCIES, [0.0]).all()


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
