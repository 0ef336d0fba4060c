"""Px4Stage with the fake firmware in one process, 100 steps a second: what is sent is obeyed, and time is simulated."""

from __future__ import annotations

import math

from fake_firmware import PERIOD, FakeFirmware
from px4_layouts import plain_messages

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, PointingCommand
from av_px4.stage import Px4Stage

EPOCH = 1.7e9      # s, ROS time minus the steady clock


class Program:
    """Another program of the user: it flies north in OFFBOARD with a speed (m/s), by setpoints and heartbeats of its own."""

    def __init__(self, speed=2.0):
        self.speed, self.begin = speed, None

    def tick(self, model):
        if self.begin is None and model.nav_state == 14:
            self.begin = model.time
        along = 0.0 if self.begin is None else self.speed * (model.time - self.begin)
        model.heartbeat()
        model.setpoint((along, 0.0, -2.0), math.nan, math.nan)


class Flight:
    """A vehicle, and the rig's stage with a target that pointing turns to.

    rig: the stage, None while its process is dead.  program: of the user, None for none.  linked: whether the agent runs; what
    comes while it stalls arrives in a crowd once it runs on, at most the newest ten of a topic.
    """

    def __init__(self, firmware='1.17', model=None, **settings):
        self.messages = plain_messages(firmware)
        self.firmware = FakeFirmware(firmware, self.messages, **(model or {}))
        self.model, self.parameters = self.firmware.model, node_parameters('av_px4', 'px4_node', overrides=settings)
        self.time, self.program, self.linked, self.enabled, self.pilot = 100.0, None, True, True, None
        self.sent, self.waiting, self.silent = [], [], set()
        self.start()

    def start(self, former=None):
        """A new process of px4_node."""
        self.rig = Px4Stage(self.parameters, self.messages)
        self.rig.start(self.now, former)

    @property
    def now(self):
        return Instant(self.time, EPOCH + self.time)

    def run(self, seconds, until=None, **command):
        """Simulate; the pilot selects `pilot` whenever PX4 lets him. `until` ends it when it is fulfilled; returns whether."""
        for _ in range(round(seconds / PERIOD)):
            self.step(command)
            if until is not None and until(self):
                return True
        return False

    def step(self, command):
        self.time += PERIOD
        outputs = list(self.firmware.tick(round(1e6 * self.time)))
        if self.linked:
            for name, message in (*self.waiting, *outputs):
                self.hear(name, message)
            self.waiting = []
        else:
            self.waiting += outputs
            for name in {name for name, _ in self.waiting}:
                old = [item for item in self.waiting if item[0] == name][:-10]
                self.waiting = [item for item in self.waiting if not any(item is one for one in old)]
        if self.firmware.ticks % 2 == 0:
            if self.program is not None:
                self.program.tick(self.model)
            if self.rig is not None:
                self.rig.others = '' if self.program is None else '/path_follower publishes /fmu/in/trajectory_setpoint'
                self.command(command)
                self.send(self.rig.on_time(self.now))
        if self.pilot not in (None, self.model.nav_state):
            self.model.select_mode(self.pilot)

    def command(self, fields):
        """A bearing with a measurement of now, and the command that follows."""
        stamp = to_stamp(self.now.ros)
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE, measured=stamp)
        command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_gimbal=self.enabled, move_body=self.enabled, **fields)
        bearing.header.stamp = command.header.stamp = stamp
        for name, message in (('bearing', bearing), ('command', command)):
            self.hear(name, message)

    def hear(self, name, message):
        if self.rig is not None and name not in self.silent and hasattr(self.rig, f'on_{name}'):
            self.send(getattr(self.rig, f'on_{name}')(message, self.now))

    def send(self, out):
        for topic, message in out:
            self.sent.append((self.time, topic, message))
            if topic in self.firmware.inputs and self.linked:
                for reply in self.firmware.take(topic, message, round(1e6 * self.time)):
                    self.hear(*reply)

    def of(self, topic, since=-math.inf):
        """Messages to a topic that were sent since a time."""
        return [message for time, name, message in self.sent if name == topic and time >= since]

    @property
    def own_mode(self):
        """nav_state of the rig's mode, None while PX4 has none."""
        return next((mode.nav_state for mode in self.model.modes.values()), None)

    @property
    def said(self):
        """The newest px4/state."""
        return self.of('px4/state')[-1]

    def value(self, key):
        """A value of the newest px4/state."""
        return {pair.key: pair.value for pair in self.said.values}[key]
