"""Images of any depth as 8-bit colour."""

import numpy as np
import pytest
from scipy.stats import norm

from av_vision.image import LEVELS, RARE, SURROUNDINGS, AutomaticGain, local_mean, to_bgr8

COLOUR = np.random.default_rng(0).integers(0, 256, (7, 11, 3), np.uint8)


def test_any_depth_becomes_8_bit_colour():
    ramp = np.linspace(1000, 3000, 64 * 64).reshape(64, 64).astype(np.uint16)
    grey = to_bgr8(ramp)
    assert grey.shape == (64, 64, 3)
    assert grey.min() == 0
    assert grey.max() == 255
    assert np.array_equal(to_bgr8(COLOUR[..., :1])[..., 2], COLOUR[..., 0])
    for nothing in (np.empty((0, 4, 3), np.uint8), np.zeros(5, np.uint8), np.zeros((4, 4, 2), np.uint8)):
        with pytest.raises(ValueError, match='no image'):
            to_bgr8(nothing)


def sky(seed, noise=4.0):
    """Raw counts of a thermal camera: a sky that is warmer below, with noise."""
    rows = np.linspace(7000.0, 7400.0, 256)[:, None]
    return rows + np.random.default_rng(seed).normal(0.0, noise, (256, 320))


def test_the_gain_does_not_flicker_when_something_hot_passes():
    """A truck that takes a tenth of the view enters within one image; the sky's grey hardly changes from image to image."""
    gain, levels, at_once = AutomaticGain(), [], []
    for k in range(400):
        counts = sky(k)
        if 50 <= k < 250:
            counts[200:, 100:240] = 9500.0
        image = counts.clip(0, 65535).astype(np.uint16)
        levels.append(gain.apply(image, k / 30.0)[:150].mean())
        at_once.append(to_bgr8(image)[:150].mean())
    assert np.abs(np.diff(at_once)).max() > 40.0  # what a range of each image by itself would do
    assert np.abs(np.diff(levels)).max() < 5.0
    assert levels[240] == pytest.approx(at_once[240], abs=2.0)  # it has followed after some seconds
    assert levels[-1] == pytest.approx(at_once[-1], abs=2.0)


def test_a_plain_sky_is_shown_without_its_noise():
    plain = np.random.default_rng(1).normal(7000.0, 4.0, (256, 320)).astype(np.uint16)
    shown = AutomaticGain().apply(plain, 0.0)
    assert shown.std() < 255.0 / 18.0
    assert shown.mean() == pytest.approx(127.5, abs=10.0)
    hot = plain.copy()
    hot[100:104, 100:106] += 60  # fifteen times the noise, far less than a hundredth of the image
    assert AutomaticGain().apply(hot, 0.0)[100:104, 100:106].min() > 200


def picture(counts, gain, time):
    return gain.apply(np.rint(counts).clip(0, 65535).astype(np.uint16), time).astype(float)


@pytest.mark.parametrize('jump', [150.0, -800.0])
def test_a_flat_field_correction_does_not_show(jump):
    """All counts move within one image, by less or more than their range."""
    gain = AutomaticGain()
    for k in range(30):
        before = picture(sky(k), gain, k / 30.0)
    after = picture(sky(30) + jump, gain, 1.0)
    assert np.abs(after - before)[10:-10].mean() < 8.0  # noise: 4 counts of 400 in either


def test_dead_and_saturated_pixels_do_not_tell_the_range():
    """Two columns and a row are dead, and the sun saturates a disc of 24 pixels: 3 % of the image."""
    rows, columns = np.mgrid[:256, :320]
    counts = sky(0)
    counts[:, [40, 200]] = counts[17] = 0.0
    counts[np.hypot(rows - 60, columns - 100) < 24.0] = 16383.0
    plain, odd = picture(sky(0), AutomaticGain(), 0.0), picture(counts, AutomaticGain(), 0.0)
    assert np.abs(odd - plain)[100:, 210:].mean() < 3.0
    left_aligned = picture(4.0 * counts, AutomaticGain(), 0.0)
    assert np.abs(left_aligned - odd).mean() < 3.0


@pytest.mark.parametrize('stuck', [0.0, 3000.0, 12000.0])
def test_bad_rows_and_pixels_of_a_thermal_sensor_are_filled_and_do_not_tell_the_range(stuck):
    """Four rows, a column, and one pixel in a hundred; a dead one is known at once, a stuck one within 20 images."""
    bad = np.random.default_rng(1).random((256, 320)) < 0.01
    bad[30:34] = bad[:, 40] = True
    whole, faulty = AutomaticGain(heat=True), AutomaticGain(heat=True)
    for k in range(100):
        counts = sky(k)
        counts[100:108, 150:162] += 400.0
        plain, shown = picture(counts, whole, k / 30), picture(np.where(bad, stuck, counts), faulty, k / 30)
        if k > 20 or not stuck:
            assert np.abs(shown - plain)[~bad].mean() < 8.0
            assert np.abs(shown - plain)[bad].mean() < 25.0    # the noise of a pixel


