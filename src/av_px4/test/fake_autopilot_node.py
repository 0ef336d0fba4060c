"""The fake autopilot on PX4's topics, with PX4's quality of service and the suffixes of its firmware.

Run with a `px4_msgs` of px4_layouts.py. Reads one JSON object a line ({"pilot": 14}, {"set": {"acknowledges": false}},
{"silence": ["vehicle_status"]}, {"connected": false}, {"speak": {"vehicle_status": "vehicle_status_v2"}},
{"reset_heading": 0.5}, {"point": {...} or null}, {"target": {"azimuth": 1.0, "rate": 0.2, "age": 0.3} or null},
{"program": {"speed": 2.0, "sends": true} or null}), or a line of PX4's shell (commander takeoff, commander mode ext1); writes
its state twenty times a second.
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
from functools import cached_property

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fake_firmware import PERIOD, FakeFirmware
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32MultiArray

from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, PointingCommand

messages = importlib.import_module('px4_msgs.msg')   # built by px4_layouts.py, not installed
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
WRITES = QoSProfile(depth=5, reliability=BEST_EFFORT, durability=DurabilityPolicy.TRANSIENT_LOCAL)
READS = QoSProfile(depth=20, reliability=BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
RIG = QoSProfile(depth=20)
COMMANDER = {'commander takeoff': {'set': {'armed': True}}, 'commander mode ext1': {'pilot': 23},
             'commander mode offboard': {'pilot': 14}}
CLOCK_LAG = 0.187      # s by which PX4's synchronised clock was seen to lag


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


class Program:
    """Another program of the user, which flies its path in OFFBOARD: north with a speed (m/s), at a height of 2 m."""

    def __init__(self, speed, sends=True, namespace=''):
        self.speed, self.sends, self.begin = speed, sends, None    # silent ones keep their publishers
        self.node = rclpy.create_node('path_follower', namespace=namespace)
        self.heartbeat, self.setpoint = (self.node.create_publisher(getattr(messages, kind), f'fmu/in/{name}', READS)
                                         for name, kind in (('offboard_control_mode', 'OffboardControlMode'),
                                                            ('trajectory_setpoint', 'TrajectorySetpoint')))

    def tick(self, now, in_offboard):
        if not self.sends:
            return
        self.begin = self.begin or (now if in_offboard else None)
        along = self.speed * (now - self.begin) if self.begin else 0.0
        self.heartbeat.publish(messages.OffboardControlMode(position=True))
        self.setpoint.publish(messages.TrajectorySetpoint(
            position=[along, 0.0, -2.0], velocity=[math.nan] * 3, acceleration=[math.nan] * 3, jerk=[math.nan] * 3,
            yaw=math.nan, yawspeed=math.nan))


class FakeNode:
    """Topics around a FakeFirmware."""

    def __init__(self, firmware, told=None, namespace='', system=1, stale=()):
        self.node = rclpy.create_node('fake_autopilot', namespace=namespace)
        self.firmware = FakeFirmware(firmware, messages, told, system=system)
        self.model, self.silent, self.point, self.program = self.firmware.model, set(), None, None
        self.connected, self.spoken, self.said = True, {}, {}
        self.pilot, self.counts, self.lock = None, {}, threading.Lock()
        self.publishers = {name: self.node.create_publisher(*self.topic('out', name, kind), WRITES)
                           for name, kind in self.firmware.outputs.items()}
        for name, kind in self.firmware.inputs.items():
            self.node.create_subscription(*self.topic('in', name, kind), self.input(name), READS)
        self.publishers |= {name: self.node.create_publisher(
            getattr(messages, ''.join(map(str.capitalize, name.rpartition('_')[0].split('_')))), f'fmu/out/{name}', WRITES)
            for name in stale}
        for kind, name, take in ((Odometry, 'odometry', self.on_odometry),
                                 (DiagnosticArray, '/diagnostics', self.on_diagnostics),
                                 (DiagnosticStatus, 'px4/state', lambda m: self.said.update(state=m.message)),
                                 (Float32MultiArray, 'motor_speeds', lambda m: self.said.update(motors=list(m.data)))):
            self.node.create_subscription(kind, name, take, READS if name == 'motor_speeds' else RIG)
        self.odometry = None
        self.target, self.last_bearing, self.turned_then = None, math.inf, 0.0

    # Only where this node takes the part of fusion or pointing: beside theirs it would be a second publisher, and refused.
    @cached_property
    def bearings(self):
        return self.node.create_publisher(Bearing, 'target/bearing', RIG)

    @cached_property
    def pointing(self):
        return self.node.create_publisher(PointingCommand, 'pointing/command', RIG)

    def topic(self, side, name, kind):
        message = getattr(messages, kind)
        version = getattr(message, 'MESSAGE_VERSION', 0)
        return message, f'fmu/{side}/{name}' + (f'_v{version}' if version else '')

    # inputs

    def input(self, name):
        """What is done with an input while the agent runs."""
        def take(message):
            with self.lock:
                if self.connected:
                    self.counts[name] = self.counts.get(name, 0) + (message.timestamp > 0)    # the program leaves it at 0
                    for reply in self.firmware.take(name, message, self.timestamp()):
                        self.publish(*reply)
        return take

    def on_diagnostics(self, m):
        for status in m.status:
            if status.name.endswith('px4_node: status'):
                self.said['diagnostics'] = status.message

    def on_odometry(self, m):
        q = m.pose.pose.orientation
        self.odometry = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))

    # outputs

    def timestamp(self):
        return int(1e6 * (time.time() - CLOCK_LAG))

    def publish(self, name, message):
        if name in self.publishers and name not in self.silent and self.connected:
            self.publishers[self.spoken.get(name, name)].publish(message)

    def tick(self):
        k, model = self.firmware.ticks, self.model
        for name, message in self.firmware.tick(self.timestamp()):
            self.publish(name, message)
        if self.point is not None and k % 2 == 0:
            self.command_rig()
        if self.program is not None and k % 2 == 0:
            self.program.tick(model.time, model.nav_state == 14)
        self.see(math.pi / 2.0 - model.estimated_heading)
        if k % 5 == 0:
            print(json.dumps(self.state()), flush=True)

    def see(self, yaw):
        """Publish the bearings that arrive now, and note the turn of the body until 0.3 s after the newest."""
        for bearing in self.target.look(yaw, self.firmware.ticks) if self.target else ():
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

    def publish_escs(self, rpm):
        """The speeds (1/min) of the motors."""
        kind, topic = self.topic('out', 'esc_status', 'EscStatus')
        if 'esc_status' not in self.publishers:
            self.publishers['esc_status'] = self.node.create_publisher(kind, topic, WRITES)
        status = kind(esc_count=len(rpm), esc_online_flags=2**len(rpm) - 1)
        for esc, speed in zip(status.esc, rpm, strict=False):
            esc.esc_rpm = speed
        self.publish('esc_status', status)

    def state(self):
        model = self.model
        modes = {number: (mode.name, mode.nav_state) for number, mode in model.modes.items()}
        return {'most_modes': model.most_modes, 'granted': model.granted, 'said': self.said, 'time': model.time,
                'nav_state': model.nav_state, 'failsafe': model.failsafe, 'position': model.position,
                'speed': math.hypot(*model.velocity), 'heading': model.heading, 'yaw_rate': model.yaw_rate,
                'wanted_rate': model.wanted_rate, 'gimbal': model.gimbal, 'owner': model.owner, 'denied': model.denied,
                'commands': {str(number): model.commands.count(number) for number in set(model.commands)},
                'setpoints': self.counts.get('trajectory_setpoint', 0), 'foreign': model.setpoints_in_foreign_modes,
                'heartbeats': self.counts.get('offboard_control_mode', 0), 'events': model.events, 'modes': modes,
                'odometry': self.odometry, 'largest_rate': model.largest_rate,
                'rms': self.target.rms() if self.target else None, 'since_bearing': model.turned - self.turned_then}

    def obey(self, order):
        for name, value in order.items():
            if hasattr(self, f'obey_{name}'):
                getattr(self, f'obey_{name}')(value)
            elif name in ('point', 'pilot', 'connected'):
                setattr(self, name, value)
            else:
                result = getattr(self.model, name)(*value) if isinstance(value, list) else getattr(self.model, name)(value)
                self.model.events.append(f'{name} {value}: {result}')

    def obey_set(self, value):
        for key, new in value.items():
            setattr(self.model, key, tuple(new) if isinstance(new, list) else new)

    def obey_silence(self, value):
        self.silent = set(value)

    def obey_speak(self, value):
        self.spoken = value

    def obey_esc_rpm(self, value):
        self.publish_escs(value)

    def obey_target(self, value):
        self.target = Target(**value) if value else None

    def obey_program(self, value):
        if self.program is not None:
            self.program.node.destroy_node()
        self.program = Program(**value, namespace=self.node.get_namespace()) if value else None


def read_orders(orders):
    """Lines of stdin into a queue, '' at its end. A thread: `select` does not see a line that stdin has buffered."""
    for line in sys.stdin:
        orders.put(line)
    orders.put('')


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('firmware')
    parser.add_argument('--told', help='the firmware whose layouts it has when asked, if not this one')
    parser.add_argument('--namespace', default='')
    parser.add_argument('--system', type=int, default=1)
    parser.add_argument('--pilot', type=int, help='the mode that the pilot selects whenever PX4 lets him')
    parser.add_argument('--stale', nargs='*', default=[], help='topics of another firmware that a stale agent offers')
    parser.add_argument('--parameters', help="MNT_MODE_IN at the start of PX4's SITL, which begins on the ground")
    options = parser.parse_args()
    rclpy.init()
    fake = FakeNode(options.firmware, options.told, options.namespace, options.system, options.stale)
    fake.pilot = options.pilot
    if options.parameters is not None:
        fake.obey_set({'armed': False, 'gimbal_input': options.parameters in ('0', '4')})
    orders = queue.SimpleQueue()
    threading.Thread(target=read_orders, args=(orders,), daemon=True).start()
    # A thread: where a busy machine makes ticks late, what is received does not wait for them.
    executor = SingleThreadedExecutor()
    executor.add_node(fake.node)
    threading.Thread(target=executor.spin, daemon=True).start()
    due = time.monotonic()
    while True:
        time.sleep(max(0.0, min(due - time.monotonic(), PERIOD)))
        with fake.lock:
            due = step(fake, due, orders)
            if due is None:
                return


def step(fake, due, orders):
    """Ticks that are due, then orders; the time of the next tick, None at the end of the orders."""
    while time.monotonic() >= due:
        fake.tick()
        due = max(due + PERIOD, time.monotonic() - 0.1)
    while not orders.empty():
        line = orders.get()
        if not line:
            return None
        fake.obey(COMMANDER[line.strip()] if line.startswith('commander') else json.loads(line))
    if fake.pilot not in (None, fake.model.nav_state):
        fake.model.select_mode(fake.pilot)
    return due


if __name__ == '__main__':
    main()
