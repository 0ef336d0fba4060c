"""From the simulator's datagrams to the topics of the rig, and commands back."""

from __future__ import annotations

import math
import socket
import threading
from contextlib import ExitStack

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, Imu
from vision_msgs.msg import Detection2DArray

from av_audio.ring_buffer import RingBuffer
from av_common.clock import SenderClock
from av_common.config_files import find_config
from av_common.frames import frd_to_flu
from av_common.node import RigNode, run
from av_common.qos import PICTURE, RESULT, STREAM
from av_common.rig import load_rig
from av_interfaces.msg import AudioFrame, PointingCommand
from av_sim_bridge.bridge.consumer import Consumer
from av_sim_bridge.bridge.direction_check import DirectionCheck
from av_sim_bridge.bridge.intake import (
    AudioIntake,
    CaptureStamps,
    ImageIntake,
    ImuIntake,
    StampedImage,
    TimeSyncIntake,
    TruthIntake,
)
from av_sim_bridge.bridge.receiver import Handler, Receiver, open_port
from av_sim_bridge.nodes import bridge_messages as messages
from av_sim_bridge.nodes.bridge_node_parameters import bridge_node as parameters
from av_sim_bridge.vehicle import VehicleState, to_truth
from av_sim_bridge.wire.audio import AudioFormat
from av_sim_bridge.wire.imu import ImuSample
from av_sim_bridge.wire.oracle import OracleBox
from av_sim_bridge.wire.ports import TIME_SYNC_GROUP
from av_sim_bridge.wire.rig_control import RigControl, encode_rig_control
from av_sim_bridge.wire.truth import encode_truth

LONGEST_BLOCK = 4800   # frames in one message
STREAMS = ('audio', 'image', 'rig_truth', 'target_truth')    # whose silence is worth a warning


