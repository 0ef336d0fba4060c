"""Positions of targets as PX4 takes those of aircraft from a receiver of ADS-B."""

from __future__ import annotations

import importlib
import math
from types import ModuleType
from typing import Any

import numpy as np

from av_reports.contacts import PositionTrack

# Of PX4's TransponderReport, which is MAVLink's ADSB_VEHICLE (246).
COORDINATES, ALTITUDE, HEADING, VELOCITY, CALLSIGN = 1, 2, 4, 8, 16
GEOMETRIC, UAV = 1, 14
LOCAL_ADDRESSES = 0xF00000  # of ICAO's 24 bits; those from here on belong to no country
LONGEST_S = 255


def load_px4_msgs() -> ModuleType:
    """The module px4_msgs.msg. Raises ImportError with instructions for its installation."""
    try:
        return importlib.import_module('px4_msgs.msg')
    except ImportError as error:
        raise ImportError('traffic.enabled needs px4_msgs of the firmware in the workspace: docs/guides/px4.md') from error


def transponder_report(messages: Any, track: PositionTrack, timestamp: int, geoid_height: float) -> Any:
    """The TransponderReport of a target.

    Parameters:
        messages: the module px4_msgs.msg.
        track: the target.
        timestamp (us): the present.
        geoid_height (m): of mean sea level above the ellipsoid, from which PX4 counts altitudes.
    """
    east, north, up = track.velocity
    moving = HEADING | VELOCITY if all(map(math.isfinite, track.velocity_sigma)) else 0
    report = messages.TransponderReport(
        timestamp=timestamp, icao_address=LOCAL_ADDRESSES | track.id & 0xFFFFF, lat=track.latitude, lon=track.longitude,
        altitude_type=GEOMETRIC, altitude=track.altitude - geoid_height, heading=math.atan2(east, north) % math.tau,
        hor_velocity=math.hypot(east, north), ver_velocity=up, emitter_type=UAV,
        tslc=min(max(round(track.time - track.measured), 0), LONGEST_S),
        flags=COORDINATES | ALTITUDE | CALLSIGN | moving)
    callsign = f'AV{track.id % 1_000_000:06d}'.encode()
    report.callsign = np.frombuffer(callsign.ljust(len(report.callsign), b'\0'), np.uint8)
    return report
