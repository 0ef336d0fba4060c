"""Runs attacks on a rig, one after the other, until the time is over, and judges each."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from random import Random

from av_evaluation.attack.attacks import ATTACKS, HERE, NOT_RESPAWNED, PROCESS_ATTACKS, THERE, Arena, victims
from av_evaluation.attack.rig import Memory, Rig, free_domain, growth
from av_evaluation.attack.verdicts import GOAL_PER_HOUR, Result, sent_by_target, table, too_few, verdicts
from av_evaluation.attack.worker import Worker, WorkerError
from av_evaluation.namespaces import Host, is_inside

PLANNED = 1.25             # times the messages that must be sent; a busy machine sends fewer than planned
MESSAGE_ATTACKS = 3.5      # of one round, which send to every topic
DATAGRAM_ATTACKS = 3.5     # of one round, which send to every port
SHORTEST, LONGEST = 3.0, 10.0   # s of one attack: for a longer one, in which the body stands still, the target is anywhere
OVERHEAD = 4.0             # s between attacks
MOST_RATE = 2000.0         # Hz for each topic and each port
START = 90.0               # s in which the rig must track
PATIENCE = 12.0            # s for which tracking is awaited after an attack
SETTLE = 11.0              # s of tracking before the first attack, and at most before the others
FACED = math.radians(10.0)    # from the body's front to the target where an attack begins: each shows its own effect
# Cyclone DDS would choose the cable to the other host.
LOOPBACK_ONLY = '<General><Interfaces><NetworkInterface name="lo"/></Interfaces></General>'
ARGUMENTS = ('scenario:=circle', 'oracle:=true')


@dataclass(frozen=True)
class Options:
    """What to run.

    Parameters:
        minutes: duration of all attacks.
        messages: to send to each topic, and datagrams to each port; 0 for GOAL_PER_HOUR, or its part of less than an hour.
        out: folder for the table, the data and what the rig prints.
        only: names of attacks, empty for all.
        seed: of all random values.
        offset: of the rig's UDP ports.
        arguments: further launch arguments.
    """

    minutes: float
    out: Path
    only: tuple[str, ...] = ()
    seed: int = 0
    offset: int = 0
    arguments: tuple[str, ...] = ()
    messages: int = 0

    @property
    def planned(self) -> float:
        """Messages to send to each topic, and datagrams to each port."""
        return PLANNED * (self.messages or GOAL_PER_HOUR * self.minutes / 60.0)

    @property
    def goal(self) -> int:
        """Messages that each topic and each port must get for the verdict on it; 0 without one."""
        return self.messages or (GOAL_PER_HOUR if self.minutes >= 60.0 and not self.only else 0)

    @property
    def seconds(self) -> float:
        """Duration of one attack: all kinds have their turn."""
        return min(max(60.0 * self.minutes / (2.0 * len(ATTACKS)) - OVERHEAD, SHORTEST), LONGEST)

    @property
    def victims(self) -> int:
        """Processes that are killed, and stopped, in one round."""
        return 1 if self.minutes < 3.0 else 3


class Program:
    """The attacks on one rig.

    Parameters:
        options: what to run.
    """

    def __init__(self, options: Options) -> None:
        self._options, self._random, self._log = options, Random(options.seed), options.out / 'attack.log'
        self._results: list[Result] = []
        self._first: Memory = {}    # before the first attack on each process, and after the last
        self._last: Memory = {}
        self._opened = ExitStack()
        self._next_victims: dict[str, list[str]] = {kind: [] for kind in PROCESS_ATTACKS}

    def run(self) -> int:
        """Attack, print and write the results; returns 1 where a verdict fails."""
        options = self._options
        options.out.mkdir(parents=True, exist_ok=True)
        with self._opened:
            self._open()
            if not self._tracks(time.time() - 5.0, START):
                print(f'attack: the rig does not track without an attack, see {options.out / "rig.log"}', file=sys.stderr)
                return 1
            print(f'topics: {" ".join(self._arena.messages.call("find"))}', flush=True)
            time.sleep(SETTLE)
            self._begun = time.monotonic()
            failed = 0
            try:
                for kind, name in self._plan():
                    self._attack(kind, name)
            except KeyboardInterrupt:
                print('attack: interrupted', file=sys.stderr)
            except WorkerError as error:
                print(f'attack: {error}, see {self._log}', file=sys.stderr)
                failed = 2
            return self._report() if not failed else max(failed, self._report())

    def _open(self) -> None:
        options, opened = self._options, self._opened
        environment = {'ROS_DOMAIN_ID': str(free_domain()), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                       'CYCLONEDDS_URI': LOOPBACK_ONLY}
        other_host = self._other_host()
        defaults = [one for one in ARGUMENTS if not any(given.startswith(one.partition('=')[0]) for given in options.arguments)]
        given = [*defaults, f'record:={self._bag()}', f'port_offset:={options.offset}', *options.arguments]
        rig = Rig(given, options.out / 'rig.log', environment)
        opened.callback(rig.close)
        observer, messages, datagrams = (self._worker(module, environment) for module in ('observer', 'messages', 'datagrams'))
        rounds = max(60.0 * options.minutes / self._round_seconds(), 1.0)
        message_rate, datagram_rate = (min(options.planned / (rounds * attacks * options.seconds), MOST_RATE)
                                       for attacks in (MESSAGE_ATTACKS, DATAGRAM_ATTACKS))
        self._arena = Arena(rig, observer, messages, datagrams, other_host, options.offset, options.seconds, message_rate,
                            datagram_rate, self._random)

    def _bag(self) -> Path:
        """A bag that the recorder writes during the attacks, in a folder that is removed with it."""
        folder = tempfile.mkdtemp(prefix='attack_')
        self._opened.callback(shutil.rmtree, folder, ignore_errors=True)
        return Path(folder) / 'rig_%H%M%S.mcap'

    def _round_seconds(self) -> float:
        options = self._options
        return len(ATTACKS) * (options.seconds + OVERHEAD) + len(PROCESS_ATTACKS) * options.victims * 2.0 * OVERHEAD

    def _other_host(self) -> Worker | None:
        if not is_inside():
            return None
        try:
            host = Host('attack0', f'{THERE}/24', f'{HERE}/24')
        except (OSError, subprocess.SubprocessError) as error:
            print(f'attack: no other host: {error}', file=sys.stderr)
            return None
        self._opened.callback(host.close)
        return self._worker('datagrams', prefix=host.prefix)

    def _worker(self, module: str, environment: Mapping[str, str] | None = None, prefix: Sequence[str] = ()) -> Worker:
        worker = Worker(module, self._log, environment, prefix)
        self._opened.callback(worker.close)
        return worker

    def _plan(self) -> Iterator[tuple[str, str]]:
        """Kinds of attacks with the process that they concern, round after round until the time is over."""
        end = self._begun + 60.0 * self._options.minutes
        kinds = [kind for kind in (*ATTACKS, *PROCESS_ATTACKS) if not self._options.only or kind in self._options.only]
        if self._arena.other_host is None and 'another host' in kinds:
            kinds.remove('another host')
        for number in count():
            for kind in kinds:
                names = self._victims(kind) if kind in PROCESS_ATTACKS else ['']
                for name in names:
                    if number and time.monotonic() > end:    # the first round has all kinds
                        return
                    yield kind, name

    def _victims(self, kind: str) -> list[str]:
        """The next processes, each in its turn."""
        chosen = []
        for _ in range(self._options.victims):
            if not self._next_victims[kind]:
                self._next_victims[kind] = victims(self._arena.rig)
                self._random.shuffle(self._next_victims[kind])
            chosen += self._next_victims[kind][:1]
            del self._next_victims[kind][:1]
        return chosen

    def _attack(self, kind: str, name: str) -> None:
        arena = self._arena
        self._settle()
        result = Result(' '.join(filter(None, (kind, name))))
        deaths, begun = len(arena.rig.deaths), time.monotonic()
        before = arena.rig.measure()
        self._first = before | self._first
        arena.observer.call('begin')
        try:
            if kind in ATTACKS:
                ATTACKS[kind](arena, result)
            else:
                PROCESS_ATTACKS[kind](arena, result, name)
        except KeyError as error:
            result.faults.append(f'{error} does not run')
        result.seconds = time.monotonic() - begun
        self._judge(result, kind)
        result.growth = growth(before, self._measure())
        result.deaths = [f'{name} at {moment:.1f}' for moment, name in arena.rig.deaths[deaths:]]
        self._results.append(result)
        self._show(result)
        if result.recovery is None or arena.rig.ended:
            arena.rig.restart()
            self._tracks(time.time(), START)
            arena.observer.call('forget')

    def _settle(self) -> None:
        deadline = time.monotonic() + SETTLE
        while time.monotonic() < deadline and not self._arena.observer.call('faces', angle=FACED):
            time.sleep(0.2)

    def _judge(self, result: Result, kind: str) -> None:
        """Restore what a permitted peer changed, wait for tracking, and collect what was observed."""
        arena = self._arena
        result.ended = result.ended or time.time()
        if kind in ('lifecycle requests', 'parameter requests', 'disabled'):
            lost = arena.messages.call('restore', timeout=60.0)   # a shutdown ends a process that is not started again
            result.faults += [f'{name} cannot be active again' for name in lost if not name.endswith(NOT_RESPAWNED)]
            result.ended = time.time()
        arena.observer.call('quiet', since=result.ended)
        result.recovery = self._tracks(result.ended, PATIENCE)
        until = result.ended + (PATIENCE if result.recovery is None else result.recovery)
        result.meanwhile = arena.observer.call('faults', begin=result.ended, end=until)
        found = arena.observer.call('findings')
        for key in ('commands', 'bad', 'moves', 'bad_count', 'move_count', 'largest_yaw_rate'):
            setattr(result, key, found[key])
        result.diagnostics |= found['diagnostics']

    def _measure(self) -> Memory:
        now = self._arena.rig.measure()
        self._last |= now
        return now

    def _tracks(self, since: float, timeout: float) -> float | None:
        """Time (s) after `since` at which tracking was back, None where it was not within `timeout` (s)."""
        deadline = time.time() + timeout
        while time.time() < deadline:
            recovered = self._arena.observer.call('recovered', since=since)
            if recovered is not None:
                return float(recovered)
            if self._arena.rig.ended:
                return None
            time.sleep(0.2)
        return None

    def _show(self, result: Result) -> None:
        spent, load = time.monotonic() - self._begun, os.getloadavg()[0]
        back = 'never' if result.recovery is None else f'{result.recovery:.1f} s'
        print(f'{spent:5.0f} s  {result.name}: {sum(result.sent.values())} sent, {len(result.deaths)} deaths, '
              f'{result.bad_count} bad commands, {result.move_count} wrong moves, memory {result.largest_growth:+.1f} MiB, '
              f'tracking back: {back} (load {load:.0f})', flush=True)
        if result.recovery is None or result.recovery > result.most_recovery:
            print(f'         bearings meanwhile: {result.meanwhile}', flush=True)
        for fault in (*result.deaths, *result.bad[:2], *result.moves[:2], *result.faults, *result.late):
            print(f'         {fault}', flush=True)

    def _report(self) -> int:
        if not self._results:
            print('attack: no attack came to its end, so nothing is known', file=sys.stderr)
            return 2
        failed = verdicts(self._results, growth(self._first, self._last))
        sent = sent_by_target(self._results)
        if goal := self._options.goal:
            failed[f'{goal:,} to each topic and each port'] = too_few(sent, goal)
        lines = [table(self._results), '', '| verdict | |', '|---|---|']
        lines += [f'| {verdict} | {"holds" if not reasons else "FAILED: " + "; ".join(reasons[:5])} |'
                  for verdict, reasons in failed.items()]
        lines += ['', 'Sent: ' + ', '.join(f'{target} {count:,}' for target, count in sorted(sent.items())) + '.']
        text = '\n'.join(lines)
        print(f'\n{text}', flush=True)
        (self._options.out / 'table.md').write_text(text + '\n')
        data = {'options': {**asdict(self._options), 'out': str(self._options.out)}, 'verdicts': failed, 'sent': sent,
                'results': [asdict(result) for result in self._results], 'load': os.getloadavg(), 'cores': os.cpu_count(),
                'processes': self._processes()}
        (self._options.out / 'attack.json').write_text(json.dumps(data, indent=1, default=str) + '\n')
        return 1 if any(failed.values()) else 0

    def _processes(self) -> list[dict[str, object]]:
        """Memory, threads and descriptors of each process before its first attack and after its last."""
        return [{'name': name, 'pid': process_id, 'first': asdict(self._first[process_id][1]), 'last': asdict(last)}
                for process_id, (name, last) in self._last.items() if process_id in self._first]


def attack(options: Options) -> int:
    """Run the attacks; returns the exit code: 0, 1 where a verdict fails, 2 where the attack itself failed."""
    if not math.isfinite(options.minutes) or options.minutes <= 0.0:
        raise ValueError(f'minutes is {options.minutes}, expected a positive number')
    if options.messages < 0:
        raise ValueError(f'messages is {options.messages}, expected a number from 0')
    try:
        return Program(options).run()
    except WorkerError as error:
        print(f'attack: {error}', file=sys.stderr)
        return 2
