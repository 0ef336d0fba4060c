"""The fake autopilot on PX4's topics, with PX4's quality of service and the suffixes of its firmware.

Run with a `px4_msgs` of px4_layouts.py. Reads one JSON object a line ({"pilot": 14}, {"set": {"acknowledges": false}},
{"silence": ["vehicle_status"]}, {"connected": false}, {"speak": {"vehicle_status": "vehicle_status_v2"}},
{"reset_heading": 0.5}, {"point": {...} or null}, {"target": {"azimuth": 1.0, "rate": 0.2, "age": 0.3} or null}), writes its
state twenty times a second.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import queue
import sys
import threading
import time
from collections import deque

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fake_autopilot import FakeAutopilot
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import Bearing, PointingCommand

messages = importlib.import_module('px4_msgs.msg')   # built by px4_layouts.py, not installed
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
WRITES = QoSProfile(depth=5, reliability=BEST_EFFORT, durability=DurabilityPolicy.TRANSIENT_LOCAL)
READS = QoSProfile(depth=20, reliability=BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
RIG = QoSProfile(depth=20)
CLOCK_LAG = 0.187      # s by which PX4's synchronised clock was seen to lag
PERIOD = 0.01


def quaternion(yaw, pitch=0.0):
    """(w, x, y, z) of yaw, then pitch."""
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return [cy * cp, -sy * sp, cy * sp, sy * cp]


class Target:
    """A target in the world, seen 20 times a second from the vehicle; bearings of it are late."""

    def __init__(self, azimuth, rate, age):
        self.azimuth, self.rate, self.age, self.begin = azimuth, rate, age, time.time()
        self.seen, self.errors = deque(), deque(maxlen=400)

    def look(self, yaw, tick):
        """The bearings that arrive now."""
        now = time.time()
        world = self.azimuth + self.rate * (now - self.begin)
        self.errors.append(math.remainder(world - yaw, 2.0 * math.pi))
        if tick % 5 == 0:
            stamp = to_stamp(now)
            bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE, resolved=True, azimuth=self.errors[-1],
                              azimuth_variance=1e-4, azimuth_world=math.remainder(world, 2.0 * math.pi),
                              azimuth_world_rate=self.rate, attitude_known=True, measured=stamp)
            bearing.header.stamp = stamp
            self.seen.append((now, bearing))
        while self.seen and self.seen[0][0] <= now - self.age:
            yield self.seen.popleft()[1]

    def rms(self):
        return math.sqrt(sum(error**2 for error in self.errors) / len(self.errors)) if len(self.errors) == 400 else math.inf


class FakeNode:
    """Topics around a FakeAutopilot."""

    def __init__(self, firmware, prefix='/fmu', acks=True, stale=()):
        self.node, self.model = rclpy.create_node('fake_autopilot'), FakeAutopilot(obeys_any_mode=firmware == '1.16')
        self.prefix, self.firmware, self.silent, self.point = prefix, firmware, set(), None
        self.connected, self.spoken, self.said = True, {}, {}
        self.ticks, self.pilot, self.bearing, self.log = 0, None, None, []
        outputs = {'vehicle_status': 'VehicleStatus', 'vehicle_attitude': 'VehicleAttitude',
                   'vehicle_odometry': 'VehicleOdometry', 'vehicle_local_position': 'VehicleLocalPosition'}
        inputs = {'vehicle_command': ('VehicleCommand', self.on_command),
                  'offboard_control_mode': ('OffboardControlMode', lambda m: self.model.heartbeat()),
                  'trajectory_setpoint': ('TrajectorySetpoint', lambda m: self.model.setpoint(m.position, m.yaw, m.yawspeed))}
        if firmware != '1.14':
            outputs |= {'register_ext_component_reply': 'RegisterExtComponentReply',
                        'arming_check_request': 'ArmingCheckRequest'}
            inputs |= {'register_ext_component_request': ('RegisterExtComponentRequest', self.on_register),
                       'unregister_ext_component': ('UnregisterExtComponent',
                                                    lambda m: self.model.unregister(m.arming_check_id)),
                       'arming_check_reply': ('ArmingCheckReply',
                                              lambda m: self.model.answer(m.registration_id, m.can_arm_and_run)),
                       'config_control_setpoints': ('VehicleControlMode', lambda m: None)}
        if acks and firmware != '1.14':
            outputs['vehicle_command_ack'] = 'VehicleCommandAck'
        if firmware == '1.17':
            outputs['gimbal_device_attitude_status'] = 'GimbalDeviceAttitudeStatus'
        self.publishers = {name: self.node.create_publisher(*self.topic('out', name, kind), WRITES)
                           for name, kind in outputs.items()}
        for name, (kind, callback) in inputs.items():
            self.node.create_subscription(*self.topic('in', name, kind), self.while_connected(callback), READS)
        self.publishers |= {name: self.node.create_publisher(
            getattr(messages, ''.join(map(str.capitalize, name.rpartition('_')[0].split('_')))), f'{prefix}/out/{name}', WRITES)
            for name in stale}
        self.bearings = self.node.create_publisher(Bearing, '/target/bearing', RIG)
        self.pointing = self.node.create_publisher(PointingCommand, '/pointing/command', RIG)
        self.node.create_subscription(Odometry, '/odometry', self.on_odometry, RIG)
        self.node.create_subscription(Bearing, '/target/bearing', self.on_bearing, RIG)
        self.node.create_subscription(PointingCommand, '/pointing/command', self.on_pointing, RIG)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, RIG)
        self.node.create_subscription(DiagnosticStatus, '/px4/state', lambda m: self.said.update(state=m.message), RIG)
        self.odometry, self.tracking = None, 0.0
        self.target, self.last_bearing, self.turned_then = None, math.inf, 0.0

    def topic(self, side, name, kind):
        message = getattr(messages, kind)
        version = getattr(message, 'MESSAGE_VERSION', 0)
        return message, f'{self.prefix}/{side}/{name}' + (f'_v{version}' if version else '')

    # inputs

    def while_connected(self, callback):
        """The callback while the agent runs."""
        return lambda m: callback(m) if self.connected else None

    def on_diagnostics(self, m):
        for status in m.status:
            if status.name == 'px4_node: status':
                self.said['diagnostics'] = status.message

    def on_command(self, m):
        params = [getattr(m, f'param{k}') for k in range(1, 8)]
        result = self.model.command(m.command, params, (m.source_system, m.source_component),
                                    (m.target_system, m.target_component))
        if result is not None:
            self.publish('vehicle_command_ack', messages.VehicleCommandAck(
                timestamp=self.timestamp(), command=m.command, result=result, target_system=m.source_system,
                target_component=m.source_component))

    def on_register(self, m):
        number, nav_state = self.model.register(bytes(bytearray(m.name)).split(b'\0')[0].decode())
        self.publish('register_ext_component_reply', messages.RegisterExtComponentReply(
            timestamp=self.timestamp(), request_id=m.request_id, name=m.name, px4_ros2_api_version=1, success=True,
            arming_check_id=number, mode_id=nav_state, mode_executor_id=-1))

    def on_odometry(self, m):
        q = m.pose.pose.orientation
        self.odometry = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))

    def on_pointing(self, m):
        self.tracking = (self.tracking or self.model.time) if m.mode == PointingCommand.MODE_TRACK else 0.0

    def on_bearing(self, m):
        """When it came and how old, how long it has been followed, where it is, how far from it the gimbal looks right now."""
        self.bearing = {'state': m.state, 'azimuth': m.azimuth, 'hemisphere': m.hemisphere_probability}
        if m.state != Bearing.STATE_NONE:
            error = math.remainder(m.azimuth + self.model.gimbal[1], 2 * math.pi)
            now = time.time()
            self.log.append((now, now - to_seconds(m.header.stamp), self.model.time - self.tracking if self.tracking else 0.0,
                             m.azimuth, error))

    # outputs

    def timestamp(self):
        return int(1e6 * (time.time() - CLOCK_LAG))

    def publish(self, name, message):
        if name in self.publishers and name not in self.silent and self.connected:
            self.publishers[self.spoken.get(name, name)].publish(message)

    def tick(self):
        model, now, k = self.model, self.timestamp(), self.ticks
        before = model.nav_state, model.armed, model.failsafe
        self.ticks += 1
        model.advance(PERIOD)
        heading, reset = model.estimated_heading, model.resets
        q = quaternion(heading)
        self.publish('vehicle_attitude', messages.VehicleAttitude(
            timestamp=now, timestamp_sample=now, q=q, quat_reset_counter=reset, delta_q_reset=quaternion(model.last_reset)))
        self.publish('vehicle_odometry', messages.VehicleOdometry(
            timestamp=now, timestamp_sample=now, pose_frame=1, velocity_frame=1, position=list(model.position), q=q,
            velocity=[0.0] * 3, angular_velocity=[0.0, 0.0, model.yaw_rate], reset_counter=reset))
        if k % 2 == 0:
            x, y, z = model.position
            self.publish('vehicle_local_position', messages.VehicleLocalPosition(
                timestamp=now, xy_valid=True, z_valid=True, x=x, y=y, z=z, heading=heading, heading_reset_counter=reset,
                delta_heading=model.last_reset, heading_good_for_control=True))
        if k % 50 == 0 or before != self.told:
            self.told = before
            self.publish('vehicle_status', messages.VehicleStatus(
                timestamp=now, nav_state=model.nav_state, arming_state=2 if model.armed else 1, failsafe=model.failsafe,
                system_id=model.system, component_id=1))
        if k % 30 == 0 and model.modes:
            model.question = (model.question + 1) % 256
            request = messages.ArmingCheckRequest(timestamp=now, request_id=model.question)
            if hasattr(request, 'valid_registrations_mask'):
                request.valid_registrations_mask = sum(1 << number for number in model.modes)
            self.publish('arming_check_request', request)
        if k % 5 == 0 and self.firmware == '1.17':
            self.publish('gimbal_device_attitude_status', messages.GimbalDeviceAttitudeStatus(
                timestamp=now, device_flags=12 + 32, q=quaternion(model.gimbal[1], model.gimbal[0])))
        if self.point is not None and k % 2 == 0:
            self.command_rig()
        self.see(math.pi / 2.0 - heading)
        if k % 5 == 0:
            print(json.dumps(self.state()), flush=True)

    told = None

    def see(self, yaw):
        """Publish the bearings that arrive now, and note the turn of the body until 0.3 s after the newest."""
        for bearing in self.target.look(yaw, self.ticks) if self.target else ():
            self.bearings.publish(bearing)
            self.last_bearing = self.model.time
        if self.model.time <= self.last_bearing + 0.3:
            self.turned_then = self.model.turned

    def command_rig(self):
        stamp = to_stamp(time.time())
        fields = {'mode': 1, 'move_gimbal': True, 'move_body': True, **self.point}
        bearing = Bearing(state=fields.pop('state', Bearing.STATE_VISUAL_ACTIVE), azimuth=float(fields.get('pan', 0.0)))
        command = PointingCommand(**fields)
        bearing.header.stamp = bearing.measured = command.header.stamp = stamp
        self.bearings.publish(bearing)
        self.pointing.publish(command)

    def state(self):
        model = self.model
        return {'most_modes': model.most_modes, 'said': self.said, 'time': model.time,
                'nav_state': model.nav_state, 'heading': model.heading, 'yaw_rate': model.yaw_rate,
                'wanted_rate': model.wanted_rate, 'gimbal': model.gimbal, 'owner': model.owner, 'denied': model.denied,
                'commands': {str(number): model.commands.count(number) for number in set(model.commands)},
                'setpoints': model.setpoints, 'foreign': model.setpoints_in_foreign_modes, 'events': model.events,
                'heartbeats': len(model.heartbeats), 'modes': model.modes, 'odometry': self.odometry,
                'bearing': self.bearing, 'followed': sum(row[2] > 0.6 for row in self.log),
                'largest_rate': model.largest_rate, 'rms': self.target.rms() if self.target else None,
                'since_setpoint': model.turned - model.turned_at_setpoint, 'since_bearing': model.turned - self.turned_then}

    def obey(self, order):
        for name, value in order.items():
            if name == 'set':
                for key, new in value.items():
                    setattr(self.model, key, tuple(new) if isinstance(new, list) else new)
            elif name == 'silence':
                self.silent = set(value)
            elif name == 'speak':
                self.spoken = value
            elif name in ('point', 'pilot', 'connected'):
                setattr(self, name, value)
            elif name == 'target':
                self.target = Target(**value) if value else None
            elif name == 'write_log':
                with open(value, 'w') as file:  # noqa: PTH123
                    json.dump(self.log, file)
                print(json.dumps({'written': True, **self.state()}), flush=True)
            else:
                result = getattr(self.model, name)(*value) if isinstance(value, list) else getattr(self.model, name)(value)
                self.model.events.append(f'{name} {value}: {result}')


def read_orders(orders):
    """Lines of stdin into a queue, '' at its end. A thread: `select` does not see a line that stdin has buffered."""
    for line in sys.stdin:
        orders.put(line)
    orders.put('')


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('firmware')
    parser.add_argument('--prefix', default='/fmu')
    parser.add_argument('--pilot', type=int, help='the mode that the pilot selects whenever PX4 lets him')
    parser.add_argument('--stale', nargs='*', default=[], help='topics of another firmware that a stale agent offers')
    options = parser.parse_args()
    rclpy.init()
    fake = FakeNode(options.firmware, options.prefix, stale=options.stale)
    fake.pilot = options.pilot
    orders = queue.SimpleQueue()
    threading.Thread(target=read_orders, args=(orders,), daemon=True).start()
    due = time.monotonic()
    while True:
        rclpy.spin_once(fake.node, timeout_sec=max(0.0, min(due - time.monotonic(), PERIOD)))
        while time.monotonic() >= due:
            fake.tick()
            due = max(due + PERIOD, time.monotonic() - 0.1)
        while not orders.empty():
            line = orders.get()
            if not line:
                return
            fake.obey(json.loads(line))
        if fake.pilot not in (None, fake.model.nav_state):
            fake.model.select_mode(fake.pilot)


if __name__ == '__main__':
    main()
