"""A rig without sensors in one host: reports as a simulated rig would, and prints the picture of its network node.

`python -m av_evaluation.hosts.light_rig NAME SEED RIGS DRONES DURATION`. Its input is a line `begin TIME`; its output are
lines of JSON: how many listen to its reports, and the positions that `tracks` of its namespace has, and by how many
seconds the machine is too slow.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Header

from av_common.qos import RESULT, STREAM
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.network import cases
from av_evaluation.network.simulation import Arrival
from av_interfaces.msg import RigReport, TargetDirection, WorldTrackArray
from av_network.report import Report, Sighting

NODE, TOPIC = 'fusion_node', 'network/report'


class LightRig:
    """A node that reports, as `fusion_node` does, and listens to the network node beside it.

    Parameters:
        name: the rig's name and namespace.
        arrivals: the reports of all rigs.
    """

    def __init__(self, name: str, arrivals: list[Arrival]) -> None:
        self._reports = [one.report for one in arrivals if one.report.rig == name]
        self._node = rclpy.create_node(NODE, namespace=name, start_parameter_services=False, enable_rosout=False)
        self._publisher = self._node.create_publisher(RigReport, TOPIC, STREAM)
        self._node.create_subscription(WorldTrackArray, 'tracks', self._on_tracks, RESULT)
        self._node.create_timer(0.1, self._count_listeners)
        self._listeners, self._late = 0, 0.0

    def run(self) -> None:
        """Take part until the standard input ends."""
        threading.Thread(target=self._tell, daemon=True).start()
        with suppress(ExternalShutdownException):
            rclpy.spin(self._node)

    def _tell(self) -> None:
        """Wait for the beginning, send each report at its time, then wait for the end."""
        line = sys.stdin.readline().split()
        for report in self._reports if line[:1] == ['begin'] else ():
            due = float(line[1]) + report.time
            time.sleep(max(due - time.time(), 0.0))
            self._publisher.publish(message_of(report, float(line[1])))
            self._late = time.time() - due
        sys.stdin.read()
        rclpy.try_shutdown()

    def _count_listeners(self) -> None:
        before, self._listeners = self._listeners, self._publisher.get_subscription_count()
        if self._listeners != before:
            _print({'listeners': self._listeners})

    def _on_tracks(self, message: WorldTrackArray) -> None:
        rows = [[one.id, *(getattr(one.position, axis) for axis in 'xyz'), *(getattr(one.velocity, axis) for axis in 'xyz')]
                for one in message.tracks if one.positioned]
        stamp = to_seconds(message.header.stamp)
        _print({'time': stamp, 'targets': rows, 'late': max(self._late, time.time() - stamp)})


def message_of(report: Report, begin: float) -> RigReport:
    """The message of a report.

    Parameters:
        report: with times from 0 on.
        begin (s): what is added to its times.
    """
    unknown = np.full(3, np.nan, np.float32)    # a surveyed rig
    header = Header(stamp=to_stamp(begin + report.time), frame_id='base_link')
    return RigReport(version=RigReport.VERSION, header=header, position=unknown,
                     directions=[_direction(one, begin) for one in report.sightings])


def _direction(one: Sighting, begin: float) -> TargetDirection:
    information = np.linalg.inv(one.covariance).ravel()[[0, 1, 3]].astype(np.float32)
    return TargetDirection(id=one.id, azimuth=one.azimuth, elevation=one.elevation, information=information,
                           measured=to_stamp(begin + one.measured), existence=one.existence, drone_probability=0.9,
                           seen=not one.by_sound, resolved=one.resolved, class_id='drone')


def _print(values: dict[str, object]) -> None:
    print(json.dumps(values), flush=True)


def main(arguments: list[str]) -> None:
    """Run the rig."""
    name, (seed, rigs, drones) = arguments[0], map(int, arguments[1:4])
    simulation = cases.square(seed, rigs, drones, float(arguments[4]))
    rclpy.init(args=['--ros-args', '--enclave', f'/{name}/{NODE}'])
    LightRig(name, simulation.arrivals()).run()


if __name__ == '__main__':
    main(sys.argv[1:])
