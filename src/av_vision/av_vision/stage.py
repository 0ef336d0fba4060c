"""The detection stage, from images to detections and visibility, for detector_node, replay and experiments."""

from __future__ import annotations

import math
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from vision_msgs.msg import Detection2DArray

from av_common.camera import PinholeCamera
from av_common.stamps import to_seconds
from av_interfaces.msg import Visibility
from av_vision.encoded_image import MOST_PIXELS, check_pixels
from av_vision.messages import detections_message, header_of, image_from_message, visibility_message
from av_vision.models import shipped_model
from av_vision.temporal_detector import TemporalDetector
from av_vision.visibility_reporter import VisibilityReporter, VisibilitySettings
from av_vision.yolo import Detector, DetectorSettings


class DetectionStage:
    """Detects objects in every image and estimates visibility in some of them.

    Parameters:
        detector: the detector and its state over images.
        visibility: rate and scene of estimates of visibility; None for no estimates.
        camera: intrinsics for visibility over flat ground; None until `on_camera_info`.
        most_pixels: maximum number of pixels of an image; larger ones are refused.
    """

    def __init__(self, detector: TemporalDetector, visibility: VisibilitySettings | None = None,
                 camera: PinholeCamera | None = None, most_pixels: int = MOST_PIXELS) -> None:
        self.detector = detector
        self._most_pixels = most_pixels
        self._visibility = VisibilityReporter(visibility or VisibilitySettings(rate=0.0), camera)

    def on_image(self, message: Image | CompressedImage, arrival: float) -> tuple[Detection2DArray, Visibility | None]:
        """The detections in an image, and the visibility when an estimate is due; both carry the image's header.

        Parameters:
            message: raw or compressed image; its stamp is the time of capture.
            arrival (s): time of arrival on the node's clock. Not used: results depend on the time of capture.

        Raises ValueError for an image that cannot be decoded or is too large.
        """
        image = image_from_message(message, self._most_pixels)
        time, header = to_seconds(message.header.stamp), header_of(message)
        detections, tracks = self.detector.detect(image, time)
        visibility = self._visibility.report(image, time)
        return (detections_message(header, detections, tracks),
                None if visibility is None else visibility_message(header, visibility))

    def on_depth(self, message: Image) -> None:
        """Use a depth image that is aligned to the colour image as scale for visibility. Raises ValueError for other types."""
        check_pixels(message.width, message.height, self._most_pixels)
        self._visibility.on_depth(message)

    def on_camera_info(self, message: CameraInfo) -> None:
        """Use the intrinsics for visibility over flat ground. Raises ValueError for impossible ones."""
        self._visibility.on_camera_info(message)

    def reset(self) -> None:
        """Discard tracks and earlier images."""
        self.detector.reset()
        self._visibility.reset()


def make_detection_stage(parameters: Any, camera: PinholeCamera | None = None) -> DetectionStage:
    """A stage with the settings of detector_node. Raises ModelError or ValueError.

    Parameters:
        parameters: generated struct of detector_node, from the node or from `av_common.parameters.node_parameters`.
        camera: intrinsics; None until a CameraInfo arrives.
    """
    p = parameters
    detector = TemporalDetector(make_detector(p), p.track_gap, p.temporal_fusion)
    visibility = VisibilitySettings(p.visibility_rate, p.visibility_distance, p.camera_height, math.radians(p.camera_pitch_deg))
    return DetectionStage(detector, visibility, camera, p.max_image_pixels)


def make_detector(parameters: Any) -> Detector:
    """The detector of one image from the parameters of detector_node; empty names in lists are ignored.

    Raises ModelError or ValueError.
    """
    p = parameters
    return Detector(p.model or shipped_model(), DetectorSettings(
        score_threshold=p.score_threshold, nms_iou=p.nms_iou, nms_nested=p.nms_nested,
        max_detections=p.max_detections, keep=(p.target_class,),
        rename=dict.fromkeys(filter(None, p.keep_classes), p.target_class), layout=p.layout,
        class_names=tuple(filter(None, p.class_names)), input_size=p.input_size, slice_size=p.slice_size,
        providers=tuple(p.providers), threads=p.threads))
