"""Mistakes in descriptions of rigs: each is named with its file, key and value."""

from __future__ import annotations

import pytest

from av_common.rig import load_rig


@pytest.mark.parametrize(('text', 'named'), [
    ('camera: {distortion: [0.1, 0.2, 0.3]}', r'camera: distortion is \(0.1, 0.2, 0.3\), expected one of'),
    ('camera:\n\twidth: 640', 'not YAML in line 3'),
    ('camera: {width: "640"}', "camera.width: '640', a whole number expected"),
    ('camera: {horizontal_fov_deg: .nan}', 'camera.horizontal_fov_deg: nan, a number, finite'),
    ('camera: {mount: {position: [80.0, 0.0, 50.0]}}', r'camera.mount: position is \[80.0, 0.0, 50.0\], expected metres'),
    ('camera: {mount: {rpy_deg: [0.0, -800.0, 0.0]}}', r'camera.mount: rpy_deg is \[0.0, -800.0, 0.0\], expected degrees'),
    ('camera: {frame: microphones}', "camera.frame is 'microphones', which is array.frame, too, expected names that differ"),
    ('gimbal: {frame: camera_link}', "camera.frame is 'camera_link', which is gimbal.frame, too"),
    ('second_camera: {kind: thermal}', "second_camera.frame is 'camera_link', which is camera.frame, too"),
    ('gimbal: {frame: base_link}', "gimbal.frame is 'base_link', which is the name of a frame of REP-105"),
    ('camera: {optical_frame: /optical}', "camera.optical_frame is '/optical', expected a name without blanks"),
    ('camera: {frame: my camera}', "camera.frame is 'my camera', expected a name without blanks"),
    ('kamera: {width: 640}', 'kamera: unknown key, one of array, camera')])
def test_a_mistake_is_named_when_the_file_is_read(tmp_path, text, named):
    file = tmp_path / 'rig.yaml'
    file.write_text(f'array: {{file: pair.yaml}}\n{text}\n', encoding='utf-8')
    with pytest.raises(ValueError, match=named) as raised:
        load_rig(file)
    assert str(file) in str(raised.value) and '\n' not in str(raised.value)
