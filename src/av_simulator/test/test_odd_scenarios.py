"""Scenarios with a value replaced by an extreme or a wrong one: refused with the key, or simulated to finite sound."""

from __future__ import annotations

import dataclasses
import math
import os
import random
import resource
import time
import typing
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml

from av_common.config_reader import ConfigError, read
from av_common.rig import load_rig
from av_simulator import Scenario, World, find_config, load_scenario

SCENARIOS = sorted(find_config('circle', 'scenarios').parent.glob('*.yaml'))
WRONG = [1e300, -1e300, math.inf, math.nan, 10**400, 'text', '', None, True, {}, [], [[]], {'kind': 'static'}, b'\0']
EXTREME = [0, -1, 1e-9, -1e-9, 1e-300, 1.0, 2, 3, 20, 1e3, 1e4, 1e6, -1e6]
SOME = int(os.environ.get('ODD_SCENARIOS', '60'))
SEVERAL = {  # what no shipped scenario has
    'noise': {'wind': {}, 'snr': {'ratio_db': 10.0}, 'urban_db_spl': 50.0, 'diffuse_db_spl': 40.0},
    'ground': {'flow_resistivity': 2e5}, 'reverberation': [{'minimum': [-9, -9, 0], 'maximum': [9, 9, 5], 'gain_db': 3.0}],
    'obstacles': [{'kind': 'box', 'center': [3, 4, 1], 'size': [1, 1, 2]}, {'kind': 'trunk', 'center': [5, 5]}],
    'weather': {'smoke': [{'position': [3, 3, 2]}], 'fog': [[0, 0.1], [5, 0.2]], 'rain_mm_h': 2.0},
    'targets': [{'trajectory': trajectory, 'signal': signal} for trajectory, signal in zip([
        {'kind': 'line', 'position': [9, 0, 5], 'velocity': [1, 0, 0]},
        {'kind': 'circle', 'center': [0, 0, 5]},
        {'kind': 'figure_eight', 'center': [0, 0, 5]},
        {'kind': 'waypoints', 'points': [[0, 9, 9, 9], [5, 9, 8, 9]]},
        {'kind': 'steps', 'center': [0, 0, 2]},
        {'kind': 'random', 'center': [0, 0, 9]}], [{'kind': 'rotor'}, {'kind': 'tone'}] * 3, strict=True)],
}


def written_out(value, hint):
    """A read scenario as YAML, with all defaults."""
    if typing.get_origin(hint) is typing.Annotated:
        kind = next((name for name, cls in typing.get_args(hint)[1].items() if type(value) is cls), None)
        return value if kind is None else {'kind': kind, **written_out(value, type(value))}
    if dataclasses.is_dataclass(value):
        hints = typing.get_type_hints(type(value), include_extras=True)
        found = {name: written_out(getattr(value, name), hints[name]) for name in hints}
        return {name: each for name, each in found.items() if each is not None}
    if isinstance(value, (tuple, list)):
        inner = typing.get_args(hint)
        return [written_out(each, inner[0] if inner else type(each)) for each in value]
    return str(value) if isinstance(value, Path) else value


def leaves(content, path=()):
    """Paths of all values."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from leaves(value, (*path, key))


def replaced(content, path, value):
    """A copy with another value at a path."""
    if not path:
        return value
    copy = content.copy()
    copy[path[0]] = replaced(content[path[0]], path[1:], value)
    return copy


def key_of(path):
    text = ''.join(f'[{part}]' if isinstance(part, int) else f'.{part}' for part in path)
    return text.lstrip('.')


def contents():
    for file in SCENARIOS:
        yield written_out(load_scenario(file), Scenario)
    whole = {**yaml.safe_load(SCENARIOS[0].read_text()), **SEVERAL}
    yield written_out(read(Scenario, whole, folder=SCENARIOS[0].parent), Scenario)


@pytest.fixture(scope='module')
def cases():
    return [(content, path) for content in contents() for path in leaves(content)]


def test_wrong_values_are_refused_with_their_key(cases):
    random.seed(1)
    for content, path in random.sample(cases, min(10 * SOME, len(cases))):
        value = random.choice(WRONG)
        try:
            read(Scenario, replaced(content, path, value))
        except ConfigError as error:
            text = str(error)
            assert '\n' not in text and len(text) < 600, text
            # The key, one above it, or the class that checks several together.
            assert any(key_of(path[:end]) in text for end in (len(path), len(path) - 1, 1)), (path, value, text)
        else:
            allowed = (None, True, '', 'text', b'\0') if value is not math.inf else ()
            assert value in allowed or isinstance(value, (dict, list)) or path[-1] == 'seed', (path, value)


def test_extreme_values_are_refused_or_simulated(cases):
    random.seed(2)
    rig = load_rig(find_config('rig'))
    warnings.simplefilter('ignore')
    for content, path in random.sample(cases, min(SOME, len(cases))):
        value = random.choice(EXTREME)
        began, held = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            scenario = read(Scenario, replaced(content, path, value))
            world = World(scenario, rig)
        except (ConfigError, ValueError, OSError):
            spent = time.process_time() - began
        else:
            spent = time.process_time() - began
            assert np.isfinite(world.advance(1600)).all(), (path, value)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held) / 1024
        assert spent < 2.0, (path, value, spent)
        assert grown < 300.0, (path, value, grown)
