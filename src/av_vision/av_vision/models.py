"""The detector that ships with the package."""

from __future__ import annotations

from pathlib import Path

NAME = 'drone_detector.onnx'


def shipped_model() -> Path:
    """Path of the model file, in the source tree or in the share folder of the installed package."""
    in_source = Path(__file__).resolve().parents[1] / 'models' / NAME
    if in_source.exists():
        return in_source
    from ament_index_python import get_package_share_directory
    return Path(get_package_share_directory('av_vision'), 'models', NAME)
