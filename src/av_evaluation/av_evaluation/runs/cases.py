"""Cases: input, settings and methods of a run, with a key by which its result is found on disk, and how they are computed."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from av_audio.localizer import LocalizerSettings
from av_audio.methods import DOA_METHODS
from av_bags.reader import Bag
from av_bags.topics import parse_remappings
from av_common.rig import UNDESCRIBED_GIMBAL, load_rig
from av_evaluation.experiments.methods import code_of, estimators_of
from av_evaluation.experiments.offline_run import OfflineRun
from av_evaluation.experiments.physical import FILMED, detection_stage, filmed
from av_evaluation.metrics.results import RunResult
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.evaluation import evaluate_run
from av_fusion.settings import TRACKERS
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_pointing.controller import PointingController
from av_pointing.settings import PointingSettings
from av_simulator.config_files import find_config
from av_simulator.scenario import load_scenario
from av_vision.methods import DETECTORS
from av_vision.models import shipped_model

PACKAGES = ('av_audio', 'av_bags', 'av_common', 'av_evaluation', 'av_fusion', 'av_pointing', 'av_sim_bridge', 'av_simulator',
            'av_vision')
BAG_ENDINGS = ('.mcap', '.db3')


@dataclass(frozen=True)
class Case:
    """One run of a scenario or a bag, and the methods to evaluate.

    Parameters:
        input: shipped name or file of a scenario, a bag, or `filmed:CLIP`.
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
        data: folder of recordings for `filmed:`.
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
    def name(self) -> str:
        """Name of the run in reports and files."""
        stem = Path(self.input).stem.replace(':', '_')
        if self.data:
            return stem
        rig = f'_{Path(self.rig).stem}' if self.rig else ''
        return stem if is_bag(Path(self.input)) else f'{stem}_{self.seed}{rig}'

    @property
    def key(self) -> str:
        """Digest of everything that the result depends on: case, files, detector, and code, also that of others' methods."""
        files = (self.input, self.model, self.rig, *self.parameters)
        others = [*code_of(self.methods), DETECTORS.code(self.model) if self.model != 'shipped' else '']
        if self.parameters:  # which may name any of them
            others += [group.code(name) for group in (DOA_METHODS, TRACKERS, DETECTORS) for name in group.others]
        content = json.dumps([asdict(self), *map(_content, files), _code(), *others])
        return hashlib.sha256(content.encode()).hexdigest()[:12]


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2, as file or folder; the folder may lack metadata.yaml after an interrupted recording."""
    if path.is_dir():
        first = (path / f'{path.name}_0{ending}' for ending in BAG_ENDINGS)
        return (path / 'metadata.yaml').exists() or any(file.exists() for file in first)
    return path.suffix in BAG_ENDINGS and path.exists()


def find_inputs(inputs: list[str]) -> list[str]:
    """Scenarios and bags that the inputs name, each once, with those in folders and their subfolders.

    Raises FileNotFoundError for a bag that does not exist, ValueError for a file of another kind and a folder without inputs,
    ConfigError (a ValueError) for an unknown scenario.
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
            if not is_bag(path) and find_config(name, 'scenarios').suffix not in ('.yaml', '.yml'):
                raise ValueError(f'{name}: neither a bag (.mcap, .db3, rosbag2 folder) nor a scenario (.yaml)')
            found.append(name)
    return list(dict.fromkeys(found))


def _search(folder: Path) -> list[str]:
    """Bags and scenarios in a folder and its subfolders."""
    found = []
    for entry in sorted(folder.iterdir()):
        if is_bag(entry) or (entry.suffix == '.yaml' and entry.is_file()):
            found.append(str(entry))
        elif entry.is_dir() and not entry.name.startswith('.'):
            found += _search(entry)
    return found


def _content(name: str) -> list[tuple[str, int, int]]:
    """Files of a path with their sizes and times of change; none of a shipped name."""
    path = Path(name)
    files = [] if not name else sorted(path.rglob('*')) if path.is_dir() else [path]
    return [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()]


@cache
def _code() -> str:
    """Digest of the code of PACKAGES, the shipped detector, and the shipped scenarios, rigs and drones."""
    digest, folders = hashlib.sha256(), [(Path(str(import_module(package).__file__)).parent, '*.py') for package in PACKAGES]
    for folder, files in (*folders, (shipped_model().parent, '*.onnx'), (find_config('rig').parent, '*.yaml')):
        for file in sorted(folder.rglob(files)):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def run_case(case: Case) -> RunResult:
    """Compute one case: every method on the same measurements. Raises ValueError or OSError with a message about the input."""
    log, notes = _measure(case)
    result = evaluate_run(case.name, log, case.methods)
    result.case, result.key = asdict(case), case.key
    result.notes += notes
    return result


def _measure(case: Case) -> tuple[RunLog, list[str]]:
    """Log, and notes on the origin of the data."""
    if case.input.startswith(FILMED):
        return filmed(case.input.removeprefix(FILMED), Path(case.data), estimators_of(case.methods), case.model)
    return _replay(case) if is_bag(Path(case.input)) else _simulate(case)


def _simulate(case: Case) -> tuple[RunLog, list[str]]:
    scenario = load_scenario(find_config(case.input, 'scenarios'))
    rig = load_rig(find_config(case.rig or scenario.rig.description))
    settings = PointingSettings(rig.gimbal or UNDESCRIBED_GIMBAL, move_gimbal=rig.gimbal is not None)
    pointing = PointingController(settings) if case.follow else None
    tracker = MultiTargetTracker(TrackerSettings(gimbal=rig.gimbal))
    run = OfflineRun(scenario, rig, tracker, case.seed, pointing, estimators_of(case.methods),
                     detection_stage(case.model, rig.camera.images) if case.model else None,
                     settings=LocalizerSettings(max_sources=case.max_sources))
    run.run(case.duration or None)
    return run.log, [] if case.model else ["sight is the simulator's visual oracle: no detector ran"]


def _replay(case: Case) -> tuple[RunLog, list[str]]:
    settings = ReplaySettings(stage=case.stage, model=case.model, parameters=case.parameters, namespace=case.namespace,
                              remappings=parse_remappings(case.remap), duration=case.duration or math.inf)
    with Bag(case.input) as bag:
        replay = Replay(bag, settings, True, estimators_of(case.methods))
        return replay.run(), replay.notes
