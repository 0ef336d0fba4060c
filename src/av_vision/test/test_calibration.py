"""Calibration files of a camera."""

from pathlib import Path

import numpy as np
import pytest

from av_common.camera import PinholeCamera
from av_vision.nodes.camera_node import load_calibration

DISTORTED = PinholeCamera(640, 480, 450.0, 455.0, 322.0, 238.0, (-0.28, 0.09, 0.001, -0.0007, -0.01))


def test_calibration_file(tmp_path):
    file = tmp_path / 'camera.yaml'
    file.write_text('image_width: 640\nimage_height: 480\n'
                    'camera_matrix: {rows: 3, cols: 3, data: [450, 0, 322, 0, 455, 238, 0, 0, 1]}\n'
                    'distortion_model: plumb_bob\n'
                    'distortion_coefficients: {rows: 1, cols: 5, data: [-0.28, 0.09, 0.001, -0.0007, -0.01]}\n')
    assert load_calibration(file) == DISTORTED
    file.write_text('image_width: 640\n')
    with pytest.raises(ValueError, match='camera.yaml.*camera_matrix'):
        load_calibration(file)


EQUIDISTANT = ('image_width: 1280\nimage_height: 1024\n'
               'camera_matrix: {rows: 3, cols: 3, data: [420, 0, 638, 0, 421, 510, 0, 0, 1]}\n'
               'distortion_model: MODEL\n'
               'distortion_coefficients: {rows: 4, cols: 1, data: [0.02, -0.004, 0.001, -0.0003]}\n')


def test_a_fisheye_calibration_is_one(tmp_path):
    file = tmp_path / 'fisheye.yaml'
    file.write_text(EQUIDISTANT.replace('MODEL', 'equidistant'))
    angle = np.radians(62.0)
    reach = angle * (1.0 + 0.02 * angle**2 - 0.004 * angle**4 + 0.001 * angle**6 - 0.0003 * angle**8)
    x, _, z = load_calibration(file).rays([[638.0 - 420.0 * reach, 510.0]])[0]
    assert np.degrees(np.arctan2(-x, z)) == pytest.approx(62.0, abs=1e-3)
    file.write_text(EQUIDISTANT.replace('MODEL', 'fov'))
    with pytest.raises(ValueError, match="fisheye.yaml: distortion_model is 'fov', expected plumb_bob, .*equidistant"):
        load_calibration(file)


@pytest.mark.parametrize(('old', 'new', 'reason'), [
    ('distortion_model', 'distortion_modell', "'distortion_modell' is no entry .* nearest is distortion_model"),
    ('distortion_coefficients', 'distorsion_coefficients', 'nearest is distortion_coefficients'),
    ('[420, 0, 638, 0, 421, 510, 0, 0, 1]', '[420, 0, 0, 0, 421, 0, 638, 510, 1]', 'expected fx, 0, cx'),    # by columns
    ('[420, 0, 638', '[420, 17, 638', 'expected fx, 0, cx'),
    ('[420, 0, 638, 0, 421, 510', '[4.2, 0, 6.4, 0, 4.21, 5.1', '4.2 and 4.21 for 1280 x 1024 pixels, expected pixels')])
def test_what_would_be_another_lens_is_refused(tmp_path, old, new, reason):
    """A misspelt entry counted as absent, and a matrix of another form, or in millimetres, was read as a lens."""
    file = tmp_path / 'fisheye.yaml'
    text = EQUIDISTANT.replace('MODEL', 'equidistant') + 'date: today\n'
    file.write_text(text)
    load_calibration(file)
    file.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=f'fisheye.yaml: .*{reason}'):
        load_calibration(file)


FIELD_CASE = Path(__file__).resolve().parents[4] / 'shared/data/field_cases/calibration/cal_equidistant.yaml'


@pytest.mark.skipif(not FIELD_CASE.exists(), reason='needs ../shared/data')
def test_the_calibration_of_the_field():
    camera = load_calibration(FIELD_CASE)
    angle = np.radians(47.8)
    reach = angle * (1.0 + 0.01 * angle**2 - 0.02 * angle**4 + 0.003 * angle**6)
    x, _, z = camera.rays([[319.5 + 300.0 * reach, 239.5]])[0]
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(47.8, abs=1e-3)
