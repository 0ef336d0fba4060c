"""The detectors that ship with the package."""

from __future__ import annotations

from pathlib import Path

from av_common.shipped import shipped_file

FILES = {'visible': 'drone_detector.onnx', **dict.fromkeys(('thermal', 'black_hot'), 'drone_detector_ir.onnx')}


def shipped_model(camera_kind: str = 'visible') -> Path:
    """Path of the model file for a kind of camera, in the source tree or in the share folder of the installed package."""
    return shipped_file('av_vision', 'models', FILES[camera_kind])
