"""YOLO models in ONNX of the usual exports; boxes in pixels of the image."""

from av_vision.detections import Detections
from av_vision.yolo.detector import Detector, DetectorSettings
from av_vision.yolo.model import ModelError

__all__ = ['Detections', 'Detector', 'DetectorSettings', 'ModelError']
