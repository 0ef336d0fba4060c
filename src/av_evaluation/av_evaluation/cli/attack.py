"""ros2 run av_evaluation attack: hostile messages against the running rig.

One attack after the other until the time is over or tracking does not come back, and the verdict on what must hold throughout.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import signal
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from itertools import count
from multiprocessing.managers import RemoteError
from pathlib import Path
from typing import TypeVar

from av_common.arguments import positive
from av_evaluation.attack.judges import Findings
from av_evaluation.attack.messages import messages_beside
from av_evaluation.attack.observer import Observer
from av_evaluation.processes import MarkedProcesses, launched_rig, slowdown
from av_simulator.cli.arguments import port_offset

KINDS = ('messages', 'no inputs')
SECONDS = 6.0              # of one attack: for a longer one, in which the body stands still, the target is anywhere
MESSAGE_RATE = 30.0        # Hz, to each topic
START_S, PATIENCE_S, SETTLE_S = 90.0, 30.0, 11.0    # in which the rig tracks first, tracks again, faces the target
FACED = math.radians(10.0)    # from the body's front to the target where an attack begins
NO_INPUTS_S = 4.0          # of an attack while the simulator is stopped, which the launch replaces after 8 s
# From the end of inputs to the moment from which nothing may move, and from the first message on: the graph
# tells of second publishers, of whom no input is used.
STILL_AFTER_S, CONTESTED_AFTER_S = 0.5, 3.0
# Where nothing waits for a processor. What begins to hear again needs SOUND_S more on any machine: the newest second of sound
# decides whether it is that of a drone.
MOST_RECOVERY_S, SOUND_S = 1.0, 1.0
COMMANDS = '/pointing/command'
LOOPBACK_ONLY = '<General><Interfaces><NetworkInterface name="lo"/></Interfaces></General>'
ARGUMENTS = ('scenario:=circle', 'oracle:=true')
IN_TIME = 'tracking is back in time'
Answer = TypeVar('Answer')


@dataclass
class Result:
    """What one attack did.

    Attributes:
        name: of the attack.
        sent: number of messages by their topic.
        deaths: processes that ended.
        found: commands that were bad, or moved what must not move.
        recovery (s): from the end until tracking was back; None where it did not come back.
        slowdown: of the rig by other load, from the start of the attack until tracking was back.
        meanwhile: bearings until then by what was wrong with them.
    """

    name: str
    sent: dict[str, int] = field(default_factory=dict)
    deaths: list[str] = field(default_factory=list)
    found: Findings = field(default_factory=Findings)
    recovery: float | None = None
    slowdown: float = 1.0
    meanwhile: dict[str, int] = field(default_factory=dict)

    @property
    def late(self) -> list[str]:
        """What took longer than is permitted on a machine as slow as this one was."""
        if self.recovery is not None and self.recovery <= SOUND_S + MOST_RECOVERY_S * self.slowdown:
            return []
        back = f'not back {self.meanwhile}' if self.recovery is None else f'back after {self.recovery:.1f} s'
        return [f'tracking is {back}, {self.slowdown:.1f} times slower than alone']


class Attack:
    """The attacks on one rig, each a method that takes its result.

    Parameters:
        options: `minutes` of all attacks, of which the first round has all kinds; `out`, the folder for what is written; names
            of kinds (`only`), empty for all; `port_offset` of the rig.
    """

    def __init__(self, options: Namespace) -> None:
        self._options, self._random = options, random.Random(0)
        self._results: list[Result] = []
        self._replaced: set[int] = set()    # simulators that the launch has replaced because they were stopped
        self._opened = ExitStack()
        self._kinds: dict[str, Callable[[Result], None]] = dict(zip(KINDS, (self._messages, self._no_inputs), strict=True))

    def run(self) -> int:
        """Attack, print and write the results; returns 1 where a verdict fails, 2 where the attack itself fails."""
        options = self._options
        options.out.mkdir(parents=True, exist_ok=True)
        with self._opened:
            try:
                self._open()
                if not self._tracks(time.time(), START_S):
                    print(f'attack: the rig does not track without an attack, see {options.out / "rig.log"}', file=sys.stderr)
                    return 2
                print(f'topics: {" ".join(self._peer.find())}', flush=True)
                time.sleep(SETTLE_S)
                self._attack_all()
            except KeyboardInterrupt:
                print('attack: interrupted', file=sys.stderr)
            except (RemoteError, OSError, EOFError) as error:
                print(f'attack: {error}, see {options.out / "attack.log"}', file=sys.stderr)
                return 2
            return self._report()

    def _open(self) -> None:
        os.environ |= {'ROS_DOMAIN_ID': str(random.SystemRandom().randrange(1, 101)), 'CYCLONEDDS_URI': LOOPBACK_ONLY,
                       'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        bags = self._opened.enter_context(tempfile.TemporaryDirectory(prefix='attack_'))
        log = self._opened.enter_context((self._options.out / 'rig.log').open('wb'))
        given = [*ARGUMENTS, f'record:={bags}/rig.mcap', f'port_offset:={self._options.port_offset}']
        self._rig: MarkedProcesses = self._opened.enter_context(launched_rig(given, log))
        self._observer = Observer()
        self._opened.callback(self._observer.close)
        self._peer = self._opened.enter_context(messages_beside(self._options.out / 'attack.log'))

    def _parts(self) -> dict[str, int]:
        """Process ids of the rig's programs by name."""
        return {name: number for number, name in self._rig.alive().items() if name.endswith('_node') or name == 'simulator'}

    def _attack_all(self) -> None:
        """Attack by all kinds in turn, round after round."""
        self._begun = time.monotonic()
        for number in count():
            for kind in self._options.only or KINDS:
                over = number and time.monotonic() > self._begun + 60.0 * self._options.minutes
                if over or not self._attack(kind):
                    return

    def _attack(self, kind: str) -> bool:
        """Attack once; returns whether the rig tracks again."""
        self._wait(SETTLE_S, lambda: abs(self._observer.bearings.azimuth) < FACED or None)
        result, before, times, observer = Result(kind), self._parts(), self._rig.run_times(), self._observer
        with observer.lock:
            observer.commands.begin()
        self._kinds[kind](result)
        ended = time.time()
        with observer.lock:
            observer.bearings.forget_truth(ended)
        result.recovery = self._tracks(ended, PATIENCE_S)
        with observer.lock:
            result.meanwhile = dict(observer.bearings.faults(ended, ended + (result.recovery or PATIENCE_S)))
            result.found = observer.commands.findings
        result.slowdown = slowdown(times, self._rig.run_times())
        after = set(self._parts().values())
        result.deaths = [dead for dead, number in before.items() if number not in after | self._replaced]
        self._results.append(result)
        self._show(result)
        return result.recovery is not None and self._rig.process.poll() is None

    def _tracks(self, since: float, timeout: float) -> float | None:
        """Time (s) after `since` at which tracking was back, None where it was not within `timeout` (s)."""
        return self._wait(timeout, lambda: self._observer.bearings.recovered(since))

    def _wait(self, timeout: float, ask: Callable[[], Answer | None]) -> Answer | None:
        """Ask the observer's judges until they answer; None after a time (s), or where the rig has ended."""
        deadline = time.monotonic() + timeout
        while True:
            with self._observer.lock:
                answer = ask()
            if answer is not None or time.monotonic() > deadline or self._rig.process.poll() is not None:
                return answer
            time.sleep(0.1)

    def _send(self, result: Result, seconds: float = SECONDS, **options: object) -> None:
        """Send messages with hostile fields, damaged ones, and genuine ones at another time, on every topic.

        Parameters:
            result: gets the numbers of messages.
            seconds: duration.
            options: of `Messages.attack`.
        """
        result.sent = self._peer.attack(seconds, MESSAGE_RATE, self._random.randrange(2**31), **options)

    def _messages(self, result: Result) -> None:
        """Every input has a second publisher: none of it is used."""
        with self._still(CONTESTED_AFTER_S):
            self._send(result)

    def _no_inputs(self, result: Result) -> None:
        """The simulator is stopped, and messages whose stamps are far from now must move nothing."""
        simulator = self._parts().get('simulator')
        if simulator is None:    # it has died before, and tracking is not back
            return
        os.kill(simulator, signal.SIGSTOP)
        try:
            with self._still(STILL_AFTER_S):
                self._send(result, NO_INPUTS_S, stale=True, spare=(COMMANDS,))
        finally:
            with suppress(ProcessLookupError):
                os.kill(simulator, signal.SIGCONT)
        if self._parts().get('simulator') != simulator:    # replaced, on a slow machine
            self._replaced.add(simulator)

    @contextmanager
    def _still(self, after: float) -> Iterator[None]:
        """Nothing may move, from a time (s) after the beginning on."""
        with self._observer.lock:
            self._observer.commands.begin(time.time() + after)
        try:
            yield
        finally:
            with self._observer.lock:
                self._observer.commands.end(time.time())

    def _show(self, result: Result) -> None:
        back = 'never' if result.recovery is None else f'{result.recovery:.1f} s'
        print(f'{time.monotonic() - self._begun:5.0f} s  {result.name}: {sum(result.sent.values())} sent, {len(result.deaths)} '
              f'deaths, {len(result.found.bad)} bad commands, {len(result.found.moves)} wrong moves, tracking back: {back}',
              flush=True)
        if result.late:
            print(f'         bearings meanwhile: {result.meanwhile}', flush=True)
        for fault in (*result.deaths, *result.found.bad[:2], *result.found.moves[:2], *result.late):
            print(f'         {fault}', flush=True)

    def _report(self) -> int:
        failed = verdicts(self._results)
        for verdict, reasons in failed.items():
            print(f'{verdict}: {"; ".join(reasons[:5]) or "holds"}', flush=True)
        data = {'verdicts': failed, 'results': [asdict(result) for result in self._results], 'load': os.getloadavg(),
                'cores': os.cpu_count()}
        (self._options.out / 'attack.json').write_text(json.dumps(data, indent=1) + '\n')
        return 1 if any(failed.values()) or not self._results else 0