@pytest.mark.parametrize('most', [16383.0, 15900.0])
def test_what_is_below_or_above_the_range_of_a_thermal_camera_is_no_bad_pixel(most):
    """A cold sky of count 0, and a hot thing at the end of the range, rest for seconds."""
    gain = AutomaticGain(heat=True)
    for k in range(40):
        counts = sky(k)
        counts[:100] = 0.0
        counts[150:160, 100:112] = most
        shown = picture(counts, gain, k / 30)
    assert (shown[150:160, 100:112] == 255).all() and (shown[:100] == 0).all()


def test_ground_and_a_warmer_horizon_do_not_hide_what_is_faint_in_the_sky():
    """Raw counts have the whole sky's range and the ground's; cameras take most of it out of pictures of their own."""
    counts = np.linspace(6000.0, 8000.0, 256)[:, None] + np.random.default_rng(0).normal(0.0, 5.0, (256, 320))
    counts[230:] += 1000.0
    counts[100:106, 150:158] += 200.0
    shown, linear = picture(counts, AutomaticGain(heat=True), 0.0), picture(counts, AutomaticGain(), 0.0)
    contrast, before = (one[100:106, 150:158].mean() - one[100:106, 130:180].mean() for one in (shown, linear))
    assert contrast > 2.0 * before > 20.0
    assert shown[:200].mean(axis=1).std() < 0.5 * linear[:200].mean(axis=1).std()
    assert picture(np.dstack([counts] * 3), AutomaticGain(heat=True), 0.0).shape == (256, 320, 3)  # a PNG of 16 bits


def test_the_local_mean_before_an_edge_is_that_of_one_side_and_some_of_the_other():
    """Of normal weights, the share of a side in the surroundings is the normal distribution of the distance from its edge."""
    counts = np.full((256, 320), 7000.0, np.float32)
    counts[:, 160:] += 1000.0
    side = norm.cdf((160.0 - np.arange(320) - 0.5) / (SURROUNDINGS * 320))
    cold, hot = (1000.0 * RARE * share / (1.0 - share + RARE) for share in (1.0 - side, side))
    expected = 7000.0 + np.where(np.arange(320) < 160, cold, 1000.0 - hot)
    np.testing.assert_allclose(local_mean(counts)[128, 80:240], expected[80:240], atol=15.0)  # of cells of 8 pixels
    np.testing.assert_array_equal(local_mean(counts[..., None])[..., 0], local_mean(counts))
    between = counts + 1000.0 / (LEVELS - 1)
    np.testing.assert_allclose(local_mean(between), local_mean(counts) + 1000.0 / (LEVELS - 1), atol=0.1)


def beside_a_roof(seed, warmer):
    """A sky with a drone of 8 x 6 pixels that is 200 counts warmer, and a roof on the quarter at the left."""
    counts = sky(seed)
    counts[:, :80] += warmer
    counts[100:106, 200:208] += 200.0
    return counts


@pytest.mark.parametrize('warmer', [1200.0, 3200.0, -3200.0])
def test_a_hot_or_cold_roof_does_not_hide_a_drone_before_the_sky(warmer):
    """Of three or eight times the sky's range; linear gain leaves 255 * 200 / 3600 = 14 grey levels of the drone at most."""
    shown = picture(beside_a_roof(0, warmer), AutomaticGain(heat=True), 0.0)
    assert shown[100:106, 200:208].mean() - shown[95:111, 170:190].mean() > 28.0


def test_the_gain_of_heat_does_not_flicker_when_a_roof_comes_into_view():
    gain = AutomaticGain(heat=True)
    shown = [picture(beside_a_roof(k, 3200.0 * (k >= 30)), gain, k / 30.0)[:, 150:].mean(axis=1) for k in range(90)]
    assert np.abs(np.diff(shown, axis=0)).max() < 12.0  # noise of rows aside
    at_once = picture(beside_a_roof(89, 3200.0), AutomaticGain(heat=True), 0.0)[:, 150:].mean(axis=1)
    assert np.abs(np.diff([shown[29], at_once], axis=0)).max() > 24.0


def test_the_gain_begins_anew_with_another_size_and_after_a_loop():
    gain = AutomaticGain()
    first = gain.apply(sky(0).astype(np.uint16), 5.0)
    gain.apply(20000 + sky(1).astype(np.uint16), 5.1)
    np.testing.assert_array_equal(gain.apply(sky(0).astype(np.uint16), 1.0), first)
    small = sky(2).astype(np.uint16)[:100, :100]
    np.testing.assert_array_equal(gain.apply(small, 1.1), AutomaticGain().apply(small, 0.0))
