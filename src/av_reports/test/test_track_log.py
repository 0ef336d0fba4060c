"""Logs of tracks, read by other programs' rules: RFC 4180 for tables, RFC 7946 for features."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_tracks import NOW, bearing, position
from test_report_messages import TIME, network, targets

from av_common.freshness import Instant
from av_common.stamps import to_stamp
from av_reports import Place, ReportSettings, ReportStage, Situation, TrackLog

PLACE = Place(51.5, -0.12, 30.0)
FORMULA = ('=', '+', '-', '@', '\t', '\r', '\n')    # beginnings of what spreadsheets compute (OWASP, CSV injection)


def seen(*tracks, place=PLACE):
    return Situation(tracks, place, (), False, NOW)


def files(folder):
    """The table and the features of a log."""
    return next(folder.glob('*.csv')), next(folder.glob('*.geojsonl'))


def logged(folder, *tracks, place=PLACE):
    """The geometries of tracks in a log of their own."""
    log = TrackLog(folder)
    log.report(seen(*tracks, place=place))
    log.close()
    return [json.loads(line)['geometry'] for line in files(folder)[1].read_text().splitlines()]


def haversine(first, second):
    """Great-circle distance (m) of two pairs of longitude and latitude (deg) on a sphere."""
    (a, b), (c, d) = [tuple(map(math.radians, point[:2])) for point in (first, second)]
    return 2 * 6371008.8 * math.asin(math.sqrt(math.sin((d - b) / 2)**2 + math.cos(b) * math.cos(d) * math.sin((c - a) / 2)**2))


def test_a_position_is_a_point_and_a_bearing_a_line_of_its_length_and_direction(tmp_path):
    point, line, ahead = logged(tmp_path / 'known', position(1), bearing(2, elevation=math.nan), bearing(3, north=False))
    assert point == {'type': 'Point', 'coordinates': [-0.12, 51.5, 80.0]} and ahead is None
    start, end = line['coordinates']
    assert start == [-0.12, 51.5, 30.0] and haversine(start, end) == pytest.approx(500.0, rel=5e-3)
    east, north = haversine(start, [end[0], start[1]]), haversine(start, [start[0], end[1]])
    assert end[0] < start[0] and math.degrees(math.atan2(-east, north)) % 360.0 == pytest.approx(300.0, abs=0.3)
    assert logged(tmp_path / 'unknown', position(1), bearing(2), place=None) == [point, None]


def test_table_and_features_say_the_same(tmp_path):
    log = TrackLog(tmp_path / 'new')
    log.report(seen(bearing(3), position(5)))
    log.report(seen(bearing(3, time=NOW + 0.5)))  # within a second
    log.report(seen(bearing(3, elevation=math.nan, drone_probability=math.nan, measured=0.0, time=NOW + 2.0), place=None))
    log.close()
    table, lines = files(tmp_path / 'new')
    with table.open(newline='') as file:
        rows = list(csv.DictReader(file))
    features = [json.loads(line) for line in lines.read_text().splitlines()]
    assert len(rows) == len(features) == log.written == 3
    for row, one in zip(rows, features, strict=True):
        known = {name: text for name, text in row.items() if text}
        assert known == {name: str(value) for name, value in one['properties'].items()}
    assert rows[0]['time'] == '2023-11-14T22:13:20.150Z' and rows[0]['azimuth_deg'] == '300.0' and rows[1]['latitude'] == '51.5'
    assert rows[2]['elevation_deg'] == rows[2]['drone_probability'] == rows[2]['measured'] == ''


@pytest.mark.parametrize('positions', [False, True])
def test_a_log_of_a_bag_has_the_times_of_the_recording(tmp_path, positions):
    """Whenever that is played, and at any rate."""
    log, stage = TrackLog(tmp_path), ReportStage(ReportSettings(positions=positions, north=False))
    for step in range(15):
        stamp, now = TIME + 0.1 + 0.4 * step, Instant(0.2 * step, TIME + 0.15 + 0.4 * step)
        played = 1.7e9 + 0.2 * step - now.ros
        if positions:
            message = network(measured=to_stamp(stamp - 0.1))
            message.header.stamp = to_stamp(stamp)
            stage.on_network_tracks(message, now, played)
        else:
            message = targets(last_heard=to_stamp(stamp - 0.1))
            message.header.stamp = to_stamp(stamp)
            stage.on_targets(message, now, played)
        log.report(stage.situation(now, played))
    log.close()
    with files(tmp_path)[0].open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['time'] for row in rows] == [f'1970-01-01T00:16:4{s}Z' for s in ('0.100', '1.300', '2.500', '3.700', '4.900')]
    assert rows[0]['measured'] == '1970-01-01T00:16:40.000Z'


def test_files_of_others_are_not_overwritten_and_their_size_is_limited(tmp_path):
    log = TrackLog(tmp_path, largest=10_000)
    for number in range(1000):
        log.report(seen(bearing(3, time=NOW + 2.0 * number)))
    log.close()
    assert 'reached its size' in log.problem() and log.written < 100
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) <= 10_000 + 1000
    TrackLog(tmp_path).close()
    assert len(list(tmp_path.glob('tracks_*.csv'))) == 2


def test_a_clock_that_is_set_back_and_a_full_disk_end_no_log(tmp_path, monkeypatch):
    log = TrackLog(tmp_path)
    log.report(seen(bearing(3)))
    log.report(seen(bearing(3, time=NOW - 3600.0)))
    assert log.written == 2
    log.close()
    log = TrackLog(tmp_path)
    log._table = Path('/dev/full').open('w')  # noqa: SIM115  the log closes it
    log.report(seen(bearing(3)))
    assert 'No space left' in log.problem()
    log.close()
    assert log._table.closed and log._features.closed


@given(st.text(max_size=30) | st.text(max_size=5).map('=HYPERLINK'.__add__))
def test_any_name_of_a_class_stays_within_its_field(tmp_path_factory, name):
    """Also one that a spreadsheet would compute, which is quoted in the table only."""
    folder = tmp_path_factory.mktemp('log')
    log = TrackLog(folder)
    log.report(seen(bearing(3, class_id=name, time=NOW), place=None))
    log.close()
    table, lines = files(folder)
    with table.open(newline='', encoding='utf-8') as file:
        row, = csv.DictReader(file)
    assert row['class_id'] == (f"'{name}" if name.startswith(FORMULA) else name) and row['id'] == '3'
    assert json.loads(lines.read_text(encoding='utf-8'))['properties'].get('class_id', '') == name
