"""YOLO models in ONNX: whatever export people have, in; boxes in pixels of the picture, out."""

from av_vision.yolo.detections import Detections
from av_vision.yolo.detector import Detector, DetectorSettings
from av_vision.yolo.model import ModelError

__all__ = ['Detections', 'Detector', 'DetectorSettings', 'ModelError']
