"""Random messages for every stage: ValueError for what cannot be used, finite results for the rest, bounded memory."""

from __future__ import annotations

import array
import math
from random import Random
from typing import Any

import numpy as np
import psutil
import pytest
import rclpy
import yolo_models
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from px4_layouts import plain_messages
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Float32MultiArray
from vision_msgs.msg import Detection2DArray

from av_audio.stage import make_doa_stage
from av_common.freshness import Instant
from av_common.gimbal_history import GimbalHistory
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_evaluation.nodes.monitor_node import MonitorNode
from av_fusion.stage import make_fusion_stage
from av_interfaces.msg import AudioFrame, Bearing, DoaArray, FusionState, GimbalState, PointingCommand, Visibility
from av_pointing.stage import make_pointing_stage
from av_px4.commands import GIMBAL_PITCH_YAW
from av_px4.stage import ODOMETRY_TOPIC, Outgoing, Px4Stage
from av_vision.messages import ENCODINGS
from av_vision.stage import make_detection_stage

MESSAGES, GROWTH_MB = 1000, 60.0
PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), 'pair')
INTEGERS = {f'{sign}int{bits}': (0 if sign else -2**(bits - 1), 2**bits - 1 if sign else 2**(bits - 1) - 1)
            for sign in ('', 'u') for bits in (8, 16, 32, 64)}
NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e300, -1e300, 3e38, 1e9, math.pi)
# Fields that may be infinite or NaN.
UNKNOWN = ('variance', 'cosine', 'visibility', 'range', 'look_', 'drone_probability', 'fundamental')
PLAUSIBLE = {'channels': (2,), 'sample_rate': (48000,), 'width': (640,), 'height': (480,), 'nav_state': (4, 14, 5, 23),
             'arming_state': (1, 2), 'system_id': (7,), 'target_system': (7,), 'target_component': (191,),
             'command': (1000, 1001), 'pose_frame': (1,)}
FRAMES = ('microphones', 'camera_optical_frame', 'base_link', '', 'x' * 300)


