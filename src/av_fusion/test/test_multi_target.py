"""The multi-target filter against targets whose paths are known, and against random input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings

SOUND_SIGMA, SIGHT_SIGMA = math.radians(2.0), math.radians(0.3)
WINDOW = 0.1  # s, as long as the time between two: errors are independent


def make_filter():
    """A filter of a rig that stands at the origin, facing east."""
    motion = RigMotion()
    return MultiBernoulliFilter(FilterSettings(), motion), motion


def heard(random, time, azimuths, confidence=0.9):
    """One direction for each source, in random order."""
    return [DoaMeasurement(time, (Hypothesis(float(wrap(random.normal(azimuth, SOUND_SIGMA))), SOUND_SIGMA**2,
                                             random.normal(0.2, SOUND_SIGMA), SOUND_SIGMA**2),), confidence, WINDOW)
            for azimuth in random.permutation(azimuths)]


def seen(random, time, azimuths, score=0.8, half_view=0.6):
    """An image of all targets in view."""
    return CameraMeasurement(time, tuple(
        Detection(random.normal(azimuth, SIGHT_SIGMA), SIGHT_SIGMA**2, score, random.normal(0.2, SIGHT_SIGMA), SIGHT_SIGMA**2)
        for azimuth in azimuths if abs(azimuth) < half_view), half_view, visibility=1.0)


def followed(targets, azimuths):
    """The id of the confirmed track within 8 degrees of each azimuth, None without exactly one."""
    found = []
    for azimuth in azimuths:
        near = [track.id for track in targets.tracks if track.existence > 0.5
                and abs(wrap(track.mixture.primary().azimuth - azimuth)) < math.radians(8.0)]
        found.append(near[0] if len(near) == 1 else None)
    return found


def check(targets):
    """Existence in 0..1, weights that sum to one, and finite states."""
    assert len({track.id for track in targets.tracks}) == len(targets.tracks)
    for track in targets.tracks:
        weights = [component.weight for component in track.mixture.components]
        assert 0.0 <= track.existence <= 1.0 and min(weights, default=0.0) >= 0.0
        assert sum(weights) + track.mixture.absent == pytest.approx(1.0, abs=1e-6)
        for component in track.mixture.components:
            assert np.isfinite(component.covariance).all() and math.isfinite(component.azimuth)


def test_three_targets_have_three_tracks_that_keep_their_ids():
    """Three sources on circles; two of them pass each other in the camera's view, a degree apart in elevation."""
    random, (targets, motion) = np.random.default_rng(1), make_filter()
    names = set()
    for step in range(300):
        time = 0.1 * step
        azimuths = np.array([-0.5 + 0.03 * time, 0.4 - 0.03 * time, 2.5])
        motion.add(Pose.level(time, 0.0))
        targets.update_sound(time, heard(random, time, azimuths))
        targets.update_image(time, seen(random, time, azimuths))
        check(targets)
        if step > 20 and abs(azimuths[0] - azimuths[1]) > math.radians(16.0):
            names.add(tuple(followed(targets, azimuths)))
    assert len(names) == 1 and None not in next(iter(names))


def test_a_target_that_falls_silent_ends_and_its_id_is_not_used_again():
    """A target is heard, not heard for 8 s while another one is, and heard again."""
    random, (targets, motion) = np.random.default_rng(2), make_filter()
    first = None
    for step in range(150):
        time = 0.1 * step
        motion.add(Pose.level(time, 0.0))
        silent = 30 <= step < 110
        targets.update_sound(time, heard(random, time, [-2.0] if silent else [1.0, -2.0]))
        if step == 25:
            first, other = followed(targets, [1.0, -2.0])
        if step == 105:
            assert followed(targets, [1.0, -2.0]) == [None, other]
    again, same = followed(targets, [1.0, -2.0])
    assert same == other and again not in (None, first) and again > first


def test_clutter_is_not_confirmed():
    """One target among false directions of confidence 0.5 anywhere; a false track is confirmed in less than 2 % of the time."""
    random, (targets, motion) = np.random.default_rng(3), make_filter()
    false = 0
    for step in range(400):
        time = 0.1 * step
        motion.add(Pose.level(time, 0.0))
        clutter = random.uniform(-math.pi, math.pi, random.poisson(0.5))
        targets.update_sound(time, heard(random, time, [0.5]) + heard(random, time, clutter, 0.5))
        if step > 10:
            false += sum(track.existence > 0.5 for track in targets.tracks) - 1
    assert followed(targets, [0.5]) != [None]
    assert false < 0.02 * 390


