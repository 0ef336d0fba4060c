"""Directions of arrival, detections and odometry in; bearing and state of the fusion out."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger
from vision_msgs.msg import Detection2DArray

from av_common.files import shown
from av_common.freshness import CLOCK_TOLERANCE_S, FUTURE_S
from av_common.gimbal_history import GimbalHistory
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.rig import CAMERAS, camera_topic, camera_topics, load_rig
from av_common.tf_rotations import TfRotations
from av_common.track import DRONE
from av_fusion.calibration.sighting_calibration import AT_LIMIT
from av_fusion.nodes.fusion_node_parameters import fusion_node as parameters
from av_fusion.rig_reporter import RigReporter
from av_fusion.settings import check_sense, make_tracker
from av_fusion.stage import (
    DETECTIONS,
    GIMBAL,
    INFO,
    ODDS,
    RATE_HZ,
    VISIBILITY,
    FusionOutput,
    make_fusion_stage,
)
from av_interfaces.msg import (
    AzimuthPosterior,
    Bearing,
    DoaArray,
    DoaOdds,
    FusionState,
    GimbalState,
    PointingCommand,
    RigReport,
    TrackArray,
    Visibility,
)
from av_interfaces.srv import SelectTarget

POSTERIOR_PERIOD_S = 0.1  # for people who watch


class FusionNode(RigNode):
    """Runs a `FusionStage`."""

    RUNTIME_PARAMETERS: ClassVar[frozenset[str]] = frozenset({'tau', 'confirm_threshold'})

    def __init__(self) -> None:
        super().__init__('fusion_node', parameters)

    def configure(self) -> None:
        """Build the stage, open the publishers."""
        self._settings = self.settings
        self._rotations = TfRotations(self)
        rig = load_rig(self._settings.rig_file) if self._settings.rig_file else None
        gimbal, self._cameras = (rig.gimbal, tuple(rig.cameras)) if rig else (None, CAMERAS[:1])
        self._gimbals = [GIMBAL] if gimbal else []
        self._stage = make_fusion_stage(self._settings, self._rotations.rotation, tracker=make_tracker(self._settings, gimbal),
                                        gimbal=GimbalHistory() if gimbal else None, cameras=self._cameras)
        self._stage.converter.optical_frames = rig.optical_frames if rig else {}
        self._reporter = RigReporter()
        self._untransformed = 0
        self._meters = {name: RateMeter() for name in ('doa', *camera_topics(self._cameras, DETECTIONS), 'odometry')}
        self._bearing_publisher = self.create_publisher(Bearing, 'target/bearing', RESULT)
        self._state_publisher = self.create_publisher(FusionState, 'fusion/state', RESULT)
        self._targets_publisher = self.create_publisher(TrackArray, 'targets', RESULT)
        self._report_publisher = self.create_publisher(RigReport, 'network/report', STREAM)
        self._posterior_publisher = self.create_publisher(AzimuthPosterior, 'fusion/posterior', RESULT)

    def activate(self) -> None:
        """Subscribe to the sensors."""
        stage = self._stage
        for camera in self._cameras:
            for kind, topic, note in ((CameraInfo, INFO, stage.on_camera_info), (Visibility, VISIBILITY, stage.on_visibility)):
                self.create_subscription(kind, camera_topic(camera, topic), partial(note, camera=camera), STREAM)
        self.create_subscription(DoaOdds, ODDS, stage.on_odds, STREAM)
        inputs: list[tuple[Any, str, Any, Any]] = [
            (DoaArray, 'doa', stage.on_doa, STREAM), (GimbalState, GIMBAL, stage.on_gimbal, STREAM),
            (PointingCommand, 'pointing/command', stage.on_command, RESULT)]
        inputs += [(Detection2DArray, camera_topic(camera, DETECTIONS), partial(stage.on_detections, camera=camera), STREAM)
                   for camera in self._cameras]
        inputs += [(PointStamped, 'target/cue', stage.on_cue, RESULT)] if self._settings.use_cues else []
        for kind, topic, take, quality in inputs:
            self.create_subscription(kind, topic, partial(self._use, topic, take), quality)
        self.subscribe_odometry(partial(self._use, 'odometry', stage.on_odometry))
        self.create_service(SelectTarget, '~/select', self._on_select)
        self.create_service(Trigger, '~/request_rotation', self._on_request_rotation)
        self.create_service(Trigger, '~/forget_emitters', self._on_forget_emitters)
        self.create_timer(POSTERIOR_PERIOD_S, self._publish_posterior)
        self.refuse_second_publishers('doa', ODDS, 'odometry', *self._gimbals,
                                      *camera_topics(self._cameras, DETECTIONS, INFO, VISIBILITY),
                                      tell=self._stage.refuse_contested, besides={GIMBAL: 'rig_frames_node'})
        self._timer = self.create_timer(1.0 / RATE_HZ, lambda: self._publish(self._stage.on_time(self.now())))

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Thresholds and limits must fit each other."""
        check_sense(settings)
        make_tracker(settings)

    def apply_parameters(self) -> None:
        """Use other thresholds; the tracks stay."""
        self._stage.tracker.tune(self.settings.tau, self.settings.confirm_threshold)

    def _use(self, topic: str, take: Callable[[Any, float], FusionOutput | None], message: Any) -> None:
        """Use a message, and publish what follows from it at once."""
        if topic in self._meters:
            self._meters[topic].tick()
        self._publish(take(message, self.now()))

    def _on_select(self, request: SelectTarget.Request, response: SelectTarget.Response) -> SelectTarget.Response:
        try:
            self._stage.tracker.select(request.id)
            response.success = True
        except ValueError as error:
            response.message = str(error)
        return response

    def _on_request_rotation(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._stage.tracker.planner.ask(self.now())
            response.success, response.message = True, 'a rotation is requested until front and back are resolved'
        except ValueError as error:
            response.message = str(error)
        return response

    def _on_forget_emitters(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, f'{self._stage.tracker.forget_emitters()} fixed emitters forgotten'
        return response

    def _publish_posterior(self) -> None:
        if self._posterior_publisher.get_subscription_count():
            self._posterior_publisher.publish(self._stage.posterior(self.now()))

    def _publish(self, output: FusionOutput | None) -> None:
        if output is not None:
            self._timer.reset()
            self._state_publisher.publish(output.state)
            self._bearing_publisher.publish(output.bearing)
            self._targets_publisher.publish(output.targets)
            report = self._reporter.report(output.targets, self._stage.tracker.densities(), self._stage.tracker.motion)
            if report is not None:
                self._report_publisher.publish(report)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Which inputs are missing, and what cannot be used."""
        missing = self._stage.missing(self.now())
        if missing:
            level = DiagnosticStatus.WARN if len(missing) < len(self._meters) else DiagnosticStatus.ERROR
            status.mergeSummary(level, f'no {", ".join(missing)}')
        self._diagnose_motion(status)
        self._diagnose_classes(status)
        monitor = self._stage.consistency
        fault = monitor.fault if monitor is not None else None
        if monitor is not None:
            status.add('uncertainty by the description (deg)', f'{math.degrees(math.sqrt(monitor.belief.in_body)):.1f}')
        status.add('cameras not used', ', '.join(sorted(self._stage.left_out)) or 'none')
        if fault is not None:
            status.mergeSummary(DiagnosticStatus.ERROR if fault.is_certain else DiagnosticStatus.WARN, str(fault))
        for problem in filter(None, (self._rotations.problem, *self._stage.converter.problems.values())):
            status.mergeSummary(DiagnosticStatus.ERROR, problem)
        late, self._untransformed = self._stage.untransformed - self._untransformed, self._stage.untransformed
        if late:
            status.mergeSummary(DiagnosticStatus.WARN, f'{late} measurements without a transform of their capture time: is tf '
                                'late?')
        status.add('measurements without transform', str(self._untransformed))
        foreign = self._stage.gate.foreign_stamps
        if any(foreign.values()):
            status.mergeSummary(
                DiagnosticStatus.ERROR, f'{sum(foreign.values())} stamps more than '
                f"{CLOCK_TOLERANCE_S:.0f} s before this node's clock, or {FUTURE_S:g} s after it: set "
                'use_sim_time alike on all nodes, or synchronise the clocks')
            foreign.update(dict.fromkeys(foreign, 0))
        for name, meter in self._meters.items():
            status.add(f'{name} rate (Hz)', f'{meter.rate:.1f}')
        values = self._stage.tracker.diagnostics()
        for name, value in values.items():
            status.add(name, value)
        if values.get(AT_LIMIT, 'none') != 'none':
            status.mergeSummary(DiagnosticStatus.WARN, f'{AT_LIMIT}: {values[AT_LIMIT]}; mend mount: rpy_deg or positions of '
                                'the array, or run `ros2 run av_audio calibrate`')

    def _diagnose_classes(self, status: DiagnosticStatusWrapper) -> None:
        foreign = self._stage.converter.foreign_classes
        if foreign:
            status.mergeSummary(DiagnosticStatus.WARN, f'detections are of the classes {shown(foreign)}, none so far is '
                                f'{DRONE}: only that class may be the target')

    def _diagnose_motion(self, status: DiagnosticStatusWrapper) -> None:
        motion, now = self._stage.tracker.motion, self.now()
        problem, known = motion.problem(now), motion.is_known(now)
        if problem:
            status.mergeSummary(DiagnosticStatus.WARN, problem)
        status.add('attitude', 'known' if known else
                   'not known or frozen: the rig counts as level, at its last heading or facing east')
        status.add('jumps of odometry', str(motion.jumps))


def main() -> None:
    """Run the node."""
    run(FusionNode)
