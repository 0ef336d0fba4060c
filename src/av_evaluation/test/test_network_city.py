"""Cells of a city: which rigs reach them, and names that last across borders."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import Header

from av_common.stamps import to_stamp
from av_evaluation.cli.city import _take
from av_evaluation.network.city import NAMES, TRACKS, Cell, Grid, Names, World, all_cells
from av_interfaces.msg import RigReport, WorldTrack, WorldTrackArray

GRID = Grid(2, 100.0, 100.0)


@pytest.mark.parametrize('seed', range(3))
def test_reports_go_to_all_cells_that_a_rig_reaches(seed):
    """Of places within reach of a rig, each is in a cell that takes the rig's reports."""
    grid, random = Grid(4, 200.0, 80.0), np.random.default_rng(seed)
    cells = all_cells(grid, 0, 1)
    for _ in range(200):
        rig, offset = random.uniform(0.0, 800.0, 2), random.normal(size=2)
        target = grid.cell_of(np.clip(rig + 79.9 * offset / np.linalg.norm(offset), 0.0, 799.9))
        x, y = map(int, grid.report_key('rig', rig).split('/')[2:4])
        assert (x, y) in (target, *grid.neighbours(target))
    assert len(cells) == 16 and sorted(all_cells(grid, 0, 2)) + sorted(all_cells(grid, 1, 2)) == sorted(cells)


def test_drones_keep_their_names_across_borders():
    """2 x 2 cells and 14 rigs that no list names; each drone has one track at a time, and no name changes."""
    world, names = World(GRID, 14, 2, 3), Names(GRID, 2)
    cells = {place: Cell(place, GRID) for place in all_cells(GRID, 0, 1)}
    for step in range(60):
        time = 0.25 * step
        for rig in range(len(world.places)):
            message = world.report(rig, time + 0.01 * rig, 1000.0)
            for cell in cells.values():    # each is the neighbour of the others
                cell.on_report(f'rig{rig}', message, 1000.0 + time + 0.1)
        for cell in cells.values():
            message = cell.output(1000.0 + time + 0.2)
            for other in GRID.neighbours(cell.place):
                cells[other].on_tracks(message, 1000.0 + time + 0.2)
            for one in message.tracks:
                names.take(one.id, time + 0.2, np.array([one.position.x, one.position.y, one.position.z]),
                           np.array([one.velocity.x, one.velocity.y, one.velocity.z]))
        if time > 4.0:
            names.look(time + 0.2, world.drones(time + 0.2))
    assert names.borders >= 2 and names.changes == 0
    assert names.found > 0.95 * names.looks and names.twice < 0.05 * names.looks


@pytest.mark.parametrize(('place', 'late'), [(np.nan, 0.1), (-1e30, 0.1), (0.0, -0.3), (0.0, 2.5), (0.0, -1e9)])
def test_a_report_without_a_place_or_of_another_time_is_refused(place, late):
    """Nothing of it is left: one from the future would make all others' reports late."""
    cell, message = Cell((0, 0), GRID), World(GRID, 14, 2, 3).report(0, 0.0, 1000.0)
    message.position[1] = place or message.position[1]
    with pytest.raises(ValueError, match=r'rig is at|stamp of rig'):
        cell.on_report('rig', message, 1000.0 + late)
    assert not cell.tracker.rigs
    with pytest.raises(ValueError, match='rig reports by version 0'):
        cell.on_report('rig', RigReport(), 0.0)


def test_a_message_without_content_is_refused():
    """The middleware reads beyond its end, and ends the process."""
    counts = Counter()
    _take(SimpleNamespace(payload=SimpleNamespace(to_bytes=bytes), key_expr=f'{TRACKS}/0/0'), [], counts, [])
    assert counts['refused'] == 1


def neighbours_track(**values):
    """A track as a cell publishes it, but for some values."""
    track = WorldTrack(id=2 * NAMES + 7, existence=0.9, positioned=True, position=Point(x=60.0, y=50.0, z=40.0),
                       velocity=Vector3(x=12.0))
    for name, value in values.items():
        setattr(track, name, value)
    return track


