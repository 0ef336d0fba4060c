"""Tracks in, events of Cursor on Target out (MITRE MTR 04W0000087, schema 2.0), as XML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timezone
from xml.etree import ElementTree as ET

import numpy as np

from av_reports.contacts import SENSOR_RANGE_M, BearingTrack, Place, PositionTrack, compass_deg, is_due
from av_reports.identifiers import ObjectIds

RIG_INTERVAL_S, INTERVAL_S = 10.0, 0.99  # between two events of the rig, and of a target: a little less than a period
RIG_STALE_S, STALE_S = 120.0, 10.0  # time after which an event is no longer shown
TARGET_TYPE = 'a-u-A-M-H-Q'  # with a position: unknown, air, military, rotary wing, drone
RIG_TYPE = 'a-f-G-E-S'  # friendly, ground, equipment, sensor
UNKNOWN_M = 9999999.0  # by convention of the schema
COVERED_SIGMA = 2.0  # to each side of a bearing that is drawn
NARROWEST_DEG = 1.0  # of a drawn sector
SENSOR_TYPE = 'b-m-p-s-p-loc'  # a sensor with its field of view
HOW_FUSED, HOW_GNSS, HOW_ESTIMATED = 'm-f', 'm-g', 'h-e'


def position_event(track: PositionTrack, uid: str, callsign: str, now: float) -> bytes:
    """The event of a target with a position.

    `ce` and `le` are standard deviations, as the schema defines them; the ellipse of one standard deviation is in `shape`.

    Parameters:
        track: the target.
        uid: of the target.
        callsign: of the rig.
        now (s): UTC since 1970.
    """
    east_sigma, north_sigma, up_sigma = track.sigma
    point = (track.latitude, track.longitude, track.altitude, math.hypot(east_sigma, north_sigma) / math.sqrt(2.0), up_sigma)
    event, detail = _event(uid, TARGET_TYPE, HOW_FUSED, point, (now, min(track.time, now), now + STALE_S))
    _contact(detail, f'{callsign} {track.id}', _words(track))
    east, north, up = track.velocity
    speed = math.hypot(east, north)
    ET.SubElement(detail, 'track', course=_number(compass_deg(math.atan2(east, north), 1), 1), speed=_number(speed, 2),
                  slope=_number(math.degrees(math.atan2(up, speed)), 1))
    major, minor, angle = error_ellipse(np.array(track.covariance)[:2, :2])
    ET.SubElement(ET.SubElement(detail, 'shape'), 'ellipse', major=_number(major, 2), minor=_number(minor, 2),
                  angle=_number(angle, 1))
    return _serialised(event)


def rig_event(place: Place, uid: str, callsign: str, now: float) -> bytes:
    """The event of the rig itself.

    Parameters:
        place: where it stands.
        uid, callsign: of the rig.
        now (s): UTC since 1970.
    """
    how = HOW_ESTIMATED if place.surveyed else HOW_GNSS
    event, detail = _event(uid, RIG_TYPE, how, _point(place), (now, now, now + RIG_STALE_S))
    _contact(detail, callsign)
    return _serialised(event)


def bearing_event(track: BearingTrack, place: Place, uid: str, callsign: str, now: float) -> bytes:
    """The event of a target of which only the direction is known: a sensor at the rig's place that looks there.

    Parameters:
        track: the target.
        place: where the rig stands.
        uid: of the target.
        callsign: of the rig.
        now (s): UTC since 1970.
    """
    event, detail = _event(uid, SENSOR_TYPE, HOW_FUSED, _point(place), (now, min(track.time, now), now + STALE_S))
    _contact(detail, f'{callsign} {track.id}', _words(track))
    sector = max(math.degrees(2.0 * COVERED_SIGMA * track.azimuth_sigma), NARROWEST_DEG)
    sensor = ET.SubElement(detail, 'sensor', azimuth=_number(compass_deg(track.azimuth, 1), 1),
                           fov=_number(min(sector, 360.0), 1), range=_number(SENSOR_RANGE_M, 0), roll='0.0',
                           displayMagneticReference='0', model=_text(callsign))
    if math.isfinite(track.elevation) and math.isfinite(track.elevation_sigma):
        height = max(math.degrees(2.0 * COVERED_SIGMA * track.elevation_sigma), NARROWEST_DEG)
        sensor.set('elevation', _number(math.degrees(track.elevation), 1))
        sensor.set('vfov', _number(min(height, 180.0), 1))
    return _serialised(event)


def error_ellipse(covariance: np.ndarray) -> tuple[float, float, float]:
    """Semi-axes (m) of the ellipse of one standard deviation, and the angle (deg) of the longer one, clockwise from north.

    Parameters:
        covariance (m^2, (2, 2)): of east and north.
    """
    values, vectors = np.linalg.eigh(covariance)
    east, north = vectors[:, 1]
    minor, major = np.sqrt(np.maximum(values, 0.0))
    return float(major), float(minor), math.degrees(math.atan2(east, north)) % 180.0


def _event(uid: str, kind: str, how: str, point: tuple[float, ...], times: tuple[float, float, float]
           ) -> tuple[ET.Element, ET.Element]:
    """An event and its empty detail; `times` are those of time, start and stale."""
    time, start, stale = map(_time, times)
    event = ET.Element('event', version='2.0', uid=_text(uid), type=_text(kind), how=how, time=time, start=start, stale=stale)
    latitude, longitude, altitude, circular, linear = point
    ET.SubElement(event, 'point', lat=_number(latitude, 7), lon=_number(longitude, 7), hae=_number(altitude, 2),
                  ce=_number(circular, 1), le=_number(linear, 1))
    return event, ET.SubElement(event, 'detail')


def _point(place: Place) -> tuple[float, ...]:
    error = place.sigma if math.isfinite(place.sigma) else UNKNOWN_M
    return place.latitude, place.longitude, place.altitude, error, error


def _contact(detail: ET.Element, callsign: str, remarks: str = '') -> None:
    ET.SubElement(detail, 'contact', callsign=_text(callsign))
    if remarks:
        ET.SubElement(detail, 'remarks').text = remarks


def _words(track: BearingTrack | PositionTrack) -> str:
    """What people read of a target."""
    drone = f', drone {track.drone_probability:.2f}' if math.isfinite(track.drone_probability) else ''
    return _text(f'{track.class_id or "unknown"}, existence {track.existence:.2f}{drone}')


def _time(seconds: float) -> str:
    moment = datetime.fromtimestamp(seconds, timezone.utc)
    return f'{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z'


def _number(value: float, digits: int) -> str:
    if not math.isfinite(value):
        raise ValueError(f'{value} has no place in an event')
    return f'{value:.{digits}f}'


def _text(words: str) -> str:
    """A text without the characters that XML 1.0 cannot hold."""
    return ''.join(letter for letter in words if letter in '\t\n' or ' ' <= letter < '\ud800' or '\ue000' <= letter < '\ufffe'
                   or letter > '\uffff')


def _serialised(event: ET.Element) -> bytes:
    return ET.tostring(event, encoding='UTF-8', xml_declaration=True)


class CotStage:
    """Events of the rig, of the bearings at its place, and of positions. Times are UTC in s since 1970.

    Parameters:
        uid: names this rig; the uid of each target begins with it.
        callsign: what users of TAK read beside the rig's marker.
    """

    def __init__(self, uid: str, callsign: str) -> None:
        self._uid, self._callsign = uid, callsign
        self._objects = ObjectIds()
        self._sent: dict[int, float] = {}
        self._rig_sent = -math.inf

    def on_tracks(self, tracks: Sequence[BearingTrack | PositionTrack], place: Place | None, now: float) -> list[bytes]:
        """The events that are due.

        Parameters:
            tracks: the targets; bearings that do not count from true north are left out.
            place: where the rig stands; None while unknown, which leaves out all bearings.
            now (s): the time.
        """
        events = []
        if place is not None and is_due(now, self._rig_sent, RIG_INTERVAL_S):
            self._rig_sent = now
            events.append(rig_event(place, self._uid, self._callsign, now))
        self._sent = {track.id: self._sent.get(track.id, -math.inf) for track in tracks}
        for track in tracks:
            uid = f'{self._uid}.{self._objects.ulid(track.id, now)}'
            if not is_due(now, self._sent[track.id], INTERVAL_S):
                continue
            if isinstance(track, PositionTrack):
                events.append(position_event(track, uid, self._callsign, now))
            elif track.north and place is not None:
                events.append(bearing_event(track, place, uid, self._callsign, now))
            self._sent[track.id] = now
        return events
