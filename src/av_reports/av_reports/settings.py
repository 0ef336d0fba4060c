"""Settings of stages and connections from the parameters of report_node."""

from __future__ import annotations

import math
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

SURVEYED_SIGMA_M = 5.0  # of a place along each axis, as a map or a receiver without corrections gives it


def report_settings(values: Any) -> ReportSettings:
    """What is reported.

    Parameters:
        values: the parameters.
    """
    known = values.surveyed
    place = Place(known.latitude, known.longitude, known.altitude, SURVEYED_SIGMA_M) if known.enabled else None
    heading = math.radians(known.heading_deg) if known.enabled else None
    return ReportSettings(Selection(only_drones=values.only_drones), values.positions, values.north, place, heading)


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
        given.node_id.lower() or node_uuid(socket.gethostname(), name), positions=values.positions, north=values.north,
        obey_tasks=given.obey_tasks, software_version=_version())


def cot_settings(values: Any, name: str) -> CotSettings:
    """What is told to TAK; the rig is called by its namespace there.

    Parameters:
        values: the parameters.
        name: full name of the ROS node.
    """
    namespace = name.strip('/').rpartition('/')[0]
    return CotSettings(values.cot.uid or node_uuid(socket.gethostname(), name), namespace or CotSettings.callsign)


def cot_address(values: Any) -> CotAddress:
    """Where events go.

    Parameters:
        values: the parameters.
    """
    given = values.cot
    return CotAddress(given.url, client_cert=given.client_cert, client_key=given.client_key, ca_file=given.ca_file)


def check_settings(values: Any) -> None:
    """Raise ValueError where parameters do not fit each other.

    Parameters:
        values: the parameters.
    """
    if values.sapient.peer:
        parse_peer(values.sapient.peer)
    sapient_settings(values, '')
    if values.traffic.enabled and not values.positions:
        raise ValueError('traffic.enabled is true and positions is false: bearings are no positions')
    if values.cot.url:
        check_address(cot_address(values))


def _version() -> str:
    try:
        return version('av_reports')
    except PackageNotFoundError:  # not installed
        return ''
