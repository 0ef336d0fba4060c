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

from av_view import Access, ViewServer, server

pytestmark = pytest.mark.system

LONG_S = 20.0  # on a busy machine


class Page:
    """A server, and what its viewers asked for."""

    def __init__(self, control=True):
        self.asked = []
        self.access = Access(control)
        self.server = ViewServer('127.0.0.1', 0, self.access, self.act)
        self.server.start()
        self.server.set_rigs(('',))
        self.number = 0

    async def act(self, name, rig, request):
        self.asked.append((name, rig, request.get('value')))
        if name == 'fail':
            raise ValueError('this cannot be done')
        if name == 'wait':
            await asyncio.sleep(LONG_S)
        return {'done': True, 'words': 'so be it'}

    def publish(self, picture=b'\xff\xd8 a picture'):
        self.number += 1
        row = json.dumps([self.number])
        self.server.put(lambda feed: feed.put(f'{{"number":{self.number}}}', row, picture), '')

    @contextmanager
    def viewer(self, token=''):
        offered = ['rig', token] if token else None
        with connect(f'ws://127.0.0.1:{self.server.port}/feed', max_size=None, proxy=None, subprotocols=offered) as viewer:
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
    page = Page()
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


def pending(viewer):
    """What has arrived."""
    found = []
    while True:
        try:
            found.append(viewer.recv(timeout=0.0))
        except TimeoutError:
            return found


def told(viewer, rigs):
    """The message that names just these rigs."""
    while True:
        message = viewer.recv(timeout=LONG_S)
        content = json.loads(message) if isinstance(message, str) else {}
        if content.get('rigs') == rigs:
            return content


def wait_for(condition):
    deadline = time.monotonic() + LONG_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()


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
    for path in ('/', '/words.js', '/view.js', '/draw.js', '/view.css', '/icon.svg'):
        content = page.get(path)[1].replace(b'http://www.w3.org/2000/svg', b'')  # the name of a language
        assert b'http://' not in content and b'https://' not in content and len(content) > 100


def test_a_viewer_gets_pictures_states_and_every_row(page):
    with page.viewer() as viewer:
        numbers = []
        for _ in range(5):
            page.publish()
            picture, state = update(viewer)
            assert picture.startswith(b'\xff\xd8')
            numbers += [row[0] for row in state['rows'] if row[0] not in numbers]
            assert state['serial'] == state['rows'][-1][0]
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
        assert picture == b'\xff\xd8 49' and [row[0] for row in state['rows']] == list(range(1, 52))


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


def test_who_asks_again_and_again_without_reading_is_dropped(page):
    page.publish(bytes(1_000_000))
    ask = b'{"do": "watch", "rig": ""}'
    with page.viewer() as other, socket.create_connection(('127.0.0.1', page.server.port)) as greedy:
        update(other)
        greedy.sendall(b'GET /feed HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n'
                       b'Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n')
        assert wait_for(lambda: page.server.viewers == 2)
        greedy.sendall(40 * (bytes([0x81, 0x80 | len(ask)]) + bytes(4) + ask))    # masked by zeros
        assert wait_for(lambda: page.server.viewers == 1)
        assert wait_for(lambda: page.server.refused == 1)
        page.publish()
        assert update(other)[1]['state'] == {'number': 2}


def test_all_guests_get_each_update_and_further_ones_are_refused(page):
    with ExitStack() as stack:
        guests = [stack.enter_context(page.viewer()) for _ in range(server.MOST_GUESTS)]
        holder = stack.enter_context(page.viewer(page.access.token))
        assert wait_for(lambda: len(page.server._waiting) == server.MOST_GUESTS + 1)
        for number in range(1, 11):
            page.publish()
            assert update(holder)[1]['state'] == {'number': number}  # each of them, at once
        for guest in guests:  # of 10 updates one, as no guest has asked again
            while '"state"' not in str(guest.recv(timeout=LONG_S)):
                pass
        assert not any('"state"' in str(message) for guest in guests for message in pending(guest))
        assert page.get('/')[0].status == 200
        for guest in guests:
            guest.send('{"do": "next"}')
        with pytest.raises(InvalidStatus, match='503'), page.viewer():
            pass  # all of them look


