"""Reads camera calibrations in the YAML format of ROS (`camera_calibration`, `camera_info_manager`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from av_common.camera import PinholeCamera


def load_calibration(path: str | Path) -> PinholeCamera:
    """The camera of a calibration file; raises ValueError that names the file and the entry that is missing or wrong."""
    try:
        entries = yaml.safe_load(Path(path).read_text())
        matrix = np.array(entries['camera_matrix']['data'], float).reshape(3, 3)
        distortion = entries.get('distortion_coefficients', {}).get('data', [])
        return PinholeCamera(int(entries['image_width']), int(entries['image_height']), matrix[0, 0], matrix[1, 1],
                             matrix[0, 2], matrix[1, 2], tuple(distortion))
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f'calibration {path} cannot be used: {error!r}; expected image_width, image_height, '
                         'camera_matrix.data (9) and distortion_coefficients.data') from error
