"""The published sigma: as large as errors are, for sensors and targets that are better than their models as well."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_fusion.filter import consistency
from av_fusion.filter.consistency import LEAST, InnovationConsistency
from av_fusion.measurement.rig_motion import Pose
from av_fusion.multi_target.tracker import MultiTargetTracker

SOUND, SIGHT = math.radians(1.5), math.radians(0.4)


def averaged(normalised, fraction=0.5):
    found = InnovationConsistency()
    scales = []
    for innovation in normalised:
        found.note(1.0, innovation, 1.0)
        found.adapt(fraction)
        scales.append(found.scale)
    return scales


@pytest.mark.parametrize('ratio', [0.0, 0.2, 0.4])
def test_it_finds_the_ratio_of_variances(ratio):
    """Mean of many: the larger of two averages of squared Gaussians is at most half above their expectation."""
    scales = averaged(np.random.default_rng(1).normal(0.0, math.sqrt(ratio), 4000))[100:]
    assert max(ratio, LEAST) - 0.02 < np.mean(scales) < 1.5 * ratio + LEAST + 0.02


def test_it_never_lowers_much_what_is_consistent():
    assert np.mean(averaged(np.random.default_rng(2).normal(0.0, 1.0, 4000))) > 0.85


def test_one_large_innovation_is_enough_to_trust_the_filter_as_before():
    assert averaged([0.1] * 200)[-1] == pytest.approx(LEAST, abs=0.02)
    assert averaged([0.1] * 200 + [2.5])[-1] == 1.0


def coverage(azimuth, ratio, sees, seed):
    """Share of errors within 1.64 sigma, RMSE and RMS sigma (deg), of a target at `azimuth(t)`; the rig turns by 5 deg/s.

    Parameters:
        azimuth: in the world (rad) at a time (s).
        ratio: standard deviation of the sensors' errors over that which they state.
        sees: whether the camera sees the target, also after 3 s.
        seed: of the errors.
    """
    tracker = MultiTargetTracker()
    exact, stated = SimulatedSensors(seed, ratio * SOUND, ratio * SIGHT), SimulatedSensors(seed, SOUND, SIGHT)
    errors, sigmas = [], []
    for step in range(40 * 20):
        t, yaw = step / 20.0, math.radians(5.0) * step / 20.0
        body = float(wrap(azimuth(t) - yaw))
        tracker.add_pose(Pose.level(100.0 + t, yaw))
        if step % 10 == 0:    # windows do not overlap
            heard = exact.doa(100.0 + t, body)
            tracker.add_doa(heard._replace(cone=stated.doa(0.0, body).cone._replace(cosine=heard.cone.cosine)))
        if step % 4 == 0 and (sees or t < 3.0):    # front and back are told by then
            seen = exact.camera(100.0 + t, body, half_view=3.0)
            tracker.add_camera(seen._replace(detections=tuple(
                one._replace(across_variance=SIGHT**2) for one in seen.detections)))
        track = tracker.estimate(100.0 + t)
        if t > 10.0 and track.resolved and abs(math.cos(body)) > 0.3:
            errors.append(float(wrap(track.azimuth - body)))
            sigmas.append(math.sqrt(track.azimuth_variance))
    errors, sigmas = np.array(errors), np.array(sigmas)
    return np.mean(np.abs(errors) < 1.64 * sigmas), *(math.degrees(np.sqrt(np.mean(x**2))) for x in (errors, sigmas))


def even(time):
    """Azimuth (rad) of a target that passes at 6 deg/s."""
    return math.radians(20.0 + 6.0 * time)


def swerving(time):
    """Azimuth (rad) of a target that swerves by 25 deg every 4 s."""
    return math.radians(20.0 + 12.5 * math.sin(math.tau * time / 8.0))


def mean_coverage(*arguments):
    return np.mean([coverage(*arguments, seed) for seed in (1, 2)], axis=0)


@pytest.mark.parametrize('target', [even, swerving])
@pytest.mark.parametrize('sees', [True, False])
def test_sigma_holds_where_sensors_err_as_they_state(target, sees):
    within, _, _ = mean_coverage(target, 1.0, sees)
    assert 0.8 < within < 0.98


def test_sigma_of_an_evenly_flying_target_shrinks_with_the_errors_of_the_camera(monkeypatch):
    """A third of the stated error: a sigma well below that of the models, and errors within it."""
    within, rmse, sigma = mean_coverage(even, 0.3, True)
    monkeypatch.setattr(consistency, 'LEAST', 1.0)
    _, rmse_before, sigma_before = mean_coverage(even, 0.3, True)
    assert within > 0.9 and rmse == pytest.approx(rmse_before) and sigma < 0.6 * sigma_before


def test_sigma_keeps_what_sound_alone_does_not_show(monkeypatch):
    """The target flies level with the rig, 10 deg lower than usual: innovations do not show the error of 1.5 deg."""
    within, rmse, sigma = mean_coverage(even, 0.1, False)
    monkeypatch.setattr(consistency, 'LEAST', 1.0)
    assert within > 0.9 and rmse > 1.0 and sigma < 0.75 * mean_coverage(even, 0.1, False)[2]


def test_a_manoeuvre_is_within_the_sigma_that_small_innovations_have_lowered():
    """After 20 s of even flight, exactly measured, the target swerves."""
    within, _, _ = mean_coverage(lambda t: even(t) if t < 20.0 else even(20.0) + swerving(t - 20.0) - swerving(0.0), 0.3, True)
    assert within > 0.85
