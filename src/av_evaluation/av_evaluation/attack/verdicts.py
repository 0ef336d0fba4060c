"""Results of the attacks, the verdicts over them, and their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

GOAL_PER_HOUR = 100_000     # messages to each topic and datagrams to each port
MOST_GROWTH = 20.0          # MiB
MOST_RECOVERY = 1.0         # s after messages, datagrams, requests
MOST_RECOVERY_PROCESS = 3.0 # s after a process was killed or stopped
MOST_RESPAWN = 2.0          # s until a killed process runs again
IN_TIME = 'tracking and processes are back in time'
LEAST_SHARE = 0.95          # of the bearings that stay true while another host attacks


@dataclass
class Result:
    """What one attack did.

    Attributes:
        name: of the attack.
        sent: number of messages, datagrams or requests by their target.
        seconds: duration.
        deaths: processes that ended though nobody killed them.
        commands: number of commands of the rig.
        bad, moves: commands that are not finite or out of their limits, and that moved what must not move.
        bad_count, move_count: their numbers.
        growth (MiB): of the memory of each process.
        ended (s): time of its end, of a kill that of the signal; None until then.
        recovery (s): from the end until tracking was back; None where it did not come back.
        meanwhile: what was wrong with the bearings until then.
        most_recovery (s): that is permitted.
        respawn (s): time until a killed process ran again; None where it did not, or none was killed.
        faults, late: further reasons why the attack succeeded; `late` those that a busy machine alone may cause.
        diagnostics: state of each node afterwards.
    """

    name: str
    sent: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    deaths: list[str] = field(default_factory=list)
    commands: int = 0
    bad: list[str] = field(default_factory=list)
    moves: list[str] = field(default_factory=list)
    bad_count: int = 0
    move_count: int = 0
    largest_yaw_rate: float = 0.0
    growth: dict[str, float] = field(default_factory=dict)
    ended: float | None = None
    recovery: float | None = None
    meanwhile: str = ''
    most_recovery: float = MOST_RECOVERY
    respawn: float | None = None
    faults: list[str] = field(default_factory=list)
    late: list[str] = field(default_factory=list)
    diagnostics: dict[str, Any] = field(default_factory=dict)

    @property
    def largest_growth(self) -> float:
        """Growth (MiB) of the process that grew most."""
        return max(self.growth.values(), default=0.0)


def verdicts(results: Sequence[Result], growth: dict[str, float]) -> dict[str, list[str]]:
    """What did not hold, by verdict; a verdict without an entry in its list holds.

    Parameters:
        results: of all attacks.
        growth (MiB): of each process from the first attack to the end.
    """
    failed: dict[str, list[str]] = {
        'no process dies by a message': [], 'commands are finite and within their limits': [],
        'nothing moves that must not': [], f'memory grows by less than {MOST_GROWTH:.0f} MiB': [],
        'all nodes obey afterwards': [], IN_TIME: []}
    dies, limits, moves, memory, others, in_time = failed.values()
    for result in results:
        dies += [f'{result.name}: {death}' for death in result.deaths]
        limits += [f'{result.name}: {bad}' for bad in result.bad]
        moves += [f'{result.name}: {move}' for move in result.moves]
        others += [f'{result.name}: {fault}' for fault in result.faults]
        in_time += [f'{result.name}: {fault}' for fault in result.late]
        if result.recovery is None:
            in_time.append(f'{result.name}: tracking is not back ({result.meanwhile})')
        elif result.recovery > result.most_recovery:
            in_time.append(f'{result.name}: tracking is back after {result.recovery:.1f} s ({result.meanwhile})')
        memory += [f'{result.name}: {name} {grown:.0f} MiB' for name, grown in result.growth.items() if grown >= MOST_GROWTH]
    memory += [f'whole run: {name} {grown:.0f} MiB' for name, grown in growth.items() if grown >= MOST_GROWTH]
    return failed


def table(results: Sequence[Result]) -> str:
    """The results in Markdown, one row for each kind of attack; of several runs of one the sum or the worst."""
    lines = ['| attack | runs | sent | deaths | commands | bad | moves that must not be | memory (MiB) | tracking back (s) |',
             '|---|---|---|---|---|---|---|---|---|']
    for name in dict.fromkeys(result.name for result in results):
        runs = [result for result in results if result.name == name]
        recoveries = [result.recovery for result in runs]
        back = 'never' if None in recoveries else f'{max(filter(None, recoveries), default=0.0):.1f}'
        lines.append(f'| {name} | {len(runs)} | {sum(sum(one.sent.values()) for one in runs):,} '
                     f'| {sum(len(one.deaths) for one in runs)} | {sum(one.commands for one in runs):,} '
                     f'| {sum(one.bad_count for one in runs)} | {sum(one.move_count for one in runs)} '
                     f'| {max(one.largest_growth for one in runs):+.1f} | {back} |')
    return '\n'.join(lines)


def sent_by_target(results: Sequence[Result]) -> dict[str, int]:
    """Messages by topic and datagrams by port, over all attacks."""
    total: dict[str, int] = {}
    for result in results:
        for target, count in result.sent.items():
            total[target] = total.get(target, 0) + count
    return total


def too_few(sent: dict[str, int], goal: int) -> list[str]:
    """Topics and ports to which fewer than `goal` messages or datagrams were sent; requests and signals do not count."""
    return [f'{target} {count:,}' for target, count in sent.items()
            if count < goal and not target.startswith(('SIG', 'refused')) and not target.endswith('_node')]
