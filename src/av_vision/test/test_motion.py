"""What a path in the image says about a class: against paths of known speed and acceleration."""

import math

import numpy as np
import pytest

from av_vision.motion import FAINT, MotionModel, Path, motion_of

MODEL = MotionModel(gain=1.2, neutral=1.5, least_speed=0.3)
SIZE, START = 20.0, np.array([300.0, 200.0])


def flown(velocity, acceleration, seconds=1.5, rate=15.0, noise=0.0, seed=0):
    """A path of constant acceleration, in sizes and seconds."""
    path, rng = Path(), np.random.default_rng(seed)
    for time in np.arange(0.0, seconds + 1e-9, 1.0 / rate):
        centre = SIZE * (np.array(velocity) * time + 0.5 * np.array(acceleration) * time**2) + rng.normal(0, noise, 2)
        path.add(7.0 + time, centre + START, SIZE)
    return path


def test_speed_and_acceleration_are_those_flown():
    speed, acceleration = np.array(flown((1.0, 0.0), (0.0, 0.8)).motion()[:2]) / SIZE
    assert speed == pytest.approx(math.hypot(1.0, 0.8 * 0.5 * 22 / 15), rel=1e-6)  # in the middle of 23 points
    assert acceleration == pytest.approx(0.8, rel=1e-6)


def test_noise_of_a_pixel_is_as_large_as_its_theory_says():
    found = [motion_of(*sampled(seed))[1] for seed in range(300)]
    # Variance of the curvature of a parabola over T from n equal samples: 4 * 180 sigma^2 / (n T^4), in each of two directions.
    expected = math.sqrt(2 * 4 * 180 * (1.0 / SIZE) ** 2 / (23 * 1.5**4))
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(expected, rel=0.2)


def sampled(seed):
    times = np.arange(23) * 1.5 / 22
    return times, np.random.default_rng(seed).normal(0, 1.0 / SIZE, (23, 2))


def test_straight_flight_speaks_against_a_drone_and_a_bent_one_says_nothing():
    assert MODEL.log_odds(flown((1.0, 0.5), (0.0, 0.0))) == pytest.approx(1.2 * math.log(FAINT / 1.6), abs=1e-6)
    assert MODEL.log_odds(flown((1.0, 0.5), (0.0, 2.0))) == 0.0
    assert MODEL.log_odds(flown((1.0, 0.5), (0.5, 0.0))) > MODEL.log_odds(flown((1.0, 0.5), (0.2, 0.0)))


@pytest.mark.parametrize('path', [flown((0.0, 0.0), (0.0, 0.0)), flown((1.0, 0.0), (0.0, 0.0), seconds=0.7),
                                  flown((1.0, 0.0), (0.0, 0.0), rate=3.0), Path()])
def test_hovering_and_short_paths_are_not_judged(path):
    assert MODEL.log_odds(path) == 0.0


def test_images_of_few_different_times_are_not_judged():
    """Stamps of whole seconds: two times have no acceleration."""
    path = Path()
    for k in range(30):
        path.add(7.0 + k // 15, START + k, SIZE)
    assert MODEL.log_odds(path) == 0.0


def test_a_known_rotation_of_the_camera_does_not_bend_the_path():
    turned, straight = Path(), flown((1.0, 0.0), (0.0, 0.0))
    shift = np.zeros(2)
    for k, time in enumerate(np.arange(0.0, 1.5 + 1e-9, 1.0 / 15.0)):
        step = np.array([0.0, 3.0 * math.sin(k)])  # pixels, by which the camera nods
        turned.turn(lambda pixels, step=step: pixels + step)
        shift = shift + step
        turned.add(7.0 + time, SIZE * np.array([1.0, 0.0]) * time + START + shift, SIZE)
    assert MODEL.log_odds(turned) == pytest.approx(MODEL.log_odds(straight), abs=1e-6)


def test_what_leaves_the_image_is_forgotten():
    path = flown((1.0, 0.0), (0.0, 0.0))
    path.turn(lambda pixels: np.full_like(pixels, np.nan))
    assert path.motion() == (0.0, 0.0, 0.0)


WATCHED = MotionModel(speck=8.0, bend=16.0, bends=1.2, rests=2.94)


def watched(velocity, acceleration, seconds=1.5, size=6.0, noise=0.3, seed=0):
    """Log-odds of a path in pixels and seconds, of boxes that jitter."""
    path, rng = Path(), np.random.default_rng(seed)
    for time in np.arange(0.0, seconds + 1e-9, 1.0 / 15.0):
        centre = np.array(velocity) * time + 0.5 * np.array(acceleration) * time**2 + rng.normal(0, noise, 2)
        path.add(time, centre + START, size)
    return WATCHED.log_odds(path)


def test_a_speck_counts_as_what_rests_until_it_moves_as_drones_do():
    for seed in range(50):
        assert watched((0.0, 0.0), (0.0, 0.0), seed=seed) < -2.0, 'at rest'
        assert watched((2.0, 1.0), (0.0, 0.0), seed=seed) < -2.0, 'drifting as a cloud'
        assert watched((10.0, 0.0), (0.0, 12.0), seed=seed) == 0.0, 'flying'
    assert watched((10.0, 0.0), (0.0, 12.0), seconds=0.8) == pytest.approx(-2.94, abs=0.01), 'not yet to be told'
    assert watched((0.0, 0.0), (0.0, 0.0), size=9.0) == 0.0, 'no speck'


def test_what_is_seen_to_rest_needs_more_than_what_is_not_yet_to_be_told():
    """Prior odds and the evidence of the test add up: a lamp of score 0.98 is no drone, once it has rested for a second."""
    for seed in range(50):
        assert watched((0.0, 0.0), (0.0, 0.0), seconds=0.8, seed=seed) == pytest.approx(-2.94, abs=0.01)
        assert watched((0.0, 0.0), (0.0, 0.0), seed=seed) < -math.log(0.98 / 0.02)


def test_jitter_is_no_motion():
    """A box that jumps by a pixel between two leaves has a noise of its own."""
    assert np.mean([watched((0.0, 0.0), (0.0, 0.0), noise=1.0, seed=seed) < -1.0 for seed in range(200)]) > 0.95


def test_of_specks_at_rest_one_in_twenty_is_taken_for_a_drone_at_most():
    """Wald's bound, where the alternative is the fitted density of drones."""
    assert np.mean([watched((0.0, 0.0), (0.0, 0.0), seed=seed) == 0.0 for seed in range(400)]) < 0.05
