"""Bags of a folder, and nothing else."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from av_view.nodes.rig_control import BagFolder


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / 'bags'
    (made / 'walk').mkdir(parents=True)
    (made / 'walk' / 'metadata.yaml').touch()
    (made / 'pictures').mkdir()
    for age, name in enumerate(('first.mcap', 'second.db3', 'notes.txt', '.mcap')):
        (made / name).touch()
        os.utime(made / name, (age, age))
    (tmp_path / 'secret.mcap').touch()
    (made / 'link.mcap').symlink_to(tmp_path / 'secret.mcap')
    return made


def test_bags_are_listed_the_newest_first(folder):
    assert BagFolder(str(folder)).names() == ['walk', 'second.db3', 'first.mcap']
    assert BagFolder(str(folder)).path('walk') == str(folder / 'walk')


@pytest.mark.parametrize('name', ['../secret.mcap', '/etc/passwd', 'link.mcap', 'notes.txt', 'pictures', '', '.', '..', None, 7,
                                  ['walk'], 'walk/../../secret.mcap', 'first.mcap\x00', 'x' * 10_000])
def test_nothing_else_is_opened(folder, name):
    with pytest.raises(ValueError, match='is no bag'):
        BagFolder(str(folder)).path(name)


def test_what_cannot_be_read_hides_no_bag(folder, monkeypatch):
    """Another user's folder, as one that is not root finds it."""
    looked = Path.is_file

    def is_file(path):
        if path.parent.name == 'pictures':
            raise PermissionError(13, 'Permission denied', str(path))
        return looked(path)

    monkeypatch.setattr(Path, 'is_file', is_file)
    assert BagFolder(str(folder)).names() == ['walk', 'second.db3', 'first.mcap']


def test_without_a_folder_there_are_none():
    assert BagFolder('').names() == []
    with pytest.raises(ValueError, match='bags:=FOLDER'):
        BagFolder('').path('first.mcap')
