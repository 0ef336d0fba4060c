"""Calibration files of a camera."""

import pytest

from av_common.camera import PinholeCamera
from av_vision.calibration import load_calibration

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
