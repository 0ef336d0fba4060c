"""Results of runs: bearings and errors of each method, and figures over one or several runs."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from av_evaluation.metrics.metrics import blocks_of, errors_of, rmse, rmse_interval

Columns = dict[str, NDArray]
MOST_BYTES = 1_000_000_000    # of a kept result, decompressed
ARRAY = 'array'     # stands in the JSON of a kept result for an array, with its name


@dataclass
class MethodResult:
    """Bearings and errors of one method in one run.

    Attributes:
        time (n, s): of the bearings.
        azimuth (n, rad): in the body frame.
        error_time (m, s): of the bearings with a truth.
        error_deg (m, degrees): signed errors.
        opposite (m,): whether front and back are confused; empty where the true hemisphere is given.
        coverage: share of the time with a valid bearing.
        latency_ms (ms): from the capture of the newest measurement to the bearing, median.
        time_to_resolve_s (s): to resolve front and back; nan but for trackers.
        within: share of the errors within INTERVAL of the stated standard deviations; nan but for trackers.
        held_deg (k, degrees): signed errors of the newest measurement, held until the next one arrives, at the times of fused
            bearings; empty but for sound and sight.
    """

    time: NDArray
    azimuth: NDArray
    error_time: NDArray
    error_deg: NDArray
    opposite: NDArray
    coverage: float
    latency_ms: float = math.nan
    time_to_resolve_s: float = math.nan
    within: float = math.nan
    held_deg: NDArray = field(default_factory=lambda: np.zeros(0))


@dataclass
class RunResult:
    """Result of one run.

    Attributes:
        name: of the run; bags of several folders may have the same.
        key: digest of the case and the code, see `Case.key`.
        case: fields of the `Case`.
        span_s (s): time for which errors count.
        methods: results by name of the method.
        missing: reasons why a method has no result, by its name.
        notes: on the origin of the data.
        truth: columns `time` (s) and `azimuth` (rad, body frame); empty without truth.
        state: columns `time` (s), `state` and `sigma` (rad) of the track.
        tracks: fields of `TrackFigures`, of simulated runs with several targets; empty for others.
    """

    name: str
    key: str
    case: dict[str, Any]
    span_s: float = 0.0
    methods: dict[str, MethodResult] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    truth: Columns = field(default_factory=dict)
    state: Columns = field(default_factory=dict)
    tracks: dict[str, Any] = field(default_factory=dict)

    def save(self, folder: Path) -> None:
        """Write `<name>-<key>.npz`: all arrays, and the rest as JSON with the arrays' names in their places."""
        arrays: dict[str, Any] = {}
        words = json.dumps(asdict(self), default=lambda array: _put(arrays, array))
        content = io.BytesIO()
        np.savez_compressed(content, words=np.array(words), **arrays)
        partial = folder / f'{self.name}-{self.key}.part'
        partial.write_bytes(content.getvalue())
        partial.replace(folder / f'{self.name}-{self.key}.npz')

    @classmethod
    def load(cls, folder: Path, name: str, key: str) -> RunResult | None:
        """Read a result; None where there is none, or its file is incomplete or larger than any result.

        Parameters:
            folder: to which it was saved.
            name: of the run.
            key: of its case.
        """
        try:
            with np.load(folder / f'{name}-{key}.npz') as kept:
                if sum(entry.file_size for entry in kept.zip.infolist()) > MOST_BYTES:
                    return None
                values = json.loads(str(kept['words']), object_hook=lambda part: kept[part[ARRAY]] if ARRAY in part else part)
            values['methods'] = {method: MethodResult(**each) for method, each in values['methods'].items()}
            return cls(**values)
        except (OSError, ValueError, KeyError, TypeError, MemoryError, BadZipFile):  # absent, or incomplete
            return None


def _put(arrays: dict[str, NDArray], array: NDArray) -> dict[str, str]:
    """Add an array to others; returns what stands for it in JSON."""
    name = f'array{len(arrays)}'
    arrays[name] = array
    return {ARRAY: name}


def errors_together(runs: Sequence[RunResult], method: str) -> NDArray:
    """Signed errors (n, degrees) of a method, those of all runs in one array."""
    return np.concatenate([np.zeros(0), *(run.methods[method].error_deg for run in runs if method in run.methods)])


def figures_together(runs: Sequence[RunResult], method: str) -> dict[str, float | None]:
    """Figures of a method over all errors of all runs, as in metrics.json; None where a figure is not defined.

    Coverage is weighted by the lengths of the runs. Time to resolve and latency are medians over runs.
    `worst_rmse_deg` is the largest RMSE of a run.

    Parameters:
        runs: whose errors are pooled.
        method: its name.
    """
    results = [(run, run.methods[method]) for run in runs if method in run.methods]
    if not results:
        return dict.fromkeys(('coverage', *errors_of(np.zeros(0), np.zeros(0))))
    weights = np.array([max(run.span_s, 1e-9) for run, _ in results])
    coverage = np.array([result.coverage for _, result in results])
    known = np.isfinite(coverage)
    together = float(np.average(coverage[known], weights=weights[known])) if known.any() else math.nan
    opposite = np.concatenate([result.opposite for _, result in results])
    figures = {'coverage': together, **errors_of(errors_together(runs, method), opposite)}
    each = [rmse(result.error_deg) for _, result in results if result.error_deg.size]
    figures['worst_rmse_deg'] = max(each, default=math.nan)
    for key in ('time_to_resolve_s', 'latency_ms'):
        values = [getattr(result, key) for _, result in results]
        figures[key] = float(np.median([v for v in values if math.isfinite(v)] or [math.nan]))
    figures['held_rmse_deg'] = rmse(np.concatenate([result.held_deg for _, result in results]))
    stated = np.array([(result.within, len(result.error_deg)) for _, result in results if math.isfinite(result.within)])
    figures['within'] = float(np.average(stated[:, 0], weights=stated[:, 1])) if len(stated) else math.nan
    blocks = [block for _, result in results for block in blocks_of(result.error_time, result.error_deg)]
    figures['rmse_low_deg'], figures['rmse_high_deg'] = rmse_interval(blocks)
    figures['runs'] = len(results)
    return {key: value if math.isfinite(value) else None for key, value in figures.items()}


def methods_of(runs: Sequence[RunResult]) -> list[str]:
    """Methods of the runs in their order."""
    return list(dict.fromkeys(method for run in runs for method in (*run.methods, *run.missing)))


def metrics_of(runs: Sequence[RunResult], methods: Sequence[str] | None = None) -> dict[str, dict[str, float | None]]:
    """Figures of each method over all runs, the content of metrics.json.

    Parameters:
        runs: whose errors are pooled.
        methods: to include; those of the runs where None.
    """
    return {method: figures_together(runs, method) for method in methods or methods_of(runs)}


def write_json(path: Path, content: object) -> None:
    """Write content as JSON. Raises ValueError for nan, which standard JSON lacks."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + '\n')
