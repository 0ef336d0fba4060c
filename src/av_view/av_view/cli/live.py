"""The guided test of a rig that runs: `ros2 run av_view doctor --live`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection2DArray

from av_common.node import TfOdometry
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.rig import Rig
from av_interfaces.msg import AudioFrame, DoaArray, GimbalState
from av_view.doctor.cameras import draw_marker
from av_view.doctor.finding import Finding
from av_view.doctor.live import LiveCheck, Step

JUDGE_PERIOD_S = 0.5  # a person sees no faster


def test_running(rig: Rig, options: argparse.Namespace) -> list[Finding]:
    """Guide a person through the steps, write the report and the marker beside it; returns what was found.

    Parameters:
        rig: description of the rig.
        options: those of `doctor`.
    """
    marker = options.report.with_name('marker.png')
    options.report.parent.mkdir(parents=True, exist_ok=True)
    marker.write_bytes(cv2.imencode('.png', draw_marker())[1].tobytes())
    print(f'show {marker} on a telephone that plays the sound of a drone, or print it', file=sys.stderr)
    rclpy.init()
    node = Node('doctor', namespace=options.namespace)
    check = LiveCheck(rig, options.marker_side, options.distance, options.namespace)
    subscribe(node, rig, check)
    done: list[tuple[Step, list[Finding]]] = []
    try:
        for step in check.steps():
            done.append((step, perform(node, check, step)))
            if step.title == 'rig' and not all(one.level == 'ok' for one in done[0][1]):
                break
    except KeyboardInterrupt:
        print('\nended: the report is of the steps so far', file=sys.stderr)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    found = [one for _, findings in done for one in findings] + list(check.statuses.values())
    write_report(options.report, options.rig, done, list(check.statuses.values()))
    print(f'report: {options.report}', file=sys.stderr)
    return found


def subscribe(node: Node, rig: Rig, check: LiveCheck) -> None:
    """Hand the messages of a rig to a check.

    Parameters:
        node: in the namespace of the rig.
        rig: its description.
        check: takes them; what it cannot use is left out.
    """
    def taking(take: Callable[[Any], None]) -> Callable[[Any], None]:
        def use(message: Any) -> None:
            with suppress(ValueError):
                take(message)
        return use

    node.create_subscription(AudioFrame, 'audio/frames', taking(check.on_audio), STREAM)
    node.create_subscription(DoaArray, 'doa', taking(check.on_doa), STREAM)
    odometry = TfOdometry(node)
    node.create_subscription(Odometry, 'odometry', taking(lambda message: check.on_odometry(odometry.of_body(message))), STREAM)
    node.create_subscription(DiagnosticArray, '/diagnostics', taking(check.on_diagnostics), RESULT)
    node.create_subscription(CameraInfo, 'camera/camera_info', taking(check.on_camera_info), STREAM)
    node.create_subscription(Image, 'camera/image_raw', taking(check.on_image), IMAGE)
    node.create_subscription(Detection2DArray, 'detections', taking(check.on_detections), STREAM)
    if rig.gimbal is not None:
        node.create_subscription(GimbalState, 'gimbal/state', taking(
            lambda message: check.on_gimbal(message, 1e-9 * node.get_clock().now().nanoseconds)), STREAM)


def perform(node: Node, check: LiveCheck, step: Step) -> list[Finding]:
    """Ask for one step, and watch until it can be judged or its time is over; prints and returns what was found."""
    check.begin()
    end, due, found = time.monotonic() + step.seconds, 0.0, list[Finding]()
    while not found:
        rclpy.spin_once(node, timeout_sec=0.05)
        now = time.monotonic()
        if now >= due:
            due = now + JUDGE_PERIOD_S
            print(f'\r{step.title}: {step.prompt}  ({max(end - now, 0.0):2.0f} s) ', end='', file=sys.stderr, flush=True)
            found = step.judge(now >= end)
    print(file=sys.stderr)
    print(*(one.lines() for one in found), sep='\n', file=sys.stderr)
    return found


def write_report(path: Path, rig_file: str, done: Sequence[tuple[Step, Sequence[Finding]]], statuses: Sequence[Finding]
                 ) -> None:
    """Write what was found as Markdown.

    Parameters:
        path: of the report.
        rig_file: description of the rig.
        done: the steps with what was found.
        statuses: of nodes that are not well.
    """
    rows = [(step.prompt, one) for step, findings in done for one in findings] + [('/diagnostics', one) for one in statuses]
    lines = [f'# {rig_file}, {time.strftime("%Y-%m-%d %H:%M")}', '',
             '| step | asked | found | what to do |', '|---|---|---|---|',
             *(f'| {one.area} | {asked} | {one.level}: {one.words} | {one.remedy} |' for asked, one in rows), '']
    path.write_text('\n'.join(lines), encoding='utf-8')
