"""Tasks of a fusion node: which are obeyed, and what they ask of the rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from av_common.geodesy import geodetic_to_enu
from av_reports.contacts import Command, Follow, LookAt, Place
from av_reports.identifiers import ObjectIds
from av_reports.sapient.protocol import Task, location, range_bearing

LONGEST_S = 3600.0  # a task without an end lasts this long at the most
KNOWN_PLACES = (location.LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M, location.LOCATION_DATUM_WGS84_E)
NEAREST_M = 1.0  # no direction to a place that is nearer


class RefusedTaskError(ValueError):
    """A task that is refused; the message says why."""


@dataclass(frozen=True)
class ActiveTask:
    """A task that the rig performs, or is to perform.

    Parameters:
        task_id: its ULID.
        asker: UUID of the fusion node that has asked for it.
        end (s): UTC since 1970.
        command: what it asks.
    """

    task_id: str
    asker: str
    end: float
    command: Command


def active_task(task: Any, asker: str, objects: ObjectIds, place: Place | None, now: float) -> ActiveTask:
    """What a task with control START asks of the rig. Raises RefusedTaskError for a task that it cannot perform.

    Parameters:
        task: a valid Task.
        asker: UUID of the fusion node that asks.
        objects: the objects that have been reported.
        place: where the rig stands; None while unknown.
        now (s): UTC since 1970.
    """
    start = _seconds(task.task_start_time) if task.HasField('task_start_time') else now
    end = _seconds(task.task_end_time) if task.HasField('task_end_time') else now + LONGEST_S
    if start > now + 1.0:
        raise RefusedTaskError('tasks that begin later are not supported')
    if end <= now:
        raise RefusedTaskError('the task has ended before it arrived')
    kind = task.command.WhichOneof('command')
    if task.region:
        command: Command = _region(task.region, kind)
    elif kind == 'follow':
        object_id = task.command.follow.follow_object_id
        track = objects.track(object_id)
        if track is None:
            raise RefusedTaskError(f'{object_id!r:.40} is no object that is tracked')
        command = Follow(track)
    elif kind == 'look_at':
        command = _look_at(task.command.look_at, place)
    else:
        raise RefusedTaskError(f'{kind or "a task without a command"} is not supported, only look_at and follow')
    return ActiveTask(task.task_id, asker, min(end, now + LONGEST_S), command)


def _seconds(stamp: Any) -> float:
    """A Timestamp in s; those of protobuf convert none that is out of its bounds."""
    return float(stamp.seconds + 1e-9 * stamp.nanos)


def _region(regions: Sequence[Any], kind: str | None) -> LookAt:
    """A region of interest is a direction to look at: the one kind of region that the registration offers."""
    first = regions[0]
    filtered, interest = first.class_filter or first.behaviour_filter, first.type == Task.REGION_TYPE_AREA_OF_INTEREST
    if len(regions) > 1 or kind or filtered or not interest:
        raise RefusedTaskError('of regions, one area of interest without filters and without a command is supported')
    if first.region_area.WhichOneof('fov_oneof') != 'range_bearing':
        raise RefusedTaskError('regions are understood as directions only')
    return _direction(first.region_area.range_bearing)


def _look_at(where: Any, place: Place | None) -> LookAt:
    if where.WhichOneof('fov_oneof') == 'range_bearing':
        return _direction(where.range_bearing)
    if len(where.location_list.locations) != 1:
        raise RefusedTaskError(f'look_at has {len(where.location_list.locations)} places, expected one')
    if place is None:
        raise RefusedTaskError('this node does not know where it stands')
    point = where.location_list.locations[0]
    if (point.coordinate_system, point.datum) != KNOWN_PLACES:
        raise RefusedTaskError('places are understood as latitude and longitude in degrees on the ellipsoid of WGS84 only')
    if not (abs(point.y) <= 90.0 and abs(point.x) <= 360.0 and point.HasField('z')):
        raise RefusedTaskError('the place needs a latitude, a longitude and an altitude')
    east, north, up = geodetic_to_enu((point.y, point.x, point.z), (place.latitude, place.longitude, place.altitude))
    if math.hypot(east, north, up) < NEAREST_M:
        raise RefusedTaskError('the place is that of this node')
    return LookAt(math.atan2(east, north) % math.tau, math.atan2(up, math.hypot(east, north)), True)


def _direction(cone: Any) -> LookAt:
    systems = {range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_DEGREES_M: math.pi / 180.0,
               range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_DEGREES_KM: math.pi / 180.0,
               range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_RADIANS_M: 1.0,
               range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_RADIANS_KM: 1.0}
    north = {range_bearing.RANGE_BEARING_DATUM_TRUE: True, range_bearing.RANGE_BEARING_DATUM_PLATFORM: False}
    if cone.coordinate_system not in systems or cone.datum not in north:
        raise RefusedTaskError('directions are understood in degrees or radians from true north or from the platform only')
    if not cone.HasField('azimuth'):
        raise RefusedTaskError('the direction has no azimuth')
    azimuth, elevation = systems[cone.coordinate_system] * cone.azimuth, systems[cone.coordinate_system] * cone.elevation
    if not abs(elevation) <= math.pi / 2:
        raise RefusedTaskError(f'the elevation is {math.degrees(elevation):.0f} deg, expected -90 to 90')
    return LookAt(azimuth % math.tau, elevation, north[cone.datum])
