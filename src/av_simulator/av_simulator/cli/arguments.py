"""Command line arguments of the simulators, and the world that they describe."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from av_common.arguments import checked, not_negative, whole, within
from av_sim_bridge.wire.ports import Ports
from av_simulator.config_files import find_config
from av_simulator.run import open_world
from av_simulator.scenario import load_scenario
from av_simulator.sound.source_signals import RecordedSignal
from av_simulator.trajectories import Static
from av_simulator.world import World

_PORTS = vars(Ports()).values()
port_offset = within(1 - min(_PORTS), 65_535 - max(_PORTS), whole=True)    # with which every port is one


def finite(text: str) -> float:
    """A finite number."""
    return checked(text, math.isfinite, 'a finite number')


def parser_of(program: str, description: str | None) -> argparse.ArgumentParser:
    """A parser of what every simulator has.

    Parameters:
        program: name of the program.
        description: what it does.
    """
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument('scenario', help='name of a shipped scenario, or a YAML file')
    parser.add_argument('--rig', default='', help="rig description (default: the scenario's, else the shipped config/rig.yaml)")
    parser.add_argument('--seed', type=whole, help="seed (default: the scenario's)")
    parser.add_argument('--drone-recording', metavar='FILE', help='sound file that every drone emits')
    parser.add_argument('--image-rate', type=not_negative, default=15.0,
                        help='images a second, 0 for none (default: %(default)s)')
    return parser


def world_of(options: argparse.Namespace, at: tuple[float, float, float, float] | None = None) -> World:
    """The world that the options describe. Raises ValueError or OSError for unreadable files.

    Parameters:
        options: what `parser_of` has parsed.
        at: position (m, ENU) and yaw (deg) of the rig in place of the scenario's.
    """
    scenario = load_scenario(find_config(options.scenario, 'scenarios'))
    if options.drone_recording:
        signal = RecordedSignal(options.drone_recording)
        scenario = replace(scenario, targets=tuple(replace(target, signal=signal) for target in scenario.targets))
    if at:
        scenario = replace(scenario, rig=replace(scenario.rig, trajectory=Static(at[:3]), yaw_deg=at[3]))
    return open_world(scenario, options.rig, options.seed)
