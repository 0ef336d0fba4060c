"""Seeing as the parameters of detector_node describe it, for the node and for what does without one."""

from __future__ import annotations

from typing import Any

from av_vision.models import shipped_model
from av_vision.yolo import Detector, DetectorSettings


def make_detector(p: Any) -> Detector:
    """Of the parameters of detector_node; empty names in lists stand for none. Raises ModelError or ValueError."""
    return Detector(p.model or shipped_model(), DetectorSettings(
        score_threshold=p.score_threshold, nms_iou=p.nms_iou, nms_nested=p.nms_nested,
        max_detections=p.max_detections, keep=(p.target_class,),
        rename=dict.fromkeys(filter(None, p.keep_classes), p.target_class), layout=p.layout,
        class_names=tuple(filter(None, p.class_names)), input_size=p.input_size, slice_size=p.slice_size,
        providers=tuple(p.providers), threads=p.threads))
