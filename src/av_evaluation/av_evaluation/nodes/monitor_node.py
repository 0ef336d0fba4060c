"""Shows a person what the rig is doing: a line a second, and at the end a table and a picture."""

from __future__ import annotations

import json
import math
import time as wall
from dataclasses import asdict
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2DArray

from av_common.frames import attitude_of, yaw_of
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_common.track import State
from av_evaluation.metrics.metrics import summarise
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.nodes.monitor_node_parameters import monitor_node as parameters
from av_evaluation.report.status_line import format_status
from av_evaluation.report.table import format_table
from av_fusion.measurement.converter import MeasurementConverter
from av_fusion.nodes.tf_rotations import TfRotations
from av_interfaces.msg import Bearing, DoaArray, FusionState, PointingCommand


class MonitorNode(RigNode):
    """Logs the rig's topics; changes nothing."""

    def __init__(self) -> None:
        super().__init__('monitor_node', parameters)

    def configure(self) -> None:
        """Start an empty log."""
        self._settings = self.settings
        self._rotations = TfRotations(self, self._settings.base_frame)
        self._converter = MeasurementConverter(self._rotations.rotation, self._settings.target_classes)
        self._log = RunLog()
        self._meters = {name: RateMeter() for name in ('doa', 'detections', 'bearing')}
        self._state: FusionState | None = None
        self._command: PointingCommand | None = None
        self._bearing: Bearing | None = None
        self._problems: dict[str, str] = {}
        self._reported = False

    def activate(self) -> None:
        """Listen to everything."""
        self._started = wall.monotonic()
        subscribe = self.create_subscription
        self.while_active(subscribe, DoaArray, 'doa', self._on_doa, STREAM)
        self.while_active(subscribe, Detection2DArray, 'detections', self._on_detections, STREAM)
        self.while_active(subscribe, CameraInfo, 'camera/camera_info', self._converter.set_camera_info, STREAM)
        self.while_active(subscribe, Bearing, 'target/bearing', self._on_bearing, RESULT)
        self.while_active(subscribe, FusionState, 'fusion/state', self._on_state, RESULT)
        self.while_active(subscribe, PointingCommand, 'pointing/command', self._on_command, RESULT)
        self.while_active(subscribe, Odometry, 'truth/target', self._on_target, STREAM)
        self.while_active(subscribe, Odometry, 'truth/rig', self._on_rig, STREAM)
        self.while_active(subscribe, DiagnosticArray, '/diagnostics', self._on_diagnostics, RESULT)
        self.while_active(self.create_timer, 1.0, self._each_second, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def deactivate(self) -> None:
        """Say how it went."""
        self._report()

    @property
    def _logging(self) -> bool:
        return wall.monotonic() - self._started < 3600.0 * self._settings.max_hours

    def _age(self, stamp: float) -> float:
        return self.now() - stamp

    def _on_doa(self, message: DoaArray) -> None:
        self._meters['doa'].tick()
        for sound in self._converter.doa(message)[:1]:
            azimuths = [hypothesis.azimuth for hypothesis in sound.hypotheses]
            if self._logging:
                self._log.sound.add(sound.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan,
                                    sound.confidence, self._age(sound.time) - 0.5 * message.window)

    def _on_detections(self, message: Detection2DArray) -> None:
        self._meters['detections'].tick()
        if any(detection.id.startswith('oracle') for detection in message.detections):
            self._log.notes['detections'] = "the simulator's visual oracle (no detector ran)"
        look = self._converter.detections(message)
        if look is not None and self._logging:
            best = look.best
            self._log.sight.add(look.time, best.azimuth if best else math.nan, best.score if best else 0.0,
                                self._age(look.time))

    def _on_bearing(self, message: Bearing) -> None:
        self._meters['bearing'].tick()
        self._bearing = message
        known = message.state != State.NONE
        if self._logging:
            self._log.fused.add(
                to_seconds(message.header.stamp), message.azimuth, math.sqrt(message.azimuth_variance), message.state,
                message.resolved,
                self._age(to_seconds(message.measured)) if known else math.nan)

    def _on_state(self, message: FusionState) -> None:
        self._state = message

    def _on_command(self, message: PointingCommand) -> None:
        self._command = message

    def _on_target(self, message: Odometry) -> None:
        position = message.pose.pose.position
        if self._logging:
            self._log.target.add(to_seconds(message.header.stamp), position.x, position.y, position.z)

    def _on_rig(self, message: Odometry) -> None:
        position, q = message.pose.pose.position, message.pose.pose.orientation
        if self._logging:
            self._log.rig.add(to_seconds(message.header.stamp), position.x, position.y, position.z,
                              yaw_of(attitude_of(q)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.removesuffix(': status')
            self._problems.pop(name, None)
            if status.level != DiagnosticStatus.OK:
                self._problems[name] = status.message

    def _each_second(self) -> None:
        elapsed = wall.monotonic() - self._started
        truth = float(self._log.true_azimuth([to_seconds(self._bearing.header.stamp)])[0]) if self._bearing else math.nan
        delay = self._age(to_seconds(self._bearing.measured)) if self._bearing and self._bearing.measured.sec else math.nan
        rates = {name: meter.rate if meter.age < 2.0 else 0.0 for name, meter in self._meters.items()}
        print(format_status(elapsed, self._bearing, self._state, self._command, truth, rates, delay, self._problems),
              flush=True)
        if self._settings.duration and elapsed >= self._settings.duration:
            self.finish()

    def _report(self) -> None:
        if self._reported:
            return
        self._reported = True
        summary = summarise(self._log, self._settings.tau)
        print(f'\n{self._settings.title}\n{format_table(summary)}', flush=True)
        if self._settings.out:
            out = Path(self._settings.out)
            self._log.save(out)
            (out / 'metrics.json').write_text(json.dumps(asdict(summary), indent=2) + '\n')
            from av_evaluation.report.plot import draw  # matplotlib takes a second to load: not at the start

            draw(self._log, out / 'bearing.png', self._settings.title)
            print(f'{"picture":<20}  {out / "bearing.png"}', flush=True)


def main() -> None:
    """Run the node."""
    run(MonitorNode)
