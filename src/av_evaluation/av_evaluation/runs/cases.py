"""Cases: input, settings and methods of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from av_audio.localizer import LocalizerSettings
from av_simulator.config_files import find_config

BAG_ENDINGS = ('.mcap', '.db3')


@dataclass(frozen=True)
class Case:
    """One run of a scenario or a bag, and the methods to evaluate.

    Parameters:
        input: shipped name or file of a scenario, a bag, or `filmed:CLIP` and `room:NUMBER`.
        seed: of the scenario's noise.
        methods: to evaluate.
        duration (s): 0 for that of the input.
        model: ONNX file of the detector, 'shipped', or '' for the simulator's visual oracle or the recorded detections.
        follow: whether the rig of a scenario obeys the pointing controller, or moves as the scenario defines.
        rig: name or file of the rig's description, '' for the scenario's.
        max_sources: largest number of sources of the localizer in scenarios.
        stage: of a bag, from which to compute, see `ReplaySettings`.
        parameters: parameter files for a bag.
        remap: remappings of a bag's topics.
        namespace: of the recorded rig in a bag.
        data: folder of recordings for `filmed:` and `room:`.
    """

    input: str
    seed: int = 0
    methods: tuple[str, ...] = ('fused', 'sound', 'sight')
    duration: float = 0.0
    model: str = ''
    follow: bool = True
    rig: str = ''
    max_sources: int = LocalizerSettings.max_sources
    stage: str = ''
    parameters: tuple[str, ...] = ()
    remap: tuple[str, ...] = ()
    namespace: str = ''
    data: str = ''

    @property
    def is_bag(self) -> bool:
        """Whether the input is a bag."""
        return is_bag(Path(self.input))

    @property
    def name(self) -> str:
        """Name of the run in reports and files."""
        stem = Path(self.input).stem.replace(':', '_')
        if self.data:
            return stem
        rig = f'_{Path(self.rig).stem}' if self.rig else ''
        return stem if self.is_bag else f'{stem}_{self.seed}{rig}'


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2, as file or folder; the folder may lack metadata.yaml after an interrupted recording."""
    if path.is_dir():
        first = (path / f'{path.name}_0{ending}' for ending in BAG_ENDINGS)
        return (path / 'metadata.yaml').exists() or any(file.exists() for file in first)
    return path.suffix in BAG_ENDINGS and path.exists()


def find_inputs(inputs: list[str]) -> list[str]:
    """Scenarios and bags that the inputs name, with those in folders and their subfolders.

    Raises FileNotFoundError for a bag that does not exist, ValueError for a folder without inputs, ConfigError (a ValueError)
    for an unknown scenario.
    """
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
    """Bags and scenarios in a folder and its subfolders."""
    found = []
    for entry in sorted(folder.iterdir()):
        if is_bag(entry) or (entry.suffix == '.yaml' and entry.is_file()):
            found.append(str(entry))
        elif entry.is_dir() and not entry.name.startswith('.'):
            found += _search(entry)
    return found
