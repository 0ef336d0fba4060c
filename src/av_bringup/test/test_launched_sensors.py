"""What the launch files tell the nodes of sensors."""

from __future__ import annotations

from pathlib import Path

import pytest

from av_bringup import launching

CONFIG = Path(__file__).resolve().parents[3] / 'config'


@pytest.mark.parametrize('name', ['rig', 'rig_thermal', 'rig_two_cameras'])
def test_cameras_have_the_view_of_the_rigs_description(monkeypatch, name):
    """Without it a camera of 50 degrees had the 70 of the parameter's default, and bearings were 1.5 times too large."""
    monkeypatch.setattr(launching, 'rig_node', lambda arguments, package, executable, parameters, **options: parameters)
    file = CONFIG / f'{name}.yaml'
    given = launching.camera_nodes({'rig': str(file)}, {'source': 'device'})
    cameras = launching.load_rig(file).cameras.values()
    assert [(one['width'], one['height'], one['horizontal_fov_deg'], one['frame_id']) for one in given] == \
        [(camera.width, camera.height, camera.horizontal_fov_deg, camera.optical_frame) for camera in cameras]


def test_sound_has_the_frame_of_the_rigs_description(monkeypatch, tmp_path):
    """With the default of the node, fusion refused what was heard by an array of another name."""
    monkeypatch.setattr(launching, 'rig_node', lambda arguments, package, executable, parameters, **options: parameters)
    text = (CONFIG / 'rig.yaml').read_text().replace('arrays/', f'{CONFIG}/arrays/')
    text = text.replace('frame: microphones', 'frame: ears')
    (tmp_path / 'rig.yaml').write_text(text)
    given = launching.audio_node({'rig': str(tmp_path / 'rig.yaml')}, {'source': 'device'})
    assert given == {'frame_id': 'ears', 'source': 'device'}
