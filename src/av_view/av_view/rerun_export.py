"""A recording for rerun (`.rrd`) of the topics of a bag, by the optional package `rerun-sdk`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from av_bags import topics as names
from av_bags.feed import Feed
from av_bags.reader import Bag
from av_bags.topics import find_topics
from av_common.angles import angles_to_direction
from av_view.optional_package import load_optional
from av_view.picture import Picture
from av_vision.messages import image_from_message

REACH_M = 10.0  # length of directions whose range is unknown
BLUE, ORANGE, GREEN, PURPLE = (109, 179, 242), (242, 163, 60), (80, 220, 60), (199, 155, 232)
PICTURE, ABOVE = 'camera/picture', 'rig'  # paths of entities


class RerunExport:
    """Writes messages of the rig to a file of rerun: pictures with boxes, directions in the rig's frame, curves, and words.

    Parameters:
        rerun: the module.
        file: to write.
        width (pixels), quality: of the pictures, see `Picture`.
    """

    def __init__(self, rerun: ModuleType, file: Path, width: int = 640, quality: int = 80) -> None:
        self._rerun, self._width, self._quality = rerun, width, quality
        self._recording = rerun.RecordingStream('av_rig')
        self._recording.save(file)
        self._size = (1.0, 1.0)  # shares of the sides to which pictures are reduced
        self._reason = ''
        self.topics: Mapping[str, Callable[[Any], None]] = {
            names.IMAGE: self._on_image, names.DETECTIONS: self._on_detections, names.BEARING: self._on_bearing,
            names.DOA: self._on_doa, names.STATE: self._on_state, names.TARGETS: self._on_targets, names.MARKS: self._on_mark,
            names.TRUE_TARGET: self._on_truth, names.COMMAND: self._on_command}

    def write(self, name: str, arrival: float, message: Any) -> None:
        """Write one message.

        Parameters:
            name: the rig's name of its topic, one of `topics`.
            arrival (s): when it was recorded.
            message: the message.
        """
        self._recording.set_time('time', timestamp=arrival)
        self.topics[name](message)

    def close(self) -> None:
        """Finish the file."""
        self._recording.flush()
        self._recording.disconnect()

    def _log(self, path: str, what: Any) -> None:
        self._recording.log(path, what)

    def _curve(self, path: str, value: float) -> None:
        if math.isfinite(value):
            self._log(path, self._rerun.Scalars(float(value)))

    def _arrows(self, path: str, directions: list[tuple[float, float, float]], color: tuple[int, int, int],
                labels: list[str] | None = None) -> None:
        """Arrows of azimuth, elevation (rad) and length (m); those that are not finite are left out."""
        kept = np.array([one for one in directions if all(map(math.isfinite, one))]).reshape(-1, 3)
        vectors = kept[:, 2:] * angles_to_direction(kept[:, 0], kept[:, 1])
        self._log(path, self._rerun.Arrows3D(vectors=vectors, colors=[color] * len(kept),
                                             labels=labels if labels and len(labels) == len(kept) else None))

    def _on_image(self, message: Any) -> None:
        picture = Picture.of(image_from_message(message), 0.0, self._width, self._quality)
        self._size = picture.width / message.width, picture.height / message.height
        self._log(PICTURE, self._rerun.EncodedImage(contents=picture.data, media_type='image/jpeg'))

    def _on_detections(self, message: Any) -> None:
        found = [one for one in message.detections if one.results]
        best = [max((result.hypothesis for result in one.results), key=lambda hypothesis: hypothesis.score) for one in found]
        boxes = np.array([(one.bbox.center.position.x, one.bbox.center.position.y, one.bbox.size_x, one.bbox.size_y)
                          for one in found]).reshape(-1, 4) * (*self._size, *self._size)
        self._log(f'{PICTURE}/detections', self._rerun.Boxes2D(
            centers=boxes[:, :2], sizes=boxes[:, 2:], colors=[GREEN] * len(found),
            labels=[f'{one.class_id} {one.score:.2f}' for one in best]))

    def _on_bearing(self, message: Any) -> None:
        known = message.state != message.STATE_NONE
        azimuth = message.azimuth if known else math.nan
        self._curve('azimuth_deg/fused', math.degrees(azimuth))
        self._curve('sigma_deg/fused', math.degrees(math.sqrt(max(message.azimuth_variance, 0.0))) if known else math.nan)
        elevation = message.elevation if math.isfinite(message.elevation_variance) else 0.0
        self._arrows(f'{ABOVE}/bearing', [(azimuth, elevation, _length(message.range))], BLUE)

    def _on_doa(self, message: Any) -> None:
        for number, one in enumerate(message.hypotheses[:2]):
            self._curve(f'azimuth_deg/sound_{number}', math.degrees(one.azimuth))
        self._arrows(f'{ABOVE}/sound', [(one.azimuth, one.elevation, REACH_M) for one in message.hypotheses], ORANGE)

    def _on_state(self, message: Any) -> None:
        for sensor in ('sound', 'sight'):
            self._curve(f'confidence/{sensor}', getattr(message, f'{sensor}_confidence'))
        if message.reason != self._reason:
            self._reason = message.reason
            self._log('log/fusion', self._rerun.TextLog(message.reason))

    def _on_targets(self, message: Any) -> None:
        self._arrows(f'{ABOVE}/tracks', [(one.azimuth, one.elevation, _length(one.range)) for one in message.tracks], BLUE,
                     [f'#{one.id} {one.class_id}' for one in message.tracks])

    def _on_truth(self, message: Any) -> None:
        at = message.pose.pose.position
        self._log('world/target', self._rerun.Points3D([(at.x, at.y, at.z)], colors=[PURPLE], radii=0.3))

    def _on_command(self, message: Any) -> None:
        if message.move_gimbal:
            self._curve('command/pan_deg', math.degrees(message.pan))
        if message.move_body:
            self._curve('command/yaw_rate_deg_s', math.degrees(message.yaw_rate))

    def _on_mark(self, message: Any) -> None:
        self._log('log/marks', self._rerun.TextLog(message.msg, level='WARN'))


def export(path: Path, file: Path, namespace: str = '') -> tuple[dict[str, int], list[str]]:
    """Write a bag as a recording of rerun; returns the number of messages by topic, and what could not be read.

    Parameters:
        path: the bag.
        file: to write.
        namespace: of the recorded rig.

    Raises ImportError without `rerun-sdk`, BagError or OSError.
    """
    rerun, counts = load_optional(['rerun'], 'rerun-sdk', 'bag_to_rerun'), dict[str, int]()
    with Bag(path) as bag:
        recorder = RerunExport(rerun, file)
        found = find_topics(bag, recorder.topics, namespace=namespace)
        feed = Feed(bag, found.topics)
        for record in feed:
            try:
                recorder.write(record.name, record.arrival, record.message)
            except ValueError as error:  # a message of the bag that cannot be used
                feed.problems[f'{record.name}: {error}'] += 1
                continue
            counts[record.name] = counts.get(record.name, 0) + 1
        recorder.close()
        return counts, [*bag.notes, *feed.notes, *bag.problems, *feed.lost]


def _length(distance: float) -> float:
    return distance if math.isfinite(distance) else REACH_M
