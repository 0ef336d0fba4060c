"""From a track to a pointing command that is safe to obey."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'controller': 'PointingController',
    'stage': 'PointingStage make_pointing_stage',
})
