"""What a restarted process finds of the process before it."""

from __future__ import annotations

import pytest

from av_common.launched import RESTARTS, RUN_FOLDER, KeptNumbers, KeptSwitch, restarts, run_folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a run."""
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    return tmp_path


def test_without_a_launch_nothing_is_kept(monkeypatch):
    monkeypatch.delenv(RUN_FOLDER, raising=False)
    monkeypatch.delenv(RESTARTS, raising=False)
    assert run_folder() is None and restarts() == 0
    KeptSwitch('/pointing_node.enabled', initial=True).set(False)
    assert KeptSwitch('/pointing_node.enabled', initial=True).value


@pytest.mark.parametrize('initial', [True, False])
@pytest.mark.parametrize('value', [True, False])
def test_a_restarted_process_finds_the_last_value(value, initial, folder, monkeypatch):
    first = KeptSwitch('/rig/pointing_node.enabled', initial)
    assert first.value == initial
    first.set(value)
    monkeypatch.setenv(RESTARTS, '1')
    assert KeptSwitch('/rig/pointing_node.enabled', initial).value == value
    assert not KeptSwitch('/other/pointing_node.enabled', initial).value


@pytest.mark.parametrize('content', [b'', b'o', b'\xff', b'on\n on'])
def test_what_cannot_be_read_is_off(content, folder, monkeypatch):
    KeptSwitch('switch', initial=True)
    (folder / 'switch').write_bytes(content)
    monkeypatch.setenv(RESTARTS, '2')
    assert not KeptSwitch('switch', initial=True).value


@pytest.mark.parametrize('text', ['', 'many', '-1', '1.5'])
def test_a_count_that_is_none_counts_nothing(text, monkeypatch):
    monkeypatch.setenv(RESTARTS, text)
    assert restarts() == 0


def test_a_restarted_process_finds_the_last_numbers(folder, monkeypatch):
    first = KeptNumbers('/pointing_node.angles', (0.0, 0.0))
    first.keep(0.5, -0.25)
    first.keep(0.7, -0.25)
    assert KeptNumbers('/pointing_node.angles', (0.0, 0.0)).values == (0.0, 0.0)
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
