"""What the algorithms say, as messages for a bag."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from av_audio.localizer import DoaEstimate
from av_common.angles import angles_to_direction
from av_fusion.bags import topics as names
from av_fusion.bags.definitions import learn
from av_fusion.measurements import State, Track
from av_fusion.pointing import Command
from av_vision.visibility import Visibility
from av_vision.yolo import Detections


class MessageMaker:
    """Makes messages, and bytes of them. `frame` is the body's."""

    def __init__(self, frame: str = 'base_link') -> None:
        self.frame = frame
        for name in (names.DOA, names.DETECTIONS, names.VISIBILITY, names.BEARING, names.STATE, names.COMMAND):
            self._store = learn(names.KINDS[name][0])
        self._types = types = self._store.types
        self._no_pose = types['geometry_msgs/msg/PoseWithCovariance'](types['geometry_msgs/msg/Pose'](
            types['geometry_msgs/msg/Point'](0.0, 0.0, 0.0), types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)),
            np.zeros(36))

    def serialise(self, message: Any) -> memoryview:
        """A message as CDR."""
        return self._store.serialize_cdr(message, message.__msgtype__)

    def output(self, name: str, time: float, content: Any) -> memoryview:
        """What a stage said at `time`, as CDR."""
        if name == names.BEARING:
            content = self.bearing(content, self.header(time, self.frame))
        elif name == names.STATE:
            content = self.state(*content, self.header(time, self.frame))
        elif name == names.COMMAND:
            content = self.command(content, self.header(time, self.frame))
        else:
            return content
        return self.serialise(content)

    def header(self, time: float, frame: str) -> Any:
        """A std_msgs/Header."""
        return self._types['std_msgs/msg/Header'](self._stamp(time), frame)

    def doa(self, estimate: DoaEstimate, time: float, frame: str, window: float, method: str) -> Any:
        """Hypotheses of the window whose centre is at `time`."""
        kind, vector = self._types['av_interfaces/msg/Doa'], self._types['geometry_msgs/msg/Vector3']
        directions = angles_to_direction(estimate.azimuth, estimate.elevation)
        hypotheses = [kind(vector(*map(float, directions[k])), *(float(column[k]) for column in (
            estimate.azimuth, estimate.elevation, estimate.azimuth_variance, estimate.elevation_variance,
            estimate.confidence)), int(estimate.group[k]), bool(estimate.end_fire[k])) for k in range(len(directions))]
        return self._types[names.KINDS[names.DOA][0]](self.header(time, frame), window, method, estimate.level_dbfs,
                                                      hypotheses)

    def detections(self, found: Detections, tracks: Sequence[int], header: Any) -> Any:
        """A picture's detections under the picture's header."""
        detection, result, hypothesis, box, pose, point = (self._types[f'vision_msgs/msg/{kind}'] for kind in (
            'Detection2D', 'ObjectHypothesisWithPose', 'ObjectHypothesis', 'BoundingBox2D', 'Pose2D', 'Point2D'))
        rows = zip(found.centres.tolist(), found.sizes.tolist(), found.scores.tolist(), found.class_names, tracks,
                   strict=True)
        return self._types[names.KINDS[names.DETECTIONS][0]](header, [
            detection(header, [result(hypothesis(name, score), self._no_pose)], box(pose(point(*centre), 0.0), *size),
                      str(track)) for centre, size, score, name, track in rows])

    def visibility(self, seen: Visibility, header: Any) -> Any:
        """How far one can see in a picture."""
        return self._types[names.KINDS[names.VISIBILITY][0]](header, float(seen.share), float(seen.range))

    def bearing(self, track: Track, header: Any) -> Any:
        """A track."""
        known = track.state != State.NONE and track.measured > 0.0
        return self._types[names.KINDS[names.BEARING][0]](
            header=header, azimuth=track.azimuth, elevation=track.elevation, azimuth_variance=track.azimuth_variance,
            elevation_variance=track.elevation_variance, azimuth_world=track.azimuth_world,
            azimuth_world_rate=track.azimuth_world_rate, state=int(track.state), source=int(track.source),
            hemisphere_probability=track.hemisphere_probability, measured=self._stamp(track.measured if known else 0.0))

    def state(self, track: Track, missing: list[str], header: Any) -> Any:
        """The state of the fusion."""
        return self._types[names.KINDS[names.STATE][0]](
            header=header, state=int(track.state), reason=track.reason, changed=self._stamp(max(track.changed, 0.0)),
            sound_confidence=track.sound_confidence, sight_confidence=track.sight_confidence,
            sound_weight=track.sound_weight, sight_weight=track.sight_weight, visibility=track.visibility,
            front_probability=track.front_probability, hemisphere_resolved=track.resolved,
            requested_rotation=track.requested_rotation, missing=missing)

    def command(self, command: Command, header: Any) -> Any:
        """A command for gimbal and body."""
        return self._types[names.KINDS[names.COMMAND][0]](
            header=header, mode=int(command.mode), reason=command.reason, move_gimbal=command.move_gimbal,
            pan=command.pan, tilt=command.tilt, pan_rate=command.pan_rate, tilt_rate=command.tilt_rate,
            move_body=command.move_body, yaw_rate=command.yaw_rate)

    def _stamp(self, time: float) -> Any:
        return self._types['builtin_interfaces/msg/Time'](*divmod(round(time * 1e9), 10**9))
