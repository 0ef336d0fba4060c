"""Judges of a rig under attack: are its bearings true, its commands within their limits, does it stand where it must."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

from nav_msgs.msg import Odometry

from av_common.angles import wrap
from av_common.frames import attitude_of, yaw_of
from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.settings import PointingSettings

LARGEST_ERROR = math.radians(5.0)  # rad, of a bearing that counts as true: ten sigma of what is seen
STEADY_S = 0.5           # for which all bearings are true before tracking counts as back
LARGEST_GAP_S = 0.3      # between bearings
FARTHEST_TRUTH_S = 0.1   # from a bearing to the truth that it is compared with
ARRIVED_S = 0.5          # after which the truth that was published before a bearing has arrived
LONGEST_STEP_S = 1.0     # commands may be lost on the way to the observer
ROUNDING = 1e-4          # of float32
JITTER_S = 0.03          # between the two clocks that give a command's stamp and its motion, read one after the other


class BearingCheck:
    """Compares bearings with the truth. Times are in s of the system's clock.

    Attributes:
        azimuth (rad): true azimuth of the target from the body, of the newest bearing with a truth; NaN before.
    """

    def __init__(self) -> None:
        self._truth: dict[str, deque[tuple[float, float, float, float, float]]] = {   # stamp, x, y, yaw, published
            'rig': deque(maxlen=400), 'target': deque(maxlen=400)}
        self._waiting: deque[tuple[float, float, Bearing]] = deque(maxlen=1000)
        self._verdicts: deque[tuple[float, str]] = deque(maxlen=6000)
        self._truth_from = -math.inf
        self.azimuth = math.nan

    def on_truth(self, name: str, message: Odometry, published: float) -> None:
        """The true state of `rig` or `target`, published at a time (s)."""
        if published >= self._truth_from:
            place, attitude = message.pose.pose.position, attitude_of(message.pose.pose.orientation)
            self._truth[name].append((to_seconds(message.header.stamp), place.x, place.y, yaw_of(attitude), published))

    def on_bearing(self, message: Bearing, published: float) -> None:
        """A bearing, and the time (s) of its publication. Raises ValueError for a stamp that is none."""
        self._waiting.append((published, to_seconds(message.header.stamp), message))

    def judge(self, now: float) -> None:
        """Compare the bearings published long enough before `now` (s)."""
        while self._waiting and self._waiting[0][0] < now - ARRIVED_S:
            published, stamp, message = self._waiting.popleft()
            self._verdicts.append((published, self._fault(stamp, message)))

    def forget_truth(self, until: float) -> None:
        """Drop what an attack, which ended at `until` (s), may have said about the truth."""
        self._truth_from = until
        for name, rows in self._truth.items():    # an observer that is behind has heard some of the truth since
            self._truth[name] = deque((row for row in rows if row[-1] >= until), rows.maxlen)
        self._waiting = deque((row for row in self._waiting if row[0] >= until), self._waiting.maxlen)

    def recovered(self, since: float) -> float | None:
        """Time (s) after `since` from which on bearings are true for STEADY_S; None where they are not yet."""
        start: float | None = None
        before = math.nan
        for time, fault in self._verdicts:
            if time < since:
                continue
            if fault or time - before > LARGEST_GAP_S:
                start = None
            if not fault and start is None:
                start = time
            before = time
            if start is not None and time - start >= STEADY_S:
                return start - since
        return None

    def faults(self, begin: float, end: float = math.inf) -> Counter[str]:
        """Numbers of bearings between two times (s) by what is wrong with them, '' for the true ones."""
        return Counter(fault for time, fault in self._verdicts if begin <= time <= end)

    def _fault(self, stamp: float, message: Bearing) -> str:
        """What is wrong with a bearing with a `stamp` (s), empty for a true one."""
        if message.state == Bearing.STATE_NONE or not math.isfinite(message.azimuth):
            return 'no bearing'
        rig, target = (min(rows, key=lambda row: abs(row[0] - stamp), default=None) for rows in self._truth.values())
        if rig is None or target is None or max(abs(rig[0] - stamp), abs(target[0] - stamp)) > FARTHEST_TRUTH_S:
            return 'no truth of its time'
        self.azimuth = float(wrap(math.atan2(target[2] - rig[2], target[1] - rig[1]) - rig[3]))
        if abs(float(wrap(message.azimuth - self.azimuth))) >= LARGEST_ERROR:
            return 'elsewhere'
        return '' if message.resolved else 'not resolved'


class CommandLimits:
    """Compares each command with the limits and with the command before.

    Parameters:
        settings: limits of the axes.
        tolerance (rad, rad/s): excess that is permitted for rounding.
        jitter (s): by which a command's time may be wrong; over many commands that adds nothing to the acceleration.
    """

    def __init__(self, settings: PointingSettings, tolerance: float = 1e-9, jitter: float = 0.0) -> None:
        self._settings, self._tolerance, self._jitter = settings, tolerance, jitter
        self._before: Any = None
        self._credit: dict[str, float] = {}    # s of full acceleration by axis, ahead of the commands' times

    def check(self, command: Any, elapsed: float) -> str:
        """The first fault of a command, '' for none.

        Parameters:
            command: of pointing, as plain data or as message: angles in rad, rates in rad/s.
            elapsed (s): time since the command before.
        """
        before, self._before = self._before, command
        axes = (('pan', command.pan, command.pan_rate, self._settings.pan),
                ('tilt', command.tilt, command.tilt_rate, self._settings.tilt),
                ('yaw', 0.0, command.yaw_rate, self._settings.yaw))
        for name, angle, rate, limits in axes:
            if not (math.isfinite(angle) and math.isfinite(rate)):
                return f'{name} is not finite: {angle} rad, {rate} rad/s'
            if not (limits.lower - self._tolerance <= angle <= limits.upper + self._tolerance
                    and abs(rate) <= limits.rate + self._tolerance):
                return f'{name} is out of its limits: {angle:.3g} rad, {rate:.3g} rad/s'
            change = 0.0 if before is None else abs(rate - getattr(before, f'{name}_rate'))
            credit = self._credit.get(name, self._jitter) + elapsed - change / limits.acceleration
            self._credit[name] = min(max(credit, 0.0), self._jitter)
            if credit < -self._tolerance / limits.acceleration:
                return f'{name} accelerates by {change:.3g} rad/s in {elapsed:.3g} s'
        return ''


@dataclass
class Findings:
    """What was found since the last `begin`.

    Attributes:
        commands: number of commands of the rig.
        bad, moves: descriptions of the commands that are bad, and of those that moved what must not move.
    """

    commands: int = 0
    bad: list[str] = field(default_factory=list)
    moves: list[str] = field(default_factory=list)


class CommandJudge:
    """Compares commands with their limits, and with whether anything may move. Times are in s of the system's clock.

    Parameters:
        settings: limits of the commands.
    """

    def __init__(self, settings: PointingSettings) -> None:
        self._limits = CommandLimits(settings, ROUNDING, JITTER_S)
        self._still_from = self._still_until = math.inf
        self._stamp = math.nan
        self.findings = Findings()

    def begin(self, still_from: float = math.inf) -> None:
        """Start a new attack; from `still_from` (s) on nothing may move whatever arrives."""
        self.findings, self._still_from, self._still_until = Findings(), still_from, math.inf

    def end(self, now: float) -> None:
        """From `now` (s) on motion is permitted again."""
        self._still_until = now

    def on_command(self, command: PointingCommand, stamp: float) -> None:
        """Judge a command of the rig by its stamp (s)."""
        found = self.findings
        found.commands += 1
        elapsed = min(max(stamp - self._stamp, 0.0), LONGEST_STEP_S) if math.isfinite(self._stamp) else LONGEST_STEP_S
        self._stamp = stamp
        if fault := self._limits.check(command, elapsed):
            found.bad.append(f'{stamp:.3f} {fault}')
        if command.move_body and abs(command.yaw_rate) >= ROUNDING and self._still_from <= stamp < self._still_until:
            found.moves.append(f'{stamp:.3f} {math.degrees(command.yaw_rate):+.1f} deg/s, '
                               f'{stamp - self._still_from:.2f} s after all motion had to end')
