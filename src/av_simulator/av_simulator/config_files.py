"""The shipped configuration: rigs, scenarios and drones by their names."""

from __future__ import annotations

import os
from pathlib import Path

from av_common.config_reader import ConfigError


def find_config(name: str, folder: str = '') -> Path:
    """A file by path, or a shipped one by name from `folder` of config/. Raises ConfigError naming what there is.

    Searched are `$AV_CONFIG`, the configuration that av_fusion installs, and config/ of the source tree, in this order.
    """
    direct = Path(name).expanduser()
    if direct.suffix and direct.is_file():
        return direct
    shelves = [root / folder for root in _config_roots() if (root / folder).is_dir()]
    for shelf in shelves:
        candidate = shelf / (name if direct.suffix else f'{name}.yaml')
        if candidate.is_file():
            return candidate
    raise ConfigError(f'{name}: no such file, nor one of the shipped {", ".join(shipped(folder)) or "(none found)"}')


def shipped(folder: str) -> list[str]:
    """Names of the YAML files in `folder` of config/."""
    return sorted({file.stem for root in _config_roots() for file in (root / folder).glob('*.yaml')})


def _config_roots() -> list[Path]:
    roots = [Path(os.environ['AV_CONFIG'])] if 'AV_CONFIG' in os.environ else []
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    roots += [Path(prefix) / 'share' / 'av_fusion' / 'config' for prefix in prefixes if prefix]
    here = Path(__file__).resolve()
    return roots + [parent / 'config' for parent in here.parents if (parent / 'config' / 'scenarios').is_dir()]
