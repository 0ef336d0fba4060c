"""Cases: what to run and how. Each is computed once; what is on disk of the same case and the same code is read."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import av_audio
import av_bags
import av_common
import av_evaluation
import av_fusion
import av_pointing
import av_sim_bridge
import av_simulator
import av_vision
from av_simulator.config_files import find_config
from av_vision.models import shipped_model

PACKAGES = (av_audio, av_bags, av_common, av_evaluation, av_fusion, av_pointing, av_sim_bridge, av_simulator, av_vision)
BAG_ENDINGS = ('.mcap', '.db3')


@dataclass(frozen=True)
class Case:
    """One run of a scenario (shipped name or file) with a seed, or a bag, and the methods to judge.

    For scenarios: `model` is the detector's ONNX file, '' for the visual oracle; `follow` lets the rig turn as the pointing
    controller commands, else as the scenario says; `changes` are values of the scenario's file by dotted keys; `array`
    is an array file other than the rig's, `band_hz` where it listens. For bags: `stage`, `parameters`, `remap` and
    `namespace` as of `replay`. Inputs `filmed:CLIP` and `room:NUMBER` rest on recordings in the folder `data`.
    `taus`: further gates on the detection confidence, at which `fused` and `gated` are computed as well.
    """

    input: str
    seed: int = 0
    methods: tuple[str, ...] = ('fused', 'sound', 'sight')
    taus: tuple[float, ...] = ()
    duration: float = 0.0
    model: str = ''
    follow: bool = True
    changes: tuple[tuple[str, Any], ...] = ()
    array: str = ''
    band_hz: tuple[float, float] = (200.0, 4000.0)
    stage: str = ''
    parameters: tuple[str, ...] = ()
    remap: tuple[str, ...] = ()
    namespace: str = ''
    data: str = ''

    @property
    def is_bag(self) -> bool:
        """Whether the input is a record."""
        return is_bag(Path(self.input))

    @property
    def name(self) -> str:
        """What the run is called."""
        stem = Path(self.input).stem.replace(':', '_')
        if self.data:
            return stem
        changes = ''.join(f'_{key.split(".")[-1]}={value}' for key, value in self.changes if isinstance(value, int | float))
        return stem if self.is_bag else f'{stem}_{self.seed}{changes}'

    @property
    def key(self) -> str:
        """Changes with whatever could change the result."""
        files = ('' if self.data else self.input, self.model, self.array, *self.parameters)
        said = json.dumps([asdict(self), *map(_content, files), _code()])
        return hashlib.sha256(said.encode()).hexdigest()[:12]


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2: a file or a folder, even if it was cut off before its metadata were written."""
    if path.is_dir():
        first = (path / f'{path.name}_0{ending}' for ending in BAG_ENDINGS)
        return (path / 'metadata.yaml').exists() or any(file.exists() for file in first)
    return path.suffix in BAG_ENDINGS and path.exists()


def find_inputs(inputs: list[str]) -> list[str]:
    """Scenarios and bags that the inputs name, folders searched through. Raises FileNotFoundError, ValueError."""
    found: list[str] = []
    for name in inputs:
        path = Path(name)
        if path.is_dir() and not is_bag(path):
            inside = _search(path)
            if not inside:
                raise ValueError(f'{name}: neither bags (.mcap, .db3, rosbag2 folders) nor scenarios (.yaml) in this folder')
            found += inside
        elif path.suffix in BAG_ENDINGS and not path.exists():
            raise FileNotFoundError(f'{name}: no such bag')
        else:
            if not is_bag(path):
                find_config(name, 'scenarios')
            found.append(name)
    return found


def _search(folder: Path) -> list[str]:
    """Bags and scenarios in a folder and those below it."""
    found = []
    for entry in sorted(folder.iterdir()):
        if is_bag(entry) or (entry.suffix == '.yaml' and entry.is_file()):
            found.append(str(entry))
        elif entry.is_dir() and not entry.name.startswith('.'):
            found += _search(entry)
    return found


def _content(name: str) -> str:
    """What tells one state of a file from another: its text, or of a bag size and time."""
    path = Path(name)
    if name in ('', 'shipped'):
        return ''
    if is_bag(path) or path.suffix == '.onnx':
        files = sorted(path.rglob('*')) if path.is_dir() else [path]
        return str([(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.exists()])
    file = path if path.suffix == '.yaml' and path.exists() else find_config(name, 'scenarios')
    return hashlib.sha256(file.read_bytes()).hexdigest()


@cache
def _code() -> str:
    """Digest of the code that takes part and of the shipped detector."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted(Path(package.__file__).parent.rglob('*.py')):
            digest.update(file.read_bytes())
    digest.update(shipped_model().read_bytes())
    return digest.hexdigest()
