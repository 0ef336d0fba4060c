"""Node that converts a simulator's datagrams to the rig's topics, and commands to datagrams."""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, Imu
from vision_msgs.msg import Detection2DArray

from av_common.freshness import Instant
from av_common.node import RigNode, run
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.rate_meter import MISSING_AFTER_S
from av_common.rig import camera_topic
from av_interfaces.msg import AudioFrame, GimbalState, PointingCommand
from av_sim_bridge.nodes.bridge_node_parameters import bridge_node as parameters
from av_sim_bridge.receiving.allowed_senders import AllowedSenders, Refusals, SenderGate, ipv4, resolve
from av_sim_bridge.receiving.receiver import Handler, Receiver, open_port
from av_sim_bridge.stage import make_bridge_stage
from av_sim_bridge.wire.ports import TIME_SYNC_GROUP, Ports

SOCKET_BUFFER_BYTES = 4_194_304  # that each port asks of the system; RFlySim itself asks for 204,800
STREAMS = ('audio', 'image', 'rig_truth', 'target_truth')    # streams that are reported when no data arrives


class BridgeNode(RigNode):
    """Receives datagrams on one thread for each port, publishes the stage's messages, and reports missing streams."""

    def __init__(self) -> None:
        super().__init__('bridge_node', parameters)

    def configure(self) -> None:
        """Read the rig's description and create the publishers."""
        self._settings = self.settings
        self._ports = Ports().shifted(self._settings.port_offset)
        self._stage = make_bridge_stage(self._settings)
        self._check_addresses()
        topics = {'audio/frames': (AudioFrame, STREAM), 'truth/rig': (Odometry, RESULT), 'imu': (Imu, STREAM),
                  'camera/depth/image_raw': (Image, IMAGE)}
        for camera in self._stage.rig.cameras:
            topics |= {f'{camera}/image_raw': (Image, IMAGE), f'{camera}/camera_info': (CameraInfo, RESULT)}
            if self._settings.oracle_detections:
                topics[camera_topic(camera, 'detections')] = (Detection2DArray, RESULT)
        topics |= dict.fromkeys(self._stage.target_topics.values(), (Odometry, RESULT))
        if not self._settings.follow_odometry:
            topics['odometry'] = (Odometry, RESULT)
        if self._stage.rig.gimbal is not None:
            topics['gimbal/state'] = (GimbalState, RESULT)
        self._outputs = {name: self.create_publisher(kind, name, qos) for name, (kind, qos) in topics.items()}

    def activate(self) -> None:
        """Open the ports and start the threads."""
        self._stage = make_bridge_stage(self._settings)    # a new run starts with empty buffers and unset clocks
        self._receivers: dict[str, Receiver] = {}
        self._refusals, self._refused_before = Refusals(), 0
        self._foreign: dict[str, int] = {}
        with ExitStack() as opened:
            self._open_streams(opened)
            self._opened = opened.pop_all()
        self.create_subscription(PointingCommand, 'pointing/command', self._on_command, RESULT)
        self.refuse_second_publishers('pointing/command', tell=partial(setattr, self._stage, 'contested'))
        if self._settings.follow_odometry:
            self.subscribe_odometry(self._on_odometry)

    def deactivate(self) -> None:
        """Stop the threads and close the ports."""
        for receiver in self._receivers.values():
            receiver.end()    # all together: each takes up to 0.2 s
        self._opened.close()

    def _check_addresses(self) -> None:
        """Who may send to this node, and where its commands go. Raises ValueError."""
        bind_address, control_host = self._settings.bind_address, self._settings.control_host
        self._allowed = AllowedSenders(self._settings.allowed_senders)
        self._allowed.check_bind_address(bind_address)
        self._simulator = resolve('control_host', control_host)
        if ipv4('bind_address', bind_address).is_loopback and not ipv4('control_host', self._simulator).is_loopback:
            raise ValueError(f'control_host is {control_host}, which cannot be reached from bind_address {bind_address}, '
                             "expected this machine's address in the network of that host, or 0.0.0.0")

    def _open_streams(self, opened: ExitStack) -> None:
        stage, ports = self._stage, vars(self._ports)
        handlers: dict[str, Handler] = {'audio': stage.on_audio, 'depth': stage.on_depth, 'rig_truth': stage.on_truth,
                                        'target_truth': stage.on_truth, 'imu': stage.on_imu}
        for camera, stream in zip(stage.rig.cameras, ('image', 'second_image'), strict=False):
            handlers[stream] = partial(stage.on_image, camera=camera)
        if stage.rig.gimbal is not None:
            handlers['gimbal'] = stage.on_gimbal
        for name, handle in handlers.items():
            self._receive(opened, name, ports[name], handle)
        for index, number in enumerate(stage.target_topics):
            if index:
                self._receive(opened, f'target_{number}_truth', self._ports.target_truth + 2 * index, stage.on_truth)
        self._receive(opened, 'time_sync', self._ports.time_sync, stage.on_time_sync, TIME_SYNC_GROUP)

    def _receive(self, opened: ExitStack, name: str, port: int, handle: Handler, group: str | None = None) -> None:
        """Publish what the stage makes of each datagram, on a thread of the port's own."""
        def take(*datagram: Any) -> None:
            for topic, message in handle(*datagram):
                self._outputs[topic].publish(message)

        source = open_port(name, port, SOCKET_BUFFER_BYTES, self._settings.bind_address, group)
        self._receivers[name] = Receiver(name, source, take, SenderGate(source, self._allowed, self._refusals))
        opened.callback(self._receivers[name].stop)

    def _on_command(self, command: PointingCommand) -> None:
        self._send_control(self._stage.on_command(command, Instant(time.monotonic(), self.now())))

    def _on_odometry(self, odometry: Odometry) -> None:
        datagram = self._stage.on_odometry(odometry)
        if datagram is not None:
            self._send_control(datagram)

    def _send_control(self, datagram: bytes) -> None:
        """Send from the port of the rig's true state, by which the simulator knows the bridge."""
        try:
            self._receivers['rig_truth'].send(datagram, (self._simulator, self._ports.control))
        except OSError as error:
            self.get_logger().warning(f'cannot send commands to {self._settings.control_host}: {error.strerror}',
                                      throttle_duration_sec=10.0)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report rate, age and errors of every stream."""
        streams = {name: self._receivers[name] for name in STREAMS}
        silent = [name for name, receiver in streams.items() if receiver.meter.age > MISSING_AFTER_S]
        if len(silent) == len(streams):
            ports = ', '.join(f'{name} {receiver.port}' for name, receiver in streams.items())
            status.mergeSummary(DiagnosticStatus.WARN, f'no data from the simulator (UDP {ports})')
        elif silent:
            status.mergeSummary(DiagnosticStatus.WARN, f'no data: {", ".join(silent)}')
        if self._stage.problem:
            status.mergeSummary(DiagnosticStatus.WARN, self._stage.problem)
        for name, receiver in self._receivers.items():
            status.add(f'{name} rate (Hz)', f'{receiver.meter.rate:.1f}')
            status.add(f'{name} age (s)', f'{receiver.meter.age:.2f}')
            status.add(f'{name} malformed', str(receiver.failed))
            status.add(f'{name} foreign', str(receiver.foreign.total))
            if receiver.last_error:
                status.add(f'{name} last error', receiver.last_error)
        self._report_foreign(status)
        self._report_refusals(status)
        for name, value in self._stage.counts().items():
            status.add(name, str(value))

    def _report_foreign(self, status: DiagnosticStatusWrapper) -> None:
        """An error for each stream to which another than its sender has sent since the last report."""
        totals = {name: receiver.foreign.total for name, receiver in self._receivers.items()}
        for name in [name for name, total in totals.items() if total > self._foreign.get(name, 0)]:
            status.mergeSummary(
                DiagnosticStatus.ERROR, f'{name}: datagrams of {", ".join(self._receivers[name].foreign.counts())} refused, as '
                'another program sends this stream: stop one of them, or name the right one with its port in allowed_senders')
        self._foreign = totals

    def _report_refusals(self, status: DiagnosticStatusWrapper) -> None:
        refused, newest = self._refusals.total, self._refusals.counts()
        if refused > self._refused_before:
            status.mergeSummary(DiagnosticStatus.WARN, f'datagrams of {", ".join(newest)} refused: not in allowed_senders')
        self._refused_before = refused
        status.add('refused datagrams', str(refused))
        status.add('refused senders', ', '.join(f'{sender}: {count}' for sender, count in newest.items()))


def main() -> None:
    """Run the node."""
    run(BridgeNode)


if __name__ == '__main__':
    main()
