"""A vehicle with the observed behaviour of PX4: commander, failsafes, external modes, control of the gimbal, motion.

Angles here are PX4's: heading clockwise from north, gimbal yaw to the right, pitch up, all in rad; positions in NED.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
HOLD, RETURN, OFFBOARD, LAND, POSITION = 4, 5, 14, 18, 2
GIMBAL_RATE, GIMBAL_LAG = math.radians(180.0), 0.05
AT_REST = math.radians(0.1)    # rad/s, below which the fake stands still: PX4's rate has died away 0.9 s after a stop
POSITION_GAIN, VELOCITY_LAG, FASTEST = 0.95, 0.3, 12.0    # 1/s (MPC_XY_P), s, m/s (MPC_XY_VEL_MAX)
UNRESPONSIVE = 1.2             # s without an answer to an arming check after which an external mode is left
MOST_UNRESPONSIVE = 3          # times after which an answer does not revive it


def wrap(angle):
    """To (-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


@dataclass
class Mode:
    """An external mode, by the number of its arming check."""

    name: str
    nav_state: int
    answered: float
    can_run: bool = True
    unresponsive: int = 0
    silent: bool = False
    configured: float = -math.inf
    timeout: float = math.inf


@dataclass
class FakeAutopilot:
    """One hovering vehicle. `advance` simulates a step; the other methods process inputs and return the replies.

    obeys_any_mode: setpoints are obeyed in every mode, as PX4 1.16 does.  gimbal_input: MNT_MODE_IN is set; without it
    no gimbal command is ever acknowledged.  interface: version of the interface for external modes.  registers_armed:
    COM_MODE_ARM_CHK.
    """

    system: int = 1
    obeys_any_mode: bool = False
    gimbal_input: bool = True
    acknowledges: bool = True
    armed: bool = True
    interface: int = 1
    registers_armed: bool = True
    nav_state: int = HOLD
    intended: int | None = None           # by the pilot; a failsafe overrides it
    failsafe: bool = False
    heading: float = 0.0
    heading_error: float = 0.0            # what the estimator adds
    position: tuple = (0.0, 0.0, -2.0)
    velocity: tuple = (0.0, 0.0, 0.0)
    wanted_position: tuple | None = None
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
    gimbal: list = field(default_factory=lambda: [0.0, 0.0])       # pitch, yaw
    gimbal_wanted: list = field(default_factory=lambda: [0.0, 0.0])
    owner: tuple | None = None
    modes: dict = field(default_factory=dict)       # arming check id -> Mode
    granted: int = 0                      # registrations, all together
    most_modes: int = 0
    time: float = 0.0
    changed: float = 0.0                  # when the mode last changed
    heartbeats: list = field(default_factory=list)
    last_setpoint: float = -math.inf
    question: int = 0
    setpoints: int = 0
    setpoints_in_foreign_modes: int = 0
    commands: list = field(default_factory=list)    # numbers, in order
    denied: int = 0
    largest_rate: float = 0.0
    events: list = field(default_factory=list)

    def __post_init__(self):
        self.intended = self.nav_state if self.intended is None else self.intended

    @property
    def estimated_heading(self):
        return wrap(self.heading + self.heading_error)

    def mode_of(self, nav_state):
        """The external mode of a nav_state, None where there is none."""
        return next((mode for mode in self.modes.values() if mode.nav_state == nav_state), None)

    def in_charge(self):
        """Whether setpoints are obeyed. From 1.18 on an external mode must have said, since its selection, what it sends."""
        mode = self.mode_of(self.nav_state)
        return self.nav_state == OFFBOARD or (mode is not None and (self.interface == 1 or mode.configured >= self.changed))

    def advance(self, dt):
        self.time += dt
        self._check_modes()
        self._check_failsafe()
        if not self.obeys_any_mode and not self.in_charge():
            self.wanted_rate, self.wanted_position = 0.0, None
        self.turn(dt)
        self._move(dt)
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

    def _move(self, dt):
        goal = self.wanted_position or ((0.0, 0.0, self.position[2]) if self.nav_state == RETURN else None)
        wanted = [0.0] * 3 if goal is None else [POSITION_GAIN * (to - at) for to, at in zip(goal, self.position, strict=True)]
        fast = max(math.hypot(*wanted) / FASTEST, 1.0)
        share = -math.expm1(-dt / VELOCITY_LAG)
        self.velocity = tuple(v + (w / fast - v) * share for v, w in zip(self.velocity, wanted, strict=True))
        self.position = tuple(at + v * dt for at, v in zip(self.position, self.velocity, strict=True))

    # commander

    def _check_failsafe(self):
        """What cannot run is overridden by Return; as soon as it can run again, it is back: the pilot's selection remains."""
        mode = self.mode_of(self.intended)
        lost = self.intended == OFFBOARD and self._heartbeat_age() > self.loss_time
        left = mode is not None and (mode.silent or not mode.can_run)
        if self.armed and (lost or left):
            if not self.failsafe:
                self.failsafe = True
                self._enter(RETURN, 'no heartbeat' if lost else 'the external mode is silent or cannot run')
        elif self.failsafe:
            self.failsafe = False
            self._enter(self.intended, 'the failsafe is over')

    def _check_modes(self):
        for number, mode in list(self.modes.items()):
            mute = self.nav_state == mode.nav_state and self.time - max(self.last_setpoint, self.changed) > mode.timeout
            if (self.time - mode.answered > UNRESPONSIVE or mute) and not mode.silent:
                mode.silent, mode.unresponsive = True, mode.unresponsive + (100 if mute else 1)
            # One that does not answer goes, but not while armed, and then its name is listed twice after a second request.
            if mode.silent and not self.armed:
                del self.modes[number]

    def select_mode(self, nav_state):
        """The pilot selects a mode; False if PX4 refuses it."""
        beats = [beat for beat in self.heartbeats if self.time - beat < 1.5]
        if nav_state == OFFBOARD and not (len(beats) > 2 and self._heartbeat_age() < 0.5 and beats[-1] - beats[0] > 1.0):
            return False
        mode = self.mode_of(nav_state)
        if nav_state >= 23 and (mode is None or mode.silent or not mode.can_run):
            return False
        self.change_mode(nav_state, 'the pilot')
        return True

    def change_mode(self, nav_state, why):
        """The pilot's selection, which ends a failsafe."""
        self.intended, self.failsafe = nav_state, False
        self._enter(nav_state, why)

    def _enter(self, nav_state, why):
        self.events.append(f'mode {nav_state}: {why}')
        if nav_state == self.nav_state:
            return    # nav_state_timestamp stays
        self.nav_state, self.wanted_rate, self.wanted_position, self.changed = nav_state, 0.0, None, self.time
        if nav_state in (RETURN, LAND):   # these take the gimbal
            self.owner, self.gimbal_wanted = None, [0.0, 0.0]

    def _heartbeat_age(self):
        return self.time - self.heartbeats[-1] if self.heartbeats else math.inf

    # setpoints, of whoever sends them

    def heartbeat(self):
        self.heartbeats = [*self.heartbeats[-200:], self.time]

    def setpoint(self, position, yaw, yawspeed):
        self.setpoints += 1
        self.last_setpoint = self.time
        in_charge = self.nav_state == OFFBOARD or self.mode_of(self.nav_state) is not None
        if not in_charge and self.time - self.changed > 0.5:   # before, the status may still be on its way
            self.setpoints_in_foreign_modes += 1
        if not math.isnan(yaw) or any(map(math.isnan, position)):
            self.events.append(f'a setpoint with position {position} and yaw {yaw}')
        if self.in_charge() or self.obeys_any_mode:
            self.wanted_position = tuple(map(float, position))
            self.wanted_rate = 0.0 if math.isnan(yawspeed) else yawspeed
            self.largest_rate = max(self.largest_rate, abs(self.wanted_rate))

    # gimbal

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

    # external modes

    def register(self, name):
        """Arming check id and nav_state of a new external mode, None where PX4 refuses it."""
        if len(self.modes) == 8 or (self.armed and not self.registers_armed):
            return None
        number = next(k for k in range(8) if k not in self.modes)
        self.modes[number] = Mode(name, 23 + number, self.time)
        self.granted += 1
        self.most_modes = max(self.most_modes, len(self.modes))
        return number, 23 + number

    def unregister(self, number):
        mode = self.modes.pop(number, None)
        if mode is not None and mode.nav_state == self.intended:
            self.change_mode(HOLD, 'the external mode is gone')

    def configure(self, nav_state, timeout=math.inf):
        """What the mode sends; True if there is such a mode."""
        mode = self.mode_of(nav_state)
        if mode is not None:
            mode.configured, mode.timeout = self.time, timeout
        return mode is not None

    def answer(self, number, can_run, question=None):
        """An answer to an older question than the newest does not count."""
        mode = self.modes.get(number)
        if mode is not None and question in (None, self.question):
            mode.answered, mode.can_run = self.time, can_run
            mode.silent = mode.silent and mode.unresponsive > MOST_UNRESPONSIVE

    def reset_heading(self, angle):
        """The estimator corrects its heading by an angle."""
        self.heading_error += angle
        self.resets, self.last_reset = (self.resets + 1) % 256, angle
