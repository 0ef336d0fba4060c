"""A vehicle with the observed behaviour of PX4: control of the gimbal, acknowledgements, modes, setpoints.

Angles here are PX4's: heading clockwise from north, gimbal yaw to the right, pitch up, all in rad.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
HOLD, RETURN, OFFBOARD, LAND, POSITION = 4, 5, 14, 18, 2
GIMBAL_RATE, GIMBAL_LAG = math.radians(180.0), 0.05
AT_REST = math.radians(0.1)    # rad/s, below which the fake stands still: PX4's rate has died away 0.9 s after a stop


def wrap(angle):
    """To (-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


@dataclass
class FakeAutopilot:
    """One hovering vehicle. `advance` simulates a step; the other methods process inputs and return the replies.

    obeys_any_mode: setpoints are obeyed in every mode, as PX4 1.16 does.  gimbal_input: MNT_MODE_IN is set; without it
    no gimbal command is ever acknowledged.  return_on_loss: what follows when the heartbeat ends in OFFBOARD.
    """

    system: int = 1
    obeys_any_mode: bool = False
    gimbal_input: bool = True
    acknowledges: bool = True
    armed: bool = True
    failsafe: bool = False
    nav_state: int = HOLD
    heading: float = 0.0
    heading_error: float = 0.0            # what the estimator adds
    position: tuple = (0.0, 0.0, -2.0)
    resets: int = 0
    last_reset: float = 0.0
    loss_time: float = 1.0                # s without a heartbeat after which OFFBOARD ends, COM_OF_LOSS_T
    dead_time: float = 0.1                # s, of the answer to a yaw rate, as flown
    lag: float = 0.4                      # s, time constant of that answer
    yaw_rate: float = 0.0
    wanted_rate: float = 0.0
    wanted: deque = field(default_factory=deque)    # rates that do not show yet: (when they will, rate)
    obeyed_rate: float = 0.0
    turned: float = 0.0                   # sum of all turns
    turned_at_setpoint: float = 0.0       # at the newest setpoint
    gimbal: list = field(default_factory=lambda: [0.0, 0.0])       # pitch, yaw
    gimbal_wanted: list = field(default_factory=lambda: [0.0, 0.0])
    owner: tuple | None = None
    modes: dict = field(default_factory=dict)       # arming check id -> (name, nav_state)
    answered: dict = field(default_factory=dict)    # arming check id -> time
    most_modes: int = 0
    time: float = 0.0
    changed: float = 0.0                  # when the mode last changed
    heartbeats: list = field(default_factory=list)
    last_answer: float = -math.inf
    question: int = 0
    setpoints: int = 0
    setpoints_in_foreign_modes: int = 0
    commands: list = field(default_factory=list)    # numbers, in order
    denied: int = 0
    largest_rate: float = 0.0
    events: list = field(default_factory=list)

    @property
    def estimated_heading(self):
        return wrap(self.heading + self.heading_error)

    @property
    def own_modes(self):
        return {nav_state for _, nav_state in self.modes.values()}

    def advance(self, dt):
        self.time += dt
        self._forget_silent_modes()
        if not self.obeys_any_mode and self.nav_state not in {OFFBOARD} | self.own_modes:
            self.wanted_rate = 0.0
        if self.nav_state == OFFBOARD and self._heartbeat_age() > self.loss_time:
            self.change_mode(RETURN, 'no heartbeat')
        if self.nav_state in self.own_modes and self.time - self.last_answer > 1.3:
            self.change_mode(RETURN, 'the external mode is silent')
        self.turn(dt)
        for axis in (0, 1):
            step = GIMBAL_RATE * dt
            move = (self.gimbal_wanted[axis] - self.gimbal[axis]) * -math.expm1(-dt / GIMBAL_LAG)
            self.gimbal[axis] += min(max(move, -step), step)

    def turn(self, dt):
        """Turn by the rate that was wanted a dead time ago, with a first-order lag."""
        self.wanted.append((self.time - dt + self.dead_time, self.wanted_rate))
        while self.wanted and self.wanted[0][0] <= self.time + 1e-9:
            self.obeyed_rate = self.wanted.popleft()[1]
        before = self.yaw_rate
        self.yaw_rate += (self.obeyed_rate - self.yaw_rate) * -math.expm1(-dt / self.lag)
        if self.obeyed_rate == 0.0 and abs(self.yaw_rate) < AT_REST:
            self.yaw_rate = 0.0
        turn = 0.5 * (before + self.yaw_rate) * dt
        self.turned, self.heading = self.turned + turn, wrap(self.heading + turn)

    def select_mode(self, nav_state):
        """The pilot selects a mode; False if PX4 refuses it."""
        beats = [beat for beat in self.heartbeats if self.time - beat < 1.5]
        if nav_state == OFFBOARD and not (len(beats) > 2 and self._heartbeat_age() < 0.5 and beats[-1] - beats[0] > 1.0):
            return False
        self.last_answer = self.time if nav_state in self.own_modes else self.last_answer
        self.change_mode(nav_state, 'the pilot')
        return True

    def change_mode(self, nav_state, why):
        self.events.append(f'mode {nav_state}: {why}')
        self.nav_state, self.wanted_rate, self.changed = nav_state, 0.0, self.time
        if nav_state in (RETURN, LAND):   # these take the gimbal
            self.owner, self.gimbal_wanted = None, [0.0, 0.0]

    def heartbeat(self):
        self.heartbeats = [*self.heartbeats[-200:], self.time]

    def setpoint(self, position, yaw, yawspeed):
        self.setpoints += 1
        self.turned_at_setpoint = self.turned
        in_charge = self.nav_state == OFFBOARD or self.nav_state in self.own_modes
        if not in_charge and self.time - self.changed > 0.5:   # before, the status may still be on its way
            self.setpoints_in_foreign_modes += 1
        if not math.isnan(yaw) or any(map(math.isnan, position)):
            self.events.append(f'a setpoint with position {position} and yaw {yaw}')
        if in_charge or self.obeys_any_mode:
            self.wanted_rate = 0.0 if math.isnan(yawspeed) else yawspeed
            self.largest_rate = max(self.largest_rate, abs(self.wanted_rate))

    def command(self, number, params, source, target):
        """The result to acknowledge, None for no acknowledgement."""
        self.commands.append(number)
        if target[0] not in (0, self.system) or not self.acknowledges:
            return None
        if number not in (1000, 1001):
            return UNSUPPORTED
        if not self.gimbal_input:
            return None
        result = self._configure(params, source) if number == 1001 else self._point(params, source)
        self.denied += result == DENIED
        return result

    def _configure(self, params, source):
        if params[0] == -3.0:
            self.owner = None if self.owner == source else self.owner
            return ACCEPTED
        if self.nav_state in (RETURN, LAND):
            return TEMPORARILY_REJECTED
        self.owner = (int(params[0]), int(params[1]))
        return ACCEPTED

    def _point(self, params, source):
        if self.owner is None or self.owner != source:
            return DENIED
        self.gimbal_wanted = [math.radians(params[0]), math.radians(params[1])]
        return ACCEPTED

    def register(self, name):
        """Arming check id and nav_state of a new external mode."""
        number = next(k for k in range(8) if k not in self.modes)
        self.modes[number], self.answered[number] = (name, 23 + number), self.time
        self.most_modes = max(self.most_modes, len(self.modes))
        return number, 23 + number

    def unregister(self, number):
        if self.modes.pop(number, (None, None))[1] == self.nav_state:
            self.change_mode(HOLD, 'the external mode is gone')

    def answer(self, number, can_run):
        if number in self.modes:
            self.last_answer = self.answered[number] = self.time
            if not can_run and self.nav_state == self.modes[number][1]:
                self.change_mode(RETURN, 'the external mode cannot run')

    def _forget_silent_modes(self):
        """One that does not answer goes, but not while armed, and then its name is listed twice after a second request."""
        for number in [] if self.armed else list(self.modes):
            if self.time - self.answered[number] > 1.2:
                del self.modes[number]

    def reset_heading(self, angle):
        """The estimator corrects its heading by an angle."""
        self.heading_error += angle
        self.resets, self.last_reset = (self.resets + 1) % 256, angle

    def _heartbeat_age(self):
        return self.time - self.heartbeats[-1] if self.heartbeats else math.inf
