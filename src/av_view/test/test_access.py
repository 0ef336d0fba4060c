"""Hosts, origins and tokens."""

from __future__ import annotations

import socket

import pytest

from av_view.access import Access

OPEN = Access(control=True, hosts=['rig.example'])


@pytest.mark.parametrize('host', ['127.0.0.1:8780', 'localhost:8780', '[::1]:8780', '192.168.1.7', 'RIG.example:80',
                                  f'{socket.gethostname()}:8780'])
def test_this_machine_is_known_by_addresses_and_by_its_names(host):
    assert OPEN.refusal([host], []) == '' == OPEN.refusal([host], [f'http://{host}'])


@pytest.mark.parametrize(('hosts', 'origins'), [
    (['evil.example:8780'], []),  # a name that is pointed at this machine
    (['127.0.0.1.evil.example'], []), ([], []), (['localhost', 'localhost'], []), ([''], []), (['[::1'], []),
    (['localhost:8780'], ['http://evil.example']), (['localhost:8780'], ['null']), (['localhost:8780'], ['https://localhost:8780']),
    (['localhost:8780'], ['http://localhost:9999']), (['localhost:8780'], ['http://localhost:8780', 'http://evil.example'])])
def test_other_names_and_pages_are_refused(hosts, origins):
    assert 'expected' in OPEN.refusal(hosts, origins)


def test_only_the_token_opens_control():
    assert len(OPEN.token) >= 32 and Access(control=True).token != OPEN.token
    assert OPEN.may_control(OPEN.token)
    for wrong in ('', OPEN.token[:-1], OPEN.token + 'x', 'ü', None, 7, [OPEN.token]):
        assert not OPEN.may_control(wrong)


def test_without_control_nothing_is_the_token():
    closed = Access(control=False)
    assert closed.token == '' and not closed.may_control('') and not closed.may_control(None)
