"""The attacks, each a function of the arena in which it takes place."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random

from av_evaluation.attack.rig import LAUNCH, Rig
from av_evaluation.attack.verdicts import LEAST_SHARE, MOST_RECOVERY_PROCESS, MOST_RESPAWN, Result
from av_evaluation.attack.worker import Worker

REQUEST_RATE = 20.0      # Hz, of lifecycle and parameter requests
STOPPED = 2.0            # s for which a process is stopped
STILL_AFTER = 0.5        # s from the stop of the simulator to the moment from which nothing may move
DISABLED_AFTER = 0.5     # s from the request to the moment from which nothing may move
NOT_RESPAWNED = ('monitor_node',)    # its table would begin again
COMMANDS = '/pointing/command'
HERE, THERE = '10.87.0.1', '10.87.0.2'    # addresses of this host and of the other one
ANSWER = 30.0            # s for which a worker may be late


@dataclass
class Arena:
    """Where the attacks take place.

    Parameters:
        rig: the rig.
        observer, messages, datagrams: processes of the attack.
        other_host: process that sends datagrams from another host; None where there is none.
        offset: of the rig's UDP ports.
        seconds: duration of one attack.
        message_rate, datagram_rate (Hz): for each topic and each port.
        random: source of the draws.
    """

    rig: Rig
    observer: Worker
    messages: Worker
    datagrams: Worker
    other_host: Worker | None
    offset: int
    seconds: float
    message_rate: float
    datagram_rate: float
    random: Random = field(default_factory=Random)

    def seed(self) -> int:
        """A new seed."""
        return self.random.randrange(2**31)

    def send_messages(self, kind: str, result: Result, **options: object) -> None:
        """Attack all topics; adds the numbers to a result."""
        self.messages.send('attack', kind=kind, seconds=self.seconds, rate=self.message_rate, seed=self.seed(), **options)
        _add(result, self.messages.receive(self.seconds + ANSWER))

    def send_datagrams(self, kind: str, result: Result, sender: Worker | None = None, **options: object) -> None:
        """Attack all ports; adds the numbers to a result."""
        sender = sender or self.datagrams
        sender.send('attack', kind=kind, seconds=self.seconds, rate=self.datagram_rate, seed=self.seed(), offset=self.offset,
                    **options)
        _add(result, sender.receive(self.seconds + ANSWER))


def _add(result: Result, sent: dict[str, int]) -> None:
    for target, count in sent.items():
        result.sent[target] = result.sent.get(target, 0) + count


def typed(arena: Arena, result: Result) -> None:
    """Well-formed messages with hostile fields."""
    arena.send_messages('typed', result)


def malformed(arena: Arena, result: Result) -> None:
    """Damaged serializations."""
    arena.send_messages('malformed', result)


def structured(arena: Arena, result: Result) -> None:
    """Datagrams of the right layout with hostile values, from this machine."""
    arena.send_datagrams('structured', result)


def random_bytes(arena: Arena, result: Result) -> None:
    """Datagrams of random bytes and sizes."""
    arena.send_datagrams('random', result)


def other_host(arena: Arena, result: Result) -> None:
    """Datagrams from another host, some as a simulator sends them: nobody may notice."""
    assert arena.other_host is not None
    begun = time.time()
    for kind in ('structured', 'genuine'):
        arena.send_datagrams(kind, result, arena.other_host, host=HERE)
    share = arena.observer.call('share', begin=begun + 0.5, end=time.time())
    if share < LEAST_SHARE:
        result.late.append(f'only {share:.0%} of the bearings were true while another host sent')


def clocks(arena: Arena, result: Result) -> None:
    """Stamps and times that jump, drift and contradict each other, on topics and ports at once."""
    arena.datagrams.send('attack', kind='clocks', seconds=arena.seconds, rate=arena.datagram_rate, seed=arena.seed(),
                         offset=arena.offset, spare=['control'])
    arena.send_messages('clocks', result)
    _add(result, arena.datagrams.receive(arena.seconds + ANSWER))


def lifecycle(arena: Arena, result: Result) -> None:
    """Transitions in random order, valid and invalid."""
    arena.messages.send('lifecycle', seconds=arena.seconds, rate=REQUEST_RATE, seed=arena.seed())
    _add(result, arena.messages.receive(arena.seconds + ANSWER))


def parameters(arena: Arena, result: Result) -> None:
    """Requests for parameters of real and invented names, with values out of bounds and of other types."""
    arena.messages.send('parameters', seconds=arena.seconds, rate=REQUEST_RATE, seed=arena.seed())
    _add(result, arena.messages.receive(arena.seconds + ANSWER))


def still(arena: Arena, result: Result) -> None:
    """The simulator is stopped, and messages whose stamps are far from now, and random datagrams, must move nothing."""
    result.most_recovery = MOST_RECOVERY_PROCESS
    arena.rig.signal('simulator', signal.SIGSTOP)
    try:
        arena.observer.call('begin', still_from=time.time() + STILL_AFTER)
        time.sleep(STILL_AFTER)
        arena.datagrams.send('attack', kind='random', seconds=arena.seconds, rate=arena.datagram_rate, seed=arena.seed(),
                             offset=arena.offset)
        arena.send_messages('mixed', result, stale=True, spare=[COMMANDS])
        _add(result, arena.datagrams.receive(arena.seconds + ANSWER))
    finally:
        arena.observer.call('end')
        with suppress(KeyError, ProcessLookupError):
            arena.rig.signal('simulator', signal.SIGCONT)
    time.sleep(0.2)


def disabled(arena: Arena, result: Result) -> None:
    """Pointing is disabled, and no message or datagram moves the rig, however genuine it looks."""
    if not arena.messages.call('enable', enabled=False):
        result.faults.append('pointing could not be disabled')
        return
    arena.observer.call('begin', still_from=time.time() + DISABLED_AFTER)
    arena.datagrams.send('attack', kind='structured', seconds=arena.seconds, rate=arena.datagram_rate, seed=arena.seed(),
                         offset=arena.offset)
    arena.send_messages('mixed', result, spare=[COMMANDS])
    _add(result, arena.datagrams.receive(arena.seconds + ANSWER))
    arena.observer.call('end')


def kill(arena: Arena, result: Result, name: str) -> None:
    """A process is killed: it is back within 2 s, and what it did within 3 s."""
    result.most_recovery = MOST_RECOVERY_PROCESS
    killed, result.ended = arena.rig.signal(name, signal.SIGKILL), time.time()
    result.sent = {f'SIGKILL to {name}': 1}
    if name == 'pointing_node':
        arena.observer.call('forget')
    begun = time.monotonic()
    while name not in NOT_RESPAWNED and time.monotonic() - begun < 2 * MOST_RESPAWN:
        if arena.rig.alive().get(name, killed) != killed:
            result.respawn = time.monotonic() - begun
            break
        time.sleep(0.05)
    if arena.rig.ended:
        result.faults.append(f'the rig ended when {name} was killed')
    elif name not in NOT_RESPAWNED and (result.respawn is None or result.respawn > MOST_RESPAWN):
        result.late.append(f'{name} was not back in {MOST_RESPAWN:.0f} s: {result.respawn}')


def stop(arena: Arena, result: Result, name: str) -> None:
    """A process is stopped, and continues later."""
    result.most_recovery = MOST_RECOVERY_PROCESS
    arena.rig.signal(name, signal.SIGSTOP)
    result.sent = {f'SIGSTOP to {name}': 1}
    time.sleep(STOPPED)
    with suppress(KeyError, ProcessLookupError):
        arena.rig.signal(name, signal.SIGCONT)


ATTACKS: dict[str, Callable[[Arena, Result], None]] = {
    'typed messages': typed, 'malformed messages': malformed, 'structured datagrams': structured,
    'random datagrams': random_bytes, 'another host': other_host, 'clocks': clocks, 'lifecycle requests': lifecycle,
    'parameter requests': parameters, 'no inputs': still, 'disabled': disabled}
PROCESS_ATTACKS: dict[str, Callable[[Arena, Result, str], None]] = {'kill': kill, 'stop': stop}


def victims(rig: Rig) -> list[str]:
    """Names of the processes that are killed and stopped: all but the launch."""
    return sorted(name for name in rig.alive() if name != LAUNCH)
