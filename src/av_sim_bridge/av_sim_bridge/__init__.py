"""Bridge from simulators on UDP to the topics of the rig: wire formats, receivers, and one node."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'stage': 'BridgeStage make_bridge_stage',
    'vehicle': 'VehicleState',
})