def verdicts(results: Sequence[Result]) -> dict[str, list[str]]:
    """What did not hold in the attacks, by verdict; a verdict without an entry in its list holds."""
    return {
        'no process dies by a message': [f'{one.name}: {death}' for one in results for death in one.deaths],
        'commands are finite and within their limits': [f'{one.name}: {bad}' for one in results for bad in one.found.bad],
        'nothing moves that must not': [f'{one.name}: {move}' for one in results for move in one.found.moves],
        IN_TIME: [f'{one.name}: {fault}' for one in results for fault in one.late]}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the attacks and print the verdicts; returns 1 where one fails."""
    parser = argparse.ArgumentParser(prog='attack', description=__doc__)
    parser.add_argument('--minutes', type=positive, default=10.0, help='duration, of one round at least (%(default)g)')
    parser.add_argument('--only', action='append', default=[], choices=KINDS, metavar='ATTACK',
                        help=f'one kind of attack, may be repeated: {", ".join(KINDS)}')
    parser.add_argument('--out', type=Path, help='folder for all figures and what the rig prints')
    parser.add_argument('--port-offset', type=port_offset, default=0, help='of the UDP ports, beside another rig')
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    options.out = options.out or Path(tempfile.mkdtemp(prefix='attack_'))
    return Attack(options).run()
