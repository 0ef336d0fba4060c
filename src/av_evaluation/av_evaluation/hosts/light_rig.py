"""A rig without sensors in one host: reports as a simulated rig would, and prints the picture of its network node.

`python -m av_evaluation.hosts.light_rig NAME SEED RIGS DRONES DURATION [--secure]`. Its input is a line `begin TIME`; its
output are lines of JSON: how many listen to its reports, and the positions that `tracks` of its namespace has.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Header

from av_common.qos import RESULT, STREAM
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.network import cases
from av_evaluation.network.simulation import Arrival
from av_interfaces.msg import RigReport, TargetDirection, WorldTrackArray
from av_network.report import Report, Sighting

TOPIC = 'network/report'
_PRINTING = threading.Lock()


class LightRig:
    """Two nodes: one that reports, as `fusion_node` does, and one that listens, as a person does.

    Parameters:
        name: the rig's name and namespace.
        arrivals: the reports of all rigs.
        secure: whether the nodes have keys, those of these enclaves.
    """

    def __init__(self, name: str, arrivals: list[Arrival], secure: bool) -> None:
        self._reports = [one.report for one in arrivals if one.report.rig == name]
        self._contexts = []
        reporter, listener = (self._node(node, name, secure) for node in ('fusion_node', 'operator'))
        self._publisher = reporter.create_publisher(RigReport, TOPIC, STREAM)
        listener.create_subscription(WorldTrackArray, 'tracks', self._on_tracks, RESULT)
        self._nodes, self._sent = (reporter, listener), 0
        self._executor = SingleThreadedExecutor(context=listener.context)
        self._executor.add_node(listener)

    def _node(self, node: str, rig: str, secure: bool) -> Node:
        context = rclpy.Context()
        context.init(['--ros-args', '--enclave', f'/{rig}/{node}'] if secure else [])
        self._contexts.append(context)
        return rclpy.create_node(node, context=context, namespace=rig, start_parameter_services=False, enable_rosout=False)

    def run(self) -> None:
        """Take part until the standard input ends."""
        threading.Thread(target=self._tell, daemon=True).start()
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def _tell(self) -> None:
        """Wait for the beginning, send each report at its time, then wait for the end."""
        waiting = threading.Event()
        threading.Thread(target=self._count_listeners, args=(waiting,), daemon=True).start()
        line = sys.stdin.readline().split()
        waiting.set()
        for report in self._reports if line[:1] == ['begin'] else ():
            time.sleep(max(float(line[1]) + report.time - time.time(), 0.0))
            self._publisher.publish(message_of(report, float(line[1])))
        sys.stdin.read()
        for context in self._contexts:
            context.try_shutdown()

    def _count_listeners(self, ended: threading.Event) -> None:
        while not ended.wait(0.25):
            _print({'listeners': self._publisher.get_subscription_count()})

    def _on_tracks(self, message: WorldTrackArray) -> None:
        rows = [[one.id, *(getattr(one.position, axis) for axis in 'xyz'), *(getattr(one.velocity, axis) for axis in 'xyz')]
                for one in message.tracks if one.positioned]
        _print({'time': to_seconds(message.header.stamp), 'targets': rows})


def message_of(report: Report, begin: float) -> RigReport:
    """The message of a report.

    Parameters:
        report: with times from 0 on.
        begin (s): what is added to its times.
    """
    unknown = np.full(3, np.nan, np.float32)    # a surveyed rig
    return RigReport(header=Header(stamp=to_stamp(begin + report.time), frame_id='base_link'), position=unknown,
                     directions=[_direction(one, begin) for one in report.sightings])


def _direction(one: Sighting, begin: float) -> TargetDirection:
    covariance = np.array([one.covariance[0, 0], one.covariance[0, 1], one.covariance[1, 1]], np.float32)
    return TargetDirection(id=one.id, azimuth=one.azimuth, elevation=one.elevation, covariance=covariance,
                           measured=to_stamp(begin + one.measured), existence=one.existence, drone_probability=0.9,
                           seen=not one.by_sound, resolved=one.resolved, class_id='drone')


def _print(values: dict[str, object]) -> None:
    with _PRINTING:    # by two threads
        print(json.dumps(values), flush=True)


def main(arguments: list[str]) -> None:
    """Run the rig."""
    name, (seed, rigs, drones) = arguments[0], map(int, arguments[1:4])
    simulation = cases.square(seed, rigs, drones, float(arguments[4]))
    LightRig(name, simulation.arrivals(), '--secure' in arguments).run()


if __name__ == '__main__':
    main(sys.argv[1:])
