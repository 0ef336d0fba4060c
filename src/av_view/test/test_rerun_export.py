"""Bags for rerun: what is in the file, as rerun itself reads it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter

import pytest
from bag_messages import EPOCH, bag, flight, image

from av_view.cli import bag_to_rerun


def fail(*words):
    with pytest.raises(SystemExit) as end:
        bag_to_rerun.main([str(word) for word in words])
    return str(end.value.code)


def test_the_missing_package_is_named_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rerun', None)
    assert 'pip install rerun-sdk' in fail(flight(tmp_path / 'flight.mcap', duration=1.0))


def test_what_is_no_bag_is_an_error(tmp_path):
    pytest.importorskip('rerun', reason='needs rerun-sdk')
    assert 'none.mcap' in fail(tmp_path / 'none.mcap')


def test_each_message_is_a_row_of_its_entities(tmp_path, capsys):
    pytest.importorskip('rerun', reason='needs rerun-sdk')
    flight(tmp_path / 'flight.mcap', duration=2.0)
    bag_to_rerun.main([str(tmp_path / 'flight.mcap')])
    assert '145 messages of 3 topics' in capsys.readouterr().out
    found = rows(tmp_path / 'flight.rrd', tmp_path)
    assert found['/azimuth_deg/sound_0'] == found['/azimuth_deg/sound_1'] == found['/rig/sound'] == 20
    assert found['/camera/picture/detections'] == 25 and found['/world/target'] == 100


def test_pictures_are_in_it_and_those_that_are_none_are_reported(tmp_path, capsys):
    pytest.importorskip('rerun', reason='needs rerun-sdk')
    broken = image('bgr8')
    broken.encoding = 'of another world'
    with bag(tmp_path / 'pictures.mcap') as write:
        for number, message in enumerate((image('bgr8'), image('mono8'), broken)):
            write('/camera/image_raw', EPOCH + number, message)
    bag_to_rerun.main([str(tmp_path / 'pictures.mcap'), '--out', str(tmp_path / 'out.rrd')])
    assert 'of another world' in capsys.readouterr().err
    assert rows(tmp_path / 'out.rrd', tmp_path)['/camera/picture'] == 2


def rows(file, home):
    """Number of rows of each entity."""
    printed = subprocess.run([sys.executable, '-m', 'rerun', 'rrd', 'print', '-vv', str(file)], capture_output=True, text=True,
                             env={**os.environ, 'HOME': str(home)}, check=True).stdout
    counts = Counter()
    for number, entity in re.findall(r'^Chunk\(\w+\) with (\d+) rows .*? - (/\S+) - ', printed, re.MULTILINE):
        counts[entity] += int(number)
    return counts
