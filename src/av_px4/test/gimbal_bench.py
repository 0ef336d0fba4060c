"""A client of the gimbal manager against the fake autopilot, step by step."""

from __future__ import annotations

import math

from fake_autopilot import FakeAutopilot

from av_px4.gimbal import Gimbal, GimbalInputs

OWN = (1, 191)


class Bench:
    """A gimbal's client and an autopilot, 50 times a second."""

    def __init__(self, settings=None, **autopilot):
        self.client, self.autopilot, self.time = Gimbal(**(settings or {})), FakeAutopilot(**autopilot), 0.0
        self.sent = []

    def run(self, seconds, pan=0.0, tilt=0.0, move=True, fresh=True, **more):
        for _ in range(round(seconds * 50)):
            self.time += 0.02
            inputs = GimbalInputs(move, pan, tilt, 0.0, fresh, self.autopilot.nav_state, 1, **more)
            self.deliver(self.client.step(self.time, inputs))
            self.autopilot.advance(0.02)

    def deliver(self, commands):
        for command in commands:
            self.sent.append((self.time, command))
            result = self.autopilot.command(command.command, command.params, OWN, (1, 1))
            if result is not None:
                self.client.acknowledge(self.time, command.command, result)

    @property
    def looks(self):
        """Pan and tilt in deg where the fake's gimbal looks."""
        return -math.degrees(self.autopilot.gimbal[1]), math.degrees(self.autopilot.gimbal[0])
