"""What is known of one rig at the moment, as plain data for viewers: messages in, one snapshot out.

All angles of a snapshot are in degrees in the rig's body frame (azimuth counter-clockwise from ahead), unless a name says
`world`; ages and delays in s. Numbers are rounded, and None where they are unknown: JSON has no other numbers.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from transforms3d.quaternions import quat2mat

from av_common.angles import wrap
from av_common.frames import attitude_of
from av_common.rig import CAMERAS, camera_topic
from av_common.stamps import to_seconds
from av_common.track import Source, State
from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.measurement.vectors import angles
from av_pointing.controller import Mode
from av_view.camera_view import CameraView
from av_view.feed import (
    LONGEST_NAME,
    LONGEST_TEXT,
    MOST_BOXES,
    MOST_GROUPS,
    MOST_TRACKS,
    PICTURE_STALE_S,
    STALE_S,
    degrees,
    number,
)

MOST_MARKS, MOST_SECTORS = 50, 720
MOST_RIGS = 64  # of one map: as many as join a network
MOST_PAST = 30  # bearings and directions that may belong to a picture
STATES = {State.NONE: 'none', State.VISUAL_ACTIVE: 'sight', State.ACOUSTIC_ACTIVE: 'sound', State.COASTING: 'coasting'}


class RigState:
    """The newest message of each topic of a rig, and what follows from them for people who watch.

    Attributes:
        newest: the newest message by what it is of: bearing, fusion, doa, tracks, command, posterior, world, and the topics of
            detections.
        cameras: those that are known, by name: the first as it was turned at the time of the picture, others of detections.
        sound: the newest directions of arrival in the body frame, the most confident first.
    """

    def __init__(self) -> None:
        self.newest: dict[str, Any] = {}
        self.cameras: dict[str, CameraView] = {}
        self.sound: Sequence[DoaMeasurement] = ()
        self._bearings: deque[tuple[float, Any]] = deque(maxlen=MOST_PAST)
        self._heard: deque[tuple[float, Sequence[DoaMeasurement]]] = deque(maxlen=MOST_PAST)
        self._picture: tuple[float, tuple[int, int], Any] | None = None
        self._heading: float | None = None
        self._truths: dict[str, tuple[float, Any]] = {}  # times of arrival and poses of the rig and of targets
        self._spectrum: tuple[float, list[float]] = -math.inf, []  # time of arrival, levels
        self._marks: deque[tuple[float, str]] = deque(maxlen=MOST_MARKS)
        self._delay = math.nan  # s, from its newest measurement to the arrival of the bearing

    def take(self, what: str, message: Any, _arrival: float = 0.0) -> None:
        """Take a message in place of the one before. Raises ValueError for an impossible stamp.

        Parameters:
            what: it is of, see `newest`.
            message: the message.
        """
        to_seconds(message.header.stamp)
        self.newest[what] = message

    def on_bearing(self, message: Any, arrival: float) -> None:
        """Take a `Bearing`. Raises ValueError for a state that is not defined, an impossible stamp, or no azimuth.

        Parameters:
            message: the message.
            arrival (s): time of its arrival.
        """
        if State(message.state) != State.NONE and not math.isfinite(message.azimuth):
            raise ValueError(f'azimuth is {message.azimuth}, expected a number')
        measured = to_seconds(message.measured)
        self.take('bearing', message)
        self._bearings.append((to_seconds(message.header.stamp), message))
        if message.attitude_known and math.isfinite(message.azimuth_world):
            self._heading = float(wrap(message.azimuth_world - message.azimuth))
        if message.state != State.NONE and measured > 0.0:
            self._delay = arrival - measured

    def on_doa(self, message: Any, measurements: Sequence[DoaMeasurement]) -> None:
        """Take a `DoaArray`. Raises ValueError for an impossible stamp.

        Parameters:
            message: the message.
            measurements: its directions in the body frame, the most confident first.
        """
        self.take('doa', message)
        self.sound = measurements[:MOST_GROUPS]
        self._heard.append((to_seconds(message.header.stamp), self.sound))

    def on_picture(self, time: float, size: tuple[int, int], detections: Any) -> None:
        """Note which picture is shown.

        Parameters:
            time (s): when it was taken.
            size (pixels): width and height of its image.
            detections: the `Detection2DArray` of this very image; None where there is none.
        """
        self._picture = (time, size, detections)

    def on_command(self, message: Any, _arrival: float = 0.0) -> None:
        """Take a `PointingCommand`. Raises ValueError for a mode that is not defined, or an impossible stamp."""
        Mode(message.mode)
        self.take('command', message)

    def on_truth(self, name: str, message: Any, arrival: float) -> None:
        """Take a true pose of a simulation, an `Odometry`.

        Parameters:
            name: `rig`, or the name of a target.
            message: the message.
            arrival (s): time of its arrival.
        """
        if name == 'rig' or name in self._truths or len(self._truths) < MOST_TRACKS:
            self._truths[name] = arrival, message

    def on_posterior(self, message: Any, _arrival: float = 0.0) -> None:
        """Take an `AzimuthPosterior`. Raises ValueError for one that has too many sectors, or numbers that are none."""
        probability = np.asarray(message.probability, float)
        if len(probability) > MOST_SECTORS or not (np.isfinite(probability) & (probability >= 0.0)).all():
            raise ValueError(f'a posterior of {len(probability)} sectors, expected up to {MOST_SECTORS} probabilities')
        self.take('posterior', message)

    def on_mark(self, message: Any, _arrival: float = 0.0) -> None:
        """Take a mark, a `Log`. Raises ValueError for an impossible stamp."""
        self._marks.append((round(to_seconds(message.stamp), 2), message.msg[:LONGEST_NAME]))

    def on_spectrum(self, levels: Sequence[float], arrival: float) -> None:
        """Take the spectrum of the sound.

        Parameters:
            levels (dB): in the bands of `av_view.spectrum`.
            arrival (s): of the sound.
        """
        self._spectrum = arrival, [round(float(level), 1) for level in levels]

    def snapshot(self, now: float) -> dict[str, Any]:
        """What is known at `now` (s), as values that JSON can hold; parts are None where nothing is known."""
        fresh = {what: message for what in self.newest if (message := self._fresh(what, now)) is not None}
        return {
            'time': round(now, 3), 'heading': None if self._heading is None else degrees(self._heading),
            **{what: part(fresh[what]) if what in fresh else None for what, part in PARTS.items()},
            'sound': self._sound_part(fresh['doa']) if 'doa' in fresh else None, 'sight': self._sight_part(fresh),
            'picture': self._picture_part(now), 'cameras': self._cameras_part(),
            'tracks': [self._track(track, track.id == fresh['tracks'].selected)
                       for track in fresh['tracks'].tracks[:MOST_TRACKS]] if 'tracks' in fresh else [],
            'truth': self._truth_part(now),
            'posterior': _posterior_part(fresh['posterior']) if 'posterior' in fresh else [],
            'spectrum': self._spectrum[1] if _is_recent(self._spectrum[0], now) else [],
            'marks': [mark for mark in self._marks if mark[0] <= now],
            'delay': number(self._delay, 3) if 'bearing' in fresh else None}

    def _fresh(self, what: str, now: float) -> Any:
        """The newest message of what is asked for; None without one of the last STALE_S."""
        message = self.newest.get(what)
        return message if message is not None and _is_recent(to_seconds(message.header.stamp), now) else None

    def _picture_part(self, now: float) -> dict[str, Any] | None:
        """What is drawn on the picture, of the time at which it was taken."""
        if self._picture is None or not _is_recent(self._picture[0], now, PICTURE_STALE_S):
            return None
        time, size, detections = self._picture
        bearing, heard = _nearest(self._bearings, time), _nearest(self._heard, time) or ()
        boxes = detections.detections[:MOST_BOXES] if detections else ()
        camera = self.cameras.get(CAMERAS[0])
        line: list[list[float]] = []
        band, centre = line, None
        if camera and bearing and bearing.state != State.NONE:
            line = camera.meridian(bearing.azimuth)
            if 0.0 <= bearing.azimuth_variance < math.inf:
                band = camera.band(bearing.azimuth, math.sqrt(bearing.azimuth_variance))
            if _sigma(bearing.elevation_variance) is not None:
                centre = camera.point(bearing.azimuth, bearing.elevation)
        return {'age': number(now - time), 'detected': detections is not None,
                'boxes': [_box(box, size) for box in boxes if box.results], 'line': line, 'band': band, 'centre': centre,
                'heard': [camera.meridian(image.azimuth) for doa in heard for image in doa.hypotheses] if camera else []}

    def _sound_part(self, message: Any) -> dict[str, Any]:
        groups = [{'confidence': number(doa.confidence),
                   'images': [{'azimuth': degrees(image.azimuth)} for image in doa.hypotheses]} for doa in self.sound]
        return {'groups': groups, 'confidence': groups[0]['confidence'] if groups else 0.0, 'level': number(message.level, 1)}

    def _sight_part(self, fresh: Mapping[str, Any]) -> dict[str, Any] | None:
        found = {camera: fresh[topic] for camera in CAMERAS if (topic := camera_topic(camera, 'detections')) in fresh}
        return {'boxes': [self._seen(camera, detection) for camera, message in found.items()
                          for detection in message.detections[:MOST_BOXES] if detection.results]} if found else None

    def _seen(self, camera: str, detection: Any) -> dict[str, Any]:
        middle, view = detection.bbox.center.position, self.cameras.get(camera)
        azimuth = view.azimuth_of(middle.x, middle.y) if view else math.nan
        return {'camera': camera, 'score': number(_best(detection).score), 'azimuth': degrees(azimuth)}

    def _cameras_part(self) -> list[dict[str, Any]]:
        return [{'name': name, 'azimuth': degrees(camera.axis[0]), 'elevation': degrees(camera.axis[1]),
                 'view': degrees(camera.model.horizontal_fov_rad)} for name, camera in self.cameras.items()]

    def _track(self, track: Any, selected: bool) -> dict[str, Any]:
        camera = self.cameras.get(CAMERAS[0])
        return {
            'id': int(track.id), 'name': track.class_id[:LONGEST_NAME], 'azimuth': degrees(track.azimuth),
            'elevation': degrees(track.elevation), 'azimuth_world': degrees(track.azimuth_world),
            'drone': number(track.drone_probability), 'range': number(track.range), 'selected': selected,
            'source': [name for name, bit in (('sound', Source.SOUND), ('sight', Source.SIGHT)) if track.source & bit],
            'point': camera.point(track.azimuth, track.elevation) if camera else None}

    def _truth_part(self, now: float) -> list[dict[str, Any]]:
        recent = {name: message for name, (arrival, message) in self._truths.items() if _is_recent(arrival, now)}
        if 'rig' not in recent:
            return []
        rig = recent.pop('rig').pose.pose
        rotation = quat2mat(attitude_of(rig.orientation))
        targets = []
        for name in sorted(recent):
            target = recent[name].pose.pose.position
            offset = np.array([target.x - rig.position.x, target.y - rig.position.y, target.z - rig.position.z])
            azimuth, elevation = angles(tuple(rotation.T @ offset))
            targets.append({'azimuth': degrees(azimuth), 'elevation': degrees(elevation),
                            'range': number(float(np.linalg.norm(offset)), 1)})
        return targets


def _bearing_part(message: Any) -> dict[str, Any]:
    return {
        'state': STATES[State(message.state)], 'azimuth': degrees(message.azimuth), 'sigma': _sigma(message.azimuth_variance),
        'elevation': degrees(message.elevation) if _sigma(message.elevation_variance) is not None else None,
        'range': number(message.range), 'probability': number(message.hemisphere_probability, 3),
        'resolved': bool(message.resolved)}


def _fusion_part(message: Any) -> dict[str, Any]:
    return {
        'reason': message.reason[:LONGEST_TEXT], 'missing': [name[:LONGEST_TEXT] for name in message.missing[:10]],
        'sound_confidence': number(message.sound_confidence), 'sight_confidence': number(message.sight_confidence)}


def _command_part(message: Any) -> dict[str, Any]:
    return {'mode': Mode(message.mode).name.lower(), 'reason': message.reason[:LONGEST_TEXT],
            'pan': degrees(message.pan) if message.move_gimbal else None,
            'tilt': degrees(message.tilt) if message.move_gimbal else None,
            'yaw_rate': degrees(message.yaw_rate) if message.move_body else None}


def world_part(message: Any) -> dict[str, Any]:
    """The tracks and rigs of a `WorldTrackArray`, in metres in its common frame, x to the east and y to the north."""
    tracks = [found for found in map(_world_track, message.tracks[:MOST_TRACKS]) if found is not None]
    return {'tracks': tracks, 'rigs': [_rig(rig) for rig in message.rigs[:MOST_RIGS] if _is_placed(rig.position)]}


def _world_track(track: Any) -> dict[str, Any] | None:
    """A target; None where its position is not known at all."""
    covariance = np.asarray(track.position_covariance, float).reshape(3, 3)[:2, :2]
    if not _is_placed(track.position) or not np.isfinite(covariance).all():
        return None
    return {'id': int(track.id), 'name': track.class_id[:LONGEST_NAME], 'ellipse': ellipse(covariance),
            **{axis: number(getattr(track.position, axis)) for axis in 'xyz'}, 'positioned': bool(track.positioned),
            'rigs': [name[:LONGEST_NAME] for name in track.rigs[:MOST_RIGS]]}


def ellipse(covariance: np.ndarray) -> list[float | None]:
    """The ellipse of one standard deviation: its half axes (m), the longer first, and the angle of that one from x (deg).

    Parameters:
        covariance (2, 2) (m^2): of a position.
    """
    variances, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    short, long = np.sqrt(np.maximum(variances, 0.0))
    return [number(long), number(short), number(math.degrees(math.atan2(axes[1, 1], axes[0, 1])), 1)]


def _rig(rig: Any) -> dict[str, Any]:
    return {'name': rig.name[:LONGEST_NAME], 'x': number(rig.position.x), 'y': number(rig.position.y),
            'sigma': number(rig.position_sigma)}


def _is_placed(position: Any) -> bool:
    return math.isfinite(position.x + position.y)


# Parts of a snapshot that follow from a recent message alone.
PARTS: dict[str, Callable[[Any], dict[str, Any]]] = {
    'bearing': _bearing_part, 'fusion': _fusion_part, 'command': _command_part, 'world': world_part}


def _posterior_part(message: Any) -> list[float]:
    """Probabilities of the sectors relative to the most probable one; empty without one."""
    most = max(message.probability, default=0.0)
    return [round(float(value), 3) for value in np.asarray(message.probability, float) / most] if most > 0.0 else []


def _is_recent(time: float, now: float, most: float = STALE_S) -> bool:
    """Whether something is of the last moments (s); what is of a later time is of a bag before, or of another clock."""
    return abs(now - time) <= most


def _sigma(variance: float) -> float | None:
    """Standard deviation in degrees of a variance (rad^2); None where it says nothing."""
    return degrees(math.sqrt(variance)) if 0.0 <= variance <= math.pi**2 else None


def _nearest(past: Iterable[tuple[float, Any]], time: float) -> Any:
    """What was closest to a time (s); None where nothing was within STALE_S."""
    apart, found = min(((abs(stamp - time), one) for stamp, one in past), key=lambda pair: pair[0], default=(math.inf, None))
    return found if apart <= STALE_S else None


def _best(detection: Any) -> Any:
    return max((result.hypothesis for result in detection.results), key=lambda one: one.score)


def _box(detection: Any, size: tuple[int, int]) -> dict[str, Any]:
    """A detection: its box as shares of the picture's sides.

    Parameters:
        detection: of an image.
        size (pixels): width and height of the image.
    """
    best, box = _best(detection), detection.bbox
    x, y, width, height = box.center.position.x, box.center.position.y, box.size_x, box.size_y
    return {'x': number((x - 0.5 * width) / size[0], 4), 'y': number((y - 0.5 * height) / size[1], 4),
            'width': number(width / size[0], 4), 'height': number(height / size[1], 4),
            'name': best.class_id[:LONGEST_NAME], 'score': number(best.score)}
