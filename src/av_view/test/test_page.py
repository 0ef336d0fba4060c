"""The page in a browser, fed by hand: what it says before something moves, and where its stop is."""

from __future__ import annotations

import json
import socket
import socketserver
import threading
from contextlib import suppress

import pytest

pytest.importorskip('websockets.asyncio.server', reason='needs websockets 13')

from browser import Browser, find_browser

from av_view import Access, RigState, ViewServer, row_of

pytestmark = [pytest.mark.system,
              pytest.mark.skipif(not find_browser(), reason='no Chromium is installed: sudo apt-get install chromium')]
BOTH = 'the gimbal (up to 90 deg/s) and the body of the rig (up to 20 deg/s)'
STILL = {'mode': 'hold', 'reason': 'disabled', 'pan': None, 'tilt': None, 'yaw_rate': None}  # what is commanded after a stop


class Rig:
    """A server whose rig is plain data; `asked` holds what the page asks for."""

    def __init__(self):
        self.asked = []
        access = Access(control=True)
        self.server = ViewServer('127.0.0.1', 0, access, self.act)
        self.server.start()
        self.server.set_rigs(('',))
        self.address = f'http://127.0.0.1:{self.server.port}/#{access.token}'

    async def act(self, name, rig, request):
        self.asked.append((name, request.get('value')))
        return {'done': True, 'words': 'as you wish', 'parameters': []}

    def show(self, may_move=BOTH, enabled=False, **parts):
        snapshot = {**RigState().snapshot(100.0 + len(self.asked)), 'command': STILL, **parts}
        given = {'enabled': enabled if enabled is None else str(enabled), 'may move': may_move}
        values = [(name, value) for name, value in given.items() if value is not None]
        nodes = [{'node': '/pointing_node', 'level': 'ok', 'words': 'active', 'values': values, 'advice': [], 'age': 0.1}]
        health = json.dumps({'type': 'health', 'nodes': nodes, 'offers': ['enable', 'select', 'turn']})
        self.server.put(lambda feed: feed.put_health(health), '')
        self.server.put(lambda feed: feed.put(json.dumps(snapshot), json.dumps(row_of(snapshot))), '')


@pytest.fixture(scope='module')
def rig():
    rig = Rig()
    yield rig
    rig.server.stop()


@pytest.fixture(scope='module')
def phone(rig):
    with Browser(find_browser(), width=390, height=844) as browser:
        browser.open(rig.address)
        assert browser.wait_for('typeof permitted !== "undefined" && permitted')
        yield browser


def asked_for(rig, phone, **shown):
    """What the page asks before it lets the rig move."""
    rig.show(**shown)
    told = shown.get('may_move', BOTH)
    assert phone.wait_for(f'(valueOf("pointing_node", "may move") ?? null) === {json.dumps(told)} && !$("enable").hidden')
    phone.value('$("enable").click()')
    words = phone.value('$("ask-words").textContent')
    phone.value('$("ask").close("no")')
    return words


def test_the_dialog_says_what_is_configured_to_move_whatever_was_commanded(rig, phone):
    """As after a stop, when commands move nothing."""
    assert f'From now on this moves by itself towards the target: {BOTH}.' in asked_for(rig, phone)
    gimbal = asked_for(rig, phone, may_move='the gimbal (up to 90 deg/s)', command={**STILL, 'yaw_rate': 4.0})
    assert 'the gimbal (up to 90 deg/s).' in gimbal and 'the body' not in gimbal
    nothing = asked_for(rig, phone, may_move='nothing', command={**STILL, 'pan': 1.0, 'tilt': 0.0})
    assert 'Nothing of this rig is configured to move' in nothing
    for enabled, words in ((None, 'not known yet'), (False, 'Commands move nothing.')):
        rig.show(enabled=enabled)
        assert phone.wait_for(f'$("moves").textContent.includes("{words}")')
    unknown = asked_for(rig, phone, may_move=None)
    assert 'the gimbal and the body' in unknown and 'not known yet' in unknown
    phone.value('confirmMove("turn", "")')
    turn = phone.value('$("ask-words").textContent')
    phone.value('$("ask").close("no")')
    assert 'The body' not in turn and 'the gimbal and the body' in turn
    assert not [action for action, _ in rig.asked if action == 'enable']


