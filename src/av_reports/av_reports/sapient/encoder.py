"""Messages of SAPIENT about tracks and about the node itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from av_common.geodesy import enu_to_geodetic
from av_reports.contacts import LIKELY, BearingTrack, Place, PositionTrack, compass_deg
from av_reports.identifiers import new_ulid
from av_reports.sapient.protocol import (
    DetectionReport,
    Location,
    RangeBearing,
    SapientMessage,
    StatusReport,
    location,
    range_bearing,
)
from av_reports.sapient.registration import MODE
from av_reports.settings import CLASSES, UNKNOWN_CLASS

LOST = 'lost'  # state of the last report of an object
LONGEST_REASON = 200  # characters


def envelope(node_id: str, time: float, destination: str = '', **content: Any) -> Any:
    """A SapientMessage.

    Parameters:
        node_id: UUID of the sender.
        time (s): UTC since 1970.
        destination: UUID of the receiver; empty for none.
        content: the message in it, by the name of its field, such as `task_ack`.
    """
    message = SapientMessage(node_id=node_id, destination_id=destination or None, **content)
    message.timestamp.FromNanoseconds(round(time * 1e6) * 1000)
    return message


def bearing_report(track: BearingTrack, object_id: str, time: float, lost: bool = False) -> Any:
    """The DetectionReport of a direction, in degrees and without a range.

    Parameters:
        track: the direction.
        object_id: ULID of the object.
        time (s): UTC since 1970 of this report.
        lost: whether it is the last report of the object.
    """
    datum = range_bearing.RANGE_BEARING_DATUM_TRUE if track.north else range_bearing.RANGE_BEARING_DATUM_PLATFORM
    where = RangeBearing(
        azimuth=compass_deg(track.azimuth), azimuth_error=math.degrees(track.azimuth_sigma), datum=datum,
        coordinate_system=range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_DEGREES_M)
    if math.isfinite(track.elevation) and math.isfinite(track.elevation_sigma):
        where.elevation, where.elevation_error = math.degrees(track.elevation), math.degrees(track.elevation_sigma)
    report = _report(track, object_id, time, lost, track.existence * track.front_back)
    report.range_bearing.CopyFrom(where)
    _inform(report, 'front_back_probability', track.front_back)
    return report


def position_report(track: PositionTrack, object_id: str, time: float, lost: bool = False) -> Any:
    """The DetectionReport of a position and a velocity.

    Parameters:
        track: the position.
        object_id, time, lost: as of `bearing_report`.
    """
    report = _report(track, object_id, time, lost, track.existence)
    report.location.CopyFrom(location_message(Place(track.latitude, track.longitude, track.altitude), track.sigma))
    for name, value, error in zip(('east', 'north', 'up'), track.velocity, track.velocity_sigma, strict=True):
        setattr(report.enu_velocity, f'{name}_rate', value)
        if math.isfinite(error):
            setattr(report.enu_velocity, f'{name}_rate_error', error)
    return report


def location_message(place: Place, sigma: Sequence[float] = ()) -> Any:
    """The Location of a place; its errors are in the units of their coordinates.

    Parameters:
        place: latitude, longitude and altitude.
        sigma (m, 3): standard deviations to the east, north and up; empty for the place's own.
    """
    found = Location(x=place.longitude, y=place.latitude, z=place.altitude, datum=location.LOCATION_DATUM_WGS84_E,
                     coordinate_system=location.LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M)
    east, north, up = sigma or (place.sigma,) * 3
    if all(map(math.isfinite, (east, north, up))):
        latitude, found.x_error, _ = enu_to_geodetic((east, north, 0.0), (place.latitude, 0.0, 0.0))
        found.y_error, found.z_error = abs(latitude - place.latitude), up
    return found


def status_report(time: float, changed: bool, place: Place | None, problems: Iterable[str], *, error: bool = False,
                  goodbye: bool = False, task_id: str = '') -> Any:
    """The StatusReport of a node.

    Parameters:
        time (s): UTC since 1970.
        changed: something is different from the last report.
        place: where the node stands; None while unknown.
        problems: what is wrong, in words.
        error: whether the node detects nothing because of it.
        goodbye: whether the node is about to disconnect.
        task_id: ULID of the task that it performs; empty for none.
    """
    words = list(problems)
    system = (StatusReport.SYSTEM_GOODBYE if goodbye else StatusReport.SYSTEM_ERROR if error
              else StatusReport.SYSTEM_WARNING if words else StatusReport.SYSTEM_OK)
    level = StatusReport.STATUS_LEVEL_ERROR_STATUS if error else StatusReport.STATUS_LEVEL_WARNING_STATUS
    kind = StatusReport.STATUS_TYPE_NOT_DETECTING if error else StatusReport.STATUS_TYPE_INTERNAL_FAULT
    return StatusReport(
        report_id=new_ulid(time), system=system, info=StatusReport.INFO_NEW if changed else StatusReport.INFO_UNCHANGED,
        mode=MODE, active_task_id=task_id or None, node_location=location_message(place) if place else None,
        status=[StatusReport.Status(status_level=level, status_type=kind, status_value=text[:LONGEST_REASON])
                for text in words])


def _report(track: BearingTrack | PositionTrack, object_id: str, time: float, lost: bool, confidence: float) -> Any:
    report = DetectionReport(report_id=new_ulid(time), object_id=object_id, state=LOST if lost else None,
                             detection_confidence=confidence)
    _classify(report, track)
    if math.isfinite(track.drone_probability):
        _inform(report, 'drone_probability', track.drone_probability)
    if track.measured > 0.0:
        _inform(report, 'measured', track.time - track.measured)
    return report


def _classify(report: Any, track: BearingTrack | PositionTrack) -> None:
    """Add the class; a name that is none of CLASSES is a type of drones, where the target probably is one."""
    is_drone = track.drone_probability >= LIKELY and track.class_id not in set(CLASSES) - {'drone'}
    kind, finer = CLASSES.get('drone' if is_drone else track.class_id, (UNKNOWN_CLASS, ''))
    found = report.classification.add(type=kind)
    if is_drone:
        found.confidence = track.drone_probability
    if finer:
        found.sub_class.add(type=finer, level=1)
    if track.class_id and track.class_id not in CLASSES:
        report.object_info.add(type='type', value=track.class_id[:LONGEST_REASON])


def _inform(report: Any, name: str, value: float) -> None:
    report.track_info.add(type=name, value=f'{value:.3f}')
