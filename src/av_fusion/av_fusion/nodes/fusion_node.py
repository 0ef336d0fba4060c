"""Directions of arrival, detections and odometry in; one bearing and the state of the fusion out."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2DArray

from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_common.track_messages import bearing_message, state_message
from av_fusion.measurement.odometry import add_odometry
from av_fusion.nodes.fusion_node_parameters import fusion_node as parameters
from av_fusion.nodes.sensor_messages import SensorMessages
from av_fusion.settings import make_tracker
from av_interfaces.msg import Bearing, DoaArray, FusionState, Visibility

CLOCK_TOLERANCE_S = 2.0  # a capture stamp further from this node's clock than this is of another clock


class FusionNode(RigNode):
    """Thin shell around a tracker: turns messages into measurements and tracks into messages."""

    def __init__(self) -> None:
        super().__init__('fusion_node', parameters)

    def configure(self) -> None:
        """Build the tracker, open the publishers."""
        self._settings = self.settings
        self._tracker = make_tracker(self._settings)
        self._senses = SensorMessages(self, self._settings.base_frame, self._settings.target_classes)
        self._visibility = (-math.inf, math.nan)
        self._meters = {'doa': RateMeter(), 'detections': RateMeter(), 'odometry': RateMeter()}
        self._foreign = 0
        self._last_published = -math.inf
        self._bearing_publisher = self.create_publisher(Bearing, 'target/bearing', RESULT)
        self._state_publisher = self.create_publisher(FusionState, 'fusion/state', RESULT)

    def activate(self) -> None:
        """Listen to the senses."""
        self.while_active(self.create_subscription, DoaArray, 'doa', self._on_doa, STREAM)
        self.while_active(self.create_subscription, Detection2DArray, 'detections', self._on_detections, STREAM)
        self.while_active(self.create_subscription, CameraInfo, 'camera/camera_info', self._senses.set_camera, STREAM)
        self.while_active(self.create_subscription, Visibility, 'visibility', self._on_visibility, STREAM)
        self.while_active(self.create_subscription, Odometry, 'odometry', self._on_odometry, STREAM)
        self._silence = self.while_active(self.create_timer, 1.0 / self._settings.rate, self._on_silence)

    def cleanup(self) -> None:
        """Close the publishers."""
        self.destroy_publisher(self._bearing_publisher)
        self.destroy_publisher(self._state_publisher)

    def _is_foreign(self, stamp: float, now: float) -> bool:
        """Whether a stamp stems from another clock than this node's."""
        foreign = abs(stamp - now) > CLOCK_TOLERANCE_S
        self._foreign += foreign
        return foreign

    def _on_doa(self, message: DoaArray) -> None:
        self._meters['doa'].tick()
        now = self.now()
        if self._is_foreign(to_seconds(message.header.stamp), now):
            return
        for sound in self._senses.sounds(message, self._settings.min_sound_confidence):
            self._tracker.add_sound(sound)
        self._publish(now)

    def _on_detections(self, message: Detection2DArray) -> None:
        self._meters['detections'].tick()
        time, now = to_seconds(message.header.stamp), self.now()
        if self._is_foreign(time, now):
            return
        judged, visibility = self._visibility
        look = self._senses.look(message, visibility if abs(time - judged) < 1.0 else math.nan)
        if look is not None:
            self._tracker.add_look(look)
            self._publish(now)

    def _on_visibility(self, message: Visibility) -> None:
        self._visibility = (to_seconds(message.header.stamp), message.visibility)

    def _on_odometry(self, message: Odometry) -> None:
        self._meters['odometry'].tick()
        time = to_seconds(message.header.stamp)
        # The clock was read when the last track was published: it is read again only where that leaves a doubt.
        if abs(time - self._last_published) > CLOCK_TOLERANCE_S and self._is_foreign(time, self.now()):
            return
        add_odometry(self._tracker, message)

    def _on_silence(self) -> None:
        self._publish(self.now())

    def _missing(self) -> list[str]:
        return [name for name, meter in self._meters.items() if meter.age > 1.0]

    def _publish(self, now: float) -> None:
        self._last_published = now
        self._silence.reset()
        track = self._tracker.estimate(now)
        frame = self._settings.base_frame
        self._state_publisher.publish(state_message(track, self._missing(), frame))
        self._bearing_publisher.publish(bearing_message(track, frame))

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Which inputs are missing, and what cannot be used."""
        missing = self._missing()
        if missing:
            level = DiagnosticStatus.WARN if len(missing) < len(self._meters) else DiagnosticStatus.ERROR
            status.mergeSummary(level, f'no {", ".join(missing)}')
        if self._senses.problem:
            status.mergeSummary(DiagnosticStatus.ERROR, self._senses.problem)
        if self._foreign:
            status.mergeSummary(DiagnosticStatus.ERROR, f'{self._foreign} stamps more than {CLOCK_TOLERANCE_S:.0f} s off '
                                "this node's clock: set use_sim_time alike on all nodes, or synchronise the clocks")
            self._foreign = 0
        for name, meter in self._meters.items():
            status.add(f'{name} rate (Hz)', f'{meter.rate:.1f}')
        status.add('state', self._tracker.machine.state.name)
        status.add('reason', self._tracker.machine.reason)
        refinement = getattr(self._tracker, 'refinement', None)  # the published switch has none
        if refinement is not None and refinement.compared:
            for name, value in refinement.describe().items():
                status.add(f'hearing corrected: {name}', value)


def main() -> None:
    """Run the node."""
    run(FusionNode)