@pytest.mark.parametrize('enabled', [True, False, None])
def test_a_target_is_selected_at_once_only_where_nothing_can_move(rig, phone, enabled):
    """While it is not known whether commands move the rig, the page asks, too."""
    track = {'id': 1, 'name': '', 'azimuth': 12.3, 'azimuth_world': None, 'range': None, 'source': ['sound'], 'drone': 0.97,
             'selected': False, 'point': None}
    rig.asked.clear()
    known = 'null' if enabled is None else f'"{enabled}"'
    for condition in (f'(valueOf("pointing_node", "enabled") ?? null) === {known}', '$("select").length === 2'):
        rig.show(enabled=enabled, tracks=[track])    # the list of targets follows at the next state
        assert phone.wait_for(condition)
    before = phone.value('$("select").value')
    phone.value('$("select").value = "1", $("select").onchange()')
    assert phone.value('$("ask").open') is (enabled is not False)
    assert enabled is False or f'This moves towards drone 1: {BOTH}.' in phone.value('$("ask-words").textContent')
    assert enabled is not False or phone.wait_for('$("answer").textContent === "as you wish"')
    assert (('select', 1) in rig.asked) is (enabled is False)
    phone.value('$("ask").close("no")')
    assert phone.wait_for(f'$("select").value === "{before if enabled is not False else 1}"')    # what is carried out


def test_the_stop_is_in_reach_on_a_phone_and_closes_what_asks(rig, phone):
    """Wherever the page is scrolled to, whatever the page believes of the rig, and while it asks."""
    for enabled in (True, False):
        rig.show(enabled=enabled)
        assert phone.wait_for(f'$("enable").hidden === {json.dumps(enabled)}')
        for scroll in (0, 100_000):
            phone.value(f'scrollTo(0, {scroll})')
            x, y, width = phone.value('(({ left, top, width, height }) => [left + width / 2, top + height / 2, width])'
                                      '($("stop").getBoundingClientRect())')
            assert width > 300 and 700 < y < 844 and phone.value(f'document.elementFromPoint({x}, {y}).id') == 'stop'
    phone.value('$("enable").click()')
    assert phone.value(f'$("ask").open && document.elementFromPoint({x}, {y}).id') == 'stop'
    phone.value('$("stop").click()')
    assert phone.wait_for('!$("ask").open') and phone.wait_for('$("answer").textContent === "as you wish"')
    assert rig.asked[-1] == ('enable', False)
    assert phone.value('document.documentElement.scrollWidth') <= 390


def test_words_are_for_people(rig, phone):
    track = {'id': 1, 'name': 'camera_quadrotor', 'azimuth': 12.3, 'azimuth_world': None, 'range': None,
             'source': ['sound', 'sight'], 'drone': 0.97, 'selected': True, 'point': None}
    bird = {**track, 'id': 2, 'name': 'bird', 'azimuth': -47.0, 'source': ['sound'], 'drone': 0.12, 'selected': False}
    fusion = {'reason': 'no target: heard at +47 deg, judged not a drone (0.41)', 'missing': ['detections'],
              'sight_confidence': 0.78, 'sound_confidence': 0.5}
    rig.show(tracks=[bird, track], fusion=fusion)
    assert phone.wait_for('$("targets").children.length === 2')
    assert phone.value('[...$("targets").children].map(one => one.textContent)') == [
        'drone 1 (camera quadrotor): heard and seen at +12°; followed, a drone to 97 %',
        'bird 2: heard at -47°; not followed, a drone to 12 %']
    assert phone.value('$("reason").textContent') == ('heard at +47° and not followed: a drone to 41 % only; '
                                                      'detections of the camera are missing')
    said = {'stateWords({ state: "sight" }, { sight_confidence: 0.78 })': 'seen, sure to 78 %',
            'bearingWords({ state: "sound", azimuth: -120.04, sigma: 2, range: null, resolved: true })':
                '-120.0° ± 2°, behind, right',
            'targetWords({ id: 3, name: "", drone: null, azimuth: null, range: null, source: ["sound"], selected: false })':
                'target 3: heard in an unknown direction; not followed, not yet classified',
            'nameOf({ id: 3, name: "", drone: null })': 'target 3',
            'nameOf({ id: 4, name: "hexarotor", drone: 0.2 })': 'something 4',
            'statusWords("doa has 2 publishers (/a, /b) and is not used: stop all but one")':
                'directions of sound (doa) come from 2 programs (/a, /b) and are not used: stop all but one',
            'statusWords("/odometry refused: stamp 5 s")': 'cannot use the attitude of the rig: stamp 5 s'}
    for expression, words in said.items():
        assert phone.value(expression) == words


# Pairs of names whose boxes share more than a fifth of the smaller one.
OVERLAPS = """(() => {
  const boxes = [...document.querySelectorAll("svg .name")].map(one => [one.closest("svg").id, one.getBoundingClientRect()]);
  const shared = (a, b) => Math.max(0, Math.min(a.right, b.right) - Math.max(a.left, b.left))
    * Math.max(0, Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top));
  const area = box => box.width * box.height;
  let count = 0;
  boxes.forEach(([svg, a], i) => boxes.slice(0, i).forEach(([other, b]) => {
    count += svg === other && shared(a, b) > 0.2 * Math.min(area(a), area(b)); }));
  return [count, boxes.length];
})()"""


