"""Geometry against hand-made cases."""

from pathlib import Path

import numpy as np
import pytest

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.microphone_array import DelayCurve, MicrophoneArray

ARRAYS = Path(__file__).resolve().parents[3] / 'config' / 'arrays'
PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])


@pytest.mark.parametrize('path', sorted(ARRAYS.glob('*.yaml')), ids=lambda path: path.stem)
def test_ready_arrays_load(path):
    assert MicrophoneArray.load(path).name == path.stem


def test_left_source_reaches_the_left_microphone_first():
    delays = PAIR.delays(angles_to_direction(np.radians([90.0, 30.0, 150.0, -90.0])), 343.0)
    np.testing.assert_allclose(delays[:, 0], 0.2 / 343.0 * np.array([1.0, 0.5, 0.5, -1.0]), atol=1e-12)


def test_two_microphones_have_a_front_and_a_back_image():
    azimuth, elevation = direction_to_angles(PAIR.hypotheses(np.sin(np.radians([30.0]))))
    np.testing.assert_allclose(np.degrees(azimuth), [30.0, 150.0])
    np.testing.assert_allclose(elevation, 0.0)


def test_a_turned_line_mirrors_about_its_axis():
    line = MicrophoneArray(np.array([0.1, 0.0, -0.1])[:, None] * angles_to_direction(np.radians(60.0)))
    azimuth, _ = direction_to_angles(line.hypotheses([np.cos(np.radians(40.0))]))
    np.testing.assert_allclose(np.degrees(azimuth), [20.0, 100.0])


def test_a_plane_mirrors_up_and_down_and_a_space_not_at_all():
    square = MicrophoneArray.load(ARRAYS / 'quadrotor_square.yaml')
    direction = angles_to_direction(np.radians(-120.0), np.radians(20.0))
    azimuth, elevation = direction_to_angles(square.hypotheses(square.basis.T @ direction))
    np.testing.assert_allclose(np.degrees(azimuth), -120.0)
    np.testing.assert_allclose(np.degrees(elevation), [20.0, -20.0])
    pyramid = MicrophoneArray(np.vstack([square.positions, [0.0, 0.0, 0.05]]))
    np.testing.assert_allclose(pyramid.hypotheses(pyramid.basis.T @ direction), [direction], atol=1e-12)


def test_delay_curve_bends_delays_and_back(tmp_path):
    cosine = np.linspace(-1.0, 1.0, 21)
    curve = DelayCurve(cosine, cosine + 0.1 * np.sin(np.pi * cosine), 0.02)
    bent = MicrophoneArray(PAIR.positions, 'bent', curve)
    np.testing.assert_allclose(curve.true_cosine(curve.measured_cosine([-1.1, -0.3, 0.77])), [-1.1, -0.3, 0.77])
    assert bent.delays([[0.0, 0.5, 0.0]], 340.0)[0, 0] == pytest.approx(0.2 / 340.0 * 0.6)
    bent.save(tmp_path / 'bent.yaml', 'two lines\nof comment')
    again = MicrophoneArray.load(tmp_path / 'bent.yaml')
    np.testing.assert_allclose(again.delay_curve.measured, curve.measured, atol=1e-6)
    assert again.delay_curve.sigma == 0.02
    assert again.delay_curve.sigma_at([0.3]) == 0.02
    np.testing.assert_allclose(again.positions, PAIR.positions)


def test_the_scatter_about_a_delay_curve_depends_on_the_place(tmp_path):
    curve = DelayCurve([-1.0, 0.0, 1.0], [-0.8, 0.0, 0.8], [0.1, 0.02, 0.06])
    MicrophoneArray(PAIR.positions, 'head', curve).save(tmp_path / 'head.yaml')
    again = MicrophoneArray.load(tmp_path / 'head.yaml').delay_curve
    np.testing.assert_allclose(again.sigma_at([-2.0, -0.4, 0.0, 0.8]), [0.1, 0.06, 0.02, 0.06])


@pytest.mark.parametrize('text, message', [
    ('- 1', 'a mapping expected'),
    ('microphones: [[0, 0, 0]]', 'at least two'),
    ('microphones: [[0, 0], [1, 0]]', r'microphones\[0\]: \[0, 0\], a list of 3 expected'),
    ('microphones: [[0, 0, 0], [0, 0, .nan]]', 'finite'),
    ('microphones: [[0, 1, 0], [0, 1, 0]]', 'same place'),
    ('microphones: [[0, 100, 0], [0, -100.1, 0]]', 'millimetres'),
    ('microphones: [[0, 0, 1], [0, 0, 0]]', 'vertical'),
    ('microphones: [[0, a, 1], [0, 0, 0]]', r"microphones\[0\]\[1\]: 'a', a number expected"),
    ('microphones: [[0, 1, 0], [0, 0, 0]]\nmics: 2', 'mics: unknown key'),
    ('microphones: [[0, 1, 0], [0, 0, 0]]\ndelay_curve: {cosine: [0, 1], measured: [1, 0]}', 'rise strictly'),
    ('microphones: [[0, 1, 0], [0, 0, 0]]\ndelay_curve: {cosine: [0, 1], measured: [0, 1], sigma: [0.1]}', 'a list of 2'),
    ('microphones: [[0, 1, 0], [0, 0, 0]]\ndelay_curve: {cosine: [0, 1], measured: [0, 1], sigma: [0, 2]}', 'beyond 1.0'),
    ('microphones: [', 'array file'),
])
def test_bad_files_say_what_is_wrong(tmp_path, text, message):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        MicrophoneArray.load(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(('positions', 'unit'), [
    ([[0, 85, 0], [0, -85, 0]], 'millimetres'), ([[0, 8.5, 0], [0, -8.5, 0]], 'centimetres'),
    ([[46, 0, 0], [0, 46, 0], [-46, 0, 0], [0, -46, 0]], 'millimetres'),
    ([[x, y, z] for x in (-20, 20) for y in (-20, 20) for z in (0, 30)], 'millimetres'),
    ([[4.6 * np.cos(k), 4.6 * np.sin(k), 0.0] for k in range(6)], 'centimetres'),
    ([[0, 0, 0], [0.2, 0, 0], [9, 0, 0]], 'centimetres')])
def test_positions_in_other_units_are_refused_with_the_likely_one(positions, unit):
    with pytest.raises(ValueError, match=f'these look like {unit}'):
        MicrophoneArray(positions)


def test_large_arrays_of_many_microphones_are_arrays():
    assert MicrophoneArray([[2.0 * x, 2.0 * y, 0.0] for x in range(4) for y in range(4)]).aperture > 8.0
    assert MicrophoneArray([[0.0, 1.5, 0.0], [0.0, -1.5, 0.0]]).aperture == 3.0
