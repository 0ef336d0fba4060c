"""Computes cases: simulates a scenario or replays a bag, and evaluates every method on the same measurements."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

from av_audio.localizer import LocalizerSettings
from av_bags.reader import Bag
from av_bags.topics import parse_remappings
from av_common.rig import load_rig
from av_evaluation.experiments.methods import estimators_of
from av_evaluation.experiments.offline_run import OfflineRun
from av_evaluation.experiments.physical import FILMED, detection_stage, filmed
from av_evaluation.metrics.results import RunResult
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.cases import Case, is_bag
from av_evaluation.runs.evaluation import evaluate_run
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_pointing.controller import PointingController, PointingSettings
from av_pointing.settings import with_gimbal
from av_simulator.config_files import find_config
from av_simulator.scenario import load_scenario


def run_case(case: Case) -> RunResult:
    """Compute one case. Raises ValueError or OSError with a message about the input."""
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
    settings = with_gimbal(PointingSettings(move_gimbal=rig.gimbal is not None), rig.gimbal)
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
