"""Whether bearings are true: resolved, and near the target's true direction."""

from __future__ import annotations

import math
from collections import Counter, deque

from nav_msgs.msg import Odometry

from av_common.angles import wrap
from av_common.frames import attitude_of, yaw_of
from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing

LARGEST_ERROR = math.radians(5.0)
STEADY = 0.5              # s during which all bearings are true before tracking counts as back
LARGEST_GAP = 0.3         # s between bearings
FARTHEST_STAMP = 0.5      # s from a bearing's stamp to its publication
FARTHEST_TRUTH = 0.1      # s from a bearing to the truth that it is compared with


class BearingCheck:
    """Compares bearings with the truth. Times are in s of the system's clock.

    Attributes:
        azimuth (rad): true azimuth of the target from the body, of the newest bearing with a truth; NaN before.
    """

    DELAY = 0.2   # s after which a bearing is compared: the truth of its stamp has arrived by then

    def __init__(self) -> None:
        self._truth: dict[str, deque[tuple[float, float, float, float, float]]] = {   # stamp, x, y, yaw, published
            'rig': deque(maxlen=400), 'target': deque(maxlen=400)}
        self._truth_from = -math.inf
        self._waiting: deque[tuple[float, float, Bearing]] = deque(maxlen=1000)
        self._verdicts: deque[tuple[float, str]] = deque(maxlen=6000)
        self.azimuth = math.nan

    def on_truth(self, name: str, message: Odometry, published: float) -> None:
        """The true state of `rig` or `target`, published at a time (s)."""
        if published < self._truth_from:
            return
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        self._truth[name].append((to_seconds(message.header.stamp), position.x, position.y, yaw_of(attitude_of(orientation)),
                                  published))

    def on_bearing(self, message: Bearing, published: float) -> None:
        """A bearing, and the time (s) of its publication. Raises ValueError for a stamp that is none."""
        self._waiting.append((published, to_seconds(message.header.stamp), message))

    def judge(self, now: float) -> None:
        """Compare the bearings published long enough before `now` (s)."""
        while self._waiting and self._waiting[0][0] < now - self.DELAY:
            time, stamp, message = self._waiting.popleft()
            self._verdicts.append((time, self._fault(time, stamp, message)))

    def forget_truth(self, until: float) -> None:
        """Drop what an attack, which ended at `until` (s), may have said about the truth."""
        self._truth_from = until
        for name, rows in self._truth.items():    # an observer that is behind has heard some of the truth since
            self._truth[name] = deque((row for row in rows if row[-1] >= until), rows.maxlen)
        self._waiting = deque((row for row in self._waiting if row[0] >= until), self._waiting.maxlen)

    def recovered(self, since: float) -> float | None:
        """Time (s) after `since` from which on bearings are true for half a second; None where they are not yet."""
        start: float | None = None
        before = math.nan
        for time, fault in self._verdicts:
            if time < since:
                continue
            true = not fault
            if not true or time - before > LARGEST_GAP:
                start = None
            if true and start is None:
                start = time
            before = time
            if start is not None and time - start >= STEADY:
                return start - since
        return None

    def share(self, begin: float, end: float) -> float:
        """Share of true bearings (0 to 1) between two times (s); 0 without any."""
        chosen = [not fault for time, fault in self._verdicts if begin <= time <= end]
        return sum(chosen) / max(len(chosen), 1)

    def faults(self, begin: float, end: float) -> str:
        """What was wrong with the bearings between two times (s), with the number of each fault."""
        found = Counter(fault for time, fault in self._verdicts if begin <= time <= end)
        return ', '.join(f'{fault or "true"} {count}' for fault, count in found.most_common())

    def _fault(self, published: float, stamp: float, message: Bearing) -> str:
        """What is wrong with a bearing with a `stamp` (s), empty for a true one."""
        if message.state == Bearing.STATE_NONE or not math.isfinite(message.azimuth):
            return 'no bearing'
        rig, target = (min(rows, key=lambda row: abs(row[0] - stamp), default=None) for rows in self._truth.values())
        if rig is None or target is None or max(abs(rig[0] - stamp), abs(target[0] - stamp)) > FARTHEST_TRUTH:
            return 'no truth of its time' if abs(stamp - published) < FARTHEST_STAMP else 'stamp of another time'
        self.azimuth = float(wrap(math.atan2(target[2] - rig[2], target[1] - rig[1]) - rig[3]))
        if abs(float(wrap(message.azimuth - self.azimuth))) >= LARGEST_ERROR:
            return 'elsewhere'
        return '' if message.resolved else 'not resolved'
