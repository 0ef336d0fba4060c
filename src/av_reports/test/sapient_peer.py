"""Tracks to report, and what a fusion node says, for tests."""

from __future__ import annotations

import math

from av_reports.contacts import BearingTrack, PositionTrack
from av_reports.sapient.identifiers import new_ulid
from av_reports.sapient.protocol import SapientMessage, Task
from av_reports.sapient.settings import SapientSettings

NODE, FUSION_NODE = '6ba7b810-9dad-41d1-80b4-00c04fd430c8', '0f0e0d0c-0b0a-4908-8706-050403020100'
NOW = 1_700_000_000.25
SETTINGS = SapientSettings(NODE, obey_tasks=True)


def bearing(number=3, **values):
    return BearingTrack(**{
        'id': number, 'time': NOW - 0.1, 'measured': NOW - 0.2, 'existence': 0.9, 'drone_probability': 0.8, 'class_id': 'drone',
        'azimuth': math.radians(300.0), 'azimuth_sigma': math.radians(2.0), 'elevation': math.radians(12.0),
        'elevation_sigma': math.radians(4.0), **values})


def position(number=5, **values):
    return PositionTrack(**{
        'id': number, 'time': NOW - 0.1, 'measured': NOW - 0.2, 'existence': 0.95, 'class_id': 'drone', 'latitude': 51.5,
        'longitude': -0.12, 'altitude': 80.0, 'covariance': ((4.0, 1.0, 0.0), (1.0, 9.0, 0.0), (0.0, 0.0, 1.0)),
        'velocity': (1.0, -2.0, 0.5), 'velocity_sigma': (0.1, 0.2, 0.3), **values})


def from_fusion_node(destination=NODE, **content):
    message = SapientMessage(node_id=FUSION_NODE, destination_id=destination, **content)
    message.timestamp.FromNanoseconds(round(NOW * 1e9))
    return message.SerializeToString()


def acknowledgement(acceptance=True, reasons=()):
    return from_fusion_node(registration_ack={'acceptance': acceptance, 'ack_response_reason': reasons})


def task(control=Task.CONTROL_START, task_id=None, **content):
    return from_fusion_node(task=Task(task_id=task_id or new_ulid(NOW), control=control, **content))
