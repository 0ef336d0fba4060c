"""Mistakes in descriptions of rigs: each is named with its file, key and value."""

from __future__ import annotations

import pytest

from av_common.rig import load_rig


@pytest.mark.parametrize(('text', 'named'), [
    ('camera: {distortion: [0.1, 0.2, 0.3]}', r'camera: distortion is \(0.1, 0.2, 0.3\), expected one of'),
    ('camera:\n\twidth: 640', 'not YAML in line 3'),
    ('camera: {width: "640"}', "camera.width: '640', a whole number expected"),
    ('camera: {horizontal_fov_deg: .nan}', 'camera.horizontal_fov_deg: nan, a number, finite'),
    ('kamera: {width: 640}', 'kamera: unknown key, one of array, camera')])
def test_a_mistake_is_named_when_the_file_is_read(tmp_path, text, named):
    file = tmp_path / 'rig.yaml'
    file.write_text(f'array: {{file: pair.yaml}}\n{text}\n', encoding='utf-8')
    with pytest.raises(ValueError, match=named) as raised:
        load_rig(file)
    assert str(file) in str(raised.value) and '\n' not in str(raised.value)
