"""ros2 run av_evaluation city: a city of cells on this machine, over Zenoh, with simulated rigs; prints what it costs.

Each cell takes the reports of the rigs that reach it, and hands tracks over to its neighbours. No list names the rigs. Halfway
the router is killed, and started again after --outage. Needs eclipse-zenoh.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import multiprocessing.synchronize
import queue
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message

from av_common.arguments import not_negative, positive, whole, within
from av_common.guarded_node import decode
from av_common.stamps import to_seconds
from av_evaluation.network.city import REPORTS, TRACKS, Cell, Grid, Names, World, all_cells
from av_interfaces.msg import RigReport, WorldTrackArray

RATE_HZ, OUTPUT_HZ, STEP_S = 4.0, 4.0, 0.05  # of reports and of tracks; of the loops
QUIET = bytes(serialize_message(RigReport(version=RigReport.VERSION)))  # a report without directions
READY_S, GRACE_S = 60.0, 5.0  # for the processes to begin, and to end
MOST_WAITING = 1000  # messages of one key, of which the oldest are lost then
COUNTS = ('sent', 'sent bytes', 'received', 'received bytes')
DIED = 'city: a process has ended before its time, or says nothing'
COVERED, LATE_S = 0.9, 0.5  # what is asked for: drones with a track, and age of 95 % of the reports


class Traffic(NamedTuple):
    """What one process did: its name, counts of messages and bytes by COUNTS, processor time (s), and delays (s) of reports."""

    name: str
    counts: Counter[str]
    cpu: float
    delays: Sequence[float] = ()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the city; returns 1 where names, tracks or processes are lost or reports are late, 2 where Zenoh is missing."""
    options = _options(arguments)
    try:
        import zenoh  # noqa: F401 - an option
    except ImportError as error:
        print(f'city: needs the Python package eclipse-zenoh: pip install eclipse-zenoh ({error})', file=sys.stderr)
        return 2
    context = multiprocessing.get_context('spawn')
    stop, results = context.Event(), context.Queue()
    ready, begin = context.Semaphore(0), context.Value('d', 0.0)
    router = _started(context, _router, options)
    others = [_started(context, _rigs, options, ready, begin, stop, results)]
    others += [_started(context, _cells, options, share, ready, stop, results) for share in range(options.processes)]
    try:
        waiting, end = len(others), time.monotonic() + READY_S
        while waiting and time.monotonic() < end and not _died([router, *others]):
            waiting -= ready.acquire(timeout=STEP_S)
        if waiting:
            print(DIED if _died(others) else f'city: no router at {options.router}: is the port in use? Another one: '
                  '--router tcp/127.0.0.1:PORT', file=sys.stderr)
            return 1
        begin.value = time.time() + 0.5
        names, outage = _watch(options, begin.value, others, lambda: _started(context, _router, options), router)
    finally:
        stop.set()
    found = _told(results, others, GRACE_S + options.duration)
    for each in others:
        each.join(GRACE_S)
    outage.kill()
    if len(found) < len(others):
        print(DIED, file=sys.stderr)
        return 1
    return 0 if _report(options, found, names) else 1


def _died(processes: Iterable[Any]) -> bool:
    """Whether one of some processes has failed, or was killed."""
    return any(each.exitcode for each in processes)


def _told(results: Any, others: Sequence[Any], seconds: float) -> list[Traffic]:
    """What processes tell at their end, within a time (s) at most; nothing comes from those that died."""
    found, end = list[Traffic](), time.monotonic() + seconds
    while len(found) < sum(not each.exitcode for each in others) and time.monotonic() < end:
        with suppress(queue.Empty):
            found.append(results.get(timeout=STEP_S))
    return found