def test_a_missed_detection_in_clear_air_ends_a_false_track():
    """A false detection of score 0.7 is confirmed by none of the next ten images."""
    random, (targets, motion) = np.random.default_rng(4), make_filter()
    motion.add(Pose.level(0.0, 0.0))
    targets.update_image(0.0, seen(random, 0.0, [0.2], 0.7))
    for step in range(1, 11):
        targets.update_image(0.1 * step, seen(random, 0.1 * step, []))
    assert all(track.existence < 0.1 for track in targets.tracks)


@pytest.mark.parametrize(('visibility', 'is_drone'), [(1.0, False), (1e-3, True)])
def test_fog_does_not_speak_against_a_drone_that_is_heard(visibility, is_drone):
    """Low scores at a sound that is not judged: of a bird in clear air, and of anything in fog."""
    random, (targets, motion) = np.random.default_rng(5), make_filter()
    for step in range(40):
        time = 0.1 * step
        motion.add(Pose.level(time, 0.0))
        targets.update_sound(time, heard(random, time, [0.2, 1.5]))
        if step > 20:
            targets.update_image(time, seen(random, time, [0.2], 0.2)._replace(visibility=visibility))
    drones = {track.id for track in targets.tracks if not track.kind.drone < 0.5}
    assert [identifier in drones for identifier in followed(targets, [0.2, 1.5])] == [is_drone, True]


def test_a_sound_that_is_hardly_told_from_a_bystander_still_measures_its_target():
    """A source on a circle, not judged for the first second, then less likely a drone's than not, by a little."""
    random, (targets, motion) = np.random.default_rng(6), make_filter()
    for step in range(80):
        time = 0.1 * step
        motion.add(Pose.level(time, 0.0))
        judged = 0.2 if step > 10 else math.nan
        targets.update_sound(time, [one._replace(drone_probability=judged) for one in heard(random, time, [0.1 * time])])
        if step > 20:
            assert followed(targets, [0.1 * time]) == [1]


def test_mirror_images_stay_inside_of_one_track_until_the_rig_turns():
    """A pair of microphones hears one source: one track with two components, and with one after the turn."""
    sensors, (targets, motion) = SimulatedSensors(5), make_filter()
    for step in range(100):
        time = 0.1 * step
        yaw = max(0.0, 0.3 * (time - 3.0))
        motion.add(Pose.level(time, yaw))
        targets.update_sound(time, [sensors.doa(time, 2.4 - yaw)])
        confirmed = [track for track in targets.tracks if track.existence > 0.5]
        if 5 < step < 30:
            track, = confirmed
            sides = {math.copysign(1.0, math.cos(component.azimuth)) for component in track.mixture.components
                     if component.weight > 0.2}
            assert sides == {1.0, -1.0}
    track, = confirmed
    assert track.mixture.share_of(track.mixture.primary(), None) > 0.95
    assert abs(wrap(track.mixture.primary().azimuth - 2.4)) < math.radians(5.0)


def test_the_world_turns_with_a_correction_of_the_attitude():
    """After a correction by 90 degrees, the track's azimuth is 90 degrees larger."""
    random, (targets, motion) = np.random.default_rng(7), make_filter()
    motion.add(Pose.level(0.0, 0.0))
    targets.update_image(0.0, seen(random, 0.0, [0.2]))
    before = targets.tracks[0].mixture.primary().azimuth
    targets.turn_world(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert wrap(targets.tracks[0].mixture.primary().azimuth - before) == pytest.approx(0.5 * math.pi)


@pytest.mark.parametrize('seed', range(5))
def test_random_measurements_break_nothing(seed):
    """Directions, cones and images at random, late ones among them: see `check`."""
    random, (targets, motion) = np.random.default_rng(100 + seed), make_filter()
    sensors, time = SimulatedSensors(seed), 0.0
    for _ in range(60):
        time += random.exponential(0.15)
        motion.add(Pose.level(time, random.uniform(-math.pi, math.pi)))
        late = time - random.choice([0.0, 0.2])
        azimuths = random.uniform(-math.pi, math.pi, random.integers(0, 5))
        kind = random.integers(3)
        if kind == 0:
            targets.update_sound(late, heard(random, late, azimuths, random.uniform(0.01, 1.0)))
        elif kind == 1:
            targets.update_sound(late, [sensors.doa(late, float(azimuth)) for azimuth in azimuths])
        else:
            targets.update_image(late, seen(random, late, azimuths, random.uniform(0.0, 1.0), random.uniform(0.1, math.pi)))
        check(targets)
