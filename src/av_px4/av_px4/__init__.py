"""Interface to PX4: pointing commands to its gimbal and body, and its pose as the rig's odometry."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'guard': 'BodyGuard Decision Inputs',
    'handover': 'Handover VehicleStatus',
    'stage': 'Px4Stage',
})
