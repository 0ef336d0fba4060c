"""Runs of scenarios with seeds, each a case: computed in parallel, kept on disk, so that an interrupted evaluation resumes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from av_fusion.bayes import BayesTracker
from av_fusion.evaluation.methods import BASELINES, bearings
from av_fusion.evaluation.metrics import figures_of, summarise
from av_fusion.evaluation.offline_run import OfflineRun
from av_fusion.evaluation.picture import draw
from av_fusion.pointing import PointingController, PointingSettings
from av_sim_bridge.config_files import find_config
from av_sim_bridge.rig import load_rig
from av_sim_bridge.scenario import load_scenario
from av_vision.yolo import Detector, DetectorSettings


@dataclass(frozen=True)
class Case:
    """One run: a scenario (shipped name or file), a seed, the detector's ONNX file ('' for the oracle), and what to compute.

    `follow`: the rig turns as the pointing controller commands; else as the scenario says. `taus`: further gates on the
    detection confidence, at which `fused` and `gated` are computed as well.
    """

    scenario: str
    seed: int
    methods: tuple[str, ...]
    model: str = ''
    follow: bool = True
    duration: float = 0.0
    taus: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """File name of the case's results."""
        return f'{Path(self.scenario).stem}_{self.seed}'


def run_case(case: Case, out: Path) -> dict:
    """Compute one case and write `<name>.json` and `<name>.png` into `out`. Raises what the scenario or the model raise."""
    scenario = load_scenario(find_config(case.scenario, 'scenarios'))
    pointing = PointingController(PointingSettings(move_gimbal=False)) if case.follow else None
    detect = _detect(case.model) if case.model else None
    run = OfflineRun(scenario, load_rig(find_config('rig')), BayesTracker(), case.seed, pointing,
                     tuple(BASELINES.values()), detect)
    log = run.run(case.duration or None)
    summary = summarise(log)
    end = float(log.fused['time'][-1])

    def figures(method: str, tau: float = 0.5) -> dict:
        return asdict(figures_of(*bearings(method, run.recording, log, tau), log, summary.acquired, end))

    result = {
        'case': asdict(case), 'time_to_decide': summary.time_to_decide, 'switches': summary.switches,
        'sight_coverage': summary.senses['sight'].coverage, 'methods': {method: figures(method) for method in case.methods},
        'taus': {f'{tau:g}': {method: figures(method, tau) for method in ('fused', 'gated')} for tau in case.taus}}
    draw(log, out / f'{case.name}.png', f'{case.scenario}, seed {case.seed}')
    partial = out / f'{case.name}.part'
    partial.write_text(json.dumps(result, indent=1))
    partial.replace(out / f'{case.name}.json')
    return result


def run_cases(cases: Sequence[Case], out: Path, workers: int = 0,
              report: Callable[[int, int], None] = lambda done, total: None) -> Iterator[dict]:
    """Results of all cases as they are done; those whose file is there and stems from the same case are read."""
    out.mkdir(parents=True, exist_ok=True)
    kept = [result for result in (_read(case, out) for case in cases) if result is not None]
    left = [case for case in cases if _read(case, out) is None]
    yield from kept
    report(len(kept), len(cases))
    with ProcessPoolExecutor(workers or os.cpu_count()) as pool:
        running = [pool.submit(run_case, case, out) for case in left]
        for done, future in enumerate(as_completed(running), start=len(kept) + 1):
            yield future.result()
            report(done, len(cases))


def _read(case: Case, out: Path) -> dict | None:
    try:
        result = json.loads((out / f'{case.name}.json').read_text())
    except (OSError, json.JSONDecodeError):
        return None
    return result if result['case'] == json.loads(json.dumps(asdict(case))) else None


def _detect(model: str) -> Callable:
    detector = Detector(model, replace(DetectorSettings(), threads=1))

    def detect(picture: object) -> list[tuple[float, float, float, float, float]]:
        found = detector.detect(picture)
        return [(*map(float, box), float(score)) for box, score in zip(found.boxes, found.scores, strict=True)]

    return detect
