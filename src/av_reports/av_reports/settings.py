"""Settings of stages and connections from the parameters of report_node."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from av_reports.contacts import Place
from av_reports.cot.connection import check_address
from av_reports.identifiers import is_uuid
from av_reports.link import parse_peer
from av_reports.stage import ReportSettings

SURVEYED_SIGMA_M = 5.0  # of a place along each axis, as a map or a receiver without corrections gives it
CLASSES = {  # of this suite: class and sub-class of the standard's taxonomy
    'drone': ('Air Vehicle', 'UAV Rotary Wing'), 'airplane': ('Air Vehicle', 'Manned Fixed Wing'),
    'helicopter': ('Air Vehicle', 'Manned Rotary Wing'), 'bird': ('Animal', 'Bird'),
}
UNKNOWN_CLASS = 'Unknown'


@dataclass(frozen=True)
class SapientSettings:
    """Settings of a node of SAPIENT.

    Parameters:
        node_id: UUID that names this node to its fusion node.
        positions: it reports positions of a network of rigs; otherwise bearings of a single rig.
        north: its bearings count from true north; otherwise from the rig's forward direction.
        obey_tasks: tasks of the fusion node are obeyed; otherwise all are refused.
    """

    node_id: str
    positions: bool = False
    north: bool = True
    obey_tasks: bool = False


def report_settings(values: Any) -> ReportSettings:
    """What is reported.

    Parameters:
        values: the parameters.
    """
    known = values.surveyed
    is_surveyed = bool(known.latitude or known.longitude)
    place = Place(known.latitude, known.longitude, known.altitude, SURVEYED_SIGMA_M) if is_surveyed else None
    heading = math.radians(known.heading_deg) if is_surveyed else None
    return ReportSettings(values.only_drones, values.positions, values.north, place, heading)


def check_settings(values: Any) -> None:
    """Raise ValueError where parameters do not fit each other.

    Parameters:
        values: the parameters.
    """
    if values.sapient.peer:
        parse_peer(values.sapient.peer)
    node_id = values.sapient.node_id
    if node_id and not is_uuid(node_id, 4):  # the middleware acknowledges no others
        raise ValueError(f'sapient.node_id is {node_id!r:.80}, expected a UUID of version 4, or nothing for one of its own')
    if values.cot.url:
        check_address(values.cot)