def test_many_targets_fit_a_small_phone(rig):
    """The stop stays on the screen, the map is no longer than that, and names can be read: the selected target's is there."""
    tracks = [{'id': number, 'name': 'camera_quadrotor', 'azimuth': -180.0 + 7.1 * number, 'azimuth_world': None, 'point': None,
               'range': 900.0 / number, 'source': ['sound', 'sight'], 'drone': 0.97, 'selected': number == 33}
              for number in range(1, 51)]
    world = {'tracks': [{'id': number, 'name': 'drone', 'ellipse': [4.0, 1.0, 30.0], 'x': 7.0 * (number % 8), 'y': 3.0 * number,
                         'z': 30.0, 'positioned': number % 2 == 0, 'rigs': ['rig_1', 'rig_2']} for number in range(1, 51)],
             'rigs': [{'name': f'rig_{number}', 'x': 9.0 * number, 'y': 0.0, 'sigma': 0.1} for number in range(8)]}
    bearing = {'state': 'sound', 'azimuth': -120.04, 'sigma': 12.0, 'elevation': None, 'range': 1234.0, 'probability': 0.7,
               'resolved': False}
    with Browser(find_browser(), width=320, height=568) as phone:
        phone.open(rig.address)
        assert phone.wait_for('typeof permitted !== "undefined" && permitted')
        rig.show(enabled=True, tracks=tracks, world=world, bearing=bearing)
        assert phone.wait_for('$("targets").children.length === 50 && !$("map-box").hidden && !$("stop-bar").hidden')
        assert phone.value('document.documentElement.scrollWidth') <= 320
        assert phone.value('$("stop").getBoundingClientRect().bottom') <= 568
        assert max(phone.value('["targets", "map-box", "polar-box"].map(id => $(id).getBoundingClientRect().height)')) < 640
        overlaps, names = phone.value(OVERLAPS)
        assert overlaps == 0 and names > 10
        assert phone.value('[...document.querySelectorAll("#polar .name")].some(one => one.textContent.startsWith("drone 33"))')
        rig.show(tracks=[{**tracks[0], 'azimuth': None}])    # what is ahead is not known to be there
        assert phone.wait_for('$("targets").children.length === 1')
        assert phone.value('document.querySelectorAll("#polar .track").length') == 0


def test_what_is_shown_fades_while_the_connection_is_lost():
    """It is not how things are now; when the rig is back, it is shown as before."""
    rig, faded = Rig(), 'getComputedStyle(document.querySelector("main")).opacity < 0.6'
    port = rig.server.port
    with Browser(find_browser(), width=390, height=844) as phone:
        phone.open(rig.address)
        assert phone.wait_for('typeof permitted !== "undefined" && permitted')
        rig.show()
        assert phone.wait_for('state !== null') and not phone.value(faded)
        rig.server.stop()
        assert phone.wait_for(f'{faded} && $("state").textContent === "no connection"')
        rig.server = ViewServer('127.0.0.1', port, Access(control=False), rig.act)
        rig.server.start()
        rig.server.set_rigs(('',))
        rig.show()
        assert phone.wait_for(f'!({faded}) && state !== null')
        rig.server.stop()


class Proxy(socketserver.ThreadingTCPServer):
    """A web server that passes on what is below /rig/, by connections of one request each."""

    daemon_threads = True

    class RequestHandlerClass(socketserver.BaseRequestHandler):
        def handle(self):
            with socket.create_connection(('127.0.0.1', self.server.behind)) as behind:
                asked = self.request.recv(65536)
                assert asked.startswith(b'GET /rig/')
                behind.sendall(asked.replace(b'/rig/', b'/', 1))
                threading.Thread(target=self.pass_on, args=(self.request, behind), daemon=True).start()
                self.pass_on(behind, self.request)

        @staticmethod
        def pass_on(source, target):
            with suppress(OSError):    # either may have ended
                while data := source.recv(65536):
                    target.sendall(data)
                target.shutdown(socket.SHUT_RDWR)

    def __init__(self, behind):
        super().__init__(('127.0.0.1', 0), self.RequestHandlerClass)
        self.behind = behind
        threading.Thread(target=self.serve_forever, daemon=True).start()


def test_the_page_may_be_below_a_path_of_another_web_server(rig):
    with Proxy(rig.server.port) as proxy, Browser(find_browser()) as browser:
        browser.open(f'http://127.0.0.1:{proxy.server_address[1]}/rig/#{rig.address.partition("#")[2]}')
        assert browser.wait_for('typeof permitted !== "undefined" && permitted')
        proxy.shutdown()


def test_a_browser_that_keeps_nothing_shows_the_page(rig):
    """All cookies are blocked, and with them what a page may keep."""
    with Browser(find_browser()) as browser:
        browser.command('Page.addScriptToEvaluateOnNewDocument', source='Object.defineProperty(window, "sessionStorage", '
                        '{ get() { throw new DOMException("Access is denied", "SecurityError"); } })')
        browser.open(rig.address)
        assert browser.wait_for('typeof permitted !== "undefined" && permitted', 10.0)
