"""Computes cases: simulates a scenario or replays a bag, and evaluates every method on the same measurements."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np

from av_audio.localizer import LocalizerSettings
from av_bags.reader import Bag
from av_bags.topics import parse_remappings
from av_common.rig import load_rig
from av_evaluation.experiments.methods import UnavailableError, bearings, estimators_of, is_folded, is_tracker, track
from av_evaluation.experiments.offline_run import OfflineRun
from av_evaluation.experiments.physical import FILMED, ROOM, detection_stage, filmed, room
from av_evaluation.metrics.metrics import compare, coverage_of, instants, summarise, switches, time_to_resolve
from av_evaluation.metrics.results import MethodResult, RunResult
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.cases import Case
from av_evaluation.runs.measurement_record import MeasurementRecord
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_pointing.controller import PointingController, PointingSettings
from av_pointing.settings import with_gimbal
from av_simulator.config_files import find_config
from av_simulator.scenario import load_scenario


def run_case(case: Case) -> RunResult:
    """Compute one case. Raises ValueError or OSError with a message about the input."""
    log, record, notes = _measure(case)
    result = evaluate_run(case.name, log, record, case.methods)
    result.case, result.key = asdict(case), case.key
    result.notes += notes
    return result


def _measure(case: Case) -> tuple[RunLog, MeasurementRecord, list[str]]:
    """Log, record of measurements, and notes on the origin of the data."""
    if case.input.startswith(FILMED):
        return filmed(case.input.removeprefix(FILMED), Path(case.data), estimators_of(case.methods), case.model)
    if case.input.startswith(ROOM):
        return room(int(case.input.removeprefix(ROOM)), Path(case.data), estimators_of(case.methods))
    return _replay(case) if case.is_bag else _simulate(case)


def evaluate_run(name: str, log: RunLog, record: MeasurementRecord, methods: tuple[str, ...]) -> RunResult:
    """Evaluate methods on one run.

    Parameters:
        name: of the run.
        log: truth, measurements and bearings.
        record: measurements for other methods.
        methods: to evaluate.
    """
    acquired = summarise(log).acquired
    ends = [float(series['time'].max()) for series in (log.fused, log.sound, log.sight) if len(series)]
    span = max(ends, default=0.0) - acquired if math.isfinite(acquired) else 0.0
    result = RunResult(name, '', {}, span, notes=[f'{key}: {value}' for key, value in log.notes.items()])
    for method in methods:
        try:
            result.methods[method] = _evaluate(method, log, record, acquired, span)
        except UnavailableError as error:
            result.missing[method] = str(error)
    if log.has_truth:
        result.truth = {'time': log.target['time'], 'azimuth': log.true_azimuth(log.target['time'])}
    seen = (log.sight['time'] + log.sight['delay'])[log.sight['score'] >= 0.5]
    heard = log.sound['time'][log.sound['confidence'] > 0.0]
    if len(seen) and len(heard):
        result.seen_s = float(max(seen.min() - heard.min(), 0.0))
    visible = log.picture['visible'] > 0.0
    if visible.any():
        result.in_picture = float(np.mean(log.picture['inside'][visible]))
    if log.tracks is not None:
        result.tracks = log.tracks._asdict()
    result.state = {'time': log.fused['time'], 'state': log.fused['state'], 'sigma': log.fused['sigma']}
    return result


def _evaluate(method: str, log: RunLog, record: MeasurementRecord, acquired: float, span: float) -> MethodResult:
    time, azimuth = bearings(method, record, log)
    compared = compare(time, azimuth, log, acquired)
    grid = instants(acquired, acquired + span) if span > 0.0 else np.zeros(0)
    folded = is_folded(method)
    opposite = np.zeros(0, bool) if folded else compared.opposite
    result = MethodResult(time, azimuth, compared.time, compared.error_deg, opposite, coverage_of(grid, time))
    if is_tracker(method) and not folded:
        series = track(method, record, log)
        result.time_to_resolve_s, result.switches = time_to_resolve(log, series), float(switches(series))
        delay = series['delay'][series['state'] > 0]
    elif is_tracker(method) and method != 'moving_average':
        delay = np.zeros(0)
    elif method == 'sight':
        delay = log.sight['delay']
    else:
        window = next((doa.window for measurements in record.doa.values() for doa in measurements), 0.0)
        delay = log.sound['delay'] + 0.5 * window
    known = delay[np.isfinite(delay)]
    result.latency_ms = 1e3 * float(np.median(known)) if known.size else math.nan
    return result


def _simulate(case: Case) -> tuple[RunLog, MeasurementRecord, list[str]]:
    scenario = load_scenario(find_config(case.input, 'scenarios'))
    rig = load_rig(find_config(case.rig or scenario.rig.description))
    settings = with_gimbal(PointingSettings(move_gimbal=rig.gimbal is not None), rig.gimbal)
    pointing = PointingController(settings) if case.follow else None
    tracker = MultiTargetTracker(TrackerSettings(gimbal=rig.gimbal))
    run = OfflineRun(scenario, rig, tracker, case.seed, pointing, estimators_of(case.methods),
                     detection_stage(case.model) if case.model else None,
                     settings=LocalizerSettings(max_sources=case.max_sources))
    run.run(case.duration or None)
    return run.log, run.rig.record, [] if case.model else ["sight is the simulator's visual oracle: no detector ran"]


def _replay(case: Case) -> tuple[RunLog, MeasurementRecord, list[str]]:
    record = MeasurementRecord()
    settings = ReplaySettings(stage=case.stage, model=case.model, parameters=case.parameters, namespace=case.namespace,
                              remappings=parse_remappings(case.remap), duration=case.duration or math.inf)
    with Bag(case.input) as bag:
        replay = Replay(bag, settings, record, estimators_of(case.methods))
        return replay.run(), record, replay.notes
