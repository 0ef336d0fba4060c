"""Memory, threads and descriptors of a rig's processes over a long run, whether they stay as they are, and what was lost."""

from __future__ import annotations

import csv
import math
import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from av_bags.reader import Bag
from av_evaluation.processes import MarkedProcesses, ProcessSample, sample

WINDOW_S = 60.0     # medians and least counts are taken over this much time
# Counters of the bridge that stay 0 on one machine.
LOSSES = ('audio lost', 'audio lost frames', 'audio overwritten frames', 'audio malformed', 'audio foreign')
PAGE_S = 10.0       # between updates of a page that goes on, on a busy machine, too
ADDRESS = re.compile(r'the rig in your browser: http://([^/ ]+)/')
DYING_S = 10.0      # processes that end this shortly before the rig has ended were ended by it


@dataclass(frozen=True)
class Limits:
    """What counts as steady.

    Attributes:
        settle (s): samples of this time after a process' first are left out.
        growth (MiB): largest growth of the resident memory.
    """

    settle: float = 300.0
    growth: float = 5.0


@dataclass
class ProcessHistory:
    """Samples of one process.

    Attributes:
        name: of the node or program.
        process_id: of the process.
        times (s): of the samples, since the start of the run.
        samples: as many.
    """

    name: str
    process_id: int
    times: list[float] = field(default_factory=list)
    samples: list[ProcessSample] = field(default_factory=list)

    def add(self, now: float, taken: ProcessSample) -> None:
        """Append a sample taken at `now` (s)."""
        self.times.append(now)
        self.samples.append(taken)

    def column(self, quantity: str) -> NDArray[np.float64]:
        """One attribute of all samples (n,)."""
        return np.array([getattr(one, quantity) for one in self.samples], float)

    def settled(self, quantity: str, settle: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times (n,) and values (n,) of a quantity from `settle` (s) after the first sample on; all where none is so late."""
        times, values = np.array(self.times), self.column(quantity)
        later = times - times[0] >= settle
        return (times[later], values[later]) if later.any() else (times, values)

    def growth(self, quantity: str, settle: float) -> float:
        """Median of a quantity over the last minute less that over the first after `settle` (s)."""
        times, values = self.settled(quantity, settle)
        return float(np.median(values[times >= times[-1] - WINDOW_S]) - np.median(values[times <= times[0] + WINDOW_S]))

    def span(self, quantity: str, settle: float) -> tuple[int, int]:
        """Smallest and largest value of a count after `settle` (s), of the least in each minute.

        A file that is open for a moment, such as that of the heartbeat, is none that stays open.
        """
        times, values = self.settled(quantity, settle)
        minutes = (times - times[0]) // WINDOW_S
        minutes = np.minimum(minutes, max(minutes[-1] - 1.0, 0.0))  # the last one has 60 to 120 s
        least = [values[minutes == minute].min() for minute in np.unique(minutes)]
        return int(min(least)), int(max(least))

    def faults(self, limits: Limits, end: float) -> list[str]:
        """What did not stay as it was; empty for a steady process.

        Parameters:
            limits: what counts as steady.
            end (s): of the run.
        """
        found = []
        if self.times[-1] < end - DYING_S:
            found.append(f'ended after {self.times[-1]:.0f} s')
        if self.times[0] > limits.settle:
            found.append(f'started after {self.times[0]:.0f} s')
        if (grown := self.growth('resident', limits.settle)) > limits.growth:
            found.append(f'grew by {grown:.1f} MiB')
        for quantity in ('threads', 'descriptors'):
            low, high = self.span(quantity, limits.settle)
            if low != high:
                found.append(f'{low} to {high} {quantity}')
        return found


class PageViewer:
    """A viewer of the page, in a thread: asks for one update after the other, as a browser does.

    Attributes:
        updates: number of states that the page has sent.

    Parameters:
        log: file with what the rig prints, which names the address.
    """

    def __init__(self, log: Path) -> None:
        self._log, self.updates, self._newest = log, 0, -math.inf
        threading.Thread(target=self._look, daemon=True).start()

    @property
    def waits(self) -> bool:
        """Whether there was no state within the last PAGE_S."""
        return time.monotonic() - self._newest > PAGE_S

    def _look(self) -> None:
        while True:
            found = ADDRESS.findall(self._log.read_text(errors='replace'))
            with suppress(OSError, WebSocketException):
                for address in found[-1:]:
                    self._follow(f'ws://{address}/feed')
            time.sleep(1.0)

    def _follow(self, address: str) -> None:
        with connect(address, max_size=None) as connection:
            connection.send('{"do": "next"}')
            for message in connection:
                if isinstance(message, str) and message.startswith('{"type":"state"'):
                    self.updates, self._newest = self.updates + 1, time.monotonic()
                    connection.send('{"do": "next"}')


def watch(rig: MarkedProcesses, seconds: float, period: float = 5.0,
          show: Callable[[float, Sequence[ProcessHistory]], None] = lambda *_: None) -> list[ProcessHistory]:
    """Sample all processes of a program until it ends, or for some time; returns a history of each process.

    Parameters:
        rig: the program.
        seconds (s): length of the run at most.
        period (s): time between samples.
        show: called after each round of samples with the time since the start (s) and the histories so far.
    """
    histories: dict[int, ProcessHistory] = {}
    begun = time.monotonic()
    while rig.process.poll() is None and (now := time.monotonic() - begun) < seconds:
        for process_id, name in rig.alive().items():
            taken = sample(process_id)
            if taken is not None:
                histories.setdefault(process_id, ProcessHistory(name, process_id)).add(now, taken)
        show(now, list(histories.values()))
        time.sleep(max(0.0, begun + now + period - time.monotonic()))
    return lasting(list(histories.values()), period)


def lasting(histories: Sequence[ProcessHistory], period: float) -> list[ProcessHistory]:
    """Histories by name, without those of a few samples: a shell that starts another program."""
    return sorted((history for history in histories if history.times[-1] - history.times[0] > 2.0 * period),
                  key=lambda history: history.name)


def format_histories(histories: Sequence[ProcessHistory], limits: Limits, end: float) -> str:
    """A table with a row for each process: memory after settling, growth, threads, descriptors and verdict.

    Parameters:
        histories: of the processes.
        limits: what counts as steady.
        end (s): of the run.
    """
    lines = [f'{"process":<22}{"resident":>10}{"growth":>9}{"private":>10}{"growth":>9}{"threads":>9}{"files":>8}   verdict',
             f'{"":<22}{"MiB":>10}{"MiB":>9}{"MiB":>10}{"MiB":>9}']
    for one in histories:
        first = {name: float(np.median(one.settled(name, limits.settle)[1][:5])) for name in ('resident', 'private')}
        memory = ''.join(f'{first[name]:10.1f}{one.growth(name, limits.settle):+9.2f}' for name in first)
        counts = [_range(*one.span(name, limits.settle)) for name in ('threads', 'descriptors')]
        verdict = ', '.join(one.faults(limits, end)) or 'holds'
        lines.append(f'{one.name[:21]:<22}{memory}{counts[0]:>9}{counts[1]:>8}   {verdict}')
    return '\n'.join(lines)


def save_histories(histories: Sequence[ProcessHistory], path: Path) -> None:
    """Write all samples as CSV.

    Parameters:
        histories: of the processes.
        path: of the file.
    """
    names = [field.name for field in fields(ProcessSample)]
    with path.open('w', newline='') as file:
        rows = csv.writer(file, lineterminator='\n')
        rows.writerow(['process', 'process_id', 'time', *names])
        for one in histories:
            rows.writerows([one.name, one.process_id, f'{time:.1f}', *(f'{getattr(taken, name):.9g}' for name in names)]
                           for time, taken in zip(one.times, one.samples, strict=True))


def lost_sound(recording: Path) -> dict[str, int]:
    """What the bridge says at last in a recording of LOSSES, but for what is 0; empty without a bridge. Raises BagError."""
    counts: dict[str, str] = {}
    with Bag(recording) as bag:
        for topic, _, data in bag.messages(['/diagnostics']):
            for status in bag.decode(topic, data).status:
                if 'bridge_node' in status.name:
                    counts = {value.key: value.value for value in status.values}
    return {name: int(counts[name]) for name in LOSSES if int(counts.get(name, 0))}


def _range(low: int, high: int) -> str:
    return f'{low}' if low == high else f'{low}-{high}'