class Fuzzer:
    """Random messages: most fields plausible, some absurd.

    Parameters:
        seed: of the random draws.
    """

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.now = 1000.0

    def message(self, kind: type) -> Any:
        self.now += self.random.choice((0.0, 0.02, 0.1, 0.1, 30.0, -0.1))
        self._absurd = self.random.choice((0.0, 0.05, 0.5))
        message = kind()
        for name, spelled in kind.get_fields_and_field_types().items():
            setattr(message, name, self._value(spelled, name))
        if kind is Image and self.random.random() < 0.5:
            self._fill(message)
        return message

    def _fill(self, image: Image) -> None:
        """Pixels of a known encoding, more or less as many as there should be."""
        image.encoding = self.random.choice(list(ENCODINGS))
        image.width, image.height, image.step = (self.random.choice((1, 2, 9, 64)) for _ in range(3))
        image.step *= self.random.choice((1, 4, 12))
        image.data = array.array('B', self.random.randbytes(image.height * image.step))

    def _value(self, spelled: str, name: str) -> Any:
        if spelled.startswith('sequence<'):
            inner, count = spelled[9:-1].partition(',')[0], self.random.choice((0, 0, 1, 2, 3, 8, 40))
            return self._list(inner, count, name)
        if spelled.endswith(']'):
            inner, _, count = spelled[:-1].rpartition('[')
            return self._list(inner, int(count), name)
        if spelled == 'builtin_interfaces/Time':
            return self._stamp()
        if '/' in spelled:
            return self._message(spelled, name)
        if spelled in ('float', 'double'):
            # as a subscriber receives it: numbers beyond float32 arrive as infinite
            value = self.random.choice(NUMBERS) if self._wild() else self.random.gauss(0.0, 1.0)
            with np.errstate(over='ignore'):
                return float(np.float32(value)) if spelled == 'float' else value
        if spelled in INTEGERS:
            return self._integer(spelled, name)
        if spelled == 'boolean':
            return self.random.random() < 0.5
        if spelled == 'octet':
            return bytes([self.random.randrange(256)])
        return self.random.choice(FRAMES) if name == 'frame_id' else self.random.choice(('drone', '', 'x' * 300))

    def _integer(self, spelled: str, name: str) -> int:
        low, high = INTEGERS[spelled]
        if self._wild():
            return self.random.choice((low, high, 0, high // 2))
        return round(1e6 * self.now) if name.startswith('timestamp') else self.random.choice(PLAUSIBLE.get(name, range(4)))

    def _message(self, spelled: str, name: str) -> Any:
        package, kind = spelled.split('/')
        message = get_message(f'{package}/msg/{kind}')()
        if name == 'axis' and not self._wild():
            message.y = self.random.choice((0.0, 1.0))  # a unit vector, or none
            return message
        for inner, part in type(message).get_fields_and_field_types().items():
            setattr(message, inner, self._value(part, inner))
        return message

    def _list(self, inner: str, count: int, name: str) -> Any:
        if name == 'q' and not self._wild():
            return array.array('f', [math.cos(self.now), 0.0, 0.0, math.sin(self.now)])  # an attitude of PX4
        values = [self._value(inner, name) for _ in range(count)]
        codes = {'float': 'f', 'double': 'd', 'int32': 'i', 'uint32': 'I', 'uint8': 'B'}
        return array.array(codes[inner], values) if inner in codes else values

    def _stamp(self) -> Any:
        stamp = get_message('builtin_interfaces/msg/Time')()
        near = self.now + self.random.choice((0.0, -0.1, -0.3, 1.0))
        stamp.sec, stamp.nanosec = math.floor(near), int(1e9 * (near % 1.0))
        if self._wild():
            stamp.sec = self.random.choice((0, -1, -2**31, 2**31 - 1, 5))
            stamp.nanosec = self.random.choice((0, 10**9, 2**32 - 1))
        return stamp

    def _wild(self) -> bool:
        return self.random.random() < self._absurd


def px4_inputs() -> dict[type, Any]:
    """Of Px4Stage, the setpoints and commands of which are checked here."""
    messages = plain_messages('1.18')
    stage = Px4Stage(node_parameters('av_px4', 'px4_node', overrides={'offboard': True, 'motors.full_rpm': 10_000.0}), messages)
    stage.start(Instant(0.0, 0.0))

    def sent(out: list[Outgoing]) -> list[Any]:
        for topic, message in out:
            if topic == 'trajectory_setpoint':
                assert all(map(math.isfinite, message.position))
                assert math.isnan(message.yawspeed) or abs(message.yawspeed) <= stage.max_rate + 1e-9
            elif topic == 'vehicle_command' and message.command == GIMBAL_PITCH_YAW:
                assert abs(message.param1) <= 90.0 and abs(message.param2) <= 180.0
        return [message for topic, message in out if topic == ODOMETRY_TOPIC]

    def taking(take: Any) -> Any:
        return lambda message, now: sent(take(message, Instant(now, now)) + stage.on_time(Instant(now, now)))
    kinds = {'vehicle_status': 'VehicleStatus', 'vehicle_odometry': 'VehicleOdometry',
             'vehicle_local_position': 'VehicleLocalPosition', 'vehicle_command_ack': 'VehicleCommandAck',
             'gimbal_device_attitude_status': 'GimbalDeviceAttitudeStatus',
             'register_ext_component_reply': 'RegisterExtComponentReply', 'arming_check_request': 'ArmingCheckRequest',
             'setpoint_config_reply': 'SetpointConfigReply', 'actuator_motors': 'ActuatorMotors'}
    return {PointingCommand: taking(stage.on_command), Bearing: taking(stage.on_bearing)} | {
        getattr(messages, kind): taking(getattr(stage, f'on_{name}')) for name, kind in kinds.items()}


def monitor_inputs(node: MonitorNode, clock: Fuzzer) -> dict[type, Any]:
    """Of the monitor, which is no stage: the callbacks of a node that hears nothing else."""
    node.now = lambda: clock.now
    node.trigger_configure()
    node._converter._rotation_of = lambda *_: np.eye(3)
    takes = {DoaArray: node._on_doa, Detection2DArray: node._on_detections, Bearing: node._on_bearing,
             CameraInfo: node._converter.set_camera_info, FusionState: node._on_state, PointingCommand: node._on_command,
             DiagnosticArray: node._on_diagnostics, Odometry: lambda message: node._on_truth('truth/target', message)}

    def taking(take: Any) -> Any:
        def call(message: Any, _: float) -> None:
            try:
                take(message)
            finally:
                show()
        return call

    def show() -> None:
        try:
            node._each_second()
        except ValueError as error:
            raise AssertionError('what was refused is shown') from error
    return {kind: taking(take) for kind, take in takes.items()}


def inputs_of(name: str) -> dict[type, Any]:
    """The inputs of a stage by type: functions of message and time that return messages."""
    if name == 'px4':
        return px4_inputs()
    if name == 'doa':
        stage = make_doa_stage(node_parameters('av_audio', 'doa_node'), PAIR)
        return {AudioFrame: stage.on_audio, Float32MultiArray: lambda message, _: stage.on_motor_speeds(message)}
    if name == 'pointing':
        stage = make_pointing_stage(node_parameters('av_pointing', 'pointing_node'))
        return {Bearing: lambda message, now: stage.on_bearing(message, Instant(now, now)),
                Odometry: lambda message, now: stage.on_odometry(message, Instant(now, now))}
    fusion = make_fusion_stage(node_parameters('av_fusion', 'fusion_node', overrides={'method': name}),
                               lambda frame, time: np.eye(3), gimbal=GimbalHistory())
    return {DoaArray: fusion.on_doa, Detection2DArray: fusion.on_detections, Odometry: fusion.on_odometry,
            Visibility: lambda message, _: fusion.on_visibility(message),
            CameraInfo: lambda message, _: fusion.on_camera_info(message), GimbalState: fusion.on_gimbal}


def numbers(message: Any) -> list[float]:
    """All floating-point numbers of a message that must be finite."""
    found = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if isinstance(value, float):
            found += [] if any(word in name for word in UNKNOWN) else [value]
        elif hasattr(value, 'get_fields_and_field_types'):
            found += numbers(value)
        elif isinstance(value, list):
            found += [number for item in value if hasattr(item, 'get_fields_and_field_types') for number in numbers(item)]
    return found


@pytest.mark.parametrize('seed', [1, 2])
def test_random_images_raise_nothing_but_value_errors(seed, tmp_path):
    """Also as depth images, and as what the scale of visibility is taken from."""
    model = yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata={'names': "['bird', 'drone', 'kite']"})
    detection = make_detection_stage(node_parameters('av_vision', 'detector_node', overrides={
        'model': str(model), 'camera_height': 3.0, 'threads': 1}))

    def see(message: Any, now: float) -> Any:
        return detection.on_depth(message) if fuzzer.random.random() < 0.3 else detection.on_image(message, now)
    fuzzer = Fuzzer(seed)
    attack(fuzzer, {Image: see, CompressedImage: detection.on_image,
                    CameraInfo: lambda message, _: detection.on_camera_info(message),
                    Odometry: lambda message, _: detection.on_odometry(message),
                    Bearing: lambda message, _: detection.on_bearing(message)})


@pytest.mark.parametrize('seed', [1, 2])
def test_random_messages_leave_the_monitor_a_table(seed, capsys):
    """Its figures are printed at the end, whatever it was told."""
    fuzzer = Fuzzer(seed)
    rclpy.init(args=['--ros-args', '-p', 'autostart:=false'])
    try:
        node = MonitorNode()
        attack(fuzzer, monitor_inputs(node, fuzzer))
        node.deactivate()
        assert 'resolved in' in capsys.readouterr().out
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize('name', ['doa', 'bayes', 'gated', 'pointing', 'px4'])
@pytest.mark.parametrize('seed', [1, 2])
def test_random_messages_raise_nothing_but_value_errors(name, seed):
    """And what the stage answers is finite."""
    attack(Fuzzer(seed), inputs_of(name))


def attack(fuzzer: Fuzzer, inputs: dict[type, Any]) -> None:
    """Random messages to all inputs; what is answered must be finite."""
    refused = 0
    before = psutil.Process().memory_info().rss
    for _ in range(MESSAGES):
        kind = fuzzer.random.choice(list(inputs))
        message = fuzzer.message(kind)
        try:
            with np.errstate(all='ignore'):
                answer = inputs[kind](message, fuzzer.now)
        except ValueError:
            refused += 1
            continue
        answers = answer if isinstance(answer, list | tuple) else [answer]
        for output in filter(None, answers):
            if hasattr(output, 'get_fields_and_field_types') and getattr(output, 'state', None) != Bearing.STATE_NONE:
                assert all(map(math.isfinite, numbers(output))), (message, output)
    assert 0 < refused < MESSAGES
    assert (psutil.Process().memory_info().rss - before) / 1e6 < GROWTH_MB
