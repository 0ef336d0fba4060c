"""Converts messages of other packages to those of the rig."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import CompressedImage, Image, Imu
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesis, ObjectHypothesisWithPose

from av_bags import topics as names
from av_bags.definitions import BagError
from av_bags.reader import Bag
from av_common.clock import SenderClock
from av_common.frames import BASE_FRAME, attitude_of, is_orientation
from av_common.pose_messages import odometry_message
from av_common.quaternions import Quaternion, inverse, product, vector_of
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import AudioFrame
from av_vision.messages import header_of, image_from_message, image_message

Converter = Callable[[Any, int], Iterable[Any]]
# A stamp that is later than the samples before it by more than this marks a gap in the audio.
GAP_S = 0.05
AT_REST = (0.0, 0.0, 0.0)
DETECTIONS = names.OF_CAMERA[names.DETECTIONS][0]
# Frame of audio whose messages name none.
ARRAY_FRAME = 'microphones'
# Of audio_common_msgs: numpy's type and full scale.
FORMATS = {'S16LE': ('<i2', 32768.0), 'S32LE': ('<i4', 2147483648.0), 'F32LE': ('<f4', 1.0)}
# Of AudioStamped, which describes itself (github.com/mgonzs13/audio_common): its arrays, of which one is filled, by format.
ARRAYS = {'S16LE': 'int16_data', 'S32LE': 'int32_data', 'F32LE': 'float32_data'}


@dataclass(frozen=True)
class AudioLayout:
    """Layout of audio that is recorded as bytes without a description.

    Parameters:
        sample_rate (Hz): rate of each channel, 8000 to 384000.
        channels: number of interleaved channels, 1 to 64.
        sample_format: one of FORMATS.

    Raises BagError for values out of bounds.
    """

    sample_rate: int
    channels: int
    sample_format: str = 'S16LE'

    def __post_init__(self) -> None:
        if not (8000 <= self.sample_rate <= 384_000 and 1 <= self.channels <= 64):
            raise BagError(f'audio of {self.sample_rate} Hz and {self.channels} channels, expected 8000..384000 and 1..64')
        if self.sample_format not in FORMATS:
            raise BagError(f'audio in {self.sample_format!r}, expected one of {", ".join(FORMATS)}')


def converter(bag: Bag, name: str, topic: str, layout: AudioLayout | None = None) -> Converter | None:
    """The converter from messages of a bag's topic to those of the rig's topic; None when the types are equal.

    Parameters:
        bag: the bag.
        name: the rig's name of the topic.
        topic: its name in the bag.
        layout: layout of audio bytes; None takes it from a message AudioInfo in the bag.

    Raises BagError when the layout of audio bytes is unknown.
    """
    kind = bag.topics[topic].kind
    if kind == DETECTIONS and bag.different_fields(topic):
        return detections_of_another_version
    if kind == names.KINDS[name][0]:
        return None
    if name == names.AUDIO:
        return AudioBytes(None if kind.endswith('/AudioStamped') else layout or _described_layout(bag, topic))
    return {'sensor_msgs/msg/CompressedImage': decompressed, 'sensor_msgs/msg/Imu': odometry_of_imu}.get(kind, Poses())


class AudioBytes:
    """Converts AudioData, AudioDataStamped and AudioStamped (audio_common_msgs) with PCM samples to AudioFrame.

    A sample may be split between two messages.

    Parameters:
        layout: layout of the bytes; None for messages that describe themselves.
    """

    def __init__(self, layout: AudioLayout | None) -> None:
        self._given = layout
        self._clock = SenderClock()
        self._rest = b''
        self._next = 0
        self._origin: float | None = None

    def __call__(self, message: Any, time_ns: int) -> Iterable[AudioFrame]:
        """The frame of a message recorded at `time_ns` (ns); empty while no sample is complete. Raises BagError."""
        stamped = hasattr(message, 'header')
        sound = message.audio if stamped else message
        self._layout, data = (self._given, sound.data) if self._given else _self_described(sound)
        samples = self._samples(data)
        if not len(samples):
            return []
        if stamped:
            stamp = to_seconds(message.header.stamp)
            self._skip_gap(stamp)
        else:  # the last sample was captured just before the message arrived
            end = self._clock.date((self._next + len(samples)) / self._layout.sample_rate, 1e-9 * time_ns)
            if end is None:  # refused by the clock: omitted, which leaves a gap
                self._next += len(samples)
                return []
            stamp = end - len(samples) / self._layout.sample_rate
        frame = (message.header.frame_id if stamped else '') or ARRAY_FRAME
        first, self._next = self._next, self._next + len(samples)
        return [AudioFrame(header=Header(stamp=to_stamp(max(stamp, 0.0)), frame_id=frame), first_sample=first,
                           sample_rate=self._layout.sample_rate, channels=self._layout.channels,
                           samples=array('f', samples.tobytes()))]

    def _samples(self, data: ArrayLike) -> NDArray[np.float32]:
        """Complete samples (n, channels) of full scale 1; the bytes of an incomplete one are kept."""
        kind, full_scale = FORMATS[self._layout.sample_format]
        size = np.dtype(kind).itemsize * self._layout.channels
        content = self._rest + bytes(np.asarray(data, None if isinstance(data, np.ndarray) else np.uint8))
        whole = len(content) // size * size
        self._rest = content[whole:]
        samples = np.frombuffer(content[:whole], kind).reshape(-1, self._layout.channels)
        return (samples / full_scale).astype(np.float32)

    def _skip_gap(self, stamp: float) -> None:
        expected = stamp if self._origin is None else self._origin + self._next / self._layout.sample_rate
        if self._origin is None or stamp - expected > GAP_S:
            self._next += round((stamp - expected) * self._layout.sample_rate)
            self._origin = stamp - self._next / self._layout.sample_rate


class Poses:
    """Converts PoseStamped and PoseWithCovarianceStamped to Odometry, with the angular velocity since the previous pose."""

    def __init__(self) -> None:
        self._before: tuple[float, Quaternion] | None = None

    def __call__(self, message: Any, _: int) -> Iterable[Odometry]:
        """Convert one pose."""
        pose = message.pose.pose if hasattr(message.pose, 'pose') else message.pose
        time, attitude, rate = to_seconds(message.header.stamp), attitude_of(pose.orientation), AT_REST
        if is_orientation(attitude):    # others are left to whoever takes the odometry, and tell no rate
            if self._before is not None and time > self._before[0]:
                x, y, z = vector_of(product(inverse(self._before[1]), attitude))
                rate = x / (time - self._before[0]), y / (time - self._before[0]), z / (time - self._before[0])
            self._before = (time, attitude)
        at = pose.position
        return [odometry_message(message.header, BASE_FRAME, (at.x, at.y, at.z), attitude, AT_REST, rate)]


def decompressed(message: CompressedImage, _: int) -> Iterable[Image]:
    """Convert a CompressedImage to an Image. Raises ValueError when it cannot be decoded."""
    return [image_message(message.header, image_from_message(message))]


def detections_of_another_version(message: Any, _: int) -> Iterable[Detection2DArray]:
    """Convert detections of vision_msgs before 4.0 (Humble), where results had no `hypothesis`, or centres no `position`."""
    converted = Detection2DArray(header=header_of(message))
    for one in message.detections:
        made = Detection2D(header=header_of(one), id=str(getattr(one, 'id', '')))
        for result in one.results:
            stated = getattr(result, 'hypothesis', result)
            name = stated.class_id if hasattr(stated, 'class_id') else stated.id
            made.results.append(ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=str(name), score=stated.score)))
        centre = getattr(one.bbox.center, 'position', one.bbox.center)
        made.bbox.center.position.x, made.bbox.center.position.y = centre.x, centre.y
        made.bbox.size_x, made.bbox.size_y = one.bbox.size_x, one.bbox.size_y
        converted.detections.append(made)
    return [converted]


def odometry_of_imu(message: Imu, _: int) -> Iterable[Odometry]:
    """Convert an Imu to Odometry of its frame at the origin; empty for one without orientation (covariance -1)."""
    if message.orientation_covariance[0] == -1.0:
        return []
    rate = message.angular_velocity
    return [odometry_message(message.header, message.header.frame_id or BASE_FRAME, AT_REST,
                             attitude_of(message.orientation), AT_REST, (rate.x, rate.y, rate.z))]


def _self_described(sound: Any) -> tuple[AudioLayout, NDArray]:
    """Layout and samples of the Audio in an AudioStamped. Raises BagError for an array of another format."""
    kind = next((kind for kind, name in ARRAYS.items() if len(getattr(sound.audio_data, name))), None)
    if kind is None:
        raise BagError(f'audio of format {sound.info.format}, expected samples in {", ".join(ARRAYS.values())}')
    return AudioLayout(sound.info.rate, sound.info.channels, kind), getattr(sound.audio_data, ARRAYS[kind])


def _described_layout(bag: Bag, topic: str) -> AudioLayout:
    described = [other.name for other in bag.topics.values() if other.kind == 'audio_common_msgs/msg/AudioInfo']
    for other in described:
        for _, _, data in bag.messages([other]):
            info = bag.decode(other, data)
            try:
                if info.coding_format.lower() not in ('wave', 'wav', 'pcm', 'raw', ''):
                    raise BagError(f'{bag.path}: {topic} is coded as {info.coding_format}, expected uncompressed (wave)')
                return AudioLayout(info.sample_rate, info.channels, info.sample_format.upper())
            except (AttributeError, TypeError):    # another package of this name has other fields
                break
    raise BagError(f'{bag.path}: {topic} is {bag.topics[topic].kind}, which says neither rate nor channels; '
                   'give audio_rate, audio_channels and audio_format')
