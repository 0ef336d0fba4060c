"""Shared by all packages: base of nodes, clocks, parameters, frames, geometry of sensors, configuration files."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'angles': 'angles_to_direction direction_to_angles wrap',
    'camera': 'PinholeCamera',
    'config_reader': 'ConfigError load',
    'frames': 'attitude_of heading_of is_orientation rotation_from_rpy yaw_of',
    'geodesy': 'enu_to_geodetic geodetic_to_enu',
    'methods': 'Methods',
    'microphone_array': 'DelayCurve MicrophoneArray',
    'node': 'RigNode run',
    'parameters': 'node_parameters',
    'rig': 'Rig load_rig',
    'stamps': 'to_seconds to_stamp',
    'track': 'Source State Target Targets Track',
    'yaml_reader': 'load_yaml',
})
