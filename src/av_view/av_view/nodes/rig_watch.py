"""The subscriptions to one rig that somebody looks at."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import MarkerArray

from av_common.guarded_node import decode
from av_common.node import RigNode
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.refused_inputs import BAD_INPUT
from av_common.stamps import to_seconds
from av_common.tf_rotations import TfRotations
from av_fusion.measurement.converter import MeasurementConverter
from av_interfaces.msg import (
    AudioFrame,
    AzimuthPosterior,
    Bearing,
    DoaArray,
    FusionState,
    PointingCommand,
    TrackArray,
    WorldTrackArray,
)
from av_view.camera_view import CameraView
from av_view.coherence import Coherence
from av_view.feed import Feed
from av_view.foxglove_port import Shown
from av_view.markers import markers, world_markers
from av_view.picture import Picture
from av_view.rig_state import RigState
from av_view.rows import row_of
from av_view.spectrum import spectrum
from av_vision.messages import image_from_message

TRUTH, WORLD = 'truth/', 'av_interfaces/msg/WorldTrackArray'
CAMERA_PERIOD_S, SPECTRUM_PERIOD_S, MOST_SAMPLES = 1.0, 0.25, 100_000
Take = Callable[[Any, float], None]  # of a message and the time of its arrival (s)


class RigWatch:
    """Subscribes to the topics of a namespace, and puts what viewers see into its feed.

    Messages are decoded when they are shown, those that newer ones replace before never: most come more often than pictures.

    Attributes:
        seen (s): when somebody last looked, by `time.monotonic`.
        shown: the newest state and picture.

    Parameters:
        node: owns the subscriptions.
        rig: namespace of the rig, such as '/left', or ''.
        put: changes the feed.
    """

    def __init__(self, node: RigNode, rig: str, put: Callable[[Callable[[Feed], None]], None]) -> None:
        self.seen = time.monotonic()
        self._node, self._rig, self._put, self._settings = node, rig, put, node.settings
        self._state = state = RigState()
        self.shown = Shown(state.snapshot(node.now()), None)
        self._spectrum_time, self._coherence = 0.0, Coherence()
        self._waiting: dict[str, tuple[bytes, float]] = {}  # the newest message of each topic, and when it came (monotonic, s)
        self._topics: dict[str, tuple[Any, Take, float]] = {}  # with the period (s) in which one message is taken
        self._due: dict[str, float] = {}  # when a message of a topic is taken again (monotonic, s)
        before = set(node.entities())
        self._rotations = TfRotations(node, self._settings.base_frame)
        self._converter = MeasurementConverter(self._rotations.rotation, self._settings.target_classes)
        # In the order in which they are taken: the camera before what is seen through it.
        self._subscribe(CameraInfo, 'camera/camera_info', lambda message, _: self._converter.set_camera_info(message), STREAM,
                        period=CAMERA_PERIOD_S)
        self._subscribe(Image, 'camera/image_raw', self._on_image, IMAGE)
        self._subscribe(Bearing, 'target/bearing', state.on_bearing, RESULT)
        self._subscribe(FusionState, 'fusion/state', state.on_fusion, RESULT)
        self._subscribe(TrackArray, 'targets', state.on_tracks, RESULT)
        self._subscribe(AzimuthPosterior, 'fusion/posterior', state.on_posterior, RESULT)
        self._subscribe(Log, 'marks', state.on_mark, RESULT)
        self._subscribe(PointingCommand, 'pointing/command', state.on_command, RESULT)
        self._subscribe(DoaArray, 'doa', lambda message, _: state.on_doa(message, self._converter.doa(message)), STREAM)
        self._subscribe(Detection2DArray, 'detections', self._on_detections, STREAM)
        self._subscribe(AudioFrame, 'audio/frames', self._on_audio, STREAM, period=SPECTRUM_PERIOD_S)
        self._entities = [entity for entity in node.entities() if entity not in before]

    def find_topics(self) -> None:
        """Subscribe to the true poses of a simulation, and to the tracks of several rigs, as they appear."""
        beginning, before = f'{self._rig}/{TRUTH}', set(self._node.entities())
        for topic, kinds in self._node.get_topic_names_and_types():
            name = topic.removeprefix(beginning)
            if topic.startswith(beginning) and 'nav_msgs/msg/Odometry' in kinds and f'{TRUTH}{name}' not in self._topics:
                self._subscribe(Odometry, f'{TRUTH}{name}', partial(self._state.on_truth, name), STREAM)
            elif WORLD in kinds and WORLD not in self._topics:
                self._subscribe(WorldTrackArray, WORLD, self._state.world.on_tracks, RESULT, topic)
        self._entities += [entity for entity in self._node.entities() if entity not in before]

    def update(self) -> None:
        """Put the present state into the feed."""
        now = time.monotonic()
        offset = self._node.now() - now
        for topic in [name for name in self._topics if name in self._waiting and now >= self._due.get(name, now)]:
            data, arrival = self._waiting.pop(topic)
            self._due[topic] = now + self._topics[topic][2]
            self._take(topic, data, arrival + offset)
        snapshot = self._state.snapshot(self._node.now())
        self.shown = Shown(snapshot, self.shown.picture)
        state, row = (json.dumps(part, separators=(',', ':'), allow_nan=False) for part in (snapshot, row_of(snapshot)))
        self._put(lambda feed: feed.put_state(state, row))

    def markers(self) -> MarkerArray:
        """The state of the newest update, for RViz and Foxglove."""
        made = markers(self.shown.snapshot, self._state.sound, self._settings.base_frame)
        if self.shown.snapshot['world'] is not None:
            made.markers.extend(world_markers(self._state.world.message))
        return made

    def close(self) -> None:
        """End the subscriptions."""
        self._node.destroy_entities(self._entities)

    def _subscribe(self, kind: Any, topic: str, take: Take, qos: QoSProfile, name: str = '', period: float = 0.0) -> None:
        """Keep the newest message of a topic, which has another `name` where it is not one of the rig; once a `period` (s)."""
        def wait(data: bytes) -> None:
            self._waiting[topic] = data, time.monotonic()

        self._topics[topic] = kind, take, period
        self._node.create_subscription(kind, name or f'{self._rig}/{topic}', wait, qos, raw=True)

    def _take(self, topic: str, data: bytes, arrival: float) -> None:
        """Decode a message and take it; one that cannot be used is counted."""
        kind, take, _ = self._topics[topic]
        try:
            take(decode(kind, data), arrival)
        except BAD_INPUT as error:
            self._node.refused.refuse(topic, error)

    def _on_detections(self, message: Detection2DArray, _arrival: float) -> None:
        self._state.on_detections(message, self._converter.detections(message))

    def _on_image(self, message: Image, _arrival: float) -> None:
        taken = to_seconds(message.header.stamp)
        if self._converter.camera is not None:
            rotation = self._rotations.rotation(message.header.frame_id, taken)
            self._state.camera = None if rotation is None else CameraView(self._converter.camera, rotation)
        picture = Picture.of(image_from_message(message), taken, self._settings.picture_width, self._settings.jpeg_quality)
        self.shown = self.shown._replace(picture=picture)
        self._put(lambda feed: feed.put_picture(picture.data))

    def _on_audio(self, message: AudioFrame, arrival: float) -> None:
        if message.channels:
            since, self._spectrum_time = arrival - self._spectrum_time, arrival
            samples = np.asarray(message.samples, np.float32)[:MOST_SAMPLES]
            whole = len(samples) - len(samples) % message.channels
            block = samples[:whole].reshape(-1, message.channels)
            self._state.on_spectrum(spectrum(block, message.sample_rate).tolist(),
                                    self._coherence.add(block, message.sample_rate, since))
