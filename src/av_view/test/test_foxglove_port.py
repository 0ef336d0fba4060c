"""The port for Foxglove: what a subscriber is sent."""

from __future__ import annotations

import json
import struct
import time

import numpy as np
import pytest

pytest.importorskip('foxglove', reason='needs foxglove-sdk')
from view_messages import CAMERA, NOW, bearing, seen
from websockets.sync.client import connect

from av_view.foxglove_port import FoxglovePort, Shown
from av_view.picture import Picture
from av_view.rig_state import RigState

pytestmark = pytest.mark.system


def test_a_subscriber_gets_picture_boxes_and_state_and_without_one_nothing_is_made():
    state = RigState()
    state.camera = CAMERA
    state.on_bearing(bearing(), NOW)
    state.on_detections(seen(319.5, 239.5), None)
    picture = Picture.of(np.zeros((480, 960, 3), np.uint8), NOW, 640, 70)
    assert (picture.width, picture.height) == (640, 320)
    port = FoxglovePort('127.0.0.1', 0)
    try:
        with connect(f'ws://127.0.0.1:{port.port}', subprotocols=['foxglove.sdk.v1'], proxy=None, max_size=None) as viewer:
            channels = {}
            while len(channels) < 6:
                message = viewer.recv(timeout=30.0)
                if isinstance(message, str) and json.loads(message)['op'] == 'advertise':
                    channels |= {one['topic']: one['id'] for one in json.loads(message)['channels']}
            assert not port.watched
            wanted = [{'id': number, 'channelId': channel} for number, channel in enumerate(channels.values())]
            viewer.send(json.dumps({'op': 'subscribe', 'subscriptions': wanted}))
            deadline = time.monotonic() + 30.0
            while not port.watched and time.monotonic() < deadline:
                time.sleep(0.05)
            port.put(Shown(state.snapshot(NOW), picture))
            received = {}
            while len(received) < 4:
                message = viewer.recv(timeout=30.0)
                if isinstance(message, bytes) and message[0] == 1:  # messageData: subscription, time, payload
                    number, = struct.unpack_from('<I', message, 1)
                    received[list(channels)[number]] = message[13:]
    finally:
        port.close()
    assert picture.data in received['/camera/image_raw/compressed']
    assert b'drone 0.80' in received['/view/annotations']
    assert json.loads(received['/target/bearing'])['azimuth'] == pytest.approx(0.1, abs=1e-3)
    assert json.loads(received['/view/state'])['bearing']['azimuth'] == pytest.approx(5.7)
