"""What a fusion node says, for tests."""

from __future__ import annotations

import itertools
import socket
import struct

from link_peer import LONG_S, exactly
from report_tracks import NOW
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from wire_decoder import fields

from av_reports.sapient.stage import SapientStage
from av_reports.settings import SapientSettings

START_S = 180.0  # of a rig on a busy machine
NODE, FUSION_NODE = '6ba7b810-9dad-41d1-80b4-00c04fd430c8', '0f0e0d0c-0b0a-4908-8706-050403020100'
SETTINGS = SapientSettings(NODE, obey_tasks=True)
_NUMBERS = itertools.count()


def new_ulid():
    """A text of 26 characters of Crockford's base 32, that no other is."""
    return f'{next(_NUMBERS):026d}'


def from_fusion_node(destination=NODE, node_id=FUSION_NODE, **content):
    message = SapientMessage(node_id=node_id, destination_id=destination, **content)
    message.timestamp.FromNanoseconds(round(NOW * 1e9))
    return message.SerializeToString()


def acknowledgement(acceptance=True, reasons=()):
    return from_fusion_node(registration_ack={'acceptance': acceptance, 'ack_response_reason': reasons})


def task(control=Task.CONTROL_START, task_id=None, **content):
    return from_fusion_node(task=Task(task_id=task_id or new_ulid(), control=control, **content))


def accepted(settings=SETTINGS):
    """A stage that a fusion node has accepted."""
    stage = SapientStage(settings)
    stage.on_connected(NOW)
    stage.on_message(acknowledgement(), None, NOW)
    return stage


class FusionNode:
    """A fusion node of SAPIENT that accepts whoever names itself NODE."""

    def __init__(self):
        self.listener = socket.create_server(('127.0.0.1', 0))
        self.listener.settimeout(START_S)
        self.peer = self.listener
        self.port = self.listener.getsockname()[1]
        self.address = f'127.0.0.1:{self.port}'

    def meet(self):
        """Take the next connection."""
        self.peer, _ = self.listener.accept()
        self.peer.settimeout(LONG_S)

    def accept(self):
        self.meet()
        assert 4 in fields(self.receive()), 'a registration comes first'
        self.send(acknowledgement())

    def receive(self):
        return exactly(self.peer, struct.unpack('<I', exactly(self.peer, 4))[0])

    def next(self, kind):
        """Content of the next message of a kind, by its field number."""
        while True:
            message = fields(self.receive())
            if kind in message:
                return message[kind][0]

    def send(self, message):
        self.peer.sendall(struct.pack('<I', len(message)) + message)

    def close(self):
        self.listener.close()
        self.peer.close()
