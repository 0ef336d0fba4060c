"""ros2 run av_evaluation soak: an hour of the whole rig, with a recorder and a page that somebody looks at.

Its processes keep memory, threads, descriptors; no sound is lost.
"""

from __future__ import annotations

import argparse
import math
import re
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from av_bags.reader import Bag
from av_common.arguments import positive
from av_evaluation.processes import MarkedProcesses, ProcessSample, launched_rig, sample

EVERY_S = 5.0  # between samples
RIG = ('model:=shipped', 'renderer:=flat', 'view:=true')
WINDOW_S = 60.0     # medians and least counts are taken over this much time
# Counters of the bridge that stay 0 on one machine.
LOSSES = ('audio lost', 'audio lost frames', 'audio malformed', 'audio foreign')
PAGE_S = 10.0       # between updates of a page that goes on, on a busy machine, too
ADDRESS = re.compile(r'the rig in your browser: http://([^/ ]+)/')
DYING_S = 10.0      # processes that end this shortly before the rig has ended were ended by it


@dataclass
class ProcessHistory:
    """Samples of one process.

    Attributes:
        name: of the node or program.
        times (s): of the samples, since the start of the run.
        samples: as many.
    """

    name: str
    times: list[float] = field(default_factory=list)
    samples: list[ProcessSample] = field(default_factory=list)

    def add(self, now: float, taken: ProcessSample) -> None:
        """Append a sample taken at `now` (s)."""
        self.times.append(now)
        self.samples.append(taken)

    def settled(self, quantity: str, settle: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times (n,) and values (n,) of a quantity from `settle` (s) after the first sample on; all where none is so late."""
        times, values = np.array(self.times), np.array([getattr(one, quantity) for one in self.samples], float)
        later = times - times[0] >= settle
        return (times[later], values[later]) if later.any() else (times, values)

    def growth(self, settle: float) -> float:
        """Median of the memory (MiB) over the last minute less that over the first after `settle` (s)."""
        times, values = self.settled('resident', settle)
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

    def faults(self, settle: float, most_growth: float, end: float) -> list[str]:
        """What did not stay as it was; empty for a steady process.

        Parameters:
            settle (s): samples of this time after the first are left out.
            most_growth (MiB): largest growth of the resident memory.
            end (s): of the run.
        """
        found = []
        if self.times[-1] < end - DYING_S:
            found.append(f'ended after {self.times[-1]:.0f} s')
        if self.times[0] > settle:
            found.append(f'started after {self.times[0]:.0f} s')
        if (grown := self.growth(settle)) > most_growth:
            found.append(f'grew by {grown:.1f} MiB')
        for quantity in ('threads', 'descriptors'):
            low, high = self.span(quantity, settle)
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
        place = urlsplit(address)
        direct = socket.create_connection((place.hostname, place.port or 80))    # a proxy would not find this machine's page
        with connect(address, sock=direct, max_size=None) as connection:
            connection.send('{"do": "next"}')
            for message in connection:
                if isinstance(message, str) and message.startswith('{"type":"state"'):
                    self.updates, self._newest = self.updates + 1, time.monotonic()
                    connection.send('{"do": "next"}')


def watch(rig: MarkedProcesses, seconds: float) -> list[ProcessHistory]:
    """Sample all processes of a program until it ends, or for some time; returns a history of each process.

    Parameters:
        rig: the program.
        seconds (s): length of the run at most.
    """
    histories: dict[int, ProcessHistory] = {}
    begun = time.monotonic()
    while rig.process.poll() is None and (now := time.monotonic() - begun) < seconds:
        for process_id, name in rig.alive().items():
            taken = sample(process_id)
            if taken is not None:
                histories.setdefault(process_id, ProcessHistory(name)).add(now, taken)
        time.sleep(max(0.0, begun + now + EVERY_S - time.monotonic()))
    return lasting(list(histories.values()))


def lasting(histories: Sequence[ProcessHistory]) -> list[ProcessHistory]:
    """Histories by name, without those of a few samples: a shell that starts another program."""
    return sorted((history for history in histories if history.times[-1] - history.times[0] > 2.0 * EVERY_S),
                  key=lambda history: history.name)


def format_histories(histories: Sequence[ProcessHistory], settle: float, most_growth: float, end: float) -> str:
    """A table with a row for each process: resident memory after settling, growth, threads, descriptors and verdict.

    Parameters:
        histories: of the processes.
        settle (s), most_growth (MiB), end (s): see `ProcessHistory.faults`.
    """
    lines = [f'{"process":<22}{"MiB":>10}{"growth":>9}{"threads":>9}{"files":>8}   verdict']
    for one in histories:
        first = float(np.median(one.settled('resident', settle)[1][:5]))
        counts = ['-'.join(map(str, sorted({*one.span(name, settle)}))) for name in ('threads', 'descriptors')]
        verdict = ', '.join(one.faults(settle, most_growth, end)) or 'holds'
        grown = one.growth(settle)
        lines.append(f'{one.name[:21]:<22}{first:10.1f}{grown:+9.2f}{counts[0]:>9}{counts[1]:>8}   {verdict}')
    return '\n'.join(lines)


def sound_faults(recording: Path) -> list[str]:
    """What is wrong with the sound of a recording, by what the bridge says at last of LOSSES; nothing without a bridge."""
    counts: dict[str, str] = {}
    try:
        with Bag(recording) as bag:
            for topic, _, data in bag.messages(['/diagnostics']):
                for status in bag.decode(topic, data).status:
                    if 'bridge_node' in status.name:
                        counts = {value.key: value.value for value in status.values}
    except (ValueError, OSError) as error:
        return [f'the recording cannot be read: {error}']
    lost = {name: int(counts[name]) for name in LOSSES if int(counts.get(name, 0))}
    return [f'sound lost on the way to the bridge: {lost}'] if lost else []


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the rig and print the table; returns 0 where all processes stay as they are, 1 where not, 2 where the rig ends."""
    parser = argparse.ArgumentParser(prog='soak', description=__doc__)
    parser.add_argument('rig', nargs='*', default=list(RIG), metavar='NAME:=VALUE',
                        help=f'arguments of rig.launch.py (default: {" ".join(RIG)})')
    parser.add_argument('--minutes', type=positive, default=60.0, help='length of the run (%(default)s)')
    parser.add_argument('--settle', type=positive, default=5.0,
                        help='minutes at the start that do not count, at most half of the run (%(default)s)')
    parser.add_argument('--most-growth', type=positive, default=5.0, help="limit of a process' growth in MiB (%(default)s)")
    parser.add_argument('--out', type=Path, help="folder for table, the rig's output and the monitor's files")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ExitStack() as opened:
        bags = opened.enter_context(tempfile.TemporaryDirectory(prefix='soak_'))
        out = options.out or Path(bags)
        out.mkdir(parents=True, exist_ok=True)
        log = opened.enter_context((out / 'rig.log').open('wb'))
        given = [f'record:={bags}/soak.mcap', f'out:={out}', *options.rig]
        viewer = PageViewer(out / 'rig.log') if 'view:=true' in given else None
        try:
            with launched_rig(given, log) as rig:
                histories = watch(rig, 60.0 * options.minutes)
                ended_early = rig.process.poll() is not None
                blank = viewer is not None and viewer.waits
        except KeyboardInterrupt:
            print('soak: interrupted', file=sys.stderr)
            return 2
        if ended_early:
            output = (out / 'rig.log').read_text(errors='replace').splitlines()[-20:]
            print('soak: the rig ended before its time:', *output, sep='\n', file=sys.stderr)
            if not histories:
                return 2
        faults = sound_faults(Path(bags) / 'soak.mcap')
        if viewer is not None:
            print(f'{viewer.updates} updates of the page')
            faults += ['the page showed nothing at the end'] if blank else []
        return _report(histories, faults, options) or 2 * ended_early


def _report(histories: Sequence[ProcessHistory], faults: Sequence[str], options: argparse.Namespace) -> int:
    settle, most_growth = min(60.0 * options.settle, 30.0 * options.minutes), options.most_growth
    end = max([history.times[-1] for history in histories], default=0.0)
    steady = bool(histories) and not any(history.faults(settle, most_growth, end) for history in histories)
    table = format_histories(histories, settle, most_growth, end)
    text = (f'{table}\n{end / 60.0:.1f} min, the first {settle / 60.0:g} not counted, '
            f'growth at most {most_growth:g} MiB, counts constant: {"holds" if steady else "MISSED"}\n'
            f'{"; ".join(faults) or "no sound lost on the way to the bridge"}')
    print(text)
    if options.out:
        (options.out / 'soak.txt').write_text(f'{text}\n')
    return 0 if steady and not faults else 1
