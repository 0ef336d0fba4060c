"""What is told to TAK."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CotSettings:
    """Settings of the events.

    Parameters:
        uid: names this rig; the uid of each target begins with it.
        callsign: what users of TAK read beside the rig's marker.
        target_type: type of targets with a position, such as a-u-A-M-H-Q: unknown, air, military, rotary wing, drone.
        rig_type: type of the rig's own marker, such as a-f-G-E-S: friendly, ground, equipment, sensor.
        stale (s): time after which an event of a target is no longer shown.
        rig_stale (s): the same of the rig's own marker.
        interval (s): time between two events of a target.
        sensor_range (m): length of a drawn bearing; that of the target is not known.
    """

    uid: str
    callsign: str = 'rig'
    target_type: str = 'a-u-A-M-H-Q'
    rig_type: str = 'a-f-G-E-S'
    stale: float = 10.0
    rig_stale: float = 120.0
    interval: float = 1.0
    sensor_range: float = 500.0
