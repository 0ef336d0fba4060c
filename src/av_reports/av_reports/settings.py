"""Settings of stages and connections from the parameters of report_node."""

from __future__ import annotations

import math
import re
import socket
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from av_reports.contacts import Place, Selection
from av_reports.cot.connection import CotAddress, check_address
from av_reports.cot.settings import CotSettings
from av_reports.identifiers import is_uuid, node_uuid
from av_reports.peer import parse_peer
from av_reports.sapient.settings import SapientSettings
from av_reports.stage import ReportSettings

COT_TYPE = re.compile(r'\w+(-\w+)*')


def report_settings(values: Any) -> ReportSettings:
    """What is reported.

    Parameters:
        values: the parameters.
    """
    known = values.surveyed
    place = Place(known.latitude, known.longitude, known.altitude, known.sigma) if known.enabled else None
    return ReportSettings(
        Selection(values.min_existence, values.max_age, values.only_drones, values.unresolved), values.positions, values.north,
        place, math.radians(known.heading_deg) if known.enabled else None, values.place_age)


def sapient_settings(values: Any, name: str) -> SapientSettings:
    """What the node of SAPIENT is. Raises ValueError for a node_id that is no UUID.

    Parameters:
        values: the parameters.
        name: full name of the ROS node.
    """
    given = values.sapient
    if given.node_id and not is_uuid(given.node_id):
        raise ValueError(f'sapient.node_id is {given.node_id!r:.80}, expected a UUID, or nothing for one of its own')
    return SapientSettings(
        given.node_id.lower() or node_uuid(socket.gethostname(), name), given.name, values.positions, values.north,
        given.status_interval, given.rate, given.obey_tasks, _version())


def cot_settings(values: Any, name: str) -> CotSettings:
    """What is told to TAK. Raises ValueError for types that are none.

    Parameters:
        values: the parameters.
        name: full name of the ROS node.
    """
    given = values.cot
    for parameter in ('target_type', 'rig_type'):
        if not COT_TYPE.fullmatch(getattr(given, parameter)):
            raise ValueError(f'cot.{parameter} is {getattr(given, parameter)!r:.80}, expected a type such as a-u-A-M-H-Q')
    return CotSettings(given.uid or node_uuid(socket.gethostname(), name), given.callsign, given.target_type, given.rig_type,
                       given.stale, given.rig_stale, given.interval, given.sensor_range)


def cot_address(values: Any) -> CotAddress:
    """Where events go.

    Parameters:
        values: the parameters.
    """
    given = values.cot
    return CotAddress(given.url, given.multicast_interface, given.client_cert, given.client_key, given.ca_file)


def check_settings(values: Any) -> None:
    """Raise ValueError where parameters do not fit each other.

    Parameters:
        values: the parameters.
    """
    if values.sapient.peer:
        parse_peer(values.sapient.peer)
    sapient_settings(values, '')
    cot_settings(values, '')
    if values.traffic.enabled and not values.positions:
        raise ValueError('traffic.enabled is true and positions is false: bearings are no positions')
    if values.cot.url:
        check_address(cot_address(values))


def _version() -> str:
    try:
        return version('av_reports')
    except PackageNotFoundError:  # not installed
        return ''
