"""Bearings of bags whose cameras bin, show regions, or are fisheyes, against the direction of what was seen."""

import math
import sys
from pathlib import Path

import bag_messages as make
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from av_bags.reader import Bag
from av_bags.writer import BagWriter
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_simulator import find_config

sys.path.append(str(Path(__file__).parents[2] / 'av_vision' / 'test'))
AZIMUTH = math.radians(21.0)
FIELD_CASES = Path(__file__).resolve().parents[4] / 'shared/data/field_cases/camera_info'
F, CX, CY = make.CAMERA['focal'], 0.5 * (make.CAMERA['width'] - 1), 0.5 * (make.CAMERA['height'] - 1)


def replayed(path, **settings):
    with Bag(path) as bag:
        replay = Replay(bag, ReplaySettings(**settings))
        return replay, replay.run()


def column(model, azimuth):
    """On the sensor, of a target ahead of a level camera."""
    return CX - F * (azimuth if model == 'equidistant' else math.tan(azimuth))


@pytest.mark.parametrize('given', [
    {}, {'binning': 2}, {'region': (60, 100, 300, 420)}, {'binning': 4, 'region': (40, 80, 320, 480)}, {'model': 'equidistant'},
    {'model': 'equidistant', 'binning': 2, 'region': (20, 20, 400, 500)}])
def test_the_same_direction_in_each_geometry(tmp_path, given):
    block, (left, top, *_) = max(given.get('binning', 1), 1), given.get('region', (0, 0, 0, 0))
    at = tuple((place - first + 0.5) / block - 0.5
               for place, first in ((column(given.get('model'), AZIMUTH), left), (CY, top)))
    with make.bag(tmp_path / 'bag') as write:
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
        for k in range(40):
            time = make.EPOCH + k / 15.0
            write('/odometry', time, make.odometry(time))
            write('/camera/camera_info', time, make.camera_info(time, **given))
            write('/detections', time, make.detections(time, 0.0, at=at))
    _, log = replayed(tmp_path / 'bag', stage='doa')
    assert np.degrees(log.fused['azimuth'][-1]) == pytest.approx(math.degrees(AZIMUTH), abs=0.05)


def test_a_region_that_moves_is_followed(tmp_path):
    """As of a camera that crops where the target was."""
    with make.bag(tmp_path / 'bag') as write:
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
        for k in range(60):
            time, left = make.EPOCH + k / 15.0, 0 if k < 30 else 120
            write('/odometry', time, make.odometry(time))
            write('/camera/camera_info', time, make.camera_info(time, region=(left, 0, 480, 400)))
            write('/detections', time, make.detections(time, 0.0, at=(column('', AZIMUTH) - left, CY)))
    _, log = replayed(tmp_path / 'bag', stage='doa')
    assert np.degrees(log.sight['azimuth']) == pytest.approx(np.full(60, math.degrees(AZIMUTH)), abs=0.05)


def test_camera_infos_that_cannot_be_used_are_noted_and_the_next_is(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
        for k in range(20):
            time = make.EPOCH + k / 15.0
            model, focal = ('omni', F) if k < 3 else ('plumb_bob', 0.0 if k < 6 else F)
            info = make.camera_info(time, model=model)
            info.k[0] = focal
            write('/camera/camera_info', time, info)
            write('/detections', time, make.detections(time, AZIMUTH))
    replay, log = replayed(tmp_path / 'bag', stage='doa')
    assert np.degrees(log.fused['azimuth'][-1]) == pytest.approx(math.degrees(AZIMUTH), abs=0.1)
    assert any("'omni', expected plumb_bob" in note for note in replay.notes)
    assert any('not calibrated' in note for note in replay.notes)


def test_images_that_do_not_fit_the_description_are_refused_with_both_sizes(tmp_path):
    yolo_models = pytest.importorskip('yolo_models')
    model = str(yolo_models.write(tmp_path / 'model.onnx', metadata={'names': "['cat', 'drone', 'bird']"}))
    rig = tmp_path / 'rig.yaml'
    array = Path(__file__).parents[2] / 'av_bringup/config/arrays/two_microphones.yaml'
    rig.write_text(f'array: {{file: {array}}}\ncamera: {{width: 640, height: 360}}\n')
    with make.bag(tmp_path / 'bag') as write:
        write('/camera/image_raw', make.EPOCH, make.image('bgr8'))    # 64 x 48
    with pytest.raises(ValueError, match='64 x 48 pixels.*640 x 360'):
        replayed(tmp_path / 'bag', stage='raw', model=model, rig=str(rig))
    rig.write_text(f'array: {{file: {array}}}\ncamera: {{width: 640, height: 480}}\n')
    replayed(tmp_path / 'bag', stage='raw', model=model, rig=str(rig))


def test_a_camera_on_a_gimbal_is_turned_with_it_and_commanded_within_its_limits(tmp_path):
    """From its detections, and from the bearings that follow from these; without its orientations no image can be used."""
    pan, tilt = 0.5, math.radians(52.0)
    turn = Rotation.from_euler('ZY', [pan, -tilt])
    for known in (True, False):
        with make.bag(tmp_path / f'{known}') as write:
            for k in range(150):
                time = make.EPOCH + k / 50.0
                write('/odometry', time, make.odometry(time))
                if known:
                    write('/gimbal/state', time, make.make(
                        'av_interfaces/msg/GimbalState', make.header(time), 'gimbal_link',
                        make.make('geometry_msgs/msg/Quaternion', *map(float, turn.as_quat())), 1e-6, 1))
                if k % 4 == 3:
                    write('/camera/camera_info', time, make.camera_info(time))
                    write('/detections', time, make.detections(time - 0.02, 0.0, at=(CX, CY)))
    for stage, name in (('doa', 'True'), ('bearing', 'doa.mcap')):
        with Bag(tmp_path / name) as bag, BagWriter(tmp_path / f'{stage}.mcap') as out:
            replay = Replay(bag, ReplaySettings(stage=stage, rig=str(find_config('rig_gimbal')), commands=True))
            log = replay.run(out)
        assert not replay.lost and len(log.sight) == 37
        assert log.sight['azimuth'] == pytest.approx(np.full(37, pan), abs=0.01)
        with Bag(tmp_path / f'{stage}.mcap') as bag:
            commands = [bag.decode(topic, data) for topic, _, data in bag.messages(['/pointing/command'])]
        assert commands[-1].tilt == pytest.approx(tilt, abs=0.02)
    replay, _ = replayed(tmp_path / 'False', stage='doa', rig=str(find_config('rig_gimbal')))
    assert replay.lost and any("left out: the gimbal's orientation" in note for note in replay.notes)


@pytest.mark.skipif(not FIELD_CASES.exists(), reason='needs ../shared/data')
@pytest.mark.parametrize('name', ['plain', 'binning2', 'roi'])
def test_the_bags_of_the_field(name):
    _, log = replayed(FIELD_CASES / f'{name}.mcap', stage='doa')
    assert np.degrees(log.fused['azimuth'][-1]) == pytest.approx(15.1, abs=0.1)  # half a pixel of 0.14 deg