def _watch(options: argparse.Namespace, begin: float, others: Sequence[Any], again: Callable[[], Any], router: Any
           ) -> tuple[Names, Any]:
    """Compare all tracks with the drones until the end, or until one of the other processes dies; kill the router halfway.

    Returns the names and the last router.
    """
    grid, lock = _grid(options), threading.Lock()
    names, world = Names(grid, options.drones), World(grid, options.rigs, options.drones, options.seed)

    def take(sample: Any) -> None:
        message = decode(WorldTrackArray, sample.payload.to_bytes())
        with lock:
            for one in message.tracks:
                place, speed = ([part.x, part.y, part.z] for part in (one.position, one.velocity))
                names.take(one.id, to_seconds(message.header.stamp) - begin, np.array(place), np.array(speed))

    with _session(options) as session:
        subscription = session.declare_subscriber(f'{TRACKS}/**', take)
        middle = begin + 0.5 * options.duration
        switches = [middle, middle + options.outage] if options.outage else []
        settled = begin + min(5.0, 0.25 * options.duration)  # from which drones should have tracks
        while (now := time.time()) < begin + options.duration and not _died(others):
            if switches and now > switches[0]:
                router.kill()
                del switches[0]
                if not switches:
                    router = again()
            if now > settled:
                with lock:
                    names.look(now - begin, world.drones(now - begin))
            time.sleep(0.25)
        subscription.undeclare()
    return names, router


def _rigs(options: argparse.Namespace, ready: Any, told: Any, stop: multiprocessing.synchronize.Event, results: Any) -> None:
    """All rigs: each reports at its own moments."""
    grid = _grid(options)
    world = World(grid, options.rigs, options.drones, options.seed)
    keys = [grid.report_key(f'rig{index + 1}', place) for index, place in enumerate(world.places)]
    counts = Counter[str]()
    with _session(options) as session:
        ready.release()
        while not told.value and not stop.wait(STEP_S):
            pass
        begin = told.value
        for number in range(int(options.duration * RATE_HZ) * options.rigs):
            due = number / (RATE_HZ * options.rigs)
            if (early := begin + due - time.time()) > 0.0:
                if stop.wait(early if early > STEP_S else 0.0):
                    break
                time.sleep(max(begin + due - time.time(), 0.0))
            rig = number % options.rigs
            data = bytes(serialize_message(world.report(rig, due, begin))) if world.is_near(rig, due) else QUIET
            session.put(keys[rig], data)
            counts.update({'sent': 1, 'sent bytes': len(data)})
        stop.wait(GRACE_S)
    results.put(Traffic('rigs', counts, time.process_time()))


def _cells(options: argparse.Namespace, share: int, ready: Any, stop: multiprocessing.synchronize.Event, results: Any) -> None:
    """The cells of one process. One thread takes and tracks, as threads that wait for Python's lock would be late."""
    from zenoh.handlers import RingChannel
    grid = _grid(options)
    cells = [Cell(place, grid) for place in all_cells(grid, share, options.processes)]
    counts, delays = Counter[str](), list[float]()
    to: dict[str, list[Cell]] = {}
    for cell in cells:
        around = grid.neighbours(cell.place)
        for key in [*(f'{REPORTS}/{x}/{y}/*' for x, y in (cell.place, *around)), *(f'{TRACKS}/{x}/{y}' for x, y in around)]:
            to.setdefault(key, []).append(cell)
    with _session(options) as session:
        subscriptions = [(session.declare_subscriber(key, RingChannel(MOST_WAITING)), takers) for key, takers in to.items()]
        ready.release()
        due = time.time()
        while not stop.is_set():
            for subscription, takers in subscriptions:
                while (sample := subscription.try_recv()) is not None:
                    _take(sample, takers, counts, delays)
            if time.time() >= due:
                due = max(due + 1.0 / OUTPUT_HZ, time.time() - 1.0)
                _publish(session, cells, counts)
            time.sleep(min(STEP_S, max(due - time.time(), 0.0)))
    results.put(Traffic(f'cells {share + 1}', counts, time.process_time(), delays))


def _take(sample: Any, takers: Sequence[Cell], counts: Counter[str], delays: list[float]) -> None:
    """Count a message, and give its cells one that is more than a report without directions."""
    data, key = sample.payload.to_bytes(), str(sample.key_expr)
    counts.update({'received': 1, 'received bytes': len(data)})
    try:
        if key.startswith(TRACKS):
            tracks = decode(WorldTrackArray, data)
            for cell in takers:
                cell.on_tracks(tracks, time.time())
        elif len(data) > len(QUIET):
            message = decode(RigReport, data)
            for cell in takers:
                cell.on_report(key.rsplit('/', 1)[1], message, time.time())
            delays.append(time.time() - to_seconds(message.header.stamp))
    except Exception:  # noqa: BLE001 - whatever comes from outside
        counts['refused'] += 1


