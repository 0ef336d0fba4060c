"""What a restarted process finds of the process before it."""

from __future__ import annotations

import pytest

from av_common.launched import RESTARTS, RUN_FOLDER, KeptNumbers, restarts, run_folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a run."""
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    return tmp_path


def test_without_a_launch_nothing_is_kept(monkeypatch):
    monkeypatch.delenv(RUN_FOLDER, raising=False)
    monkeypatch.delenv(RESTARTS, raising=False)
    assert run_folder() is None and restarts() == 0
    KeptNumbers('/pointing_node.enabled', (True,)).keep(False)
    assert KeptNumbers('/pointing_node.enabled', (True,)).values == (True,)


@pytest.mark.parametrize('initial', [True, False])
@pytest.mark.parametrize('value', [True, False])
def test_a_restarted_process_finds_a_switch_as_it_was_set_last(value, initial, folder, monkeypatch):
    first = KeptNumbers('/rig/pointing_node.enabled', (initial,), lost=(False,))
    assert first.values == (initial,)
    monkeypatch.setenv(RESTARTS, '1')
    assert KeptNumbers('/rig/pointing_node.enabled', (True,), lost=(False,)).values == (initial,)
    first.keep(value)
    assert KeptNumbers('/rig/pointing_node.enabled', (initial,), lost=(False,)).values == (value,)
    assert KeptNumbers('/other/pointing_node.enabled', (initial,), lost=(False,)).values == (False,)


@pytest.mark.parametrize('content', [b'', b'o', b'\xff' * 8, b'on\n on', bytes(9)])
def test_a_switch_that_cannot_be_read_is_off(content, folder, monkeypatch):
    KeptNumbers('switch', (True,), lost=(False,))
    (folder / 'switch').write_bytes(content)
    monkeypatch.setenv(RESTARTS, '2')
    assert KeptNumbers('switch', (True,), lost=(False,)).values == (False,)


@pytest.mark.parametrize('text', ['', 'many', '-1', '1.5'])
def test_a_count_that_is_none_counts_nothing(text, monkeypatch):
    monkeypatch.setenv(RESTARTS, text)
    assert restarts() == 0


def test_a_restarted_process_finds_the_last_numbers(folder, monkeypatch):
    KeptNumbers('/pointing_node.angles', (0.0, 0.0)).keep(0.2, 0.2)
    first = KeptNumbers('/pointing_node.angles', (0.0, 0.0))
    assert first.values == (0.0, 0.0)
    first.keep(0.5, -0.25)
    first.keep(0.7, -0.25)
    monkeypatch.setenv(RESTARTS, '1')
    assert KeptNumbers('/pointing_node.angles', (0.0, 0.0)).values == (0.7, -0.25)


@pytest.mark.parametrize('content', [b'', b'\0' * 15, b'\0' * 17, b'\xff' * 16])
def test_numbers_that_cannot_be_read_are_the_initial_ones(content, folder, monkeypatch):
    (folder / 'angles').write_bytes(content)
    monkeypatch.setenv(RESTARTS, '1')
    assert KeptNumbers('angles', (1.0, 2.0)).values == (1.0, 2.0)


def test_without_a_folder_numbers_are_kept_in_the_process(monkeypatch):
    monkeypatch.delenv(RUN_FOLDER, raising=False)
    numbers = KeptNumbers('angles', (1.0, 2.0))
    numbers.keep(3.0, 4.0)
    assert numbers.values == (3.0, 4.0)
