"""Reports of several rigs to targets with positions."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from geometry_msgs.msg import PointStamped
from rclpy.publisher import Publisher
from sensor_msgs.msg import NavSatFix

from av_common.guarded_node import decode
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_interfaces.msg import RigReport, WorldTrackArray
from av_network.messages import check_version, version_of
from av_network.nodes.network_node_parameters import network_node as parameters
from av_network.observation import RigSettings
from av_network.stage import FIX, NO_DATUM, ODOMETRY, SURVEYED, NetworkStage, RigPlace

RATE_HZ = 10.0  # of messages of tracks
REPORT, REPORT_TYPE = '/network/report', 'av_interfaces/msg/RigReport'
LOOK_S = 1.0  # between two looks for rigs that join
MOST_RIGS = 64  # that join: twice as many as take one core (`network cost`)
SILENT_S = 3.0  # after which a rig is reported as silent


class NetworkNode(RigNode):
    """Subscribes to the reports of each rig and publishes `tracks`. Runs a `NetworkStage`."""

    def __init__(self) -> None:
        super().__init__('network_node', parameters)

    def configure(self) -> None:
        """Build the stage from the parameters. Raises ValueError where no rig is named yet, and none may join."""
        topics, places, datum = _network(self.settings)
        self._stage = NetworkStage(datum)
        self._topics: dict[str, str] = {}
        self._meters: dict[str, RateMeter] = {}
        for (name, topic), place in zip(topics.items(), places, strict=True):
            self._join(name, topic, place)
        self._tracks = self.create_publisher(WorldTrackArray, 'tracks', RESULT)
        self._published = 0

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Lists must fit the number of rigs, and sources of positions what is known."""
        if settings.join or any(name.strip('/') for name in settings.rigs):    # else `configure` says so
            _network(settings)

    def activate(self) -> None:
        """Subscribe to all rigs."""
        self._cues: dict[str, Publisher] = {}
        for name in self._topics:
            self._listen(name)
        self.create_timer(1.0 / RATE_HZ, self._on_time)
        if self.settings.join:
            self.create_timer(LOOK_S, self._look)

    def _join(self, name: str, topic: str, place: RigPlace) -> None:
        """Take one more rig; the first one has the reference clock."""
        p = self.settings
        clock_sigma = p.clock_sigma if self._topics else 0.0
        self._stage.join(RigSettings(name, math.radians(p.heading_sigma_deg), clock_sigma, p.position_sigma), place)
        self._topics[name], self._meters[name] = topic, RateMeter()

    def _listen(self, name: str) -> None:
        if self.settings.cue:
            self._cues[name] = self.create_publisher(PointStamped, f'{self._topics[name]}/target/cue', RESULT)
        self.create_subscription(RigReport, f'{self._topics[name]}/network/report',
                                 partial(self._on_report, name), STREAM, raw=True)
        if self._stage.rigs[name].place.source == FIX:
            self.create_subscription(NavSatFix, f'{self._topics[name]}/fix',
                                     lambda message: self._stage.on_fix(name, message, self.now()), STREAM)

    def _look(self) -> None:
        """Let rigs join whose reports have appeared below the node's namespace."""
        begin, known = self.get_namespace().rstrip('/') + '/', {self.resolve_topic_name(f'{topic}{REPORT}')
                                                                for topic in self._topics.values()}
        for topic, types in self.get_topic_names_and_types():
            name = topic.removeprefix(begin).removesuffix(REPORT)
            if (topic != f'{begin}{name}{REPORT}' or topic in known or REPORT_TYPE not in types or name in self._topics
                    or not self.count_publishers(topic)):
                continue
            if len(self._topics) >= MOST_RIGS:
                raise ValueError(f'{name} is one rig more than {MOST_RIGS}')
            self._join(name, name, RigPlace(self.settings.pose_sources[0], np.zeros(3)))
            self._listen(name)
            self.get_logger().info(f'{name} joins')

    def _on_report(self, name: str, data: bytes) -> None:
        check_version(name, version_of(data))  # others cannot be decoded
        self._stage.on_report(name, decode(RigReport, data), self.now())
        self._meters[name].tick()

    def _on_time(self) -> None:
        now = self.now()
        message = self._stage.output(now)
        self._published = len(message.tracks)
        self._tracks.publish(message)
        for name, cue in self._stage.cues(now).items() if self._cues else ():
            self._cues[name].publish(cue)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """What comes from each rig, and what was estimated of it."""
        silent = []
        for name, each in self._stage.rigs.items():
            known = self._stage.tracker.calibration.known(self._stage.tracker.rigs[name])
            age = self.now() - each.newest
            if not age < SILENT_S:
                silent.append(name)
            status.add(f'{name} rate (Hz)', f'{self._meters[name].rate:.1f}')
            status.add(f'{name} age (s)', f'{age:.2f}')
            status.add(f'{name} late', str(self._stage.queue.late.get(name, 0)))
            status.add(f'{name} without a position', str(each.unplaced))
            heading, clock = math.degrees(known.heading), 1e3 * known.clock
            heading_sigma, clock_sigma = math.degrees(known.heading_sigma), 1e3 * known.clock_sigma
            status.add(f'{name} heading correction (deg)', f'{heading:.2f} +- {heading_sigma:.2f}')
            status.add(f'{name} clock offset (ms)', f'{clock:.1f} +- {clock_sigma:.1f}')
        out = [name for name, index in self._stage.tracker.rigs.items() if index not in self._stage.tracker.trust]
        if out:
            status.mergeSummary(DiagnosticStatus.ERROR, f'{", ".join(out)} left out until it agrees with others: are heading, '
                                'position and clock right, and is it the rig that reports?')
        if silent:
            status.mergeSummary(DiagnosticStatus.WARN, f'nothing from {", ".join(silent)}')
        status.add('tracks', str(self._published))


