"""Conversion of a simulator's datagrams to messages of the rig's topics, and of commands and poses to datagrams.

This module has no sockets, threads or wall clock. Methods named after a stream have the parameters datagram, `arrival` (s, the
system's clock) and `sender` (host, port); they raise WireError for an unusable datagram.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import cv2
from nav_msgs.msg import Odometry

from av_audio.messages import audio_frame
from av_common.frames import BASE_FRAME, MAP_FRAME, frd_to_flu
from av_common.freshness import FreshInput, Instant
from av_common.rig import Rig, camera_topic, load_rig
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_seconds
from av_interfaces.msg import PointingCommand
from av_sim_bridge import messages
from av_sim_bridge.receiving.allowed_senders import Sender
from av_sim_bridge.receiving.common_clock import CommonClock, OneSender
from av_sim_bridge.receiving.streams import AudioStream, ImageStream
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

LARGEST_RATE_ERROR = 0.05    # of the sample rate; the nearest other one in use, 44,100 Hz, is 8 % off
COMMAND_TIMEOUT = 0.2   # s, age from which a pointing command moves nothing
Output = tuple[str, Any]    # topic and message


class BridgeStage:
    """The streams of one simulator and one rig. All streams share the sender's clock, so that their stamps agree.

    The method of each stream must be called by one thread only, `on_truth` by one for each vehicle.

    Attributes:
        rig: see below.
        target_topics: topic of each target's true state, by the target's number.

    Parameters:
        rig: description of the rig: microphones, camera and frames.
        layout: format of the samples in audio datagrams.
        targets: number of targets, whose numbers are consecutive from `FIRST_TARGET` on.
        follow_odometry: whether poses of the topic `odometry` move the rig in the simulator.
        oracle_detections: whether the visual oracle's reports become `detections`.
    """

    def __init__(self, rig: Rig, layout: AudioFormat, targets: int = 1, follow_odometry: bool = False,
                 oracle_detections: bool = False) -> None:
        self.rig, self._layout = rig, layout
        self._follows, self._oracle = follow_odometry, oracle_detections
        self._clock = CommonClock()
        self._audio = AudioStream(layout, self._clock)
        self._most_pixels = 2 * max(each.width * each.height for each in rig.cameras.values())
        most_bytes = 4 * self._most_pixels + 65_536    # more than any image of this size has
        self._images = {name: ImageStream(self._clock, f'image {name}', most_bytes) for name in (*rig.cameras, 'depth')}
        others = range(FIRST_TARGET + 1, FIRST_TARGET + targets)
        self.target_topics = {FIRST_TARGET: 'truth/target'} | {number: f'truth/target_{number}' for number in others}
        self._time_sync, self._time_sync_offset = OneSender('time_sync'), math.nan    # s, of this machine's time
        self._sequence = 0
        self._commanded = FreshInput()
        self.contested: Mapping[str, list[str]] = {}  # publishers of the commands where there are several
        self._unusable_odometry = self._unusable_commands = 0

    def on_audio(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The messages of the samples that are complete after a datagram."""
        return [('audio/frames', audio_frame(self._layout.to_float(block.samples), block.first_sample, self._layout.sample_rate,
                                             messages.make_header(time, self.rig.array.frame)))
                for block, time in self._audio.take(datagram, arrival, sender)]

    def on_image(self, datagram: bytes, arrival: float, sender: Sender, camera: str = 'camera') -> list[Output]:
        """The messages of a complete image of one of the rig's cameras and of its calibration, scaled to the image's size.

        Or the oracle's detections; none while the image is incomplete. Images of a thermal camera are grey (mono8), or 16-bit
        PNGs of raw counts (mono16). Raises ValueError for one that cannot be decoded.
        """
        mount, taken = self.rig.cameras[camera], self._images[camera].take(datagram, arrival, sender)
        if taken is None:
            return []
        content, stamp = taken
        header = messages.make_header(stamp, mount.optical_frame)
        if isinstance(content, list):
            detections = messages.oracle_detections_message(header, content)
            return [(camera_topic(camera, 'detections'), detections)] if self._oracle else []
        flags = cv2.IMREAD_COLOR if mount.kind == 'visible' else cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        pixels = decode_image(content.data, flags, self._most_pixels)
        height, width = pixels.shape[:2]
        calibration = camera_info_message(header, mount.model.scaled(width, height))
        return [(f'{camera}/image_raw', image_message(header, pixels)), (f'{camera}/camera_info', calibration)]

    def on_depth(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The message of a complete depth image; none while incomplete. Raises ValueError if it is not a 16-bit PNG."""
        image, stamp = self._images['depth'].take(datagram, arrival, sender) or ([], 0.0)
        if isinstance(image, list):
            return []
        depth = messages.decode_depth(image.data, self._most_pixels)
        header = messages.make_header(stamp, self.rig.camera.optical_frame)
        return [('camera/depth/image_raw', image_message(header, depth, '16UC1'))]

    def on_truth(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The messages of the true state of rig or target; none for a vehicle with another number, or for an old state."""
        truth = decode_truth(datagram)
        topic = 'truth/rig' if truth.copter_id == RIG else self.target_topics.get(truth.copter_id)
        if topic is None:
            return []
        name = topic.removeprefix('truth/')
        stamp = self._clock.date_state(f'{name}_truth', sender, truth.time, arrival)
        if stamp is None:
            return []
        message = messages.odometry_message(
            messages.make_header(stamp, MAP_FRAME), BASE_FRAME if name == 'rig' else name, from_truth(truth))
        return [(each, message) for each in (['odometry', topic] if name == 'rig' and not self._follows else [topic])]

    def on_imu(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The message of an inertial measurement of the rig; none for an old one."""
        sample = decode_imu(datagram)
        stamp = self._clock.date_state('imu', sender, sample.time, arrival)
        if stamp is None:
            return []
        header = messages.make_header(stamp, BASE_FRAME)
        return [('imu', messages.imu_message(header, frd_to_flu(sample.acceleration_frd), frd_to_flu(sample.rate_frd)))]

    def on_gimbal(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The message of the gimbal's measured orientation; none for a rig without a gimbal, or for an old one."""
        sample = decode_gimbal(datagram)
        stamp = self._clock.date_state('gimbal', sender, sample.time, arrival)
        if stamp is None or self.rig.gimbal is None:
            return []
        return [('gimbal/state', gimbal_message(self.rig.gimbal.frame, stamp, sample.orientation_wxyz, sample.variance,
                                                measured=True))]

    def on_time_sync(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """Update the offset between the simulator's clock and this machine's; no messages."""
        self._time_sync.check(sender, arrival)
        self._time_sync_offset = arrival - decode_time_sync(datagram).now_ms / 1000.0
        self._time_sync.note(sender, arrival)
        return []

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
        body = command.move_body and not self._follows
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

    @property
    def problem(self) -> str:
        """What is wrong with the sound that comes; empty where nothing is known to be."""
        rate, expected = self._audio.sample_rate, self._layout.sample_rate
        if not abs(rate - expected) > LARGEST_RATE_ERROR * expected:
            return ''
        return (f'{rate:.0f} samples a second come from the simulator instead of {expected}: it is slower than time, or sends '
                'sound of another rate, whose bearings are wrong')

    def counts(self) -> dict[str, float]:
        """Counts of lost, unusable and reordered data, for /diagnostics."""
        audio, incomplete = self._audio.decoder.counts, sum(each.assembler.incomplete for each in self._images.values())
        return {'audio lost': audio.lost, 'audio lost frames': audio.lost_frames, 'audio reordered': audio.reordered,
                'audio restarts': audio.restarts, 'image lost': incomplete, 'odometry unusable': self._unusable_odometry,
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
    return BridgeStage(rig, layout, parameters.targets, parameters.follow_odometry, parameters.oracle_detections)
