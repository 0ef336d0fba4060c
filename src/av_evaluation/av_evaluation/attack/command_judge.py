"""Judgement of pointing commands: within their limits, and no motion that nothing justifies."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from av_evaluation.metrics.command_limits import CommandLimits
from av_interfaces.msg import PointingCommand
from av_pointing.controller import PointingSettings

MOTION_LIFETIME = 0.3    # s after the arrival of the newest measurement
SLACK = 0.1              # s that a message may take through the middleware
LONGEST_STEP = 1.0       # s; commands may be lost on the way to the observer
ROUNDING = 1e-4          # of float32
JITTER = 0.03            # s between the two clocks that give a command's stamp and its motion, read one after the other
MOST_KEPT = 20


@dataclass
class Findings:
    """What was found since the last `begin`.

    Attributes:
        commands: number of commands of the rig.
        bad, moves: descriptions of the first bad commands, and of the first commands that moved what must not move.
        bad_count, move_count: numbers of all of them.
        largest_yaw_rate (rad/s): of all commands that moved the body.
    """

    commands: int = 0
    bad: list[str] = field(default_factory=list)
    moves: list[str] = field(default_factory=list)
    bad_count: int = 0
    move_count: int = 0
    largest_yaw_rate: float = 0.0


class CommandJudge:
    """Compares commands with what arrived before them. Times are in s of the system's clock.

    Parameters:
        settings: limits of the commands.
    """

    DELAY = 0.5   # s after which a command is judged: what was published before it has arrived by then

    def __init__(self, settings: PointingSettings) -> None:
        self._limits = CommandLimits(settings, ROUNDING, JITTER)
        self._waiting: deque[tuple[float, float, PointingCommand]] = deque()
        self._arrivals: dict[str, deque[float]] = {'measurement': deque(maxlen=2000), 'odometry': deque(maxlen=2000)}
        self._bearings: deque[tuple[float, float]] = deque(maxlen=2000)
        self._still_from = self._still_until = math.inf
        self._stamp = math.nan
        self.findings = Findings()

    def begin(self, still_from: float = math.inf) -> None:
        """Start a new attack.

        Parameters:
            still_from (s): time from which nothing may move whatever arrives.
        """
        self.findings, self._still_from, self._still_until = Findings(), still_from, math.inf

    def end(self, now: float) -> None:
        """From `now` (s) on motion is permitted again."""
        self._still_until = now

    def forget(self) -> None:
        """The process that makes the commands starts again."""
        self._waiting.clear()
        self._limits.forget()

    def on_input(self, kind: str, published: float, stamp: float) -> None:
        """A measurement or odometry; what was captured more than 1 s before, or after it was published, justifies no motion.

        Parameters:
            kind: `measurement` or `odometry`.
            published, stamp (s): times of its publication and capture.
        """
        if -0.1 <= published - stamp <= 1.0:
            self._arrivals[kind].append(published)

    def on_bearing(self, published: float, measured: float) -> None:
        """A bearing of the rig, which explains a command that follows it.

        Parameters:
            published (s): time of its publication.
            measured (s): capture time of its newest measurement.
        """
        self._bearings.append((published, measured))

    def on_command(self, command: PointingCommand, stamp: float, now: float) -> None:
        """A command of the rig.

        Parameters:
            command: the command.
            stamp (s): of the command.
            now (s): time of its arrival.
        """
        self._waiting.append((now, stamp, command))

    def judge(self, now: float) -> None:
        """Judge the commands that arrived long enough before `now` (s)."""
        while self._waiting and self._waiting[0][0] < now - self.DELAY:
            _, stamp, command = self._waiting.popleft()
            self._judge(command, stamp)

    def _judge(self, command: PointingCommand, stamp: float) -> None:
        found = self.findings
        found.commands += 1
        elapsed = min(max(stamp - self._stamp, 0.0), LONGEST_STEP) if math.isfinite(self._stamp) else LONGEST_STEP
        self._stamp = stamp
        if fault := self._limits.check(command, elapsed):
            found.bad_count += 1
            found.bad = [*found.bad, f'{stamp:.3f} {fault}'][:MOST_KEPT]
        if not command.move_body or abs(command.yaw_rate) < ROUNDING:
            return
        found.largest_yaw_rate = max(found.largest_yaw_rate, abs(command.yaw_rate))
        if reason := self._unjustified(stamp):
            found.move_count += 1
            found.moves = [*found.moves, f'{stamp:.3f} {math.degrees(command.yaw_rate):+.1f} deg/s {reason}'][:MOST_KEPT]

    def _unjustified(self, stamp: float) -> str:
        """Why nothing may move at `stamp` (s), '' where it may."""
        if self._still_from <= stamp < self._still_until:
            return f'{stamp - self._still_from:.2f} s after all motion had to end'
        for kind, arrivals in self._arrivals.items():
            age = stamp - max((time for time in arrivals if time <= stamp), default=-math.inf)
            if age > MOTION_LIFETIME + SLACK:
                return f'{age:.2f} s after the newest {kind}{self._newest_bearing(stamp)}'
        return ''

    def _newest_bearing(self, stamp: float) -> str:
        """When the newest measurement was stated that the bearings before `stamp` (s) rest on."""
        before = [bearing for bearing in self._bearings if bearing[0] <= stamp]
        measured = max((measured for _, measured in before), default=math.nan)
        stated = min((published for published, captured in before if captured == measured), default=math.nan)
        return f'; a bearing stated {stamp - stated:.2f} s before that it was captured {stated - measured:.2f} s before'
