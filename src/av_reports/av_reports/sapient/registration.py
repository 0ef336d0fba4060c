"""The registration of a node: what it is, what it reports, and which tasks it takes."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Any

from av_reports.sapient.protocol import ICD_VERSION, Registration, location, range_bearing, velocity
from av_reports.settings import CLASSES, UNKNOWN_CLASS, SapientSettings

MODE = 'default'
REQUESTS = ('Registration', 'Status')
MANUFACTURER, MODEL = 'av_rig', 'audio-visual rig'
STATUS_S = 10.0  # between status reports
COMPLETION_S = 10.0  # time in which a camera looks where it was told to, at the most
TRACK_INFO = (('front_back_probability', 'probability, 0.5 to 1'), ('drone_probability', 'probability, 0 to 1'),
              ('measured', 's since the newest measurement'))


def registration_message(settings: SapientSettings) -> Any:
    """The Registration of a node.

    Parameters:
        settings: what it is.
    """
    kinds = [('Microphones', Registration.NODE_TYPE_ACOUSTIC), ('Camera', Registration.NODE_TYPE_CAMERA)]
    return Registration(
        node_definition=[Registration.NodeDefinition(node_type=kind, node_sub_type=[name]) for name, kind in kinds],
        icd_version=ICD_VERSION, name=MODEL, short_name=MODEL,
        capabilities=[Registration.Capability(category='Passive', type='Position' if settings.positions else 'Bearing')],
        status_definition=Registration.StatusDefinition(
            status_interval=_seconds(STATUS_S), location_definition=_place()),
        mode_definition=[_mode(settings)],
        config_data=[Registration.ConfigurationData(manufacturer=MANUFACTURER, model=MODEL, software_version=_version())])


def _mode(settings: SapientSettings) -> Any:
    return Registration.ModeDefinition(
        mode_name=MODE, mode_type=Registration.MODE_TYPE_DEFAULT, settle_time=_seconds(0.0),
        scan_type=Registration.SCAN_TYPE_STEERABLE, tracking_type=Registration.TRACKING_TYPE_TRACKLET,
        detection_definition=[_detections(settings)],
        task=Registration.TaskDefinition(
            concurrent_tasks=1, region_definition=Registration.RegionDefinition(
                region_type=[Registration.REGION_TYPE_AREA_OF_INTEREST], region_area=[_directions(settings)]),
            command=_commands(settings)))


def _detections(settings: SapientSettings) -> Any:
    details = [Registration.DetectionReport(category=Registration.DETECTION_REPORT_CATEGORY_TRACK, type=name, units=units)
               for name, units in TRACK_INFO]
    details.append(Registration.DetectionReport(
        category=Registration.DETECTION_REPORT_CATEGORY_OBJECT, type='type', units='name of a type of drones'))
    found = Registration.DetectionDefinition(
        location_type=_place() if settings.positions else _directions(settings), detection_report=details,
        detection_class_definition=[Registration.DetectionClassDefinition(
            confidence_definition=Registration.CONFIDENCE_DEFINITION_SINGLE_CLASS, class_definition=_classes())],
        geometric_error=Registration.GeometricError(
            type='Standard Deviation', units='degrees, metres' if settings.positions else 'degrees',
            variation_type='Each Report'))
    if settings.positions:
        found.velocity_type.enu_velocity_units.CopyFrom(velocity.ENUVelocityUnits(
            east_north_rate_units=velocity.SPEED_UNITS_MS, up_rate_units=velocity.SPEED_UNITS_MS))
        found.velocity_type.location_datum = location.LOCATION_DATUM_WGS84_E
    return found


def _classes() -> list[Any]:
    """The classes, each with its sub-classes."""
    found = []
    for kind in [*sorted({kind for kind, _ in CLASSES.values()}), UNKNOWN_CLASS]:
        finer = [Registration.SubClass(type=sub, units='probability', level=1) for one, sub in CLASSES.values() if one == kind]
        found.append(Registration.ClassDefinition(type=kind, units='probability', sub_class=finer))
    return found


def _commands(settings: SapientSettings) -> list[Any]:
    """The commands that are obeyed; a network's targets are not those of the tracker that follows one."""
    kinds = [(Registration.COMMAND_TYPE_REQUEST, ', '.join(REQUESTS))]
    if settings.obey_tasks:
        kinds += [(Registration.COMMAND_TYPE_LOOK_AT, 'RangeBearing, LocationList of one')]
        kinds += [] if settings.positions else [(Registration.COMMAND_TYPE_FOLLOW, 'object_id')]
    return [Registration.Command(type=kind, units=units, completion_time=_seconds(COMPLETION_S)) for kind, units in kinds]


def _place() -> Any:
    return Registration.LocationType(location_units=location.LOCATION_COORDINATE_SYSTEM_LAT_LNG_DEG_M,
                                     location_datum=location.LOCATION_DATUM_WGS84_E)


def _directions(settings: SapientSettings) -> Any:
    north = range_bearing.RANGE_BEARING_DATUM_TRUE if settings.north else range_bearing.RANGE_BEARING_DATUM_PLATFORM
    return Registration.LocationType(range_bearing_units=range_bearing.RANGE_BEARING_COORDINATE_SYSTEM_DEGREES_M,
                                     range_bearing_datum=north)


def _seconds(value: float) -> Any:
    return Registration.Duration(units=Registration.TIME_UNITS_SECONDS, value=value)


def _version() -> str | None:
    try:
        return version('av_reports')
    except PackageNotFoundError:  # not installed
        return None
