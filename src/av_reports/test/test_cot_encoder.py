"""Events of Cursor on Target, read by another parser and held against the rules of its schema."""

from __future__ import annotations

import math
import re
from datetime import datetime
from xml.dom import minidom

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_tracks import NOW, bearing, position

from av_reports import Place
from av_reports.cot.stage import CotStage, bearing_event, error_ellipse, position_event, rig_event

PLACE = Place(51.5, -0.12, 30.0, 1.5)
NAMES = 'rig-1', 'mast'
DETAIL = {'contact', 'remarks', 'track', 'shape', 'sensor'}


def read(data):
    """Attributes of event, point and details, after the rules of the schema (Event.xsd, 2.0) have been checked."""
    event = minidom.parseString(data).documentElement
    attributes = dict(event.attributes.items())
    assert event.tagName == 'event' and attributes['version'] == '2.0' and attributes['uid']
    assert re.fullmatch(r'\w+(-\w+)*(;[^;]*)?', attributes['type']) and re.fullmatch(r'\w(-\w+)*', attributes['how'])
    time, start, stale = (instant(attributes[name]) for name in ('time', 'start', 'stale'))
    assert start <= time < stale
    point, detail = [child for child in event.childNodes if child.nodeType == child.ELEMENT_NODE]
    where = {name: float(value) for name, value in point.attributes.items()}
    assert point.tagName == 'point' and set(where) == {'lat', 'lon', 'hae', 'ce', 'le'}
    assert abs(where['lat']) <= 90.0 and abs(where['lon']) <= 180.0 and where['ce'] >= 0.0 and where['le'] >= 0.0
    assert detail.tagName == 'detail' and {child.tagName for child in detail.childNodes} <= DETAIL
    return attributes | where | {'stale_s': stale - time, 'details': {child.tagName: child for child in detail.childNodes}}


def instant(text):
    assert re.fullmatch(r'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z', text)
    return datetime.fromisoformat(text.replace('Z', '+00:00')).timestamp()


def values(element):
    return {name: float(value) for name, value in element.attributes.items() if name != 'model'}


def test_a_position_has_its_errors_its_ellipse_and_its_motion():
    event = read(position_event(position(), 'rig-1.5', 'mast', NOW))
    assert (event['uid'], event['type'], event['how']) == ('rig-1.5', 'a-u-A-M-H-Q', 'm-f')
    assert event['stale_s'] == pytest.approx(10.0)
    assert (event['lat'], event['lon'], event['hae']) == (51.5, -0.12, 80.0)
    assert (event['ce'], event['le']) == (pytest.approx(math.sqrt(6.5), abs=0.05), 1.0)
    motion = values(event['details']['track'])
    assert motion['course'] == pytest.approx(math.degrees(math.atan2(1.0, -2.0)), abs=0.1) and motion['speed'] == 2.24
    ellipse = values(event['details']['shape'].firstChild)
    assert ellipse['major'] == pytest.approx(math.sqrt(6.5 + math.sqrt(7.25)), abs=0.01)
    assert ellipse['minor'] == pytest.approx(math.sqrt(6.5 - math.sqrt(7.25)), abs=0.01)
    assert ellipse['angle'] == pytest.approx(0.5 * math.degrees(math.atan2(2.0, 5.0)), abs=0.1)


@pytest.mark.parametrize('angle', [0.0, 30.0, 90.0, 135.0])
def test_the_ellipse_contains_what_a_gaussian_says(angle):
    long, short, turn = 8.0, 2.0, math.radians(angle)
    axes = np.array([[math.sin(turn), math.cos(turn)], [math.cos(turn), -math.sin(turn)]])    # of the longer, of the shorter
    covariance = axes.T @ np.diag([long**2, short**2]) @ axes
    assert error_ellipse(covariance) == pytest.approx((long, short, angle), abs=1e-6)
    points = np.random.default_rng(1).multivariate_normal([0.0, 0.0], covariance, 100_000) @ axes.T
    inside = np.mean((points[:, 0] / long)**2 + (points[:, 1] / short)**2 <= 1.0)
    assert inside == pytest.approx(1.0 - math.exp(-0.5), abs=0.01)


def test_the_rig_is_where_it_stands():
    event = read(rig_event(PLACE, *NAMES, NOW))
    assert (event['uid'], event['type'], event['how'], event['ce']) == ('rig-1', 'a-f-G-E-S', 'h-e', 1.5)
    idle = read(rig_event(PLACE._replace(sigma=math.nan, surveyed=False), *NAMES, NOW))
    assert 'sensor' not in idle['details'] and idle['ce'] == 9999999.0 and idle['how'] == 'm-g'


@pytest.mark.parametrize('azimuth', [-1e-17, 0.0, math.radians(359.97), math.tau])
def test_due_north_is_zero(azimuth):
    event = read(bearing_event(bearing(azimuth=azimuth), PLACE, 'rig-1.3', 'mast', NOW))
    assert event['details']['sensor'].getAttribute('azimuth') == '0.0'


def test_a_bearing_is_a_sector():
    event = read(bearing_event(bearing(), PLACE, 'rig-1.3', 'mast', NOW))
    sensor = values(event['details']['sensor'])
    assert sensor == {'azimuth': 300.0, 'fov': 8.0, 'elevation': 12.0, 'vfov': 16.0, 'range': 500.0, 'roll': 0.0,
                      'displayMagneticReference': 0.0}


def test_a_bearing_is_a_sensor_at_the_rig():
    event = read(bearing_event(bearing(elevation=math.nan, azimuth_sigma=3.0), PLACE, 'rig-1.3', 'mast', NOW))
    assert (event['lat'], event['type']) == (51.5, 'b-m-p-s-p-loc')
    sensor = values(event['details']['sensor'])
    assert 'elevation' not in sensor and sensor['fov'] == 360.0


def test_events_are_due_at_their_interval_under_a_lasting_name():
    stage = CotStage(*NAMES)
    tracks = [bearing(3), bearing(4), position(5)]
    first = {event['uid']: event for event in map(read, stage.on_tracks(tracks, PLACE, NOW))}
    assert len(first) == 4 and 'sensor' not in first['rig-1']['details']
    assert stage.on_tracks(tracks, PLACE, NOW + 0.5) == []
    again = {event['uid'] for event in map(read, stage.on_tracks(tracks, PLACE, NOW + 1.0))}
    assert again == set(first) - {'rig-1'}
    assert len(stage.on_tracks(tracks, PLACE, NOW - 3600.0)) == 4, 'the clock was set back'


def test_without_a_place_or_north_no_bearing_is_shown():
    assert CotStage(*NAMES).on_tracks([bearing(3), bearing(4)], None, NOW) == []
    events = [read(event) for event in CotStage(*NAMES).on_tracks([bearing(3, north=False)], PLACE, NOW)]
    assert [event['uid'] for event in events] == ['rig-1'] and 'sensor' not in events[0]['details']


@given(st.text(max_size=40), st.text(max_size=40), st.text(max_size=40))
def test_any_text_gives_an_event_that_can_be_read_and_sent(callsign, class_id, uid):
    data = position_event(position(class_id=class_id), f'rig.{uid}', callsign, NOW)
    assert read(data)['uid'].startswith('rig.') and len(data) <= 1400, 'a datagram that no network cuts in pieces'


def test_numbers_that_are_none_are_refused():
    with pytest.raises(ValueError, match='has no place'):
        position_event(position(latitude=math.nan), 'rig-1.5', 'mast', NOW)