@pytest.mark.parametrize('values', [
    {'position': Point(x=np.nan)}, {'position': Point(z=np.inf)}, {'position': Point(y=-3e7)}, {'velocity': Vector3(y=np.nan)},
    {'velocity': Vector3(x=-4e3)}, {'positioned': False}, {'id': 0}, {'id': 4 * NAMES}], ids=lambda values: '-'.join(values))
def test_a_track_that_no_cell_publishes_is_refused(values):
    """With the whole message, and what was known stays."""
    cell = Cell((0, 0), GRID)
    cell.on_tracks(message_of(neighbours_track()), 1000.1)
    with pytest.raises(ValueError, match="a neighbour's track"):
        cell.on_tracks(message_of(neighbours_track(id=9), neighbours_track(**values)), 1000.1)
    assert list(cell._foreign) == [2 * NAMES + 7]


def message_of(*tracks, stamp=1000.0):
    return WorldTrackArray(header=Header(stamp=to_stamp(stamp)), tracks=list(tracks))


def test_tracks_of_another_time_or_without_number_are_refused():
    """A name from the future would last for ever; floods of names do not fill the memory."""
    cell, known = Cell((0, 0), GRID), message_of(neighbours_track())
    for late in (-0.5, -1e8, 3.0):
        with pytest.raises(ValueError, match='stamp of a neighbour'):
            cell.on_tracks(known, 1000.0 + late)
    cell.on_tracks(known, 1000.0)
    cell.on_tracks(message_of(neighbours_track(position=Point(x=1.0)), stamp=999.0), 1000.0)
    assert cell._foreign[2 * NAMES + 7].position[0] == 60.0, 'an older message does not replace a newer one'
    with pytest.raises(ValueError, match='more than 100 targets'):
        cell.on_tracks(message_of(*(neighbours_track(id=number) for number in range(1, 200))), 1000.0)
    for first in range(1, 3000, 100):
        with suppress(ValueError):
            cell.on_tracks(message_of(*(neighbours_track(id=number) for number in range(first, first + 100))), 1000.0)
    assert len(cell._foreign) <= 800


def command(**given):
    """A city of 12 rigs and 4 cells, by a router of its own."""
    pytest.importorskip('zenoh', reason='needs eclipse-zenoh')
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    given |= {'rigs': 12, 'cells': 2, 'size': 100, 'reach': 100, 'drones': 1, 'processes': 1, 'router': f'tcp/127.0.0.1:{port}'}
    return [sys.executable, '-m', 'av_evaluation.cli.city', *(f'--{key}={each}' for key, each in given.items())]


@pytest.mark.system
def test_a_process_that_dies_ends_the_command_with_a_line():
    """Killed as for lack of memory, long before the end; nothing is waited for, and there is no traceback."""
    with subprocess.Popen(command(duration=600), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as city:
        try:
            begun, cells = time.monotonic(), None
            while cells is None or time.monotonic() < begun + 5.0:
                assert city.poll() is None and time.monotonic() < begun + 60.0
                children = [each for each in psutil.Process(city.pid).children() if 'spawn_main' in ' '.join(each.cmdline())]
                cells = max(children, key=lambda each: each.pid) if len(children) == 3 else None    # after router and rigs
                time.sleep(0.1)
            cells.kill()
            errors = city.communicate(timeout=60.0)[1]
        finally:
            city.kill()
    assert city.returncode == 1 and 'a process has ended before its time' in errors and 'Traceback' not in errors


@pytest.mark.system
def test_the_command_prints_what_crosses_a_router_that_dies():
    """12 rigs and 4 cells as processes; the router is dead from 1 to 1.2 s. Every report is sent, most of them arrive."""
    done = subprocess.run(command(duration=2, outage=0.2), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (0, 1), done.stderr
    sent, received = (float(re.search(pattern, done.stdout, re.M)[1])
                      for pattern in (r'^rigs +([\d.]+)', r'^cells 1(?: +[\d.]+){2} +([\d.]+)'))
    assert sent == 48.0 and received > 10.0
