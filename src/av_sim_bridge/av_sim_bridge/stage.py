"""What the bridge decides: datagrams of a simulator to messages of the rig's topics, commands and poses to datagrams.

No socket, no thread and no wall clock in here. Methods named after a stream take a datagram, its arrival (s of the
system's clock) and its sender (host, port); they raise WireError for a datagram that cannot be used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry
from vision_msgs.msg import Detection2DArray

from av_audio.ring_buffer import RingBuffer
from av_common.clock import SenderClock
from av_common.frames import frd_to_flu
from av_common.rig import Rig, load_rig
from av_interfaces.msg import AudioFrame, PointingCommand
from av_sim_bridge import messages
from av_sim_bridge.receiving.direction_check import DirectionCheck
from av_sim_bridge.receiving.streams import (
    AudioStream,
    CaptureStamps,
    ImageStream,
    ImuStream,
    OracleReport,
    Sender,
    StampedImage,
    TimeSyncStream,
    TruthStream,
)
from av_sim_bridge.vehicle import to_truth
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.wire.rig_control import RigControl, encode_rig_control
from av_sim_bridge.wire.truth import encode_truth
from av_vision.messages import camera_info_message, image_message

LONGEST_BLOCK = 4800   # samples of each channel in one message
Output = tuple[str, Any]    # topic and message


@dataclass(frozen=True)
class BridgeSettings:
    """Numbers of the vehicles, and which topics the bridge serves.

    Parameters:
        rig_id: the simulator's number of the rig.
        target_id: number of the first target.
        targets: how many targets there are, numbered from `target_id` on.
        world_frame: frame of positions (ENU) in odometry and truth.
        follow_odometry: something else moves the rig, and its `odometry` goes to the simulator.
        oracle_detections: the visual oracle's reports become `detections`.
        ring_buffer_bytes: size of the buffer between the receiver of sound and `read_audio`.
    """

    rig_id: int = 1
    target_id: int = 2
    targets: int = 1
    world_frame: str = 'map'
    follow_odometry: bool = False
    oracle_detections: bool = False
    ring_buffer_bytes: int = 200_000

    @property
    def target_topics(self) -> dict[int, str]:
        """The topic of each target's truth, by its number."""
        others = range(self.target_id + 1, self.target_id + self.targets)
        return {self.target_id: 'truth/target'} | {number: f'truth/target_{number}' for number in others}