def _publish(session: Any, cells: Sequence[Cell], counts: Counter[str]) -> None:
    for cell in cells:
        message = cell.output(time.time())
        if message.tracks:
            data = serialize_message(message)
            session.put(f'{TRACKS}/{cell.place[0]}/{cell.place[1]}', data)
            counts.update({'sent': 1, 'sent bytes': len(data)})


def _router(options: argparse.Namespace) -> None:
    import zenoh
    config = zenoh.Config.from_json5(json.dumps({
        'mode': 'router', 'listen': {'endpoints': [options.router]}, 'scouting': {'multicast': {'enabled': False}}}))
    with zenoh.open(config):
        threading.Event().wait()


def _session(options: argparse.Namespace) -> Any:
    """A session with the router, which is waited for, and connected to again."""
    import zenoh
    config = zenoh.Config.from_json5(json.dumps({
        'mode': 'client', 'scouting': {'multicast': {'enabled': False}},
        'connect': {'endpoints': [options.router], 'timeout_ms': -1, 'exit_on_failure': False,
                    'retry': {'period_init_ms': 100, 'period_max_ms': 500, 'period_increase_factor': 2}}}))
    return zenoh.open(config)


def _started(context: Any, target: Callable[..., None], *values: Any) -> Any:
    process = context.Process(target=target, args=values, daemon=True)
    process.start()
    return process


def _grid(options: argparse.Namespace) -> Grid:
    return Grid(options.cells, options.size, options.reach)


def _report(options: argparse.Namespace, found: Sequence[Traffic], names: Names) -> bool:
    """Print the table; returns whether all is as asked."""
    print(f'{options.rigs} rigs, {options.cells**2} cells of {options.size:g} m, {options.drones} drones, '
          f'{options.duration:g} s')
    print(f'{"":<10}{"out/s":>9}{"kB/s":>9}{"in/s":>9}{"kB/s":>9}{"refused":>9}{"core":>8}{"delay median, 95 %, most":>30}')
    late = 0.0
    for each in sorted(found, key=lambda each: each.name):
        rates = [each.counts[name] / options.duration / (1e3 if name.endswith('bytes') else 1.0) for name in COUNTS]
        refused, spread = each.counts['refused'], ''
        if each.delays:
            middle, most95, most = np.quantile(each.delays, [0.5, 0.95, 1.0])
            late, spread = max(late, most95), f'{1e3 * middle:.0f}, {1e3 * most95:.0f}, {1e3 * most:.0f} ms'
        print(f'{each.name:<10}' + ''.join(f'{rate:>9.1f}' for rate in rates)
              + f'{refused:>9}{100.0 * each.cpu / options.duration:>6.0f} %{spread:>30}')
    covered = names.found / max(names.looks, 1)
    print(f'drones with a track {100.0 * covered:.1f} %, with two {100.0 * names.twice / max(names.looks, 1):.1f} %; '
          f'{names.borders} borders crossed, {names.changes} names lost')
    if late > LATE_S:
        print(f'city: reports are {late:.1f} s late: this machine is too slow for so many', file=sys.stderr)
    return covered >= COVERED and names.changes == 0 and late <= LATE_S


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='city', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add('--rigs', type=within(4, 1e6, whole=True), default=1000, help='which report four times a second (%(default)s)')
    add('--cells', type=within(2, 1000, whole=True), default=8, help='along each side (%(default)s)')
    add('--size', type=within(20.0, 1e6), default=200.0, help='m, of a cell (%(default)s)')
    add('--reach', type=positive, default=75.0, help='m, from a rig to the farthest drone that it measures (%(default)s)')
    add('--drones', type=within(1, 1e6, whole=True), default=8, help='which fly across (%(default)s)')
    add('--duration', type=within(2.0, 1e6), default=40.0, help='s (%(default)s)')
    add('--outage', type=not_negative, default=1.0, help='s for which the router is dead, halfway; 0 for never (%(default)s)')
    add('--processes', type=within(1, 1000, whole=True), default=2, help='which share the cells (%(default)s)')
    add('--router', default='tcp/127.0.0.1:7448', help='endpoint of the router (%(default)s)')
    add('--seed', type=whole, default=1, help='of rigs and drones (%(default)s)')
    options = parser.parse_args(arguments)
    if options.reach > options.size:
        parser.error('--reach is up to --size')
    return options


if __name__ == '__main__':
    sys.exit(main())
