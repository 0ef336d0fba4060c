"""Tests that run in real time, repeated where the machine was busy with something else."""

from __future__ import annotations

import pytest
import pytest_timeout
from _pytest.runner import runtestprotocol
from machine_load import LoadWatch

REPETITIONS = 2
WRONG_CODE = ('AttributeError', 'ImportError', 'ModuleNotFoundError', 'NameError', 'SyntaxError', 'TypeError')    # no load does


def run(item, nextitem) -> bool:
    """Run one test and report it; the hook `pytest_runtest_protocol`.

    A test that fails while the machine stands still, or has other work, is repeated, unless its time was up. What it finds at
    last counts. On an overloaded machine it has found nothing, and is skipped at once with the reason: repeating it would add
    to the load and to the time of the whole run.
    """
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for repetition in range(1 + REPETITIONS):
        with LoadWatch() as watch:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = [report for report in reports if report.failed]
        final = repetition == REPETITIONS or not watch.disturbed or watch.overloaded
        if final or not failed or any('from pytest-timeout' in _message(report) for report in failed):
            break
        item.warn(pytest.PytestWarning(f'repeated: {watch}: {_message(failed[0])}'))
        _start_anew(item)
    if failed and watch.overloaded and not any(_message(report).startswith(WRONG_CODE) for report in failed):
        for report in failed:
            path, line, _ = item.location
            report.outcome, report.longrepr = 'skipped', (path, (line or 0) + 1, f'Skipped: {watch}: {_message(report)}')
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _start_anew(item) -> None:
    """Make the fixtures of the test again, those of its module included, and give it its full time."""
    item.session._setupstate.teardown_exact(None)
    item._initrequest()
    item.ihook.pytest_timeout_cancel_timer(item=item)
    item.ihook.pytest_timeout_set_timer(item=item, settings=pytest_timeout._get_item_settings(item))


def _message(report) -> str:
    """The line that says what was wrong."""
    crash = getattr(report.longrepr, 'reprcrash', None)
    return (crash.message if crash else report.longreprtext).strip().splitlines()[0]
