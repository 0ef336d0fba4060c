"""Tasks of a fusion node: which are obeyed, what they ask of the rig, and the one that is performed.

It is accepted when the rig has begun it; a stop, its time, or the loss of its object end it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from av_common.geodesy import geodetic_to_enu
from av_reports.contacts import Command, Follow, LookAt, Place, Stop, is_due
from av_reports.identifiers import ObjectIds
from av_reports.sapient.encoder import LONGEST_REASON
from av_reports.sapient.protocol import Task, TaskAck, location, range_bearing

LONGEST_S = 3600.0  # a task without an end lasts this long at the most
KNOWN_PLACES = (location.LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M, location.LOCATION_DATUM_WGS84_E)
NEAREST_M = 1.0  # no direction to a place that is nearer
SETTLE_S = 5.0  # time in which the rig must have said whether it can
NO_TASKS = 'this node obeys no tasks: its parameter obey_tasks is false'


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


class Reaction(NamedTuple):
    """What follows from an event.

    Parameters:
        messages: to send, each without its length.
        command: what the rig is to do; None for nothing. `TaskDesk.on_done` must follow on Follow and LookAt.
    """

    messages: tuple[bytes, ...] = ()
    command: Command | None = None


class TaskDesk:
    """Decides about tasks; times are UTC in s since 1970.

    Attributes:
        active: the task that the rig performs; None for none.
        refused, accepted: numbers of tasks.

    Parameters:
        objects: the objects that have been reported.
        obey: whether any task is obeyed.
        pack: function of time (s), receiver (UUID) and content to the bytes of a message.
    """

    def __init__(self, objects: ObjectIds, obey: bool, pack: Callable[..., bytes]) -> None:
        self._objects, self._obey, self._pack = objects, obey, pack
        self._asked: tuple[ActiveTask, float] | None = None  # what the rig has not answered yet, and since when
        self.active: ActiveTask | None = None
        self.refused = self.accepted = 0

    def on_task(self, task: Any, asker: str, place: Place | None, now: float) -> Reaction:
        """Decide about a task.

        Parameters:
            task: a valid Task.
            asker: UUID of the fusion node that asks.
            place: where the rig stands; None while unknown.
            now (s): the time.
        """
        try:
            if not self._obey:
                raise RefusedTaskError(NO_TASKS)
            if task.control == Task.CONTROL_STOP:
                return self._stop(task.task_id, asker, now)
            if task.control != Task.CONTROL_START:
                raise RefusedTaskError('tasks can be started and stopped only')
            if self._asked:
                raise RefusedTaskError('another task is just beginning')
            wanted = active_task(task, asker, self._objects, place, now)
        except RefusedTaskError as error:
            return self.refuse(task.task_id, asker, str(error), now)
        self._asked = (wanted, now)
        return Reaction(command=wanted.command)

    def on_done(self, command: Command, reason: str, now: float) -> Reaction:
        """The rig has begun what it was asked to do, or cannot.

        Parameters:
            command: what it was asked; ignored unless it is the newest.
            reason: why it cannot; empty if it has begun.
            now (s): the time.
        """
        if self._asked is None or self._asked[0].command is not command:
            return Reaction()
        (begun, _), self._asked = self._asked, None
        if reason:
            return self.refuse(begun.task_id, begun.asker, reason, now)._replace(command=self._left)
        self.accepted += 1
        former, self.active = self.active, begun
        messages = [self.ack(begun.task_id, begun.asker, now, TaskAck.TASK_STATUS_ACCEPTED)]
        if former and former.task_id != begun.task_id:
            messages.insert(0, self.ack(former.task_id, former.asker, now, TaskAck.TASK_STATUS_COMPLETED,
                                        'another task has taken its place'))
        return Reaction(tuple(messages))

    def on_lost(self, track: int, now: float) -> Reaction:
        """A track is not reported any longer: who follows it has failed."""
        if self.active and self.active.command == Follow(track):
            return self._end(self.active, now, TaskAck.TASK_STATUS_FAILED, 'the object is lost')
        return Reaction()

    def on_time(self, now: float) -> Reaction:
        """End what has taken its time."""
        if self._asked and is_due(now, self._asked[1], SETTLE_S):
            return self.on_done(self._asked[0].command, 'the rig does not answer', now)
        if self.active and is_due(now, self.active.end - LONGEST_S, LONGEST_S):
            return self._end(self.active, now, TaskAck.TASK_STATUS_COMPLETED, 'its time is over')
        return Reaction()

    def abandon(self) -> Stop | None:
        """End the task without a word: nobody watches over it any longer. Returns what the rig is to do."""
        performing, self._asked, self.active = self._asked or self.active, None, None
        return Stop() if performing else None

    @property
    def _left(self) -> Command | None:
        """What the rig is to do where a task has ended: the one that remains, or nothing; None while another is beginning."""
        return None if self._asked else self.active.command if self.active else Stop()

    def _stop(self, task_id: str, asker: str, now: float) -> Reaction:
        if self._asked and self._asked[0].task_id == task_id:
            self._asked = None
        elif self.active and self.active.task_id == task_id:
            self.active = None
        else:
            raise RefusedTaskError('this node does not perform that task')
        return Reaction((self.ack(task_id, asker, now, TaskAck.TASK_STATUS_COMPLETED, 'stopped'),), self._left)

    def _end(self, task: ActiveTask, now: float, status: int, reason: str) -> Reaction:
        self.active = None
        return Reaction((self.ack(task.task_id, task.asker, now, status, reason),), self._left)

    def refuse(self, task_id: str, asker: str, reason: str, now: float) -> Reaction:
        """Refuse a task, see `ack`."""
        self.refused += 1
        return Reaction((self.ack(task_id, asker, now, TaskAck.TASK_STATUS_REJECTED, reason),))

    def ack(self, task_id: str, asker: str, now: float, status: int, reason: str = '') -> bytes:
        """The TaskAck of a task.

        Parameters:
            task_id: its ULID.
            asker: UUID of the fusion node that has asked for it.
            now (s): the time.
            status: one of TaskAck.TASK_STATUS_*.
            reason: why it was refused, or has failed or ended.
        """
        return self._pack(now, asker, task_ack=TaskAck(task_id=task_id, task_status=status,
                                                       reason=[reason[:LONGEST_REASON]] if reason else []))
