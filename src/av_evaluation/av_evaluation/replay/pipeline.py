"""The stages of the rig one after the other, and how its sensors are turned on the body."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, TypeVar

from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from av_audio.stage import DoaStage
from av_bags import topics as names
from av_bags.definitions import serialiser
from av_bags.reader import Bag
from av_common.body_odometry import FixedFrames
from av_common.frames import BASE_FRAME
from av_common.freshness import Instant
from av_common.gimbal_history import GimbalHistory, NotYetKnownError
from av_common.rig import Rig, camera_topic
from av_common.rig_messages import static_transforms
from av_common.stamps import to_seconds
from av_common.track_messages import track_of_bearing
from av_evaluation.metrics.run_log import RunLog
from av_fusion.measurement.converter import MeasurementConverter
from av_fusion.stage import FusionOutput, FusionStage
from av_interfaces.msg import AudioFrame
from av_pointing.stage import PointingStage
from av_vision.stage import DetectionStage

Message = TypeVar('Message')


class Pipeline:
    """Passes messages through the stages of the rig, as middleware would in no time.

    A stage that is None or absent is not computed: its results are expected as messages. Arrivals must not decrease.

    Attributes:
        problems: number of messages that could not be used, by topic and reason.

    Parameters:
        doa, fusion, pointing: the stages.
        detection: those of cameras, by their names.
        log: is given measurements and tracks where fusion is not computed.
        converter: converts directions and detections to measurements for it.
        publish: is called with topic (the rig's name), time (s) and message of each result.
        estimators: further stages that estimate directions, by method, whose most confident ones go to the log.
    """

    def __init__(self, doa: DoaStage | None, detection: Mapping[str, DetectionStage], fusion: FusionStage | None,
                 pointing: PointingStage | None, log: RunLog, converter: MeasurementConverter,
                 publish: Callable[[str, float, Any], None], estimators: Mapping[str, DoaStage]) -> None:
        self._estimators = estimators
        self._doa, self._detection, self._fusion, self._pointing = doa, detection, fusion, pointing
        self._log, self._converter, self._publish = log, converter, publish
        self.problems: Counter[str] = Counter()

    def advance(self, now: float) -> None:
        """Publish what is due until `now` (s) without a message."""
        if self._fusion is not None and self._fusion.due <= now:
            for output in self._fusion.outputs_until(now):
                self._publish_fused(output)

    def take(self, name: str, message: Any, arrival: float) -> None:
        """Process a message of the topic `name` (the rig's) that arrives at `arrival` (s)."""
        camera, kind = names.of_camera(name)
        detection = self._detection.get(camera)
        try:
            self._share(name, message, arrival)
            if name == names.AUDIO and self._doa is not None:
                self._hear(self._doa, message, arrival)
            elif name == names.MOTORS and self._doa is not None:
                self._doa.on_motor_speeds(message)
            elif kind == names.IMAGE and detection is not None:
                detections, visibility = detection.on_image(message, arrival)
                for topic, sensed in ((names.VISIBILITY, visibility), (names.DETECTIONS, detections)):
                    if sensed is not None:
                        self._publish_sensed(camera_topic(camera, topic), sensed, arrival)
            elif self._fusion is not None:
                self._fuse(self._fusion, name, message, arrival)
            else:
                self._follow(name, message, arrival)
        except NotYetKnownError:
            self.problems[f"{name}: the gimbal's orientation at its time is not known"] += 1
        except ValueError as error:
            self.problems[f'{name}: {error}'] += 1

    def _share(self, name: str, message: Any, arrival: float) -> None:
        """Give the rig's pose and cameras, whose regions of interest may move, to all but the fusion. Raises ValueError."""
        camera, kind = names.of_camera(name)
        if kind == names.CAMERA:
            self._converter.set_camera_info(message, camera)
            if problem := self._converter.problems.get(camera):
                self.problems[problem] += 1
            if camera in self._detection:
                self._detection[camera].on_camera_info(message)
        elif name == names.ODOMETRY:
            for detection in self._detection.values():
                detection.on_odometry(message)
            if self._pointing is not None:
                self._pointing.on_odometry(message, Instant(arrival, arrival))

    def _hear(self, doa: DoaStage, frame: AudioFrame, arrival: float) -> None:
        self._compare(frame, arrival)
        directions = doa.on_audio(frame, arrival)
        for odds in doa.odds:
            self._publish_sensed(names.ODDS, odds, arrival)
        for message in directions:
            self._publish_sensed(names.DOA, message, arrival)

    def _compare(self, frame: AudioFrame, arrival: float) -> None:
        """Give the other estimators a frame; one that cannot be used is reported by the rig's own stage."""
        for method, stage in self._estimators.items():
            with suppress(ValueError):
                for directions in stage.on_audio(frame, arrival):
                    self._log.on_other(method, self._converter.doa(transmitted(directions)), arrival)

    def _fuse(self, fusion: FusionStage, name: str, message: Any, arrival: float) -> None:
        output = None
        camera, kind = names.of_camera(name)
        if name == names.ODOMETRY:
            fusion.on_odometry(message, arrival)
        elif kind == names.CAMERA:
            fusion.on_camera_info(message, camera)
        elif kind == names.VISIBILITY:
            fusion.on_visibility(message, camera)
        elif name == names.GIMBAL:
            output = fusion.on_gimbal(message, arrival)
        elif name == names.ODDS:
            fusion.on_odds(message)
        elif name == names.CUE:
            fusion.on_cue(message, arrival)
        elif name == names.DOA:
            output = fusion.on_doa(message, arrival)
        elif kind == names.DETECTIONS:
            output = fusion.on_detections(message, arrival, camera)
        if output is not None:
            self._publish_fused(output)

    def _follow(self, name: str, message: Any, arrival: float) -> None:
        """Take a message when the bearings are recorded ones."""
        camera, kind = names.of_camera(name)
        if name == names.DOA:
            self._log.on_doa(self._converter.doa(message), arrival)
        elif kind == names.DETECTIONS:
            measurement = self._converter.detections(message, camera=camera)
            if measurement is not None:
                self._log.on_camera(measurement, message, arrival)
        elif name == names.BEARING:
            self._log.on_track(track_of_bearing(message), arrival)
            self._point(message, arrival)

    def _publish_sensed(self, name: str, message: Any, arrival: float) -> None:
        received = transmitted(message)
        self._publish(name, arrival, received)
        self.take(name, received, arrival)

    def _publish_fused(self, output: FusionOutput) -> None:
        now = to_seconds(output.bearing.header.stamp)
        self._publish(names.STATE, now, output.state)
        self._publish(names.TARGETS, now, output.targets)
        self._publish(names.BEARING, now, output.bearing)
        for detection in self._detection.values():
            detection.on_bearing(output.bearing)
        self._point(output.bearing, now)

    def _point(self, bearing: Any, now: float) -> None:
        if self._pointing is not None:
            self._publish(names.COMMAND, now, self._pointing.on_bearing(bearing, Instant(now, now)))


def transmitted(message: Message) -> Message:
    """A message as a subscriber finds it: with the precision of its fields."""
    kind = type(message)
    name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
    return deserialize_message(serialiser(name)(message), kind)


class SensorFrames:
    """Rotations (3, 3) of sensor frames into the body's, by name.

    Attributes:
        unknown: frames that were asked for in vain.
        impossible: frames whose transform has a quaternion of another norm than 1; it is left out.

    Parameters:
        rig: the description.
        gimbal: orientations of the rig's gimbal.
    """

    def __init__(self, rig: Rig, gimbal: GimbalHistory) -> None:
        self._fixed, self._described = FixedFrames(), FixedFrames()
        self._described.learn(static_transforms(rig, Time()))
        self._gimbal, self._carrier = gimbal, rig.gimbal.frame if rig.gimbal else BASE_FRAME
        self._known: dict[str, tuple[str, NDArray] | None] = {}
        self.unknown: set[str] = set()
        self.impossible: set[str] = set()

    def learn(self, bag: Bag, topic: str) -> None:
        """Take the transforms of a bag's topic; they go before the rig's description."""
        for _, _, data in bag.messages([topic]):
            self.impossible |= set(self._fixed.learn(bag.decode(topic, data).transforms))

    def rotation(self, frame: str, time: float) -> NDArray | None:
        """From `frame` to the body at `time` (s); None where neither transforms nor the description know it.

        Raises NotYetKnownError where the gimbal's orientation may still come.
        """
        if frame not in self._known:
            self._known[frame] = self._look_up(frame)
            if self._known[frame] is None:
                self.unknown.add(frame)
        parent, rotation = self._known[frame] or ('', None)
        if rotation is None or parent == BASE_FRAME:
            return rotation
        sample = self._gimbal.at(time)
        return None if sample is None else sample.rotation @ rotation

    def fixed(self, frame: str) -> NDArray | None:
        """From `frame` to the body; None where it is not known, or moves with the gimbal."""
        parent, rotation = self._look_up(frame) or (BASE_FRAME, self._fixed.rotation(frame))
        return rotation if parent == BASE_FRAME else None

    def _look_up(self, frame: str) -> tuple[str, NDArray] | None:
        """The body's or the gimbal's frame, and the rotation into it."""
        return next((found for frames in (self._fixed, self._described) for found in frames.ancestors(frame)
                     if found[0] in (BASE_FRAME, self._carrier)), None)
