"""Monitor of the rig: a status line each second, and at the end a table of figures, logs and a plot."""

from __future__ import annotations

import math
import tempfile
import time as wall
from collections import deque
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2DArray

from av_bags import topics
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.rig import CAMERAS, camera_topic
from av_common.stamps import to_seconds
from av_common.tf_rotations import TfRotations
from av_common.track_messages import track_of_bearing
from av_evaluation.metrics.run_log import LARGEST_OFFSET_S, RunLog
from av_evaluation.nodes.monitor_node_parameters import monitor_node as parameters
from av_evaluation.report.text import format_status
from av_evaluation.runs.evaluation import describe
from av_fusion.measurement.converter import MeasurementConverter
from av_interfaces.msg import Bearing, DoaArray, FusionState, PointingCommand, TrackArray
from av_pointing.controller import Mode

LONGEST_LOG_S = 7200.0    # of which table and plot are made
RECENT_BEARINGS = 10    # half a second: true poses come by UDP and may be later than the bearing of their time
MOST_PROBLEMS, LONGEST_PROBLEM = 30, 300    # states that are shown, and their characters


class MonitorNode(RigNode):
    """Subscribes to the rig's topics, logs them and prints figures; publishes nothing."""

    def __init__(self) -> None:
        super().__init__('monitor_node', parameters)
        self._started = wall.monotonic()
        self._logged = 0.0, -math.inf    # when the last message came, on this node's clock and on that of the wall

    def configure(self) -> None:
        """Start an empty log."""
        self._settings = self.settings
        self._rotations = TfRotations(self)
        self._converter = MeasurementConverter(self._rotations.rotation)
        self._log = RunLog(Path(tempfile.gettempdir()))
        self._meters = {name: RateMeter() for name in ('doa', 'detections', 'bearing')}
        self._state: FusionState | None = None
        self._command: PointingCommand | None = None
        self._bearings: deque[Bearing] = deque(maxlen=RECENT_BEARINGS)
        self._targets: TrackArray | None = None
        self._problems: dict[str, str] = {}

    def activate(self) -> None:
        """Subscribe, and start the clock of the run."""
        self._started = wall.monotonic()
        self._logged = 0.0, -math.inf
        subscribe = self.create_subscription
        subscribe(DoaArray, 'doa', self._on_doa, STREAM)
        for camera in CAMERAS:
            for kind, topic, take in ((Detection2DArray, topics.DETECTIONS, self._on_detections),
                                      (CameraInfo, topics.CAMERA, self._converter.set_camera_info)):
                subscribe(kind, camera_topic(camera, topic), partial(take, camera=camera), STREAM)
        subscribe(Bearing, 'target/bearing', self._on_bearing, RESULT)
        subscribe(FusionState, 'fusion/state', self._on_state, RESULT)
        subscribe(TrackArray, 'targets', self._on_targets, RESULT)
        subscribe(PointingCommand, 'pointing/command', self._on_command, RESULT)
        subscribe(Odometry, 'truth/target', partial(self._on_truth, topics.TRUE_TARGET), STREAM)
        subscribe(Odometry, 'truth/rig', partial(self._on_truth, topics.TRUE_RIG), STREAM)
        subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics, RESULT)
        self.create_steady_timer(1.0, self._each_second)

    def deactivate(self) -> None:
        """Print the figures and write the files of the run."""
        out = Path(self._settings.out) if self._settings.out else None
        print(f'\n{describe(self._log, out)}', flush=True)
        if out is not None:
            self._log.save(out)
            print(f'chart: {out / "bearing.png"}', flush=True)

    def _logs(self) -> bool:
        """Whether a message that comes now is logged."""
        now, elapsed = self.now(), wall.monotonic()
        (before, then), self._logged = self._logged, (now, elapsed)
        if abs(now - before) > LARGEST_OFFSET_S > elapsed - then:    # the clock was set, or the player of a bag leapt
            self._log.left_out += now - before
        return elapsed - self._started < LONGEST_LOG_S

    def _on_doa(self, message: DoaArray) -> None:
        self._meters['doa'].tick()
        if self._logs():
            self._log.on_doa(self._converter.doa(message), self.now())

    def _on_detections(self, message: Detection2DArray, camera: str = CAMERAS[0]) -> None:
        self._meters.setdefault(camera_topic(camera, topics.DETECTIONS), RateMeter()).tick()
        measurement = self._converter.detections(message, camera=camera) if self._logs() else None
        if measurement is not None:
            self._log.on_camera(measurement, message, self.now())

    def _on_bearing(self, message: Bearing) -> None:
        self._meters['bearing'].tick()
        track = track_of_bearing(message)
        if self._logs():
            self._log.on_track(track, self.now())
        self._bearings.append(message)

    def _on_state(self, message: FusionState) -> None:
        self._state = message

    def _on_targets(self, message: TrackArray) -> None:
        self._targets = message

    def _on_command(self, message: PointingCommand) -> None:
        Mode(message.mode)  # raises ValueError for an unknown mode
        self._command = message

    def _on_truth(self, name: str, message: Odometry) -> None:
        if self._logs():
            self._log.on_truth(name, message, self.now())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note what is wrong with the nodes of this rig: all rigs of a network share the topic."""
        for status in message.status:
            name = status.name.removesuffix(': status').strip('/')[:LONGEST_PROBLEM]
            self._problems.pop(name, None)
            own = name.rpartition('/')[0] == self.get_namespace().strip('/')
            if own and status.level != DiagnosticStatus.OK and len(self._problems) < MOST_PROBLEMS:
                self._problems[name] = status.message[:LONGEST_PROBLEM]

    def _each_second(self) -> None:
        elapsed = wall.monotonic() - self._started
        bearing, truth = self._shown()
        measured = self._bearings[-1].measured if self._bearings else None
        delay = self.now() - to_seconds(measured) if measured is not None and measured.sec else math.nan
        rates = {name: meter.rate if meter.age < 2.0 else 0.0 for name, meter in self._meters.items()}
        print(format_status(elapsed, bearing, self._state, self._targets, self._command, truth, rates, delay,
                            self._problems), flush=True)
        if self._settings.duration and elapsed >= self._settings.duration:
            self.finish()

    def _shown(self) -> tuple[Bearing | None, float]:
        """The newest bearing of whose time the truth has come, and that (rad); NaN with the newest bearing where none has."""
        if not self._bearings:
            return None, math.nan
        truths = self._log.newest().true_azimuth(
            [to_seconds(one.header.stamp) - self._log.left_out for one in self._bearings])
        known = [k for k, truth in enumerate(truths) if math.isfinite(truth)]
        newest = known[-1] if known else -1
        return self._bearings[newest], float(truths[newest])


def main() -> None:
    """Run the node."""
    run(MonitorNode)
