"""Runs rigs as hosts of their own: a light rig and a network node in each, parted for a while."""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from av_bringup.security.keystore import make_keystore
from av_bringup.security.policy import read_policy
from av_evaluation.hosts.host_process import HostProcess
from av_evaluation.hosts.light_rig import NODE
from av_evaluation.hosts.pictures import Picture
from av_evaluation.hosts.switch import Medium, Switch, sent_bytes
from av_evaluation.namespaces import Host
from av_evaluation.network import cases
from av_evaluation.network.simulation import NetworkSimulation

QUIET_S = 5.0  # in which the nodes know each other and nobody reports
PATIENCE_S = 300.0  # for which nodes may look for each other
STOPPED_S = 3.0  # between two looks at the processes
START_S = 1.0  # from the word to begin to the first report
HEADING_SIGMA_DEG = 0.1  # of surveyed rigs


@dataclass(frozen=True)
class TrialSettings:
    """Settings of a trial.

    Parameters:
        rigs, drones: their numbers.
        delay (s), loss: of the cable of each host.
        before, partition, after (s): durations; in the partition the first half of the rigs does not hear the others.
        seed: of the simulated reports and of what is lost.
        security: whether all have keys, and a stranger without keys takes part.
        default_dds: whether Cyclone DDS is as it comes, instead of as in config/dds/network.xml.
        from_start: whether frames are late and lost before the nodes know each other, too.
    """

    rigs: int = 4
    drones: int = 3
    delay: float = 0.2
    loss: float = 0.2
    before: float = 15.0
    partition: float = 10.0
    after: float = 15.0
    seed: int = 1
    security: bool = False
    default_dds: bool = False
    from_start: bool = False

    @property
    def parted(self) -> tuple[float, float]:
        """Beginning and end (s) of the partition."""
        return self.before, self.before + self.partition

    @property
    def simulation(self) -> NetworkSimulation:
        """The rigs, their reports and the truth."""
        return cases.square(self.seed, self.rigs, self.drones, self.before + self.partition + self.after)


@dataclass
class Traffic:
    """What a host has sent on the wire: bytes until all nodes knew each other, and bytes a second in each phase since."""

    discovery: int = 0
    rates: dict[str, float] = field(default_factory=dict)


@dataclass
class TrialResult:
    """What came of a trial.

    Parameters:
        discovery (s): time until all nodes knew each other.
        pictures: of each rig's node.
        traffic: of each rig's host.
        stranger: what the stranger heard of each rig and of itself, and the number of those who listened to it; empty without.
        late (s): by which the machine's processes were late, 95 % of the time up to this.
    """

    discovery: float
    pictures: list[list[Picture]]
    traffic: list[Traffic]
    stranger: dict[str, int]
    late: float


