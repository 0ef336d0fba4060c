"""What the page of a running rig costs, and whether the rig notices: `ros2 run av_evaluation page_cost`.

Prints the processor time of view_node without viewers and with some, what each viewer gets, and beside it the rig's delay from
a measurement to the arrival of its bearing. The numbers of viewers take turns, `--rounds` times. With `--launch ARGUMENTS` it
starts and ends the rig itself, and prints when the page was up.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import threading
import time
from contextlib import ExitStack
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np
import psutil
import rclpy
from websockets.asyncio.client import connect

from av_common.qos import RESULT
from av_common.stamps import to_seconds
from av_evaluation.processes import launched_rig
from av_interfaces.msg import Bearing

SETTLE_S = 3.0
START_S = 120.0  # for which a launched rig may start
ENDED_S = 25.0  # until the node has ended its subscriptions: its parameter `linger`, and some


class Delays:
    """The delays (s) from the capture of each new measurement to the arrival of its bearing, in a thread of its own.

    Parameters:
        topic: the bearing's.
    """

    def __init__(self, topic: str) -> None:
        rclpy.init(args=[])
        self._node = rclpy.create_node('view_benchmark')
        self._node.create_subscription(Bearing, topic, self._on_bearing, RESULT)
        self._measured = 0.0
        self.values: list[float] = []
        threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()

    def _on_bearing(self, message: Bearing) -> None:
        measured = to_seconds(message.measured)
        if message.state != Bearing.STATE_NONE and measured > self._measured:
            self.values.append(time.time() - measured)
        self._measured = measured


class Phase(NamedTuple):
    """What was measured for some seconds with a number of viewers.

    Parameters:
        share: of a core that view_node used.
        updates, pictures (1/s), size (bytes/s): what one viewer got.
        delays (s): of the rig's bearings.
    """

    share: float
    updates: float
    pictures: float
    size: float
    delays: list[float]


async def watch(address: str, seconds: float, counts: list[tuple[int, int, int]]) -> None:
    """Be a viewer that always asks for the next update; adds the number of updates, pictures and bytes to `counts`."""
    updates = pictures = size = 0
    begin = time.monotonic()
    async with connect(f'ws://{urlsplit(address).netloc}/feed', max_size=None, proxy=None) as feed:
        await feed.send('{"do": "watch"}')
        while time.monotonic() - begin < SETTLE_S + seconds:
            message = await feed.recv()
            counted = time.monotonic() - begin >= SETTLE_S
            size += counted * len(message)
            pictures += counted * isinstance(message, bytes)
            if isinstance(message, str) and json.loads(message)['type'] == 'state':
                updates += counted
                await feed.send('{"do": "next"}')
    counts.append((updates, pictures, size))


async def measure(address: str, process: psutil.Process, viewers: int, seconds: float, delays: Delays) -> Phase:
    """What `viewers` viewers cost and get within some seconds, and the rig's delays meanwhile."""
    counts: list[tuple[int, int, int]] = []
    watching = asyncio.gather(*(watch(address, seconds, counts) for _ in range(viewers)))
    await asyncio.sleep(SETTLE_S)
    before = sum(process.cpu_times()[:2])
    delays.values.clear()
    await asyncio.sleep(seconds)
    share, found = (sum(process.cpu_times()[:2]) - before) / seconds, list(delays.values)
    await watching
    updates, pictures, size = (sum(column) / max(viewers * seconds, 1.0) for column in zip((0, 0, 0), *counts, strict=True))
    return Phase(share, updates, pictures, size, found)


def row(viewers: int, phases: list[Phase]) -> str:
    """A row of the table: means of the phases, quantiles of all delays in ms, and the range of the phases' medians."""
    delays = 1000.0 * np.array([delay for phase in phases for delay in phase.delays] or [np.nan])
    medians = [1000.0 * float(np.median(phase.delays or [np.nan])) for phase in phases]
    share, updates, pictures, size = (float(np.mean([phase[column] for phase in phases])) for column in range(4))
    median, late = np.quantile(delays, (0.5, 0.95))
    return (f'{viewers:7d}  {100.0 * share:15.1f}  {updates:9.1f}  {pictures:10.1f}  {1e-3 * size:6.0f}  '
            f'{median:9.0f}  {min(medians):4.0f} to {max(medians):4.0f}  {late:7.0f}  {len(delays):8d}')


def process_at(port: int) -> psutil.Process | None:
    """The process of this machine that listens at a TCP port."""
    found = [connection.pid for connection in psutil.net_connections('tcp')
             if connection.status == psutil.CONN_LISTEN and connection.laddr.port == port and connection.pid]
    return psutil.Process(found[0]) if found else None


def measure_all(options: argparse.Namespace, process: psutil.Process) -> dict[int, list[Phase]]:
    """The phases by number of viewers, which take turns.

    Parameters:
        options: of the command line.
        process: that of view_node.
    """
    delays = Delays(f'{options.rig}/target/bearing')
    phases: dict[int, list[Phase]] = {viewers: [] for viewers in options.viewers}
    watched = False
    for _ in range(options.rounds):
        for viewers in options.viewers:
            if watched and not viewers:
                time.sleep(ENDED_S)
            watched = viewers > 0
            phases[viewers].append(asyncio.run(measure(options.address, process, viewers, options.seconds, delays)))
    return phases


def main() -> None:
    """Print the table. Exits with 1 and a line where no page is served."""
    parser = argparse.ArgumentParser(prog='page_cost', description=__doc__)
    parser.add_argument('--address', default='http://127.0.0.1:8780/', help='address of the page')
    parser.add_argument('--viewers', type=int, nargs='+', default=[0, 1, 10, 200], help='numbers of viewers')
    parser.add_argument('--seconds', type=float, default=10.0, help='to measure each')
    parser.add_argument('--rounds', type=int, default=1, help='how often the numbers of viewers take turns')
    parser.add_argument('--launch', nargs='*', metavar='ARGUMENT', help='start a rig with these arguments of rig.launch.py')
    parser.add_argument('--rig', default='', help='namespace of the rig, such as /left')
    options = parser.parse_args()
    with ExitStack() as stack:
        port, begun, launched = urlsplit(options.address).port or 80, time.monotonic(), options.launch is not None
        if launched:
            rig = stack.enter_context(launched_rig(['view:=true', *options.launch]))
            while process_at(port) is None and rig.process.poll() is None and time.monotonic() - begun < START_S:
                time.sleep(0.05)
        process, after = process_at(port), time.monotonic() - begun
        if process is None:
            sys.exit(f'page_cost: no page is served at {options.address}: start a rig with view:=true')
        if launched:
            own, spent = time.time() - process.create_time(), sum(process.cpu_times()[:2])
            print(f'the page was up {after:.1f} s after the launch, {own:.1f} s after its process began, by {spent:.1f} s of a '
                  'processor', flush=True)
            time.sleep(SETTLE_S)
        phases = measure_all(options, process)
    print('viewers  % of one core  updates/s  pictures/s    kB/s  delay, ms     by rounds     95 %  bearings')
    for viewers, found in phases.items():
        print(row(viewers, found))
