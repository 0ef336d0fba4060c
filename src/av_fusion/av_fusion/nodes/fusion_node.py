"""Directions of arrival, detections and odometry in; one bearing and the state of the fusion out."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from av_common.frames import yaw_of
from av_common.node import RigNode, run
from av_common.qos import RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds, to_stamp
from av_common.track import State, Track
from av_fusion.measurement.readings import HEARD, POSE, SEEN, Reading
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
        self.while_active(self.create_subscription, DoaArray, 'doa', self._on_doa, STREAM, raw=True)
        self.while_active(self.create_subscription, Detection2DArray, 'detections', self._on_detections, STREAM, raw=True)
        self.while_active(self.create_subscription, CameraInfo, 'camera/camera_info', self._senses.set_camera, STREAM)
        self.while_active(self.create_subscription, Visibility, 'visibility', self._on_visibility, STREAM)
        self.while_active(self.create_subscription, Odometry, 'odometry', self._on_odometry, STREAM, raw=True)
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

    def _on_doa(self, data: bytes) -> None:
        self._meters['doa'].tick()
        heard, now = _read(data, HEARD, DoaArray), self.now()
        if self._is_foreign(heard.time, now):
            return
        for sound in self._senses.sounds(heard, self._settings.min_sound_confidence):
            self._tracker.add_sound(sound)
        self._publish(now)

    def _on_detections(self, data: bytes) -> None:
        self._meters['detections'].tick()
        seen, now = _read(data, SEEN, Detection2DArray), self.now()
        if self._is_foreign(seen.time, now):
            return
        judged, visibility = self._visibility
        look = self._senses.look(seen, visibility if abs(seen.time - judged) < 1.0 else math.nan)
        if look is not None:
            self._tracker.add_look(look)
            self._publish(now)

    def _on_visibility(self, message: Visibility) -> None:
        self._visibility = (to_seconds(message.header.stamp), message.visibility)

    def _on_odometry(self, data: bytes) -> None:
        self._meters['odometry'].tick()
        pose = _read(data, POSE, Odometry)
        # The clock was read when the last track was published: it is read again only where that leaves a doubt.
        if abs(pose.time - self._last_published) > CLOCK_TOLERANCE_S and self._is_foreign(pose.time, self.now()):
            return
        if pose.has_attitude:
            self._tracker.add_pose(pose.time, yaw_of(pose.attitude), pose.yaw_rate)

    def _on_silence(self) -> None:
        self._publish(self.now())

    def _missing(self) -> list[str]:
        return [name for name, meter in self._meters.items() if meter.age > 1.0]

    def _publish(self, now: float) -> None:
        self._last_published = now
        self._silence.reset()
        track = self._tracker.estimate(now)
        header = Header(stamp=to_stamp(now), frame_id=self._settings.base_frame)
        self._state_publisher.publish(state_message(track, header, self._missing()))
        self._bearing_publisher.publish(bearing_message(track, header))

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


def _read(data: bytes, reading: Reading, kind: type) -> Any:
    try:
        return reading.read(data)
    except ValueError:  # a middleware with an encoding of its own
        return reading.of(deserialize_message(data, kind))


def bearing_message(track: Track, header: Header) -> Bearing:
    """A track as a message."""
    known = track.state != State.NONE
    return Bearing(
        header=header, azimuth=track.azimuth, elevation=track.elevation, azimuth_variance=track.azimuth_variance,
        elevation_variance=track.elevation_variance, azimuth_world=track.azimuth_world,
        azimuth_world_rate=track.azimuth_world_rate, state=int(track.state), source=int(track.source),
        hemisphere_probability=track.hemisphere_probability,
        measured=to_stamp(track.measured) if known and track.measured > 0.0 else to_stamp(0.0))


def state_message(track: Track, header: Header, missing: list[str]) -> FusionState:
    """The state of the fusion as a message."""
    return FusionState(
        header=header, state=int(track.state), reason=track.reason, changed=to_stamp(max(track.changed, 0.0)),
        sound_confidence=track.sound_confidence, sight_confidence=track.sight_confidence,
        sound_weight=track.sound_weight, sight_weight=track.sight_weight, visibility=track.visibility,
        front_probability=track.front_probability, hemisphere_resolved=track.resolved,
        requested_rotation=track.requested_rotation, missing=missing)


def main() -> None:
    """Run the node."""
    run(FusionNode)
