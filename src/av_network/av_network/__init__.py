"""Several rigs: their tracks to targets with positions."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'stage': 'NetworkStage RigPlace',
    'tracker': 'NetworkTracker',
    'observation': 'Observation Report RigSettings Sighting',
    'network_target': 'TargetState',
})
