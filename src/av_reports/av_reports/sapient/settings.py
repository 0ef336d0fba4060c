"""What a node says of itself, and what it reports."""

from __future__ import annotations

from dataclasses import dataclass

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
        name: how users call it.
        positions: it reports positions of a network of rigs; otherwise bearings of a single rig.
        north: its bearings count from true north; otherwise from the rig's forward direction.
        status_interval (s): time between status reports.
        rate (Hz): most reports of an object a second.
        obey_tasks: tasks of the fusion node are obeyed; otherwise all are refused.
        software_version: of this suite.
    """

    node_id: str
    name: str = 'audio-visual rig'
    positions: bool = False
    north: bool = True
    status_interval: float = 10.0
    rate: float = 2.0
    obey_tasks: bool = False
    software_version: str = ''
