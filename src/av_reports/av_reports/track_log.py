"""Tracks in files that spreadsheets and maps read: CSV, and GeoJSON (RFC 7946)."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from av_common.geodesy import enu_to_geodetic
from av_reports.contacts import SENSOR_RANGE_M, BearingTrack, Place, PositionTrack, compass_deg, is_due
from av_reports.stage import Situation

FIELDS = ('time', 'id', 'class_id', 'existence', 'drone_probability', 'azimuth_deg', 'azimuth_sigma_deg', 'true_north',
          'elevation_deg', 'elevation_sigma_deg', 'latitude', 'longitude', 'altitude_m', 'east_sigma_m', 'north_sigma_m',
          'up_sigma_m', 'east_m_s', 'north_m_s', 'up_m_s', 'measured')
LARGEST = 500_000_000  # bytes
FORMULA = ('=', '+', '-', '@', '\t', '\r', '\n')  # beginnings of what spreadsheets compute (OWASP, CSV injection)
Tracked = BearingTrack | PositionTrack


def properties(track: Tracked) -> dict[str, Any]:
    """What is known of a track, by the names of FIELDS; what is unknown is left out."""
    known = {'time': _iso(track.time), 'id': track.id, 'class_id': track.class_id, 'existence': round(track.existence, 4),
             'drone_probability': _round(track.drone_probability, 4),
             'measured': _iso(track.measured) if track.measured else ''}
    if isinstance(track, BearingTrack):
        known |= {'azimuth_deg': compass_deg(track.azimuth, 3), 'azimuth_sigma_deg': _degrees(track.azimuth_sigma),
                  'true_north': track.north, 'elevation_deg': _degrees(track.elevation),
                  'elevation_sigma_deg': _degrees(track.elevation_sigma)}
    else:
        known |= {'latitude': round(track.latitude, 8), 'longitude': round(track.longitude, 8),
                  'altitude_m': round(track.altitude, 3)}
        known |= {f'{name}_sigma_m': _round(value, 3) for name, value in zip(('east', 'north', 'up'), track.sigma, strict=True)}
        known |= {f'{name}_m_s': _round(value, 3) for name, value in zip(('east', 'north', 'up'), track.velocity, strict=True)}
    return {name: value for name, value in known.items() if value not in ('', None)}


def feature(track: Tracked, place: Place | None) -> dict[str, Any]:
    """A feature of GeoJSON: a point, or a line in the direction of a bearing; without geometry where that is not known.

    The line is SENSOR_RANGE_M long, as the distance of the target is not known.

    Parameters:
        track: the target.
        place: where the rig stands that has the bearing; None while unknown.
    """
    geometry: dict[str, Any] | None = None
    if isinstance(track, PositionTrack):
        geometry = {'type': 'Point', 'coordinates': _coordinates(track.latitude, track.longitude, track.altitude)}
    elif place is not None and track.north:
        elevation = track.elevation if math.isfinite(track.elevation) else 0.0
        across = SENSOR_RANGE_M * math.cos(elevation)
        offset = (across * math.sin(track.azimuth), across * math.cos(track.azimuth), SENSOR_RANGE_M * math.sin(elevation))
        end = enu_to_geodetic(offset, (place.latitude, place.longitude, place.altitude))
        geometry = {'type': 'LineString', 'coordinates': [_coordinates(*place[:3]), _coordinates(*end)]}
    return {'type': 'Feature', 'geometry': geometry, 'properties': properties(track)}


class TrackLog:
    """A table and a sequence of features, at most one line for each track and second.

    `tracks_TIME.csv` has the columns FIELDS. `tracks_TIME.geojsonl` has a feature of GeoJSON in each line, as GDAL and QGIS
    read it. The files grow while they are written. Times are those of the stamps: of a bag, those of its recording.

    Attributes:
        written: number of lines in each.

    Parameters:
        folder: of both files; it is created where it is missing.
        largest: bytes that both files together may have, but for one more line.

    Raises OSError where they cannot be written.
    """

    def __init__(self, folder: Path, largest: float = LARGEST) -> None:
        self._stem, self._largest = folder / f'tracks_{datetime.now(timezone.utc):%Y%m%dT%H%M%S_%f}', largest
        self.written, self._problem = 0, ''
        self._newest: dict[int, float] = {}
        folder.mkdir(parents=True, exist_ok=True)
        self._table = self._stem.with_name(f'{self._stem.name}.csv').open('x', encoding='utf-8', newline='')
        self._features = self._stem.with_name(f'{self._stem.name}.geojsonl').open('x', encoding='utf-8')
        csv.writer(self._table).writerow(FIELDS)

    def report(self, situation: Situation) -> None:
        """Write the tracks that are due."""
        self._newest = {track.id: self._newest.get(track.id, -math.inf) for track in situation.stamped}
        due = [track for track in situation.stamped if is_due(track.time, self._newest[track.id], 1.0)]
        self._newest |= {track.id: track.time for track in due}
        try:
            self._write(due, situation.place)
        except OSError as error:
            self._problem = f'{self._stem}.csv: {error.strerror}'

    def problem(self) -> str:
        """Why nothing is written any more."""
        return self._problem

    def values(self) -> dict[str, object]:
        """Where, and how many."""
        return {'files': f'{self._stem}.*', 'written': self.written}

    def close(self) -> None:
        """Close both files, also on a full disk, of which `problem` tells."""
        for file in (self._table, self._features):
            with suppress(OSError):
                file.close()

    def _write(self, tracks: Iterable[Tracked], place: Place | None) -> None:
        for track in tracks:
            is_full = self._table.tell() + self._features.tell() > self._largest
            self._problem = f'{self._stem}.csv has reached its size' if is_full else ''
            if is_full:
                return
            found = feature(track, place)
            csv.writer(self._table).writerow([_cell(found['properties'].get(name, '')) for name in FIELDS])
            self._features.write(json.dumps(found, separators=(',', ':'), allow_nan=False) + '\n')
            self.written += 1
        self._table.flush()
        self._features.flush()


def _cell(value: Any) -> Any:
    """A value for the table; a text that is a formula to spreadsheets is quoted: names of classes come from anybody."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def _coordinates(latitude: float, longitude: float, altitude: float) -> list[float]:
    return [round(longitude, 8), round(latitude, 8), round(altitude, 3)]


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec='milliseconds').replace('+00:00', 'Z')


def _degrees(angle: float) -> float | None:
    return _round(math.degrees(angle), 3)


def _round(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
