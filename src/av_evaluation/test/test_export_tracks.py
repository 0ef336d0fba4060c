"""Tracks of a bag as table and features."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from av_bags.writer import BagWriter
from av_common.stamps import to_stamp
from av_evaluation.cli.export_tracks import main
from av_interfaces.msg import Bearing, Track, TrackArray

BEGIN, PERIOD, COUNT = 1_700_000_000.0, 0.05, 100
PLACE = (51.5, -0.12, 30.0)


@pytest.fixture
def bag(tmp_path):
    """Five seconds of a drone at an azimuth of 10 degrees from east that turns by 4 degrees a second, and of a bird."""
    path = tmp_path / 'flight.mcap'
    with BagWriter(path) as writer:
        kinds = {'/left/targets': TrackArray, '/left/target/bearing': Bearing, '/left/fix': NavSatFix}
        for topic, kind in kinds.items():
            writer.add_topic(topic, f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}')
        for k in range(COUNT):
            time = BEGIN + k * PERIOD
            common = {'existence': 0.9, 'resolved': True, 'hemisphere_probability': 1.0, 'last_seen': to_stamp(time),
                      'covariance_world': np.array([1e-4, 0.0, 0.0, 1e-4], np.float32)}
            tracks = [Track(id=1, drone_probability=0.9, azimuth_world=math.radians(10.0 + 4.0 * k * PERIOD), **common),
                      Track(id=2, drone_probability=0.1, azimuth_world=1.0, **common)]
            fix = NavSatFix(status=NavSatStatus(status=NavSatStatus.STATUS_FIX), latitude=PLACE[0], longitude=PLACE[1],
                            altitude=PLACE[2])
            for topic, message in (('/left/target/bearing', Bearing(attitude_known=True)), ('/left/fix', fix),
                                   ('/left/targets', TrackArray(header=Header(stamp=to_stamp(time)), tracks=tracks))):
                writer.write(topic, round(1e9 * time), serialize_message(message))
    return path


def table(stem):
    with stem.with_suffix('.csv').open(newline='') as file:
        return list(csv.DictReader(file))


def test_a_bag_becomes_a_table_and_lines_on_a_map(bag, tmp_path, capsys):
    stem = tmp_path / 'tracks'
    main([str(bag), '--out', str(stem), '--namespace', 'left'])
    rows = table(stem)
    assert len(rows) == 25 and {row['id'] for row in rows} == {'1'} and '25 lines' in capsys.readouterr().out
    for index, row in enumerate(rows):
        assert float(row['azimuth_deg']) == pytest.approx(80.0 - 4.0 * 0.2 * index, abs=1e-3)
    first, *_ = map(json.loads, stem.with_suffix('.geojsonl').read_text().splitlines())
    assert first['geometry']['coordinates'][0] == [PLACE[1], PLACE[0], PLACE[2]]


def test_everything_and_another_rate(bag, tmp_path):
    stem = tmp_path / 'all'
    main([str(bag), '--out', str(stem), '--namespace', 'left', '--everything', '--rate', '20'])
    assert len(table(stem)) == 2 * COUNT


@pytest.mark.parametrize('arguments, words', [
    ((), 'no topic /targets'), (('--namespace', 'left', '--positions'), 'no topic /left/tracks')])
def test_a_bag_without_tracks_is_an_error(bag, tmp_path, arguments, words):
    with pytest.raises(SystemExit, match=words):
        main([str(bag), '--out', str(tmp_path / 'none'), *arguments])
    assert not list(tmp_path.glob('none.*'))    # it can be repeated with other arguments
