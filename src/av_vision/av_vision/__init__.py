"""Camera to detections to bearings."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'bearing': 'bearings_of_boxes',
    'detections': 'Candidates Detections',
    'drawing': 'draw',
    'messages': 'camera_info_message detections_message image_from_message image_message',
    'methods': 'DETECTORS ForeignDetector',
    'models': 'shipped_model',
    'search': 'RegionPlanner',
    'sources.capture': 'Capture DeviceSource Frame SourceError',
    'sources.files': 'FileSource Recording',
    'sources.realsense': 'RealSenseSource',
    'stage': 'DetectionStage make_detection_stage make_detector',
    'temporal_detector': 'TemporalDetector',
    'visibility': 'Visibility',
    'yolo.detector': 'Detector',
    'yolo.letterbox': 'Region',
    'yolo.model': 'DetectorSettings ModelError',
})
