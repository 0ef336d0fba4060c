"""`source:=file`: sound and video of one launch are one recording, on one clock."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import soundfile
from rig_process import RigProcess

from av_bags.converters import decompressed
from av_bags.reader import Bag
from av_common.stamps import to_seconds
from av_vision.messages import image_from_message

pytestmark = pytest.mark.system


@pytest.mark.parametrize(('seconds', 'offset'), [(2.0, 0.3), (6.0, -0.45)])
def test_sound_and_video_begin_together(tmp_path, seconds, offset):
    """A folder of numbered images at 8 a second beside a sound that is shorter, or longer; read from what was recorded."""
    (tmp_path / 'images').mkdir()
    for k in range(24):
        cv2.imwrite(str(tmp_path / 'images' / f'shot{k}.png'), np.full((48, 64), 10 * k, np.uint8))
    rng = np.random.default_rng(0)
    soundfile.write(tmp_path / 'sound.wav', 0.1 * rng.normal(size=(round(16_000 * seconds), 2)), 16_000)
    (tmp_path / 'params.yaml').write_text('/**/camera_node: {ros__parameters: {rate: 8.0}}\n')
    rig = RigProcess('source:=file', f'audio:={tmp_path}/sound.wav', f'video:={tmp_path}/images', f'video_offset:={offset}',
                     f'params:={tmp_path}/params.yaml', f'record:={tmp_path}/bag.mcap', 'duration:=15')
    assert rig.finish() == 0, rig.output
    sounds, sights = [], []
    with Bag(tmp_path / 'bag.mcap') as bag:
        for topic, _, data in bag.messages(['/audio/frames', '/camera/image_raw/compressed']):
            message = bag.decoder(topic)(data)
            if topic == '/audio/frames':
                sounds.append(to_seconds(message.header.stamp) - message.first_sample / 16_000)
            else:
                image, = decompressed(message, 0)
                number = round(float(image_from_message(image).mean()) / 10.0)
                sights.append(to_seconds(message.header.stamp) - number / 8.0)
    assert len(sounds) > 10 and len(sights) > 10
    assert np.ptp(sounds) < 1e-3 and np.ptp(sights) < 1e-3
    assert sights[0] - sounds[0] == pytest.approx(offset, abs=0.02)


@pytest.mark.parametrize(('arguments', 'reason'), [
    (['audio:=~/nothing.wav'], 'nothing.wav: no such file'),
    (['audio:=~/x.wav', 'video_offset:=soon'], "'soon', expected seconds"),
    (['audio:=~/x.wav', 'video_offset:=0.5'], 'it needs audio:= and video:=')])
def test_what_cannot_be_played_is_said_at_the_launch(tmp_path, monkeypatch, arguments, reason):
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'x.wav').touch()
    rig = RigProcess('source:=file', *arguments)
    assert rig.finish() == 1
    assert reason in rig.output
