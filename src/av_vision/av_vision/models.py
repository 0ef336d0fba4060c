"""The detector that ships with the package."""

from __future__ import annotations

from pathlib import Path

from av_common.shipped import shipped_file


def shipped_model() -> Path:
    """Path of the model file, in the source tree or in the share folder of the installed package."""
    return shipped_file('av_vision', 'models', 'drone_detector.onnx')
