"""Several rigs: their tracks to targets with positions."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'settings': 'RigSettings',
    'stage': 'NetworkStage RigPlace',
    'tracker': 'NetworkTracker',
    'observation': 'Observation Report Sighting',
    'network_target': 'TargetState',
})
