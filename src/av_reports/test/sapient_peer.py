"""What a fusion node says, for tests."""

from __future__ import annotations

from report_tracks import NOW

from av_reports.identifiers import new_ulid
from av_reports.sapient.protocol import SapientMessage, Task
from av_reports.sapient.settings import SapientSettings

NODE, FUSION_NODE = '6ba7b810-9dad-41d1-80b4-00c04fd430c8', '0f0e0d0c-0b0a-4908-8706-050403020100'
SETTINGS = SapientSettings(NODE, obey_tasks=True)


def from_fusion_node(destination=NODE, **content):
    message = SapientMessage(node_id=FUSION_NODE, destination_id=destination, **content)
    message.timestamp.FromNanoseconds(round(NOW * 1e9))
    return message.SerializeToString()


def acknowledgement(acceptance=True, reasons=()):
    return from_fusion_node(registration_ack={'acceptance': acceptance, 'ack_response_reason': reasons})


def task(control=Task.CONTROL_START, task_id=None, **content):
    return from_fusion_node(task=Task(task_id=task_id or new_ulid(NOW), control=control, **content))
