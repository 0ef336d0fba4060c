"""The topics of one rig that somebody looks at."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import MarkerArray

from av_audio.messages import samples_of
from av_bags.definitions import deserialiser
from av_common.frames import BASE_FRAME
from av_common.gimbal_history import OLDEST_S
from av_common.guarded_node import Reader, check_size
from av_common.node import RigNode
from av_common.qos import RESULT, STREAM
from av_common.refused_inputs import BAD_INPUT
from av_common.rig import CAMERAS, camera_topic, camera_topics
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
from av_view.feed import STALE_S, Feed, row_of
from av_view.markers import markers, world_markers
from av_view.picture import RecentImages, jpeg_of
from av_view.rig_state import RigState
from av_view.spectrum import spectrum
from av_vision.messages import image_from_message

TRUTH, WORLD = 'truth/', 'av_interfaces/msg/WorldTrackArray'
MOST_SAMPLES = 100_000
NEWEST, NEWEST_RESULT = (QoSProfile(depth=1, reliability=qos.reliability) for qos in (STREAM, RESULT))
ALL_IMAGES = QoSProfile(depth=10, reliability=STREAM.reliability)  # between two updates
Take = Callable[[Any, float], None]  # of a message and the time at which it was published (s)


class RigWatch:
    """Reads the topics of a namespace, and puts what viewers see into its feed.

    Messages wait in the middleware until they are shown, and newer ones replace them: most come more often than pictures.

    Attributes:
        seen (s): when somebody last looked, by `time.monotonic`.
        snapshot: the newest state.

    Parameters:
        node: owns the subscriptions.
        rig: namespace of the rig, such as '/left', or ''.
        put: changes the feed.
    """

    def __init__(self, node: RigNode, rig: str, put: Callable[[Callable[[Feed], None]], None]) -> None:
        self.seen = time.monotonic()
        self._node, self._rig, self._put = node, rig, put
        self._state = state = RigState()
        self._images = RecentImages()
        self._pictured = (0, False)  # stamp (ns) of the image that is shown, and whether its detections are
        self.snapshot = state.snapshot(node.now())
        self._topics: dict[str, tuple[Reader, Callable[[bytes, float], None]]] = {}    # what reads and takes messages
        before = set(node.entities())
        # Viewers wait for no transform.
        self._rotations = TfRotations(node, OLDEST_S, f'{rig}/')
        self._converter = MeasurementConverter(self._rotations.rotation)
        # In the order in which they are taken: the camera before what is seen through it.
        for camera in CAMERAS:
            self._read(CameraInfo, camera_topic(camera, 'camera/camera_info'), partial(self._on_camera_info, camera))
        self._read(Image, 'camera/image_raw', lambda data, _: self._images.add(data), ALL_IMAGES, decode=bytes)
        self._read(Bearing, 'target/bearing', state.on_bearing, NEWEST_RESULT)
        self._read(FusionState, 'fusion/state', partial(state.take, 'fusion'), NEWEST_RESULT)
        self._read(TrackArray, 'targets', partial(state.take, 'tracks'), NEWEST_RESULT)
        self._read(AzimuthPosterior, 'fusion/posterior', state.on_posterior, NEWEST_RESULT)
        self._read(Log, 'marks', state.on_mark, RESULT)
        self._read(PointingCommand, 'pointing/command', state.on_command, NEWEST_RESULT)
        self._read(DoaArray, 'doa', lambda message, _: state.on_doa(message, self._converter.doa(message)))
        for topic in camera_topics(CAMERAS, 'detections'):
            self._read(Detection2DArray, topic, partial(state.take, topic))
        self._read(AudioFrame, 'audio/frames', self._on_audio)
        self._decode_image = deserialiser('sensor_msgs/msg/Image')
        self._entities = [entity for entity in node.entities() if entity not in before]

    def find_topics(self) -> None:
        """Subscribe to the true poses of a simulation, and to the tracks of several rigs, as they appear."""
        beginning, before = f'{self._rig}/{TRUTH}', set(self._node.entities())
        for topic, kinds in self._node.get_topic_names_and_types():
            name = topic.removeprefix(beginning)
            if topic.startswith(beginning) and 'nav_msgs/msg/Odometry' in kinds and f'{TRUTH}{name}' not in self._topics:
                self._read(Odometry, f'{TRUTH}{name}', partial(self._state.on_truth, name))
            elif WORLD in kinds and WORLD not in self._topics:
                self._read(WorldTrackArray, WORLD, partial(self._state.take, 'world'), NEWEST_RESULT, topic)
        self._entities += [entity for entity in self._node.entities() if entity not in before]

    def update(self, pictures: bool) -> None:
        """Put the present state into the feed.

        Parameters:
            pictures: whether somebody sees them.
        """
        offset = self._node.now() - time.time()
        for name, (reader, take) in self._topics.items():
            for data, published in reader.take():
                try:
                    take(data, published + offset)
                except BAD_INPUT as error:
                    self._node.refused.refuse(name, error)
        try:
            picture = self._new_picture(pictures)
        except BAD_INPUT as error:
            self._node.refused.refuse('camera/image_raw', error)
            picture = b''
        for camera in CAMERAS[1:]:
            if (seen := self._state.newest.get(camera_topic(camera, 'detections'))) is not None:
                self._look_through(camera, seen.header)
        self.snapshot = self._state.snapshot(self._node.now())
        state, row = (json.dumps(part, separators=(',', ':'), allow_nan=False)
                      for part in (self.snapshot, row_of(self.snapshot)))
        self._put(lambda feed: feed.put(state, row, picture))

    def markers(self) -> MarkerArray:
        """The state of the newest update, for RViz and Foxglove."""
        made = markers(self.snapshot, self._state.sound, BASE_FRAME)
        if self.snapshot['world'] is not None:
            made.markers.extend(world_markers(self._state.newest['world']))
        return made

    def close(self) -> None:
        """End the subscriptions."""
        self._node.destroy_entities(self._entities)

    def _read(self, kind: Any, topic: str, take: Take, qos: QoSProfile = NEWEST, name: str = '',
              decode: Callable[[bytes], Any] | None = None) -> None:
        """Look at a topic, which has another `name` where it is not one of the rig, at each update."""
        reader = self._node.create_reader(kind, name or f'{self._rig}/{topic}', qos)
        decoded = decode or deserialiser(f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}')

        def use(data: bytes, published: float) -> None:
            check_size(kind, data)
            take(decoded(data), published)

        self._topics[topic] = reader, use

    def _new_picture(self, encode: bool) -> bytes:
        """The image in which the newest detections were made, so that boxes fit; without detections the newest image.

        Empty where it is shown already, or where it is not to be encoded.
        """
        detections = self._state.newest.get('detections')
        stamp = 0 if detections is None else detections.header.stamp.sec * 1_000_000_000 + detections.header.stamp.nanosec
        detected = detections is not None and self._node.now() - 1e-9 * stamp < STALE_S
        data = self._images.get(stamp) if detected else None
        if data is None and not (detected and self._pictured[1] and self._images.get(self._pictured[0])):
            stamp, detected, data = self._images.newest, False, self._images.get(self._images.newest)
        if data is None or (stamp, detected) == self._pictured:
            return b''
        first, self._pictured = stamp != self._pictured[0], (stamp, detected)
        message = self._decode_image(data)
        taken, image = to_seconds(message.header.stamp), image_from_message(message)
        self._look_through(CAMERAS[0], message.header)
        self._state.on_picture(taken, (message.width, message.height), detections if detected else None)
        return jpeg_of(image) if encode and first else b''

    def _look_through(self, camera: str, header: Any) -> None:
        """Note how a camera is turned at the time of what it shows, by the header of that."""
        model = self._converter.cameras.get(camera)
        rotation = None if model is None else self._rotations.rotation(header.frame_id, to_seconds(header.stamp))
        if model is None or rotation is None:
            self._state.cameras.pop(camera, None)
        else:
            self._state.cameras[camera] = CameraView(model, rotation)

    def _on_camera_info(self, camera: str, message: CameraInfo, _published: float) -> None:
        self._converter.set_camera_info(message, camera)

    def _on_audio(self, message: AudioFrame, published: float) -> None:
        block = samples_of(message)[:MOST_SAMPLES // message.channels]
        self._state.on_spectrum(spectrum(block, message.sample_rate).tolist(), published)
