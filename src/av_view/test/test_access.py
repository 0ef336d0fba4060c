"""Hosts, origins and tokens."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys

import pytest

from av_view.access import Access, PrivateAddress

OPEN = Access(control=True, hosts=['rig.example'])


@pytest.mark.parametrize('host', ['127.0.0.1:8780', 'localhost:8780', '[::1]:8780', '192.168.1.7', 'RIG.example:80',
                                  f'{socket.gethostname()}:8780'])
def test_this_machine_is_known_by_addresses_and_by_its_names(host):
    """Also behind a web server that encrypts, whose pages have its name, too."""
    assert OPEN.refusal([host], []) == '' == OPEN.refusal([host], [f'http://{host}']) == OPEN.refusal([host], [f'https://{host}'])


@pytest.mark.parametrize(('hosts', 'origins'), [
    (['evil.example:8780'], []),  # a name that is pointed at this machine
    (['127.0.0.1.evil.example'], []), ([], []), (['localhost', 'localhost'], []), ([''], []), (['[::1'], []),
    (['localhost:8780'], ['http://evil.example']), (['localhost:8780'], ['null']), (['localhost:8780'], ['https://localhost']),
    (['localhost:8780'], ['http://localhost:9999']), (['localhost:8780'], ['http://localhost:8780', 'http://evil.example'])])
def test_other_names_and_pages_are_refused(hosts, origins):
    assert 'expected' in OPEN.refusal(hosts, origins)


def test_only_the_token_opens_control():
    assert len(OPEN.token) >= 32 and Access(control=True).token != OPEN.token
    assert OPEN.may_control(OPEN.token)
    for wrong in ('', OPEN.token[:-1], OPEN.token + 'x', 'ü', '\udcff', None, 7, [OPEN.token]):
        assert not OPEN.may_control(wrong)


def test_without_control_nothing_is_the_token():
    closed = Access(control=False)
    assert closed.token == '' and not closed.may_control('') and not closed.may_control(None)


def test_a_process_that_replaces_another_keeps_its_token():
    assert Access(control=True, token=OPEN.token).may_control(OPEN.token)
    assert Access(control=False, token=OPEN.token).token == ''


def test_the_address_with_the_token_is_in_a_file_for_its_owner_and_on_the_terminal_only(tmp_path):
    """A process with a terminal whose outputs go elsewhere, as those of a launch do."""
    (tmp_path / 'page_7.address').write_text('an old one that all can read')
    program = 'from av_view.access import PrivateAddress; PrivateAddress(7).write("http://host/#secret")'
    leader, follower = pty.openpty()
    process = subprocess.run(
        [sys.executable, '-c', f'import fcntl, termios; fcntl.ioctl({follower}, termios.TIOCSCTTY, 0); {program}'],
        pass_fds=[follower], start_new_session=True, env={**os.environ, 'ROS_HOME': str(tmp_path)}, capture_output=True,
        text=True, check=True)
    file = tmp_path / 'page_7.address'
    assert file.read_text() == 'http://host/#secret\n' and file.stat().st_mode & 0o777 == 0o600
    assert b'secret' in os.read(leader, 1000) and 'secret' not in process.stdout + process.stderr
    assert [one.name for one in tmp_path.iterdir()] == ['page_7.address']


def test_the_token_of_the_process_before_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'new'))
    assert PrivateAddress(1).token() == ''
    PrivateAddress(1).write('http://host:1/#of-before')
    assert PrivateAddress(1).token() == 'of-before'
    PrivateAddress(1).remove()
    assert PrivateAddress(1).token() == '' and not PrivateAddress(1).file.exists()
