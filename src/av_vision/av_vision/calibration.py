"""Reads camera calibrations in the YAML format of ROS (`camera_calibration`, `camera_info_manager`)."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import Any

from av_common.camera import DISTORTION_LENGTHS, LENS_MODELS, PinholeCamera
from av_common.config_reader import ConfigError, number
from av_common.files import shown
from av_common.yaml_reader import load_yaml

MOST_PIXELS = 65_536
ENTRIES = ('image_width', 'image_height', 'camera_name', 'camera_matrix', 'distortion_model', 'distortion_coefficients',
           'rectification_matrix', 'projection_matrix')
ALIKE = 0.8    # likeness of two names, of which one is a misspelling of the other (difflib)


def load_calibration(path: str | Path) -> PinholeCamera:
    """The camera of a calibration file. Raises ValueError or OSError that name the file and the entry that is wrong."""
    content = load_yaml(path, 'calibration')
    try:
        if not isinstance(content, dict):
            raise ConfigError(f'{shown(content)}, expected a mapping with image_width and camera_matrix')
        for name in content:    # other programs add entries of their own
            meant = get_close_matches(str(name), ENTRIES, 1, ALIKE)
            if meant and name not in ENTRIES and meant[0] not in content:
                raise ConfigError(f'{shown(name)} is no entry of a calibration, the nearest is {meant[0]}')
        matrix, model = _numbers(content, 'camera_matrix', (9,)), content.get('distortion_model', LENS_MODELS[0])
        distortion = _numbers(content, 'distortion_coefficients', DISTORTION_LENGTHS)
        width, height = (int(number(content.get(name), name, True, {'low': 1, 'high': MOST_PIXELS}))
                         for name in ('image_width', 'image_height'))
        return PinholeCamera.from_calibration(width, height, matrix, str(model), distortion)
    except ValueError as error:
        raise ValueError(f'calibration {path}: {error}') from error


def _numbers(content: dict[str, Any], name: str, lengths: tuple[int, ...]) -> tuple[float, ...]:
    """The list `data` of an entry, which may be absent where a length of 0 is allowed."""
    entry = content.get(name, {} if 0 in lengths else None)
    data = entry.get('data', [] if 0 in lengths else None) if isinstance(entry, dict) else entry
    if not isinstance(data, list) or len(data) not in lengths:
        raise ConfigError(f'{name}.data: {shown(data)}, expected a list of {" or ".join(map(str, lengths))} numbers')
    return tuple(number(value, f'{name}.data[{index}]') for index, value in enumerate(data))
