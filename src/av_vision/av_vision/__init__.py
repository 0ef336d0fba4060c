"""Camera to detections to bearings."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'bearing': 'bearings_of_boxes',
    'detections': 'Candidates Detections',
    'drawing': 'draw',
    'methods': 'DETECTORS ForeignDetector',
    'models': 'shipped_model',
    'stage': 'DetectionStage make_detection_stage make_detector',
    'temporal_detector': 'TemporalDetector',
    'visibility': 'Visibility',
    'yolo': 'Detector DetectorSettings ModelError',
})
