"""What the algorithms say, as messages for a bag."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from struct import Struct
from typing import Any

import numpy as np

from av_audio.localizer import DoaEstimate
from av_bags import topics as names
from av_bags.definitions import learn
from av_common.angles import angles_to_direction
from av_common.track import State, Track
from av_pointing.controller import Command
from av_vision.visibility import Visibility
from av_vision.yolo import Detections

# What messages in CDR begin with (OMG DDSI-RTPS 10.2).
LITTLE_ENDIAN = b'\0\1\0\0'


class MessageMaker:
    """Makes messages, and bytes of them. `frame` is the body's."""

    def __init__(self, frame: str = 'base_link') -> None:
        self.frame = frame
        for name in (names.DOA, names.DETECTIONS, names.VISIBILITY, names.COMMAND):
            self._store = learn(names.KINDS[name][0])
        self._types = types = self._store.types
        self._no_pose = types['geometry_msgs/msg/PoseWithCovariance'](types['geometry_msgs/msg/Pose'](
            types['geometry_msgs/msg/Point'](0.0, 0.0, 0.0), types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)),
            np.zeros(36))

    def serialise(self, message: Any) -> memoryview:
        """A message as CDR."""
        return self._store.serialize_cdr(message, message.__msgtype__)

    def output(self, name: str, time: float, content: Any) -> bytes | memoryview:
        """What a stage said at `time`, as CDR."""
        if name == names.BEARING:
            return bearing(content, time, self.frame)
        if name == names.STATE:
            return state(*content, time, self.frame)
        if name == names.COMMAND:
            return self.serialise(self.command(content, self.header(time, self.frame)))
        return content

    def header(self, time: float, frame: str) -> Any:
        """A std_msgs/Header."""
        return self._types['std_msgs/msg/Header'](self._types['builtin_interfaces/msg/Time'](*_stamp(time)), frame)

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

    def command(self, command: Command, header: Any) -> Any:
        """A command for gimbal and body."""
        return self._types[names.KINDS[names.COMMAND][0]](
            header=header, mode=int(command.mode), reason=command.reason, move_gimbal=command.move_gimbal,
            pan=command.pan, tilt=command.tilt, pan_rate=command.pan_rate, tilt_rate=command.tilt_rate,
            move_body=command.move_body, yaw_rate=command.yaw_rate)


def bearing(track: Track, time: float, frame: str) -> bytes:
    """A track as av_interfaces/Bearing in CDR: packed here, for there are dozens in each second of a bag."""
    form, name = _bearing_form(frame)
    known = track.state != State.NONE and track.measured > 0.0
    return form.pack(
        LITTLE_ENDIAN, *_stamp(time), len(name), name, track.azimuth, track.elevation, track.azimuth_variance,
        track.elevation_variance, track.azimuth_world, track.azimuth_world_rate, track.state, track.source,
        track.hemisphere_probability, *_stamp(track.measured if known else 0.0))


def state(track: Track, missing: Sequence[str], time: float, frame: str) -> bytes:
    """The state of the fusion as av_interfaces/FusionState in CDR."""
    form, name, reason = _state_form(frame, track.reason)
    return form.pack(
        LITTLE_ENDIAN, *_stamp(time), len(name), name, track.state, len(reason), reason, *_stamp(max(track.changed, 0.0)),
        track.sound_confidence, track.sight_confidence, track.sound_weight, track.sight_weight, track.visibility,
        track.front_probability, track.resolved, track.requested_rotation, len(missing)) + _texts(tuple(missing))


@lru_cache
def _bearing_form(frame: str) -> tuple[Struct, bytes]:
    name = _text(frame)
    return Struct(f'<4siII{_padded(len(name))}s6f2B2xfiI'), name


@lru_cache
def _state_form(frame: str, reason: str) -> tuple[Struct, bytes, bytes]:
    name, reason = _text(frame), _text(reason)
    rest = _padded(len(name) + 1) - len(name) - 1
    return Struct(f'<4siII{len(name)}sB{rest}xI{_padded(len(reason))}siI6f?3xfI'), name, reason


@lru_cache
def _texts(texts: tuple[str, ...]) -> bytes:
    """Strings one after the other, each with its length; only the last is not padded."""
    data = b''
    for text in map(_text, texts):
        data = data.ljust(_padded(len(data)), b'\0') + len(text).to_bytes(4, 'little') + text
    return data


def _text(text: str) -> bytes:
    return text.encode() + b'\0'


def _padded(length: int) -> int:
    return length + -length % 4


@lru_cache(8)  # a track's state changed once, and has the time of its bearing
def _stamp(time: float) -> tuple[int, int]:
    return divmod(round(time * 1e9), 10**9)
