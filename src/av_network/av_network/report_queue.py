"""Reports in the order of capture, whatever the order of their arrival."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator

from av_network.observation import Report

PERIOD_S = 0.04  # least time between two reports of a rig that wait
AWAKE_S = 2.0  # since a rig's newest capture, for which the next one is waited for: some of its reports may be lost


class ReportQueue:
    """Holds reports back until those that were captured before have arrived, at the longest for a given time.

    Nodes that receive the same reports use them in the same order, and so come to the same tracks.

    Attributes:
        late: number of reports by rig that arrived too late to be used, or PERIOD_S from another one of theirs.

    Parameters:
        wait (s): longest time from capture to use; reports that arrive later are not used.
    """

    def __init__(self, wait: float) -> None:
        self._wait = wait
        self._heap: list[tuple[float, str, Report]] = []
        self._newest: dict[str, float] = {}
        self._now = self._released = -math.inf
        self.late: dict[str, int] = {}

    def put(self, report: Report, captured: float) -> bool:
        """Add a report; returns False for one that is too late, or too close to another one of its rig.

        Parameters:
            report: of a rig.
            captured (s): its time by the reference clock.
        """
        # A late one, too, tells that its rig is to be waited for; else all of its reports would be late from then on. But one
        # that comes after the longest wait tells that this is in vain: that rig's clock is behind, or its link is slow.
        if captured > self._now - self._wait:
            self._newest[report.rig] = max(self._newest.get(report.rig, -math.inf), captured)
        if captured <= self._released or any(rig == report.rig and abs(time - captured) < PERIOD_S
                                             for time, rig, _ in self._heap):
            self.late[report.rig] = self.late.get(report.rig, 0) + 1
            return False
        heapq.heappush(self._heap, (captured, report.rig, report))
        return True

    def ready(self, now: float) -> Iterator[Report]:
        """The reports before which none is missing: all rigs that are not silent have sent later ones.

        Parameters:
            now (s): the reference clock.
        """
        self._now = now
        awake = [newest for newest in self._newest.values() if now - newest < AWAKE_S]
        complete = max(min(awake, default=math.inf), now - self._wait)
        while self._heap and self._heap[0][0] <= complete:
            self._released, _, report = heapq.heappop(self._heap)
            yield report
