"""Detection with YOLO models in ONNX format; boxes are in pixels of the image."""

from av_vision.detections import Detections
from av_vision.yolo.detector import Detector
from av_vision.yolo.model import DetectorSettings, ModelError

__all__ = ['Detections', 'Detector', 'DetectorSettings', 'ModelError']
