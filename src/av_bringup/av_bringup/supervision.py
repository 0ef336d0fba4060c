"""Which processes of the rig are started again when they end or hang, and which end is the end of the rig.

A process that ends, however it ends, is started again after RESPAWN_DELAY_S; its environment holds the number of restarts. The
monitor alone is not: its table would begin again. The launch ends with an exit code other than 0 where
- a process fails at its first start: it exits with a code above 0 before it has started, as on a refused parameter;
- an essential process fails so at more than MOST_RESTARTS later starts in a row;
- an essential process ends after MOST_RESTARTS restarts, in a run with a set duration;
- the monitor ends with an error, in a run whose results it shall write.
The end of another process than an essential one is no harm otherwise. One that fails at more than MOST_RESTARTS later starts
in a row is not started again.

The executor of each node and the simulator write a heartbeat (`av_common.launched.beat`). A process whose heartbeat stands
still for SILENT_CHECKS checks of the launch in a row hangs, or is stopped: it is killed, so that the rules above hold for it,
too. Checks are counted instead of seconds, so that no process is blamed for a pause of the whole machine; and of a process
that would run, by the share of a processor that it is given, as one of low priority gets none for long while the machine is
busy.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescriptionEntity
from launch.actions import (
    EmitEvent,
    ExecuteProcess,
    LogInfo,
    OpaqueCoroutine,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.matchers import matches_action
from launch.events.process import ProcessExited, ShutdownProcess

from av_common.launched import BEAT_PERIOD_S, HUNG, RESTARTS, RUN_FOLDER, started_file

RESPAWN_DELAY_S = 0.2  # so that what fails at once is not started in a loop
RESPAWN: dict[str, Any] = {'respawn': True, 'respawn_delay': RESPAWN_DELAY_S}
MOST_RESTARTS = 3  # what fails four times in a row is no accident
# Checks in a row without a new heartbeat: 8 s; and 300 s in a transition, in which a model is compiled or a bag is closed.
SILENT_CHECKS, BUSY_CHECKS = 16, 600
PROCESSES = Path('/proc')


class Pulse:
    """Judges the heartbeats of processes. Those that have none are never judged."""

    def __init__(self) -> None:
        self._newest: dict[int, tuple[str, float]] = {}  # heartbeat, and for how many checks it has stood still
        self._ran: dict[int, float] = {}  # s, for which a process has run

    def hangs(self, process: int, heartbeat: str) -> bool:
        """Whether a process hangs, at a further check.

        Parameters:
            process: its id.
            heartbeat: what its file holds.
        """
        before, silent = self._newest.get(process, ('', 0))
        silent = silent + self._given(process) if heartbeat == before else 0.0
        self._newest[process] = heartbeat, silent
        return bool(heartbeat) and silent >= (BUSY_CHECKS if heartbeat.startswith('busy') else SILENT_CHECKS)

    def forget(self, process: int) -> None:
        """Forget a process that has ended."""
        self._newest.pop(process, None)
        self._ran.pop(process, None)

    def _given(self, process: int) -> float:
        """Share of a processor that a process was given since the check before; 1 for one that asks for none."""
        threads = []
        for file in (PROCESSES / str(process) / 'task').glob('*/stat'):
            with suppress(OSError):  # ended meanwhile
                threads.append(file.read_text().rpartition(')')[2].split())  # from field 3 of proc(5) on
        ran = sum(int(fields[11]) + int(fields[12]) for fields in threads) / os.sysconf('SC_CLK_TCK')
        before, self._ran[process] = self._ran.get(process, ran), ran
        return min((ran - before) / BEAT_PERIOD_S, 1.0) if any(fields[0] == 'R' for fields in threads) else 1.0


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
        self._hangs: Counter[ExecuteProcess] = Counter()
        self._pulse, self._killed = Pulse(), set[int]()    # ids of processes that hung

    def entities(self) -> list[LaunchDescriptionEntity]:
        """Event handlers and timers of the launch, to be placed before the processes."""
        timer = self._rest_of_the_run() if self._monitor is None else []
        watch = OpaqueCoroutine(coroutine=self._watch, ignore_context=True)
        return [RegisterEventHandler(OnProcessExit(on_exit=self._on_exit)), watch, *timer]

    async def _watch(self) -> None:
        with suppress(asyncio.CancelledError):  # at the shutdown; a cancelled task would end the launch with an error
            while True:
                await asyncio.sleep(BEAT_PERIOD_S)
                self.check()

    def check(self) -> None:
        """End the processes that hang."""
        for process in self._processes:
            details = process.process_details or {}
            number = details.get('pid', 0)
            if number and number not in self._killed and self._pulse.hangs(number, _heartbeat(details, number)):
                self._killed.add(number)
                with suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)

    def _on_exit(self, event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity] | None:
        """Count the end of a process. Raises RuntimeError, which ends the launch, by the rules."""
        process, code = event.action, event.returncode
        if context.is_shutdown or process not in self._processes:
            return None
        hung, started = event.pid in self._killed, started_file(Path(event.env[RUN_FOLDER]), event.pid)
        how = 'hung and was killed' if hung else f'ended with exit code {code}'
        end = f'{event.process_name} {how} while the rig was running'
        failed = code > 0 and not started.exists()
        self._forget(event.pid, started)
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
        self._hangs[process] += hung
        process.process_details['env'] |= {    # read after RESPAWN_DELAY_S
            RESTARTS: str(self._restarts[process]), HUNG: str(self._hangs[process])}
        return [LogInfo(msg=f'{end}: restart {self._restarts[process]}')]

    def _forget(self, number: int, started: Path) -> None:
        """Forget a process that has ended, whose id another one may get."""
        started.unlink(missing_ok=True)
        self._pulse.forget(number)
        self._killed.discard(number)

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


def _heartbeat(details: Mapping[str, Any], number: int) -> str:
    """The newest heartbeat of a process; empty without one."""
    with suppress(OSError, KeyError):
        return started_file(Path(details['env'][RUN_FOLDER]), number).read_text()
    return ''


def _shutdown() -> EmitEvent:
    return EmitEvent(event=Shutdown(reason='the run is over'))