class BridgeStage:
    """The streams of one simulator and one rig. The sender's clock is shared by all streams, so that stamps agree.

    Each stream is meant for one thread; `read_audio` and `decode_*` may run in others. `target_topics` is the topic of
    each target's truth, by the simulator's number.

    Parameters:
        rig: number of microphones, camera and frames.
        layout: format of the samples on the wire.
        settings: see BridgeSettings.
    """

    def __init__(self, rig: Rig, layout: AudioFormat, settings: BridgeSettings = BridgeSettings()) -> None:
        self._rig, self._layout, self._settings = rig, layout, settings
        self._clock = SenderClock()
        self._ring = RingBuffer(layout.channels, settings.ring_buffer_bytes, layout.dtype)
        self._direction = DirectionCheck(layout.sample_rate)
        stamps = CaptureStamps(self._clock)
        self._audio = AudioStream(layout, self._ring, self._clock)
        self._images, self._depths = ImageStream(self._clock, stamps), ImageStream(self._clock, stamps)
        self._truth, self._imu, self._time_sync = TruthStream(self._clock), ImuStream(self._clock), TimeSyncStream()
        self.target_topics = settings.target_topics
        self._sequence = 0
        self._unusable_odometry = 0

    def on_audio(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Take sound, which `read_audio` returns. Raises WireError."""
        self._audio.take(datagram, arrival, sender)

    def read_audio(self, timeout: float = 0.0) -> AudioFrame | None:
        """The oldest samples that wait, None where there are none after `timeout` (s)."""
        if not self._ring.wait(timeout):
            return None
        first, samples = self._ring.read(LONGEST_BLOCK)
        if not len(samples):
            return None
        header = messages.make_header(self._audio.stamp(first), self._rig.array.frame)
        samples = self._layout.to_float(samples)
        self._direction.add(samples)
        return messages.audio_message(header, self._layout.sample_rate, first, samples)

    def on_image(self, datagram: bytes, arrival: float, sender: Sender) -> StampedImage | Detection2DArray | None:
        """A complete image, still encoded, or the oracle's detections. Raises WireError."""
        result = self._images.take(datagram, arrival, sender)
        if not isinstance(result, OracleReport):
            return result
        if not self._settings.oracle_detections:
            return None
        header = messages.make_header(result.stamp, self._rig.camera.optical_frame)
        return messages.oracle_detections_message(header, result.boxes)

    def on_depth(self, datagram: bytes, arrival: float, sender: Sender) -> StampedImage | None:
        """A complete depth image, still encoded. Raises WireError."""
        result = self._depths.take(datagram, arrival, sender)
        return result if isinstance(result, StampedImage) else None

    def decode_image(self, stamped: StampedImage) -> list[Output]:
        """Image and calibration at the image's size. Raises ValueError for what is no image."""
        bgr = messages.decode_image(stamped.image.data)
        header = messages.make_header(stamped.stamp, self._rig.camera.optical_frame)
        height, width = bgr.shape[:2]
        calibration = camera_info_message(header, self._rig.camera.model.scaled(width, height))
        return [('camera/image_raw', image_message(header, bgr)), ('camera/camera_info', calibration)]

    def decode_depth(self, stamped: StampedImage) -> list[Output]:
        """The depth image. Raises ValueError for what is none."""
        header = messages.make_header(stamped.stamp, self._rig.camera.optical_frame)
        return [('camera/depth/image_raw', image_message(header, messages.decode_depth(stamped.image.data)))]

    def on_truth(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """The true state of rig or target; nothing for a vehicle of another number. Raises WireError."""
        state = self._truth.take(datagram, arrival, sender)
        header = messages.make_header(state.stamp, self._settings.world_frame)
        if state.copter_id == self._settings.rig_id:
            message = messages.odometry_message(header, self._rig.base_frame, state.state)
            topics = ['truth/rig'] if self._settings.follow_odometry else ['odometry', 'truth/rig']
            return [(topic, message) for topic in topics]
        topic = self.target_topics.get(state.copter_id)
        if topic is None:
            return []
        return [(topic, messages.odometry_message(header, topic.removeprefix('truth/'), state.state))]

    def on_imu(self, datagram: bytes, arrival: float, sender: Sender) -> list[Output]:
        """An inertial measurement of the rig. Raises WireError."""
        sample, stamp = self._imu.take(datagram, arrival, sender)
        header = messages.make_header(stamp, self._rig.base_frame)
        return [('imu', messages.imu_message(header, frd_to_flu(sample.acceleration_frd), frd_to_flu(sample.rate_frd)))]

    def on_time_sync(self, datagram: bytes, arrival: float, sender: Sender) -> None:
        """Compare the simulator's clock with this machine's. Raises WireError."""
        self._time_sync.take(datagram, arrival, sender)

    def on_command(self, command: PointingCommand) -> bytes:
        """The datagram for the simulator's control port."""
        self._sequence = (self._sequence + 1) % 2**31
        body = command.move_body and not self._settings.follow_odometry
        gimbal = command.move_gimbal and math.isfinite(command.pan) and math.isfinite(command.tilt)
        return encode_rig_control(RigControl(
            self._sequence, command.mode, command.yaw_rate if body else None,
            command.pan if gimbal else None, command.tilt if gimbal else None))

    def on_odometry(self, odometry: Odometry) -> bytes | None:
        """The rig's pose for the simulator's control port, None (and counted) where the message holds no pose."""
        try:
            state = messages.vehicle_state(odometry)
        except ValueError:
            self._unusable_odometry += 1
            return None
        return encode_truth(to_truth(state, self._settings.rig_id))

    @property
    def complaint(self) -> str:
        """What is wrong with the sound, empty while nothing is known to be."""
        return self._direction.complaint

    def counts(self) -> dict[str, float]:
        """What was lost, unusable or out of order, for /diagnostics."""
        audio, assembler = self._audio.decoder.counts, self._images.assembler
        return {'audio lost': audio.lost, 'audio lost frames': audio.lost_frames, 'audio reordered': audio.reordered,
                'audio restarts': audio.restarts, 'audio foreign': self._audio.foreign,
                'audio overwritten frames': self._ring.overwritten, 'image lost': assembler.incomplete,
                'image reordered': assembler.reordered, 'imu lost': self._imu.lost,
                'odometry unusable': self._unusable_odometry, 'clock restarts': self._clock.restarts,
                'time sync offset (s)': self._time_sync.offset_s,
                'audio delay spread (us)': round(1e6 * self._direction.spread_s, 1)}


def make_bridge_stage(parameters: Any) -> BridgeStage:
    """The stage of a node's parameters (generated struct, or of `av_common.parameters.node_parameters`).

    Raises ValueError or OSError for a rig that cannot be read.
    """
    if not parameters.rig_file:
        raise ValueError("rig_file is empty, expected the path of the rig's description such as config/rig.yaml")
    rig = load_rig(parameters.rig_file)
    layout = AudioFormat(parameters.sample_format, rig.array.geometry.channels, parameters.sample_rate)
    return BridgeStage(rig, layout, BridgeSettings(**{
        name: getattr(parameters, name) for name in BridgeSettings.__dataclass_fields__}))