class BridgeNode(RigNode):
    """Receives on threads of their own, publishes what comes, and counts what does not."""

    def __init__(self) -> None:
        super().__init__('bridge_node', parameters)

    def configure(self) -> None:
        """Read the rig, open publishers."""
        self._settings = self.settings
        self._rig = load_rig(self._settings.rig_file or find_config('rig'))
        self._layout = AudioFormat(self._settings.sample_format, self._rig.array.geometry.channels,
                                   self._settings.sample_rate)
        first = self._settings.target_id
        self._more_targets = range(first + 1, first + self._settings.targets)
        topics = {'audio/frames': (AudioFrame, STREAM), 'camera/image_raw': (Image, PICTURE),
                  'camera/camera_info': (CameraInfo, RESULT), 'odometry': (Odometry, RESULT),
                  'truth/rig': (Odometry, RESULT), 'truth/target': (Odometry, RESULT), 'imu': (Imu, STREAM)}
        if self._settings.follow_odometry:
            del topics['odometry']    # somebody else's, who moves the rig
        topics |= {f'truth/target_{number}': (Odometry, RESULT) for number in self._more_targets}
        if self._settings.depth_port:
            topics['camera/depth/image_raw'] = (Image, PICTURE)
        if self._settings.oracle_detections:
            topics['detections'] = (Detection2DArray, RESULT)
        self._outputs = {name: self.create_publisher(kind, name, qos) for name, (kind, qos) in topics.items()}

    def activate(self) -> None:
        """Open the ports and start the threads."""
        self._sender_clock = SenderClock()
        self._ring = RingBuffer(self._layout.channels, self._settings.ring_buffer_bytes, self._layout.dtype)
        self._direction = DirectionCheck(self._layout.sample_rate)
        self._audio = AudioIntake(self._layout, self._ring, self._sender_clock)
        self._sequence = 0
        self._receivers: dict[str, Receiver] = {}
        with ExitStack() as opened:
            self._images = Consumer[StampedImage]('decode images', self._publish_image)
            opened.callback(self._images.stop)
            stamps = CaptureStamps(self._sender_clock)
            self._pictures = ImageIntake(self._sender_clock, self._images.put, self._publish_boxes, stamps)
            truth = TruthIntake(self._sender_clock, self._publish_state)
            self._imu, self._time_sync = ImuIntake(self._sender_clock, self._publish_imu), TimeSyncIntake()
            self._receive(opened, 'audio', self._audio.take)
            self._receive(opened, 'image', self._pictures.take)
            if self._settings.depth_port:
                depths = Consumer[StampedImage]('decode depth', self._publish_depth)
                opened.callback(depths.stop)
                self._receive(opened, 'depth', ImageIntake(self._sender_clock, depths.put, lambda *_: None, stamps).take)
            self._receive(opened, 'rig_truth', truth.take)
            self._receive(opened, 'target_truth', truth.take)
            for number in self._more_targets:
                port = self._settings.target_truth_port + 2 * (number - self._settings.target_id)
                self._receive(opened, f'target_{number}_truth', truth.take, port=port)
            self._receive(opened, 'imu', self._imu.take)
            self._receive(opened, 'time_sync', self._time_sync.take, group=TIME_SYNC_GROUP)
            self._commands = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._sounding = True
            speaker = threading.Thread(target=self._publish_sound, name='publish sound', daemon=True)
            speaker.start()
            opened.callback(speaker.join)
            opened.callback(setattr, self, '_sounding', False)
            self._opened = opened.pop_all()
        self.while_active(self.create_subscription, PointingCommand, 'pointing/command', self._on_command, RESULT)
        self._unusable_poses = 0
        if self._settings.follow_odometry:
            self.while_active(self.create_subscription, Odometry, 'odometry', self._on_odometry, RESULT)

    def deactivate(self) -> None:
        """Stop the threads and give the ports back."""
        self._opened.close()

    def cleanup(self) -> None:
        """Close the publishers."""
        for publisher in self._outputs.values():
            self.destroy_publisher(publisher)

    def _receive(self, opened: ExitStack, name: str, handle: Handler, group: str | None = None,
                 port: int | None = None) -> None:
        number = getattr(self._settings, f'{name}_port') if port is None else port
        parameter = f'{name}_port' if port is None else f'target_truth_port: {name}'
        source = open_port(parameter, number, self._settings.socket_buffer_bytes, multicast_group=group)
        self._receivers[name] = Receiver(name, source, handle)
        opened.callback(self._receivers[name].stop)

    def _publish_sound(self) -> None:
        while self._sounding:
            if not self._ring.wait(0.2):
                continue
            first, samples = self._ring.read(LONGEST_BLOCK)
            if len(samples):
                header = messages.make_header(self._audio.stamp(first), self._rig.array.frame)
                samples = self._layout.to_float(samples)
                self._direction.add(samples)
                self._outputs['audio/frames'].publish(messages.audio_message(
                    header, self._layout.sample_rate, first, samples))

    def _publish_image(self, stamped: StampedImage) -> None:
        bgr = decode_picture(stamped.image.data)
        camera = self._rig.camera
        header = messages.make_header(stamped.stamp, camera.optical_frame)
        self._outputs['camera/image_raw'].publish(messages.image_message(header, bgr))
        height, width = bgr.shape[:2]
        self._outputs['camera/camera_info'].publish(
            messages.camera_info_message(header, camera.model.scaled(width, height)))

    def _publish_depth(self, stamped: StampedImage) -> None:
        header = messages.make_header(stamped.stamp, self._rig.camera.optical_frame)
        self._outputs['camera/depth/image_raw'].publish(messages.image_message(header, decode_depth(stamped.image.data)))

    def _publish_boxes(self, boxes: list[OracleBox], stamp: float) -> None:
        if self._settings.oracle_detections:
            header = messages.make_header(stamp, self._rig.camera.optical_frame)
            self._outputs['detections'].publish(messages.detections_message(header, boxes))

    def _publish_state(self, copter_id: int, state: VehicleState, stamp: float) -> None:
        header = messages.make_header(stamp, self._settings.world_frame)
        if copter_id == self._settings.rig_id:
            message = messages.odometry_message(header, self._rig.base_frame, state)
            if not self._settings.follow_odometry:
                self._outputs['odometry'].publish(message)
            self._outputs['truth/rig'].publish(message)
        elif copter_id == self._settings.target_id:
            self._outputs['truth/target'].publish(messages.odometry_message(header, 'target', state))
        elif copter_id in self._more_targets:
            self._outputs[f'truth/target_{copter_id}'].publish(
                messages.odometry_message(header, f'target_{copter_id}', state))

    def _publish_imu(self, sample: ImuSample, stamp: float) -> None:
        header = messages.make_header(stamp, self._rig.base_frame)
        self._outputs['imu'].publish(messages.imu_message(header, frd_to_flu(sample.acceleration_frd),
                                                          frd_to_flu(sample.rate_frd)))

    def _on_command(self, command: PointingCommand) -> None:
        self._sequence = (self._sequence + 1) % 2**31
        body = command.move_body and not self._settings.follow_odometry
        gimbal = command.move_gimbal and math.isfinite(command.pan) and math.isfinite(command.tilt)
        datagram = encode_rig_control(RigControl(
            self._sequence, command.mode, command.yaw_rate if body else None,
            command.pan if gimbal else None, command.tilt if gimbal else None))
        self._send_control(datagram)

    def _on_odometry(self, odometry: Odometry) -> None:
        try:
            state = messages.vehicle_state(odometry)
        except ValueError:
            self._unusable_poses += 1
            return
        self._send_control(encode_truth(to_truth(state, self._settings.rig_id)))

    def _send_control(self, datagram: bytes) -> None:
        try:
            self._commands.sendto(datagram, (self._settings.control_host, self._settings.control_port))
        except OSError as error:
            self.get_logger().warning(f'cannot command the rig at {self._settings.control_host}: {error.strerror}',
                                      throttle_duration_sec=10.0)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Rate, age and faults of every stream."""
        streams = {name: self._receivers[name] for name in STREAMS}
        silent = [name for name, receiver in streams.items() if receiver.meter.age > self._settings.stale_after]
        if len(silent) == len(streams):
            ports = ', '.join(f'{name} {receiver.port}' for name, receiver in streams.items())
            status.mergeSummary(DiagnosticStatus.WARN, f'no data from the simulator (UDP {ports})')
        elif silent:
            status.mergeSummary(DiagnosticStatus.WARN, f'no data: {", ".join(silent)}')
        if self._direction.complaint:
            status.mergeSummary(DiagnosticStatus.WARN, f'audio: {self._direction.complaint}')
        for name, receiver in self._receivers.items():
            status.add(f'{name} rate (Hz)', f'{receiver.meter.rate:.1f}')
            status.add(f'{name} age (s)', f'{receiver.meter.age:.2f}')
            status.add(f'{name} malformed', str(receiver.malformed))
            if receiver.complaint:
                status.add(f'{name} last complaint', receiver.complaint)
        for name, value in self._counts().items():
            status.add(name, str(value))

    def _counts(self) -> dict[str, float]:
        audio, assembler = self._audio.decoder.counts, self._pictures.assembler
        return {'audio lost': audio.lost, 'audio lost frames': audio.lost_frames, 'audio reordered': audio.reordered,
                'audio restarts': audio.restarts, 'audio foreign': self._audio.foreign,
                'audio overwritten frames': self._ring.overwritten, 'image lost': assembler.incomplete,
                'image reordered': assembler.reordered, 'image dropped': self._images.dropped,
                'image undecodable': self._images.failed, 'imu lost': self._imu.lost,
                'odometry unusable': self._unusable_poses,
                'clock restarts': self._sender_clock.restarts, 'time sync offset (s)': self._time_sync.offset_s,
                'audio delay spread (us)': round(1e6 * self._direction.spread_s, 1)}


def decode_picture(data: bytes, flags: int = cv2.IMREAD_COLOR) -> NDArray:
    """Picture (height, width, 3) uint8, BGR. Raises ValueError for what is no picture."""
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ValueError(f'image: {error.err}') from error
    if picture is None:
        raise ValueError('image: neither JPEG nor PNG')
    return picture


def decode_depth(data: bytes) -> NDArray:
    """Depth (height, width) uint16 in mm, 0 where there is none (REP 118). Raises ValueError for what is no depth."""
    depth = decode_picture(data, cv2.IMREAD_UNCHANGED)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise ValueError(f'depth: {depth.dtype} in {depth.ndim} dimensions, a PNG of 16 bit and one channel expected')
    return np.where(depth == 65_535, 0, depth).astype(np.uint16)


def main() -> None:
    """Run the node."""
    run(BridgeNode)


if __name__ == '__main__':
    main()
