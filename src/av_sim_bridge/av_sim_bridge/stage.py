"""Conversion of a simulator's datagrams to messages of the rig's topics, and of commands and poses to datagrams.

This module has no sockets, threads or wall clock. Methods named after a stream have the parameters datagram, `arrival` (s, the
system's clock) and `sender` (host, port); they raise WireError for an unusable datagram.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
from nav_msgs.msg import Odometry
from vision_msgs.msg import Detection2DArray

from av_audio.messages import audio_frame
from av_audio.ring_buffer import RingBuffer
from av_common.frames import BASE_FRAME, MAP_FRAME, frd_to_flu
from av_common.freshness import FreshInput, Instant
from av_common.rig import Rig, load_rig
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame, PointingCommand
from av_sim_bridge import messages
from av_sim_bridge.receiving.common_clock import CommonClock, OneSender, Sender
from av_sim_bridge.receiving.streams import AudioStream, CaptureStamps, ImageStream, StampedImage, StateStream
from av_sim_bridge.vehicle import from_truth, to_truth
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.wire.gimbal import decode_gimbal
from av_sim_bridge.wire.imu import decode_imu
from av_sim_bridge.wire.ports import FIRST_TARGET, RIG
from av_sim_bridge.wire.rig_control import MOST_ANGLE, MOST_YAW_RATE, RigControl, encode_rig_control
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import check_truth, decode_truth, encode_truth
from av_vision.image import decode_image
from av_vision.messages import camera_info_message, image_message

COMMAND_TIMEOUT = 0.2   # s, age from which a pointing command moves nothing
LONGEST_BLOCK = 4800   # maximum number of samples of each channel in one message
RING_BUFFER_BYTES = 200_000    # between `on_audio` and `read_audio`: 1 s of two channels
Output = tuple[str, Any]    # topic and message


@dataclass(frozen=True)
class BridgeSettings:
    """Number of targets, and options of the topics.

    Parameters:
        targets: number of targets, whose numbers are consecutive from `FIRST_TARGET` on.
        follow_odometry: whether poses of the topic `odometry` move the rig in the simulator.
        oracle_detections: whether the visual oracle's reports become `detections`.
    """

    targets: int = 1
    follow_odometry: bool = False
    oracle_detections: bool = False

    @property
    def target_topics(self) -> dict[int, str]:
        """Topic of each target's true state, by the target's number."""
        others = range(FIRST_TARGET + 1, FIRST_TARGET + self.targets)
        return {FIRST_TARGET: 'truth/target'} | {number: f'truth/target_{number}' for number in others}


class BridgeStage:
    """The streams of one simulator and one rig. All streams share the sender's clock, so that their stamps agree.

    The method of each stream must be called by one thread only, `on_truth` by one for each vehicle; `read_audio` and `decode_*`
    may run in other threads.
    `rig` is the rig's description, `target_topics` maps the number of each target to the topic of its true state.

    Parameters:
        rig: description of the rig: microphones, camera and frames.
        layout: format of the samples in audio datagrams.
        settings: number of targets, and options of the topics.
    """

    def __init__(self, rig: Rig, layout: AudioFormat, settings: BridgeSettings = BridgeSettings()) -> None:
        self.rig, self._layout, self._settings = rig, layout, settings
        self._clock = CommonClock()
        self._ring = RingBuffer(layout.channels, RING_BUFFER_BYTES, layout.dtype)
        stamps = CaptureStamps()
        self._audio = AudioStream(layout, self._ring, self._clock)
        self._most_pixels = 2 * max(each.width * each.height for each in rig.cameras.values())
        most_bytes = 4 * self._most_pixels + 65_536    # more than any image of this size has
        self._images = {camera: ImageStream(self._clock, stamps, f'image {camera}', most_bytes) for camera in rig.cameras}
        self._depths = ImageStream(self._clock, stamps, 'image depth', most_bytes)
        self.target_topics = settings.target_topics
        names = {RIG: 'rig_truth'} | {
            number: topic.removeprefix('truth/') + '_truth' for number, topic in self.target_topics.items()}
        self._truth = {number: StateStream(self._clock, name) for number, name in names.items()}
        self._imu, self._gimbal = StateStream(self._clock, 'imu'), StateStream(self._clock, 'gimbal')
        self._time_sync, self._time_sync_offset = OneSender('time_sync'), math.nan    # s, of this machine's time
        self._sequence = 0
        self._commanded = FreshInput()
        self.contested: Mapping[str, list[str]] = {}  # publishers of the commands where there are several
        self._unusable_odometry = self._unusable_commands = 0

    def on_audio(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Store samples for `read_audio`."""
        self._audio.take(datagram, arrival, sender)

    def read_audio(self, timeout: float = 0.0) -> AudioFrame | None:
        """The oldest stored samples, None if there are none within `timeout` (s)."""
        if not self._ring.wait(timeout):
            return None
        first, samples = self._ring.read(LONGEST_BLOCK)
        if not len(samples):
            return None
        header = messages.make_header(self._audio.stamp(first), self.rig.array.frame)
        return audio_frame(self._layout.to_float(samples), first, self._layout.sample_rate, header)

    def on_image(self, datagram: bytes, arrival: float, sender: Sender,
                 camera: str = 'camera') -> StampedImage | Detection2DArray | None:
        """A complete image of one of the rig's cameras, still encoded, or the oracle's detections; None while incomplete."""
        result = self._images[camera].take(datagram, arrival, sender)
        if result is None or isinstance(result, StampedImage):
            return result
        if not self._settings.oracle_detections:
            return None
        boxes, stamp = result
        return messages.oracle_detections_message(messages.make_header(stamp, self.rig.cameras[camera].optical_frame), boxes)

    def on_depth(self, datagram: bytes, arrival: float, sender: Sender) -> StampedImage | None:
        """A complete depth image, still encoded; None while incomplete."""
        result = self._depths.take(datagram, arrival, sender)
        return result if isinstance(result, StampedImage) else None

    def decode_image(self, stamped: StampedImage, camera: str = 'camera') -> list[Output]:
        """The messages of an image and of its calibration, scaled to the image's size. Raises ValueError if undecodable.

        Images of a thermal camera are grey (mono8), or 16-bit PNGs of raw counts (mono16).
        """
        mount = self.rig.cameras[camera]
        flags = cv2.IMREAD_COLOR if mount.kind == 'visible' else cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        pixels = decode_image(stamped.image.data, flags, self._most_pixels)
        header = messages.make_header(stamped.stamp, mount.optical_frame)
        height, width = pixels.shape[:2]
        calibration = camera_info_message(header, mount.model.scaled(width, height))
        image = messages.camera_image_message(header, pixels)
        return [(f'{camera}/image_raw', image), (f'{camera}/camera_info', calibration)]

    def decode_depth(self, stamped: StampedImage) -> list[Output]:
        """The message of a depth image. Raises ValueError if it is not a 16-bit PNG."""
        header = messages.make_header(stamped.stamp, self.rig.camera.optical_frame)
        depth = messages.decode_depth(stamped.image.data, self._most_pixels)
        return [('camera/depth/image_raw', image_message(header, depth))]

    def on_truth(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The messages of the true state of rig or target; none for a vehicle with another number, or for an old state."""
        truth = decode_truth(datagram)
        stream = self._truth.get(truth.copter_id)
        stamp = None if stream is None else stream.date(truth.time, arrival, sender)
        if stamp is None:
            return []
        header, state = messages.make_header(stamp, MAP_FRAME), from_truth(truth)
        if truth.copter_id == RIG:
            message = messages.odometry_message(header, BASE_FRAME, state)
            topics = ['truth/rig'] if self._settings.follow_odometry else ['odometry', 'truth/rig']
            return [(topic, message) for topic in topics]
        topic = self.target_topics[truth.copter_id]
        return [(topic, messages.odometry_message(header, topic.removeprefix('truth/'), state))]

    def on_imu(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The message of an inertial measurement of the rig; none for an old one."""
        sample = decode_imu(datagram)
        stamp = self._imu.date(sample.time, arrival, sender)
        if stamp is None:
            return []
        header = messages.make_header(stamp, BASE_FRAME)
        return [('imu', messages.imu_message(header, frd_to_flu(sample.acceleration_frd), frd_to_flu(sample.rate_frd)))]

    def on_gimbal(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The message of the gimbal's measured orientation; none for a rig without a gimbal, or for an old one."""
        sample = decode_gimbal(datagram)
        stamp = self._gimbal.date(sample.time, arrival, sender)
        if stamp is None or self.rig.gimbal is None:
            return []
        return [('gimbal/state', gimbal_message(self.rig.gimbal.frame, stamp, sample.orientation_wxyz, sample.variance,
                                                measured=True))]

    def on_time_sync(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Update the offset between the simulator's clock and this machine's."""
        self._time_sync.check(sender, arrival)
        self._time_sync_offset = arrival - decode_time_sync(datagram).now_ms / 1000.0
        self._time_sync.note(sender, arrival)

    def on_command(self, command: PointingCommand, arrival: Instant) -> bytes:
        """The datagram of a pointing command for the simulator's control port.

        A command without a fresh stamp stops all motion, and so do commands of two publishers. An impossible rate stops the
        body, an impossible angle leaves the gimbal alone.

        Parameters:
            command: the command.
            arrival: time of its arrival.
        """
        self._sequence = (self._sequence + 1) % 2**31
        stamp = to_seconds(command.header.stamp)
        self._commanded.take(stamp, arrival)
        fresh = 'pointing/command' not in self.contested and self._commanded.age(arrival) <= COMMAND_TIMEOUT
        possible = abs(command.yaw_rate) <= MOST_YAW_RATE
        self._unusable_commands += command.move_body and not possible
        rate = command.yaw_rate if fresh and possible else 0.0
        body = command.move_body and not self._settings.follow_odometry
        gimbal = fresh and command.move_gimbal and abs(command.pan) <= MOST_ANGLE and abs(command.tilt) <= MOST_ANGLE
        return encode_rig_control(RigControl(
            self._sequence, command.mode, rate if body else None,
            command.pan if gimbal else None, command.tilt if gimbal else None))

    def on_odometry(self, odometry: Odometry) -> bytes | None:
        """The datagram of the rig's pose for the simulator's control port; None for an impossible pose, which is counted."""
        try:
            truth = to_truth(messages.vehicle_state(odometry), RIG)
            check_truth(truth)
        except ValueError:
            self._unusable_odometry += 1
            return None
        return encode_truth(truth)

    def counts(self) -> dict[str, float]:
        """Counts of lost, unusable and reordered data, for /diagnostics."""
        audio, assemblers = self._audio.decoder.counts, [each.assembler for each in (*self._images.values(), self._depths)]
        return {'audio lost': audio.lost, 'audio lost frames': audio.lost_frames, 'audio reordered': audio.reordered,
                'audio restarts': audio.restarts, 'audio overwritten frames': self._ring.overwritten,
                'image lost': sum(each.incomplete for each in assemblers), 'odometry unusable': self._unusable_odometry,
                'commands unusable': self._unusable_commands, 'clock restarts': self._clock.restarts,
                'time sync offset (s)': self._time_sync_offset,
                'audio blocks undated': self._audio.undated} | self._clock.counts


def make_bridge_stage(parameters: Any) -> BridgeStage:
    """The stage of bridge_node's parameters (generated struct, or of `av_common.parameters.node_parameters`).

    Raises ValueError or OSError for an unreadable description of the rig.
    """
    if not parameters.rig_file:
        raise ValueError("rig_file is empty, expected the path of the rig's description such as config/rig.yaml")
    rig = load_rig(parameters.rig_file)
    layout = AudioFormat(parameters.sample_format, rig.array.geometry.channels)
    return BridgeStage(rig, layout, BridgeSettings(
        parameters.targets, parameters.follow_odometry, parameters.oracle_detections))
