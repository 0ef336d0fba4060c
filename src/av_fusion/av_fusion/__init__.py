"""Fusion of directions of arrival and detections to the bearing of one target; launch files of the suite."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'tracker': 'MultiTargetTracker',
    'measurement.measurements': 'CameraMeasurement Cone Detection DoaMeasurement Hypothesis',
    'measurement.rig_motion': 'Pose RigMotion',
    'plain_tracker': 'PlainTracker',
    'settings': 'TRACKERS Tracker make_tracker',
    'stage': 'FusionOutput FusionStage make_fusion_stage',
})