def _network(p: Any) -> tuple[dict[str, str], list[RigPlace], tuple[float, float, float]]:
    """Namespaces of the rigs by name, their places, and the datum. Raises ValueError for what contradicts each other."""
    given = [name.rstrip('/') for name in p.rigs if name.strip('/')]
    topics = {name.lstrip('/'): name for name in given}
    if not (topics or p.join) or len(topics) < len(given):
        raise ValueError(f'rigs is {list(p.rigs)}, expected different namespaces, such as [left, right], or join')
    if p.join and list(p.pose_sources) not in ([ODOMETRY], [FIX]):
        raise ValueError(f'pose_sources is {list(p.pose_sources)}, expected [odometry] or [fix] where rigs join')
    places = _places(len(topics), list(p.positions), list(p.pose_sources), list(p.headings_deg))
    if p.datum.latitude or p.datum.longitude:
        return topics, places, (p.datum.latitude, p.datum.longitude, p.datum.altitude)
    if FIX in p.pose_sources:
        raise ValueError('pose_sources has fix, which needs latitude, longitude and altitude of datum')
    return topics, places, NO_DATUM


def _places(count: int, positions: list[float], sources: list[str], headings: list[float]) -> list[RigPlace]:
    """Places of the rigs. Raises ValueError for lists of a wrong length or with impossible values."""
    sources = sources * count if len(sources) == 1 else sources
    headings = headings * count if len(headings) == 1 else headings
    if unknown := set(sources) - {SURVEYED, ODOMETRY, FIX}:
        raise ValueError(f'pose_sources has {sorted(unknown)}, expected {SURVEYED}, {ODOMETRY} or {FIX}')
    if all(source == FIX for source in sources):
        positions = [0.0] * 3 * count
    if (len(positions), len(sources), len(headings)) != (3 * count, count, count):
        raise ValueError(f'{len(positions)} positions, {len(sources)} pose_sources and {len(headings)} headings_deg for '
                         f'{count} rigs, expected {3 * count}, {count} and {count}')
    if not np.all(np.abs([*positions, *headings]) < 1e6):
        raise ValueError(f'positions {positions} and headings_deg {headings}, expected finite values')
    return [RigPlace(source, np.array(positions[3 * k:3 * k + 3]), math.radians(headings[k]))
            for k, source in enumerate(sources)]


def main() -> None:
    """Run the node."""
    run(NetworkNode)
