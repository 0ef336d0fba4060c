"""Players of one launch agree on one beginning, in the folder of the run."""

import pytest

from av_common import playback
from av_common.launched import RUN_FOLDER
from av_common.playback import LAUNCH_WAIT_S, Playback, Player, plan_playback

NOW = 1_700_000_000.0


@pytest.fixture
def clock(monkeypatch):
    """The monotonic time in a list."""
    now = [0.0]
    monkeypatch.setattr(playback.time, 'monotonic', lambda: now[0])
    return now


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    return tmp_path


def test_sound_waits_for_the_detector_of_the_video(folder, clock):
    plan_playback(folder, [Player('audio', 0.0, ['doa']), Player('camera', 0.7, ['detector'])])
    sound, sight = Playback('audio'), Playback('camera')
    for clock[0] in (0.0, 5.0, 20.0):    # the detector starts slowly; others are no reason to begin
        assert sound.begin({'doa', 'recorder'}, NOW + clock[0]) is None
        assert sight.begin({'monitor'}, NOW + clock[0]) is None
    assert sight.begin({'monitor', 'detector'}, NOW + 21.0) is None
    begin = sound.begin({'doa'}, NOW + 21.1)
    assert NOW + 21.0 < begin < NOW + 22.0
    assert sight.begin({'detector'}, NOW + 21.2) == pytest.approx(begin + 0.7, abs=1e-6)
    assert Playback('audio').begin(set(), NOW + 90.0) == begin    # started again, it joins in


def test_both_find_the_same_beginning_when_both_set_it(folder, clock):
    plan_playback(folder, [Player('audio', 0.25, ['doa']), Player('camera', 0.0, ['detector'])])
    sound, sight = Playback('audio'), Playback('camera')
    sound.begin({'doa'}, NOW)
    sight.begin({'detector'}, NOW + 0.01)
    sound.begin({'doa'}, NOW + 0.011)
    sight._agree(NOW + 5.0)
    assert sound.begin({'doa'}, NOW + 0.02) - sight.begin({'detector'}, NOW + 0.02) == pytest.approx(0.25, abs=1e-6)
    assert sight.begin({'detector'}, NOW) < NOW + 1.0


def test_a_player_does_not_wait_for_ever(folder, clock):
    plan_playback(folder, [Player('audio', 0.0, ['doa']), Player('camera', 0.0, ['detector'])])
    sound = Playback('audio')
    assert sound.begin({'doa'}, NOW) is None
    clock[0] = LAUNCH_WAIT_S + 1.0
    sound.begin({'doa'}, NOW + clock[0])
    assert sound.begin({'doa'}, NOW + clock[0]) > NOW + LAUNCH_WAIT_S


def test_a_node_outside_of_the_plan_plays_for_itself(tmp_path, monkeypatch, clock):
    monkeypatch.delenv(RUN_FOLDER, raising=False)
    alone = Playback('audio')
    assert alone.begin(set(), NOW) is None
    assert alone.begin({'anybody'}, NOW + 1.0) == NOW + 1.0
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    plan_playback(tmp_path, [Player('camera', 0.0, [])])
    assert Playback('audio').begin({'anybody'}, NOW) == NOW