def test_idle_guests_keep_no_other_out(page, monkeypatch):
    monkeypatch.setattr(server, 'IDLE_S', 0.0)
    monkeypatch.setattr(server, 'MOST_GUESTS', 3)
    with ExitStack() as stack:
        for _ in range(3):
            idle = stack.enter_context(connect(f'ws://127.0.0.1:{page.server.port}/feed', proxy=None))
        assert wait_for(lambda: page.server.viewers == 3)
        with page.viewer() as guest:
            page.publish()
            update(guest)
            assert page.server.viewers == 3 and idle is not None


def test_the_holder_is_never_refused(page):
    """Further pages with the token take the place of the one that has not asked for longest."""
    with ExitStack() as stack:
        holders = []
        for number in range(server.MOST_HOLDERS + 1):
            holders.append(stack.enter_context(page.viewer(page.access.token)))
            assert wait_for(lambda number=number: len(page.server._waiting) == min(number + 1, server.MOST_HOLDERS))
        page.publish()
        update(holders[-1]), update(holders[1])
        with pytest.raises(ConnectionClosed, match='1008'):
            update(holders[0])


def test_connections_that_say_nothing_keep_nobody_out(page):
    with ExitStack() as stack:
        for _ in range(server.MOST_OPENING + 50):
            stack.enter_context(socket.create_connection(('127.0.0.1', page.server.port)))
        assert page.get('/')[0].status == 200
        with page.viewer(page.access.token) as holder:
            page.publish()
            update(holder)
        assert wait_for(lambda: len(page.server._opening) <= server.MOST_OPENING)


def test_who_does_not_ask_is_dropped(monkeypatch):
    monkeypatch.setattr(server, 'PATIENCE_S', 0.3)
    monkeypatch.setattr(server, 'TIDY_S', 0.1)
    page = Page()
    try:
        with page.viewer() as idle, page.viewer() as patient:
            page.publish()
            update(patient)  # and waits for the next
            with pytest.raises(ConnectionClosed):
                while True:
                    idle.recv(timeout=LONG_S)  # asks for no further one
            page.publish()
            update(patient)
    finally:
        page.server.stop()


def test_a_viewer_without_a_choice_sees_a_rig_that_exists(page):
    page.server.set_rigs(())
    with page.viewer() as viewer, page.viewer() as chooser:
        chooser.send('{"do": "watch", "rig": "/right"}')
        told(viewer, [])
        assert wait_for(lambda: page.server.watched() == {None, '/right'})
        page.server.set_rigs(('/left', '/right'))
        assert told(viewer, ['/left', '/right'])['rig'] == '/left' and told(chooser, ['/left', '/right'])['rig'] == '/right'
        assert page.server.watched() == {'/left', '/right'}
        page.server.set_rigs(('/other',))
        assert told(viewer, ['/other'])['rig'] == '/other' and told(chooser, ['/other'])['rig'] == '/right'


def test_control_needs_the_token(page):
    for token in ('', 'wrong', page.access.token[:-1]):
        with page.viewer(token) as viewer:
            assert 'token' in answer(viewer, do='enable', number=1, value=True, token=page.access.token)['words']
    assert page.asked == []
    with page.viewer(page.access.token) as viewer:
        assert answer(viewer, do='enable', number=2, value=True) == {
            'type': 'answer', 'number': 2, 'done': True, 'words': 'so be it'}
        assert page.asked == [('enable', '', True)]
        assert answer(viewer, do='fail')['words'] == 'this cannot be done'


def test_a_request_that_waits_for_its_answer_holds_up_neither_a_stop_nor_the_page(page):
    with page.viewer(page.access.token) as viewer:
        viewer.send('{"do": "wait", "number": 1}')
        assert answer(viewer, do='enable', number=2, value=False)['number'] == 2
        page.publish()
        assert update(viewer)[1]['state'] == {'number': 1}


def test_without_control_nothing_is_carried_out():
    page = Page(control=False)
    try:
        with page.viewer() as viewer:
            assert 'read-only' in answer(viewer, do='enable', value=True)['words']
        assert page.asked == []
    finally:
        page.server.stop()


@pytest.mark.parametrize('message', ['', '{', '[]', '7', '{"do": 7}', '{"no": "do"}', '{"do": "enable", "number": [[]]}',
                                     b'\xff\x00', '[' * 4000, '"' + 'x' * 4000])
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
        ViewServer('127.0.0.1', taken.getsockname()[1], Access(False), asyncio.sleep).start()
