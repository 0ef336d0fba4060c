"""The server against viewers of all kinds: curious, slow, stalled, many, and hostile ones."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import time
from contextlib import ExitStack, contextmanager

import pytest

pytest.importorskip('websockets.asyncio.server', reason='needs websockets 13')
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from av_view.access import Access
from av_view.server import WRONG_TOKEN_S, ServerSettings, ViewServer

pytestmark = pytest.mark.system

LONG_S = 30.0  # on a busy machine


class Page:
    """A server, and what its viewers asked for."""

    def __init__(self, control=True, **settings):
        self.asked = []
        self.access = Access(control)
        self.server = ViewServer(ServerSettings(port=0, **settings), self.access, self.act)
        self.server.start()
        self.number = 0

    async def act(self, name, rig, request):
        self.asked.append((name, rig, request.get('value')))
        if name == 'fail':
            raise ValueError('this cannot be done')
        return {'done': True, 'words': 'so be it'}

    def publish(self, picture=b'\xff\xd8 a picture'):
        self.number += 1
        row = json.dumps([self.number])
        self.server.put(lambda feed: feed.put(f'{{"number":{self.number}}}', row, picture), '')

    @contextmanager
    def viewer(self):
        with connect(f'ws://127.0.0.1:{self.server.port}/feed', max_size=None, proxy=None) as viewer:
            viewer.send('{"do": "watch"}')
            yield viewer

    def get(self, path='/', host=None, method='GET', **headers):
        connection = http.client.HTTPConnection('127.0.0.1', self.server.port, timeout=LONG_S)
        connection.request(method, path, headers={'Host': host or f'127.0.0.1:{self.server.port}', **headers})
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer, content


@pytest.fixture
def page():
    page = Page(rate=20.0)
    yield page
    page.server.stop()


def update(viewer):
    """The next update: its picture, and its state with rows."""
    picture = None
    while True:
        message = viewer.recv(timeout=LONG_S)
        if isinstance(message, bytes):
            picture = message
            continue
        content = json.loads(message)
        if content['type'] == 'state':
            viewer.send('{"do": "next"}')
            return picture, content


def answer(viewer, **request):
    viewer.send(json.dumps(request))
    while True:
        message = viewer.recv(timeout=LONG_S)
        if isinstance(message, str) and json.loads(message)['type'] == 'answer':
            return json.loads(message)


def test_the_page_comes_with_all_it_needs_and_may_load_nothing_else(page):
    answer, content = page.get('/')
    assert answer.status == 200 and b'view.js' in content
    assert "default-src 'none'" in answer.headers['Content-Security-Policy'] and 'http' not in answer.headers[
        'Content-Security-Policy']
    for path in ('/', '/view.js', '/draw.js', '/view.css', '/icon.svg'):
        content = page.get(path)[1].replace(b'http://www.w3.org/2000/svg', b'')  # the name of a language
        assert b'http://' not in content and b'https://' not in content and len(content) > 100


def test_a_viewer_gets_pictures_states_and_every_row(page):
    with page.viewer() as viewer:
        numbers = []
        for _ in range(5):
            page.publish()
            picture, state = update(viewer)
            assert picture.startswith(b'\xff\xd8')
            numbers += [row[0] for row in state['rows']]
        assert numbers == list(range(1, 6)) and state['state'] == {'number': 5}


def test_a_slow_viewer_gets_the_newest_picture_and_no_row_is_lost(page):
    with page.viewer() as viewer:
        page.publish()
        update_once = [viewer.recv(timeout=LONG_S) for _ in range(3)]  # rigs, picture, state; and no request for the next
        assert json.loads(update_once[-1])['type'] == 'state'
        for number in range(50):
            page.publish(b'\xff\xd8 %d' % number)
        viewer.send('{"do": "next"}')
        picture, state = update(viewer)
        assert picture == b'\xff\xd8 49' and [row[0] for row in state['rows']] == list(range(2, 52))


def test_a_stalled_viewer_holds_up_nobody_and_nothing_piles_up(page):
    with page.viewer() as stalled, page.viewer() as viewer:
        for _ in range(40):
            page.publish(bytes(1_000_000))
            update(viewer)
        stalled.recv(timeout=LONG_S)
        received = sum(len(stalled.recv(timeout=LONG_S)) for _ in range(2))
        assert received < 1_100_000  # one update, whatever was published
        with pytest.raises(TimeoutError):
            stalled.recv(timeout=0.3)


def test_two_hundred_viewers_cost_no_more_than_some():
    page = Page(rate=20.0, most_updates=50.0)
    try:
        with ExitStack() as stack:
            viewers = [stack.enter_context(page.viewer()) for _ in range(200)]
            page.publish()
            for viewer in viewers:
                update(viewer)
            assert page.server.viewers == 200
            begin, updates = time.monotonic(), 0
            while time.monotonic() - begin < 3.0:
                page.publish()
                for viewer in viewers:
                    while True:
                        try:
                            updates += 'state' in str(viewer.recv(timeout=0)) and viewer.send('{"do": "next"}') is None
                        except TimeoutError:
                            break
                time.sleep(0.05)
            assert updates <= 50.0 * (time.monotonic() - begin) * 1.5 + 200
    finally:
        page.server.stop()


def test_one_viewer_too_many_is_told_so():
    page = Page(most_viewers=2)
    try:
        with page.viewer() as first, page.viewer() as second:
            page.publish()
            update(first), update(second)
            with pytest.raises(InvalidStatus, match='503'), page.viewer():
                pass
        assert page.get('/')[0].status == 200
    finally:
        page.server.stop()


def test_control_needs_the_token(page):
    with page.viewer() as viewer:
        for token in ({}, {'token': 'wrong'}, {'token': None}, {'token': page.access.token[:-1]}):
            begin = time.monotonic()
            assert answer(viewer, do='enable', number=1, value=True, **token)['done'] is False
            assert time.monotonic() - begin >= WRONG_TOKEN_S
        assert page.asked == []
        given = answer(viewer, do='enable', number=2, value=True, token=page.access.token)
        assert given == {'type': 'answer', 'number': 2, 'done': True, 'words': 'so be it'}
        assert page.asked == [('enable', '', True)]
        assert answer(viewer, do='fail', token=page.access.token)['words'] == 'this cannot be done'


def test_without_control_nothing_is_carried_out():
    page = Page(control=False)
    try:
        with page.viewer() as viewer:
            assert 'read-only' in answer(viewer, do='enable', value=True, token='')['words']
        assert page.asked == []
    finally:
        page.server.stop()


@pytest.mark.parametrize('message', ['', '{', '[]', '7', '{"do": 7}', '{"no": "do"}', b'\xff\x00', '[' * 4000,
                                     '"' + 'x' * 4000])
def test_what_is_no_request_closes_the_connection_of_its_sender_only(page, message):
    with page.viewer() as other, page.viewer() as viewer:
        viewer.send(message)
        with pytest.raises(ConnectionClosed):
            while True:
                viewer.recv(timeout=LONG_S)
        page.publish()
        assert update(other)[1]['state'] == {'number': 1}
    assert page.server.refused >= 1


def test_ten_megabytes_are_not_read(page):
    with page.viewer() as other, page.viewer() as viewer:
        with pytest.raises(ConnectionClosed) as closed:
            viewer.send('x' * 10_000_000)
            while True:
                viewer.recv(timeout=LONG_S)
        assert closed.value.rcvd is None or closed.value.rcvd.code == 1009
        page.publish()
        assert update(other)[1]['state'] == {'number': 1}


def test_a_flood_of_requests_closes_its_connection(page):
    with page.viewer() as viewer, pytest.raises(ConnectionClosed):
        for _ in range(10_000):
            viewer.send('{"do": "next"}')
        while True:
            viewer.recv(timeout=LONG_S)


@pytest.mark.parametrize('headers', [{'host': 'evil.example'}, {'Origin': 'http://evil.example'}, {'Origin': 'null'}])
def test_other_sites_are_refused(page, headers):
    assert page.get('/', **headers)[0].status == 403
    assert page.get('/feed', Upgrade='websocket', Connection='Upgrade', **headers)[0].status == 403


@pytest.mark.parametrize('path', ['/../server.py', '/page', '/view.js/', '/%2e%2e/access.py', '/feed/x', '//etc/passwd'])
def test_there_is_nothing_but_the_page(page, path):
    assert page.get(path)[0].status == 404


@pytest.mark.parametrize('data', [b'', b'\x00' * 100, b'GET\r\n\r\n',
                                  b'POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999\r\n\r\n',
                                  b'GET / HTTP/1.1\r\nHost: localhost\r\n' + b'A: b\r\n' * 1000 + b'\r\n',
                                  b'GET /' + b'x' * 100_000, b'GET / HTTP/1.1\r\n' + b'y' * 100_000])
def test_malformed_requests_harm_nobody(page, data):
    with socket.create_connection(('127.0.0.1', page.server.port)) as raw:
        raw.settimeout(LONG_S)
        raw.sendall(data)
        raw.shutdown(socket.SHUT_WR)
        try:
            while raw.recv(65536):
                pass
        except ConnectionError:
            pass
    assert page.get('/')[0].status == 200


def test_the_server_starts_and_stops_again_on_the_same_port():
    for _ in range(3):
        page = Page()
        with page.viewer():
            page.server.stop()
    with pytest.raises(OSError), socket.create_server(('127.0.0.1', 0)) as taken:
        server = ViewServer(ServerSettings(port=taken.getsockname()[1]), Access(False), asyncio.sleep)
        server.start()
