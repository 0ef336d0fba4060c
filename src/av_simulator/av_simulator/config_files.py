"""Search for configuration files: rigs, scenarios and drones by path or by name."""

from __future__ import annotations

import os
from pathlib import Path

from av_common.config_reader import ConfigError
from av_common.files import nearest


def find_config(name: str, folder: str = '') -> Path:
    """Path of a configuration file. Raises ConfigError with the names of the shipped files if there is no such file.

    The search order is the configuration installed by av_bringup, and config/ of the source tree.

    Parameters:
        name: path of a file, or name of a shipped file with or without `.yaml`.
        folder: folder within config/, such as `scenarios`; empty for config/ itself.
    """
    direct = Path(name).expanduser()
    if direct.suffix and direct.is_file():
        return direct
    shelves = [root / folder for root in _config_roots() if (root / folder).is_dir()]
    for shelf in shelves:
        candidate = shelf / (name if direct.suffix else f'{name}.yaml')
        if candidate.is_file():
            return candidate
    names = shipped(folder)
    raise ConfigError(f'{name}: no such file, the nearest is {nearest(direct.stem, names)}; shipped files are '
                      f'{", ".join(names)}')


def shipped(folder: str) -> list[str]:
    """Names of the shipped YAML files in `folder` of config/."""
    return sorted({file.stem for root in _config_roots() for file in (root / folder).glob('*.yaml')})


def _config_roots() -> list[Path]:
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    roots = [Path(prefix) / 'share' / 'av_bringup' / 'config' for prefix in prefixes if prefix]
    here = Path(__file__).resolve()
    return roots + [parent / 'config' for parent in here.parents if (parent / 'config' / 'scenarios').is_dir()]
