"""A participant without keys: speaks as a rig, listens to all rigs, and prints what it hears.

`python -m av_evaluation.hosts.stranger RIG...` speaks in the namespace of the first. Runs until its standard input ends.
"""

from __future__ import annotations

import json
import sys
import threading
from collections import Counter
from contextlib import suppress
from functools import partial

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Header

from av_common.qos import STREAM
from av_evaluation.hosts.light_rig import TOPIC
from av_interfaces.msg import RigReport, TargetDirection

MARK = 'stranger'  # frame of what it says


def main(rigs: list[str]) -> None:
    """Take part.

    Parameters:
        rigs: names of the rigs.
    """
    rclpy.init()
    node = rclpy.create_node(MARK, start_parameter_services=False, enable_rosout=False)
    publisher = node.create_publisher(RigReport, f'/{rigs[0]}/{TOPIC}', STREAM)
    heard: Counter[str] = Counter()

    def hear(rig: str, message: RigReport) -> None:
        heard['itself' if message.header.frame_id == MARK else rig] += 1

    def speak() -> None:
        now = node.get_clock().now().to_msg()
        ghost = TargetDirection(id=99, azimuth=1.0, elevation=0.3, information=np.array([1e4, 0.0, 1e4], np.float32),
                                measured=now, existence=1.0, drone_probability=1.0, seen=True, resolved=True)
        publisher.publish(RigReport(version=RigReport.VERSION, header=Header(stamp=now, frame_id=MARK), directions=[ghost],
                                    position=np.full(3, np.nan, np.float32)))
        print(json.dumps({'heard': heard, 'listeners': publisher.get_subscription_count()}), flush=True)

    kept = [node.create_subscription(RigReport, f'/{rig}/{TOPIC}', partial(hear, rig), STREAM) for rig in rigs]
    kept.append(node.create_timer(0.25, speak))
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.try_shutdown()), daemon=True).start()
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main(sys.argv[1:])
