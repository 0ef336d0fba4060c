"""The page of a live rig in a real browser: it shows what the topics say, and controls only with the token."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest
from bag_messages import flight
from rig_listener import RigListener
from rig_process import RigProcess

pytest.importorskip('websockets.sync.client', reason='needs websockets 13')
from browser import Browser, find_browser
from websockets.sync.client import connect

from av_bags.reader import Bag

pytestmark = [pytest.mark.system,
              pytest.mark.skipif(not find_browser(), reason='no Chromium is installed: sudo apt-get install chromium')]
PORT = 8790
SHOWN = 'typeof state === "object" && state !== null && state.bearing && state.bearing.state !== "none"'
PIXELS = '''(() => { const canvas = document.createElement("canvas"), image = $("picture");
    canvas.width = 64; canvas.height = 48; const context = canvas.getContext("2d"); context.drawImage(image, 0, 0, 64, 48);
    return Array.from(context.getImageData(0, 0, 64, 48).data)
        .reduce((a, b, i) => (a * 31 + b * (i % 251)) % 1000003, 0); })()'''


def address_of(rig):
    """The address with the token, which only a private file names."""
    pattern = r'the rig in your browser: (http://\S+) .* is in (\S+)\)'
    rig.wait_for(pattern)
    public, file = re.search(pattern, rig.output).groups()
    address = Path(file).read_text().strip()
    assert address.startswith(public) and address.partition('#')[2] not in rig.output
    assert Path(file).stat().st_mode & 0o777 == 0o600
    return address


def start(tmp_path, *arguments):
    parameters = tmp_path / 'view.yaml'
    parameters.write_text(f'/**/view_node:\n  ros__parameters:\n    port: {PORT}\n')
    rig = RigProcess('view:=true', 'view_control:=true', 'monitor:=false', 'oracle:=true', f'params:={parameters}', *arguments)
    return rig, address_of(rig)


def test_the_page_shows_and_controls_a_live_rig(tmp_path):
    rig, address = start(tmp_path, 'enable_pointing:=false', f'bags:={tmp_path}/bags')
    it_costs_little_to_be_up()
    listener = RigListener(rig.domain)
    try:
        with Browser(find_browser()) as browser:
            browser.open(address)
            assert browser.wait_for(SHOWN, 90.0), rig.output
            it_moves(browser)
            it_agrees_with_the_topics(browser, listener)
            without_the_token_it_is_read_only(address, listener)
            it_controls_with_the_token(browser, listener)
            it_records(browser, tmp_path / 'bags')
            a_stalled_viewer_does_no_harm(browser)
            asked = {urlsplit(request.removeprefix('blob:')).netloc for request in browser.requests}
            assert asked == {f'127.0.0.1:{PORT}'}, browser.requests
            assert browser.value('$("health").children.length') >= 5
            it_comes_back_after_a_restart(browser, rig)
    finally:
        listener.close()


def test_a_replay_is_held_and_moved_from_the_page(tmp_path):
    flight(tmp_path / 'flight.mcap', duration=120.0)
    flight(tmp_path / 'short.mcap', duration=30.0)
    parameters = tmp_path / 'view.yaml'
    parameters.write_text(f'/**/view_node:\n  ros__parameters:\n    port: {PORT}\n')
    rig = RigProcess(f'bag:={tmp_path}/flight.mcap', f'bags:={tmp_path}', 'only:=doa', 'view:=true', 'view_control:=true',
                     'monitor:=false', f'params:={parameters}', launch_file='replay.launch.py')
    with Browser(find_browser()) as browser:
        browser.open(address_of(rig))
        assert browser.wait_for(SHOWN, 90.0), rig.output
        assert browser.wait_for('!$("pause").hidden && !$("pause").disabled && $("seek").max > 100')
        browser.value('$("pause").click()')
        assert browser.wait_for('$("pause").textContent === "Play"')
        held = browser.value('state.time')
        assert browser.wait_for('$("answer").textContent === "paused"') and browser.value('state.time') <= held + 1.0
        browser.value('$("seek").value = 90, $("seek").onchange()')
        browser.value('$("pause").click()')
        assert browser.wait_for(f'state.time > {held} + 60')
        assert browser.wait_for('parseFloat($("position").value) >= 90')
        assert browser.wait_for('!$("open").hidden && $("open").length === 3')
        browser.value('$("open").value = "short.mcap", $("open").onchange()')
        assert browser.wait_for('$("seek").max > 0 && $("seek").max < 40'), browser.value('$("answer").textContent')


def process_at(port):
    """The process of this machine that listens at a TCP port."""
    found, = {connection.pid for connection in psutil.net_connections('tcp')
              if connection.status == psutil.CONN_LISTEN and connection.laddr.port == port}
    return psutil.Process(found)


def it_costs_little_to_be_up():
    """The page is to be up 3 s after the launch. A test cannot rely on that machine, but on the processor time it takes."""
    process = process_at(PORT)
    assert sum(process.cpu_times()[:2]) < 3.0 and process.nice() > 0


def it_moves(browser):
    """Picture, ring and strips are others after a while."""
    assert browser.wait_for('$("polar").querySelector(".ring")')
    seen = [PIXELS, '$("polar").querySelector(".ring")?.getAttribute("points")', '$("azimuths").toDataURL()', 'rows.length',
            *(f'$("{strip}").toDataURL()' for strip in ('confidences', 'level', 'delays', 'spectrum'))]
    before = [browser.value(expression) for expression in seen]
    for expression, value in zip(seen, before, strict=True):
        assert browser.wait_for(f'{expression} !== {json.dumps(value)}'), expression


def it_agrees_with_the_topics(browser, listener):
    """What is drawn is one of the bearings of the last seconds, in the headline and on the ring."""
    assert browser.wait_for('state.truth.length && state.cameras.length && state.sound')
    assert listener.wait_for(lambda: len(listener.bearings) >= 20)
    age, azimuth, headline = browser.value('[Date.now() / 1000 - state.time, state.bearing.azimuth, $("bearing").value]')
    assert listener.wait_for(lambda: any(abs(math.degrees(bearing.azimuth) - azimuth) < 0.06 for bearing in listener.bearings))
    assert age < 10.0 and float(headline.partition('°')[0]) == azimuth, (age, azimuth, headline)
    line = 'Number($("polar").querySelector(".stroke-fused").getAttribute'
    x, y, drawn = browser.value(f'[{line}("x2")), {line}("y2")), state.bearing.azimuth]')
    assert math.degrees(math.atan2(-x, -y)) == pytest.approx(drawn, abs=0.1)  # counter-clockwise from the top
    assert browser.value('$("polar").querySelector(".true") !== null')


def without_the_token_it_is_read_only(address, listener):
    """On a phone."""
    with Browser(find_browser(), width=390) as browser:
        browser.open(address.partition('#')[0])
        assert browser.wait_for(SHOWN)
        assert browser.wait_for('nodes.length >= 5') and browser.value('$("enable").hidden && $("stop-bar").hidden')
        assert browser.value('document.documentElement.scrollWidth') <= 390
        assert 'token' in browser.value('request("enable", { value: true }).then(answer => answer.words)')
    assert listener.wait_for(lambda: listener.values.get('pointing_node', {}).get('enabled') == 'False')


def it_controls_with_the_token(browser, listener):
    enabled = lambda: listener.values.get('pointing_node', {}).get('enabled')  # noqa: E731
    assert listener.wait_for(lambda: enabled() == 'False')
    assert browser.wait_for('!$("enable").hidden && !$("enable").disabled')
    browser.value('$("enable").click()')
    words = browser.value('$("ask-words").textContent')
    assert 'the gimbal (up to 120 deg/s) and the body of the rig (up to 45 deg/s)' in words
    browser.value('$("ask").querySelector("[value=yes]").click()')
    assert listener.wait_for(lambda: enabled() == 'True'), browser.value('$("answer").textContent')
    assert browser.wait_for('$("enable").hidden')
    browser.value('$("stop").click()')
    assert listener.wait_for(lambda: enabled() == 'False')
    assert browser.wait_for('!$("enable").hidden')
    browser.value('$("enable").click()')
    assert browser.value('$("ask-words").textContent') == words  # after a stop, too
    browser.value('$("ask").close("no")')
    it_marks(browser)


def it_records(browser, folder):
    """Start and stop, with a mark between; what the page says is in the bag."""
    for words in ('Stop recording', 'Start recording'):
        assert browser.wait_for('!$("record").hidden && !$("record").disabled')
        browser.value('$("record").click()')
        assert browser.wait_for(f'$("record").textContent === "{words}"'), browser.value('$("answer").textContent')
        if words.startswith('Stop'):
            assert browser.wait_for('valueOf("recorder_node", "/target/bearing messages") > 5')
            browser.value('$("mark-text").value = "now", $("mark").requestSubmit()')
            assert browser.wait_for('valueOf("recorder_node", "/marks messages") > 0')
    (file,) = folder.glob('*.mcap')
    with Bag(file) as bag:
        marks = [bag.decode(topic, data).msg for topic, _, data in bag.messages(['/marks'])]
    assert marks == ['now']


def it_marks(browser):
    browser.value('$("mark-text").value = "a gust", $("mark").requestSubmit()')
    assert browser.wait_for('state.marks.some(([, words]) => words === "a gust")'), browser.value('$("answer").textContent')


def a_stalled_viewer_does_no_harm(browser):
    with connect(f'ws://127.0.0.1:{PORT}/feed', max_size=None, proxy=None) as stalled:
        stalled.send('{"do": "watch"}')
        before = browser.value('state.time')
        assert browser.wait_for(f'state.time > {before} + 2')


def it_comes_back_after_a_restart(browser, rig):
    """Of the process behind it, which the launch starts again."""
    process_at(PORT).kill()
    assert browser.wait_for('$("state").textContent === "no connection"')
    assert browser.wait_for(f'$("state").textContent !== "no connection" && {SHOWN}', 60.0), rig.output
