"""Which processes of the rig are started again when they end, and which end is the end of the rig.

A process that ends, however it ends, is started again after RESPAWN_DELAY_S; its environment holds the number of restarts. The
monitor alone is not: its table would begin again. The launch ends with an exit code other than 0 where
- a process fails at its first start: it exits with a code above 0 before it has started, as on a refused parameter;
- an essential process fails so at more than MOST_RESTARTS later starts in a row;
- an essential process ends after MOST_RESTARTS restarts, in a run with a set duration;
- the monitor ends with an error, in a run whose results it shall write.
The end of another process than an essential one is no harm otherwise. One that fails at more than MOST_RESTARTS later starts
in a row is not started again.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescriptionEntity
from launch.actions import (
    EmitEvent,
    ExecuteProcess,
    LogInfo,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.matchers import matches_action
from launch.events.process import ProcessExited, ShutdownProcess

from av_common.launched import RESTARTS, RUN_FOLDER, started_file

RESPAWN_DELAY_S = 0.2
RESPAWN: dict[str, Any] = {'respawn': True, 'respawn_delay': RESPAWN_DELAY_S}
MOST_RESTARTS = 3


class Supervision:
    """Follows the processes of one launch; see the module for the rules.

    Parameters:
        essential: processes without which the rig does not work, with the options RESPAWN.
        optional: processes with the options RESPAWN whose end is never the end of the launch.
        monitor: the monitor, which ends itself after the duration; None without one.
        duration (s): time until the end of the run; 0 for none.
        results: whether the monitor writes results.
    """

    def __init__(self, essential: Sequence[ExecuteProcess], optional: Sequence[ExecuteProcess] = (),
                 monitor: ExecuteProcess | None = None, duration: float = 0.0, results: bool = False) -> None:
        self._essential, self._monitor = list(essential), monitor
        self._processes = [*essential, *optional, *([monitor] if monitor else [])]
        self._duration, self._results = duration, results
        self._begin = time.monotonic()
        self._restarts: Counter[ExecuteProcess] = Counter()
        self._failures: Counter[ExecuteProcess] = Counter()    # failed starts in a row

    def entities(self) -> list[LaunchDescriptionEntity]:
        """Event handlers and timers of the launch, to be placed before the processes."""
        timer = self._rest_of_the_run() if self._monitor is None else []
        return [RegisterEventHandler(OnProcessExit(on_exit=self._on_exit)), *timer]

    def _on_exit(self, event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity] | None:
        """Count the end of a process. Raises RuntimeError, which ends the launch, by the rules."""
        process, code = event.action, event.returncode
        if context.is_shutdown or process not in self._processes:
            return None
        end = f'{event.process_name} ended with exit code {code} while the rig was running'
        failed = code > 0 and not started_file(Path(event.env[RUN_FOLDER]), event.pid).exists()
        if failed and not self._restarts[process]:
            raise RuntimeError(end)
        if process is self._monitor:
            return self._on_monitor_exit(code, end)
        self._failures[process] = self._failures[process] + 1 if failed else 0
        given_up = self._failures[process] > MOST_RESTARTS
        if process in self._essential and (given_up or (self._duration and self._restarts[process] >= MOST_RESTARTS)):
            raise RuntimeError(f'{end}, after {self._restarts[process]} restarts')
        if given_up:
            return [LogInfo(msg=f'{end}, which goes on without it'),
                    EmitEvent(event=ShutdownProcess(process_matcher=matches_action(process)))]
        self._restarts[process] += 1
        process.process_details['env'][RESTARTS] = str(self._restarts[process])    # read after RESPAWN_DELAY_S
        return [LogInfo(msg=f'{end}: restart {self._restarts[process]}')]

    def _on_monitor_exit(self, code: int, end: str) -> list[LaunchDescriptionEntity]:
        if self._results and code:
            raise RuntimeError(f'{end}: the results are missing')
        if code == 0 and (self._results or 0.0 < self._duration <= time.monotonic() - self._begin):
            return [_shutdown()]
        return [LogInfo(msg=f'{end}, which goes on without it'), *self._rest_of_the_run()]

    def _rest_of_the_run(self) -> list[LaunchDescriptionEntity]:
        """A timer for the rest of the duration; none without a duration."""
        left = self._duration - (time.monotonic() - self._begin)
        return [TimerAction(period=max(0.0, left), actions=[_shutdown()])] if self._duration else []


def _shutdown() -> EmitEvent:
    return EmitEvent(event=Shutdown(reason='the run is over'))