class Trial:
    """One run.

    Parameters:
        settings: see `TrialSettings`.
        say: is told what is going on.
    """

    def __init__(self, settings: TrialSettings, say: Callable[[str], None]) -> None:
        self._settings, self._say = settings, say
        self._names = [rig.name for rig in settings.simulation.rigs]
        self._opened, self._processes = ExitStack(), list[HostProcess]()

    def run(self) -> TrialResult:
        """Make the network, run the rigs in it, and take all down again.

        Raises OSError or subprocess.SubprocessError where the machine permits no network, RuntimeError where a process ends or
        the nodes do not find each other.
        """
        with self._opened:
            return self._run()

    def _run(self) -> TrialResult:
        settings, names = self._settings, self._names
        folder = Path(self._opened.enter_context(tempfile.TemporaryDirectory(prefix='network_hosts_')))
        medium = self._make_network()
        self._environment = self._make_environment(folder)
        begun = time.monotonic()
        rigs = [self._start_rig(name, host, folder) for name, host in zip(names, self._hosts, strict=False)]
        self._say(f'{len(rigs)} rigs look for each other')
        self._wait(lambda: all(rig.newest('listeners') == len(rigs) and rig.newest('targets') is not None for rig in rigs),
                   PATIENCE_S, 'the nodes find each other')
        discovery, traffic = time.monotonic() - begun, [Traffic(sent_bytes(name)) for name in names]
        medium.impair(settings.delay, settings.loss)
        self._measure('at rest', QUIET_S, traffic)
        stranger = self._start_stranger(folder) if settings.security else None
        self._wait(lambda: stranger is None or bool(stranger.newest('heard')), PATIENCE_S, 'the stranger hears itself')
        begin = time.time() + START_S
        for rig in rigs:
            rig.write(f'begin {begin:.6f}')
        self._measure('before', START_S + settings.before, traffic)
        half = settings.rigs // 2
        medium.part([[*range(half), settings.rigs], range(half, settings.rigs)])
        self._measure('parted', settings.partition, traffic)
        medium.part(())
        self._measure('healed', settings.after, traffic)
        pictures = [[Picture(each['time'] - begin, each['targets']) for each in rig.values('targets')] for rig in rigs]
        late = [each['late'] for rig in rigs for each in rig.values('late')]
        return TrialResult(discovery, pictures, traffic, _heard(stranger), float(np.quantile(late, 0.95)) if late else math.inf)

    def _make_network(self) -> Medium:
        settings = self._settings
        links = [*self._names, *(['stranger'] if settings.security else [])]
        self._hosts = []
        for number, link in enumerate(links, 1):
            self._hosts.append(Host(link, f'10.88.0.{number}/24'))
            self._opened.callback(self._hosts[-1].close)
        medium = Medium(len(links), settings.seed)
        if settings.from_start:
            medium.impair(settings.delay, settings.loss)
        self._opened.callback(Switch(links, medium).close)
        return medium

    def _make_environment(self, folder: Path) -> dict[str, str]:
        common = {**os.environ, 'ROS_DOMAIN_ID': '0', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_SECURITY_ENABLE': 'false',
                  **dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), '1')}
        config = Path(get_package_share_directory('av_bringup')) / 'config'
        common['CYCLONEDDS_URI'] = '' if self._settings.default_dds else f'file://{config}/dds/network.xml'
        if not self._settings.security:
            return common
        shipped = config / 'security'
        for name in self._names:
            policy = {each.path: each for each in read_policy(shipped / 'policy.xml', name)}
            light_rig = policy[f'/{name}/{NODE}']
            light_rig = replace(light_rig, subscribe=(*light_rig.subscribe, f'rt/{name}/tracks'))
            make_keystore(folder / 'keys', [light_rig, policy[f'/{name}/network_node']], shipped / 'governance.xml', 1.0)
        return {**common, 'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce',
                'ROS_SECURITY_KEYSTORE': str(folder / 'keys')}

    def _start_rig(self, name: str, host: Host, folder: Path) -> HostProcess:
        settings, simulation = self._settings, self._settings.simulation
        places = [value for rig in simulation.rigs for value in rig.position]
        parameters = {'rigs': [f'/{rig}' for rig in self._names], 'positions': places, 'heading_sigma_deg': HEADING_SIGMA_DEG,
                      'clock_sigma': 0.001}
        program = Path(get_package_prefix('av_network')) / 'lib' / 'av_network' / 'network_node'
        node = [str(program), '--ros-args', '-r', f'__ns:=/{name}', '--enclave', f'/{name}/network_node',
                *(word for key, value in parameters.items() for word in ('-p', f'{key}:={value}'))]
        self._start(node, host, folder / f'{name}_node.log')
        words = (name, settings.seed, settings.rigs, settings.drones, simulation.duration)
        rig = [sys.executable, '-m', 'av_evaluation.hosts.light_rig', *map(str, words)]
        return self._start(rig, host, folder / f'{name}.log')

    def _start_stranger(self, folder: Path) -> HostProcess:
        self._environment = {**self._environment, 'ROS_SECURITY_ENABLE': 'false'}
        command = [sys.executable, '-m', 'av_evaluation.hosts.stranger', *self._names]
        return self._start(command, self._hosts[-1], folder / 'stranger.log')

    def _start(self, command: Sequence[str], host: Host, log: Path) -> HostProcess:
        process = HostProcess([*host.prefix, *command], self._environment, log)
        self._processes.append(process)
        self._opened.callback(process.close)
        return process

    def _measure(self, name: str, seconds: float, traffic: Sequence[Traffic]) -> None:
        """Let a phase pass; note what each host has sent a second in it."""
        self._say(f'{name}, {seconds:.0f} s')
        sent, begun = [sent_bytes(link) for link in self._names], time.monotonic()
        self._wait(lambda: time.monotonic() - begun >= seconds, seconds + STOPPED_S, name)
        spent = time.monotonic() - begun
        for each, link, before in zip(traffic, self._names, sent, strict=True):
            each.rates[name] = (sent_bytes(link) - before) / spent

    def _wait(self, condition: Callable[[], bool], patience: float, what: str) -> None:
        """Wait for a condition. Raises RuntimeError where it does not come or a process ends."""
        latest = time.monotonic()
        deadline = latest + patience
        while not condition():
            latest, before = time.monotonic(), latest
            if latest - before > STOPPED_S:
                raise RuntimeError(f'stopped for {latest - before:.0f} s by the machine: try again')
            for process in self._processes:
                process.check()
            if latest > deadline:
                raise RuntimeError(f'not within {patience:.0f} s: {what}')
            time.sleep(0.05)


def _heard(stranger: HostProcess | None) -> dict[str, int]:
    if stranger is None:
        return {}
    return {**(stranger.newest('heard') or {}), 'listeners': stranger.newest('listeners') or 0}
