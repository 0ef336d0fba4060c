"""The figures of a run as a table of plain text."""

from __future__ import annotations

import math

from av_evaluation.metrics.metrics import Errors, Summary

ROWS = (('coverage', 'coverage', '{:.1f} %', 100.0), ('RMSE', 'rmse_deg', '{:.2f} deg', 1.0),
        ('mean error', 'mae_deg', '{:.2f} deg', 1.0), ('median error', 'median_deg', '{:.2f} deg', 1.0),
        ('95th percentile', 'p95_deg', '{:.2f} deg', 1.0), ('errors > 20 deg', 'outliers', '{:.1f} %', 100.0),
        ('hemisphere wrong', 'hemisphere_errors', '{:.1f} %', 100.0), ('rate', 'rate_hz', '{:.1f} Hz', 1.0),
        ('delay, median', 'delay_median_ms', '{:.0f} ms', 1.0), ('delay, 95th perc.', 'delay_p95_ms', '{:.0f} ms', 1.0))
LABEL_WIDTH = 24


def format_table(summary: Summary) -> str:
    """One row for each figure, one column for each series, then the figures of the whole run."""
    names = list(summary.senses)
    lines = [f'{"":<{LABEL_WIDTH}}' + ''.join(f'{name:>14}' for name in names)]
    lines += [f'{label:<{LABEL_WIDTH}}' + ''.join(f'{_cell(summary.senses[name], key, form, scale):>14}' for name in names)
              for label, key, form, scale in ROWS]
    lines.append(f'{"front/back resolved in":<{LABEL_WIDTH}}{_number(summary.time_to_resolve, "{:.1f} s"):>14}')
    lines.append(f'{"switches":<{LABEL_WIDTH}}{summary.switches:>14}')
    lines += [f'{key:<{LABEL_WIDTH}}  {value}' for key, value in summary.notes.items()]
    return '\n'.join(lines)


def _cell(errors: Errors, key: str, form: str, scale: float) -> str:
    return _number(scale * getattr(errors, key), form)


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else '-'
