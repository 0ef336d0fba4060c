"""What is kept of a run: each method's bearings beside the truth, and figures of one run or of many together."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_evaluation.metrics.metrics import Errors, errors_of
from av_evaluation.metrics.statistics import blocks_of, rmse, rmse_interval

Columns = dict[str, NDArray]


@dataclass
class MethodResult:
    """One method in one run. Times in s, azimuths in rad in the body frame, errors signed, in degrees.

    `error_deg` and `opposite` belong to `judged_time`, where there is truth; `unaided_deg` are the errors without the truth's
    help. `latency_ms` is from the capture of the
    newest measurement to the bearing, `time_to_resolve_s` and `switches` are told of trackers only.
    """

    time: NDArray
    azimuth: NDArray
    judged_time: NDArray
    error_deg: NDArray
    opposite: NDArray
    unaided_deg: NDArray
    coverage: float
    latency_ms: float = math.nan
    time_to_resolve_s: float = math.nan
    switches: float = math.nan


@dataclass
class RunResult:
    """One run. `methods` by name, by `name@tau` for other gates; `missing` says why a method is not among them."""

    name: str
    key: str
    case: dict[str, Any]
    span_s: float = 0.0
    methods: dict[str, MethodResult] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    truth: Columns = field(default_factory=dict)
    state: Columns = field(default_factory=dict)
    plot: bytes = b''

    def save(self, folder: Path) -> None:
        """Write `<name>-<key>.npz` and `.png`, the plot first: what has the first file is complete."""
        columns = {f'{name}/{key}': value for name, method in self.methods.items()
                   for key, value in vars(method).items() if isinstance(value, np.ndarray)}
        columns |= {f'{part}//{key}': value for part in ('truth', 'state') for key, value in getattr(self, part).items()}
        numbers = {name: {key: value for key, value in vars(method).items() if not isinstance(value, np.ndarray)}
                   for name, method in self.methods.items()}
        words = {key: getattr(self, key) for key in ('name', 'key', 'case', 'span_s', 'missing', 'notes')}
        if self.plot:
            (folder / f'{self.name}-{self.key}.png').write_bytes(self.plot)
        content = io.BytesIO()
        np.savez_compressed(content, words=np.array(json.dumps([words, numbers])), **columns)
        partial = folder / f'{self.name}-{self.key}.part'
        partial.write_bytes(content.getvalue())
        partial.replace(folder / f'{self.name}-{self.key}.npz')

    @classmethod
    def load(cls, folder: Path, name: str, key: str) -> RunResult | None:
        """The result kept under this name and key, None where there is none."""
        try:
            with np.load(folder / f'{name}-{key}.npz') as kept:
                columns = {column: kept[column] for column in kept.files}
            words, numbers = json.loads(str(columns.pop('words')))
            plot = folder / f'{name}-{key}.png'
            result = cls(**words, plot=plot.read_bytes() if plot.exists() else b'')
        except (OSError, ValueError, KeyError):  # not there, or cut off
            return None
        for method, values in numbers.items():
            mine = {column.split('/')[1]: value for column, value in columns.items() if column.startswith(f'{method}/')}
            result.methods[method] = MethodResult(**mine, **values)
        for part in ('truth', 'state'):
            setattr(result, part, {column.split('//')[1]: value for column, value in columns.items()
                                   if column.startswith(f'{part}//')})
        return result


def errors_together(runs: Sequence[RunResult], method: str) -> NDArray:
    """Signed errors of a method in all runs, in degrees."""
    return np.concatenate([np.zeros(0), *(run.methods[method].error_deg for run in runs if method in run.methods)])


def figures_together(runs: Sequence[RunResult], method: str, intervals: bool = True) -> dict[str, float | None]:
    """Figures of a method over all errors of all runs, as they stand in metrics.json: None where there is nothing to tell.

    Coverage is weighted by the runs' lengths; times, switches and latency are medians over runs, but for
    `worst_rmse_deg`, the largest RMSE of a run.
    """
    results = [(run, run.methods[method]) for run in runs if method in run.methods]
    if not results:
        return {key: None for key in asdict(Errors()) if key in KEPT}
    weights = np.array([max(run.span_s, 1e-9) for run, _ in results])
    coverage = np.array([result.coverage for _, result in results])
    known = np.isfinite(coverage)
    together = float(np.average(coverage[known], weights=weights[known])) if known.any() else math.nan
    opposite = np.concatenate([result.opposite for _, result in results])
    errors = asdict(errors_of(errors_together(runs, method), opposite, together))
    figures = {key: errors[key] for key in KEPT}
    each = [rmse(result.error_deg) for _, result in results if result.error_deg.size]
    figures['worst_rmse_deg'] = max(each, default=math.nan)
    unaided = np.concatenate([result.unaided_deg for _, result in results])
    figures['unaided_rmse_deg'] = rmse(unaided) if unaided.size else math.nan
    for key in ('time_to_resolve_s', 'switches', 'latency_ms'):
        values = [getattr(result, key) for _, result in results]
        figures[key] = float(np.median([v for v in values if math.isfinite(v)] or [math.nan]))
    if intervals:
        blocks = [block for _, result in results for block in blocks_of(result.judged_time, result.error_deg)]
        figures['rmse_low_deg'], figures['rmse_high_deg'] = rmse_interval(blocks)
    figures['runs'] = len(results)
    return {key: value if math.isfinite(value) else None for key, value in figures.items()}


KEPT = ('coverage', 'rmse_deg', 'mae_deg', 'median_deg', 'p95_deg', 'outliers', 'hemisphere_errors')
