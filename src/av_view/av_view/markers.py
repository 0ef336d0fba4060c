"""What is known of a rig as markers in its body frame, for RViz, Foxglove and other viewers of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import ColorRGBA, Header
from transforms3d.quaternions import mat2quat
from visualization_msgs.msg import Marker, MarkerArray

from av_common.angles import angles_to_direction
from av_common.pose_messages import quaternion_message, vector_message
from av_fusion.measurement.measurements import Cone, DoaMeasurement

REACH = 10.0  # m, length of directions whose range is unknown
STEPS = 48  # points of a circle
WORLD_ID = 1 << 20  # after the ids of all others
COLORS = {'sight': (0.1, 0.7, 0.3), 'sound': (0.95, 0.6, 0.1), 'coasting': (0.5, 0.55, 0.6), 'truth': (0.65, 0.4, 0.85),
          'track': (0.2, 0.55, 0.9)}


def markers(snapshot: dict[str, Any], sound: Sequence[DoaMeasurement], frame: str) -> MarkerArray:
    """The bearing with its sector of one standard deviation, cones and directions of sound, tracks, truth, field of view.

    All replace those before; their stamps are 0, the newest transform.

    Parameters:
        snapshot: of `RigState`.
        sound: directions of arrival in the body frame, which are drawn while the snapshot has some.
        frame: name of the body frame.
    """
    made = [Marker(action=Marker.DELETEALL), *_bearing(snapshot['bearing']),
            *_heard(sound if snapshot['sound'] else ()), *_tracks(snapshot['tracks']),
            *_truth(snapshot['truth']), *_view(snapshot['cameras'])]
    for number, marker in enumerate(made):
        marker.header, marker.id = Header(frame_id=frame), number
        marker.pose.orientation.w = 1.0
    return MarkerArray(markers=made)


def world_markers(message: Any) -> Iterable[Marker]:
    """The ellipsoids of one standard deviation of positions, in their common frame; ids begin at WORLD_ID.

    Parameters:
        message: a `WorldTrackArray`.
    """
    for track in message.tracks:
        covariance = np.asarray(track.position_covariance, float).reshape(3, 3)
        covariance = 0.5 * (covariance + covariance.T)
        center = np.array([track.position.x, track.position.y, track.position.z])
        if track.positioned and np.isfinite(covariance).all() and np.isfinite(center).all():
            variances, axes = np.linalg.eigh(covariance)
            axes[:, 0] *= np.linalg.det(axes)  # a rotation, no reflection
            marker = _shape('ellipsoids', Marker.SPHERE, [], COLORS['track'], 0.0, 0.5)
            marker.header, marker.id = Header(frame_id=message.header.frame_id), WORLD_ID + int(track.id) % WORLD_ID
            marker.pose.position = _point(center)
            marker.pose.orientation = quaternion_message(mat2quat(axes))
            marker.scale = vector_message(2.0 * np.sqrt(np.maximum(variances, 0.0)))
            yield marker


def _bearing(bearing: dict[str, Any] | None) -> Iterable[Marker]:
    if bearing is None or bearing['state'] == 'none':
        return
    color, length = COLORS[bearing['state']], bearing['range'] or REACH
    elevation = bearing['elevation'] or 0.0
    yield _arrow('bearing', _directions([bearing['azimuth']], elevation, length)[0], color)
    if bearing['sigma'] is not None:
        edges = np.linspace(bearing['azimuth'] - bearing['sigma'], bearing['azimuth'] + bearing['sigma'], 9)
        rim = _directions(edges, elevation, length)
        corners = [corner for left, right in pairwise(rim) for corner in (np.zeros(3), left, right)]
        yield _shape('sigma', Marker.TRIANGLE_LIST, corners, color, 1.0, 0.3)


def _heard(sound: Sequence[DoaMeasurement]) -> Iterable[Marker]:
    for doa in sound:
        alpha = 0.3 + 0.6 * doa.confidence
        if doa.cone is not None:
            yield _shape('cones', Marker.LINE_STRIP, REACH * _circle(doa.cone), COLORS['sound'], 0.03, alpha)
        for image in doa.hypotheses:
            end = _directions([math.degrees(image.azimuth)], math.degrees(image.elevation), REACH)[0]
            yield _shape('sound', Marker.LINE_STRIP, [np.zeros(3), end], COLORS['sound'], 0.05, alpha)


def _circle(cone: Cone) -> NDArray[np.float64]:
    """Unit vectors (STEPS + 1, 3) on a cone."""
    axis = np.array(cone.axis)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, math.tau, STEPS + 1)[:, None]
    ring = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    return math.cos(cone.angle) * axis + math.sin(cone.angle) * ring


def _tracks(tracks: Iterable[dict[str, Any]]) -> Iterable[Marker]:
    for track in tracks:
        if None not in (track['azimuth'], track['elevation']):
            end = _directions([track['azimuth']], track['elevation'], track['range'] or REACH)[0]
            yield _arrow('tracks', end, COLORS['track'], 1.0 if track['selected'] else 0.5)
            label = _shape('names', Marker.TEXT_VIEW_FACING, [], COLORS['track'], 0.5)
            label.text, label.scale.z = f'#{track["id"]} {track["name"]}', 0.5
            label.pose.position = _point(end)
            yield label


def _truth(targets: Iterable[dict[str, Any]]) -> Iterable[Marker]:
    points = [_directions([one['azimuth']], one['elevation'], one['range'])[0] for one in targets
              if None not in (one['azimuth'], one['elevation'], one['range'])]
    if points:
        yield _shape('truth', Marker.SPHERE_LIST, points, COLORS['truth'], 0.4)


def _view(cameras: Iterable[dict[str, Any]]) -> Iterable[Marker]:
    for camera in cameras:
        left, right = _directions([camera['azimuth'] + 0.5 * camera['view'], camera['azimuth'] - 0.5 * camera['view']],
                                  camera['elevation'], REACH)
        yield _shape('view', Marker.LINE_STRIP, [left, np.zeros(3), right], COLORS['sight'], 0.03, 0.5)


def _directions(azimuths_deg: ArrayLike, elevation_deg: float, length: float) -> NDArray[np.float64]:
    """Points (n, 3) at a distance in directions, in degrees."""
    azimuth = np.radians(np.asarray(azimuths_deg, float))
    return length * angles_to_direction(azimuth, np.full(len(azimuth), math.radians(elevation_deg)))


def _arrow(name: str, end: NDArray, color: Sequence[float], alpha: float = 1.0) -> Marker:
    marker = _shape(name, Marker.ARROW, [np.zeros(3), end], color, 0.08, alpha)
    marker.scale = Vector3(x=0.08, y=0.25, z=0.5)  # of the shaft, and width and length of the head
    return marker


def _shape(name: str, kind: int, points: Iterable[NDArray], color: Sequence[float], size: float, alpha: float = 1.0) -> Marker:
    red, green, blue = color
    return Marker(ns=name, type=kind, points=[_point(point) for point in points], scale=Vector3(x=size, y=size, z=size),
                  color=ColorRGBA(r=red, g=green, b=blue, a=float(alpha)))


def _point(at: NDArray) -> Point:
    x, y, z = map(float, at)
    return Point(x=x, y=y, z=z)
