"""Detectors by name."""

from __future__ import annotations

import pytest

from av_vision.methods import is_model_file


@pytest.mark.parametrize('name', ['', '.', 'x' * 5000, 'a\0b', '/', 'missing/model', 'unknown'])
def test_what_names_neither_a_file_nor_a_detector_is_refused_with_those_installed(name, tmp_path, monkeypatch):
    """Whatever the file system says to it: folders, names that no file can have."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match='expected one of shipped'):
        is_model_file(name)


def test_a_file_is_told_by_its_suffix_or_by_being_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'weights').touch()
    (tmp_path / 'shipped').touch()
    assert is_model_file('weights') and is_model_file('missing.onnx') and not is_model_file('shipped')
