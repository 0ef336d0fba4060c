"""What the page of a running rig costs: `ros2 run av_view benchmark`.

Prints the processor time of view_node without viewers and with some, and what each viewer gets.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from urllib.parse import urlsplit

import psutil
from websockets.asyncio.client import connect

SETTLE_S = 3.0
ENDED_S = 25.0  # until the node has ended its subscriptions: its parameter `linger`, and some


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
            if isinstance(message, str) and json.loads(message)['type'] == 'end':
                updates += counted
                await feed.send('{"do": "next"}')
    counts.append((updates, pictures, size))


async def measure(address: str, process: psutil.Process, viewers: int, seconds: float) -> str:
    """A row of the table: share of a core, and per viewer updates and pictures a second, and kB/s."""
    counts: list[tuple[int, int, int]] = []
    watching = asyncio.gather(*(watch(address, seconds, counts) for _ in range(viewers)))
    await asyncio.sleep(SETTLE_S)
    before = sum(process.cpu_times()[:2])
    await asyncio.sleep(seconds)
    share = (sum(process.cpu_times()[:2]) - before) / seconds
    await watching
    means = [sum(column) / (viewers * seconds) for column in zip(*counts, strict=True)] if counts else [0.0, 0.0, 0.0]
    return f'{viewers:7d}  {100.0 * share:15.1f}  {means[0]:9.1f}  {means[1]:10.1f}  {1e-3 * means[2]:6.0f}'


def process_at(port: int) -> psutil.Process | None:
    """The process of this machine that listens at a TCP port."""
    found = [connection.pid for connection in psutil.net_connections('tcp')
             if connection.status == psutil.CONN_LISTEN and connection.laddr.port == port and connection.pid]
    return psutil.Process(found[0]) if found else None


def main() -> None:
    """Print the table. Exits with 1 and a line where no page is served."""
    parser = argparse.ArgumentParser(prog='benchmark', description=__doc__)
    parser.add_argument('--address', default='http://127.0.0.1:8780/', help='address of the page')
    parser.add_argument('--viewers', type=int, nargs='+', default=[0, 1, 10, 200], help='numbers of viewers')
    parser.add_argument('--seconds', type=float, default=10.0, help='to measure each')
    options = parser.parse_args()
    process = process_at(urlsplit(options.address).port or 80)
    if process is None:
        sys.exit(f'benchmark: no page is served at {options.address}: start a rig with view:=true')
    print('viewers  % of one core  updates/s  pictures/s    kB/s')
    watched = False
    for viewers in options.viewers:
        if watched and not viewers:
            time.sleep(ENDED_S)
        watched = viewers > 0
        print(asyncio.run(measure(options.address, process, viewers, options.seconds)), flush=True)
