"""What may be sent to turn the vehicle: the one place that decides it.

PX4 1.16 obeys setpoints that come by DDS in any mode, even Hold. So a setpoint leaves only while a fresh status says that
the pilot has chosen OFFBOARD or this rig's own external mode. Nothing here can arm or choose a mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

OFFBOARD = 14                      # vehicle_status nav_state
EXTERNAL_MODES = range(23, 31)     # nav_state of external modes 1 to 8
STOP_WITHIN = 0.3                  # s from staleness to standstill
MARGIN = 0.05                      # s of that for the steps' own period
STALL = 0.8                        # s between steps after which PX4 may have left OFFBOARD unheard (COM_OF_LOSS_T)


@dataclass(frozen=True)
class GuardSettings:
    """Limits in rad/s and rad/s^2, and ages in s from which an input counts as stale, by arrival.

    `max_rate / max_acceleration` is the time to stop and must fit into 0.25 s. A status comes twice a second; its age is
    feared 0.3 s before it is stale, so that the last setpoint sent holds the vehicle still.
    """

    max_rate: float = math.radians(45.0)
    max_acceleration: float = math.radians(200.0)
    command_timeout: float = 0.25
    bearing_timeout: float = 0.3
    attitude_timeout: float = 0.2
    position_timeout: float = 0.5
    status_timeout: float = 1.5

    def __post_init__(self) -> None:
        if not (self.max_rate > 0.0 and self.max_rate / self.max_acceleration <= STOP_WITHIN - MARGIN + 1e-9):
            raise ValueError(
                f'max_rate {math.degrees(self.max_rate):.1f} deg/s takes {self.max_rate / self.max_acceleration:.2f} s to stop '
                f'at max_acceleration {math.degrees(self.max_acceleration):.1f} deg/s^2, allowed are {STOP_WITHIN - MARGIN} s')
        if not self.status_timeout > 2.0 * STOP_WITHIN:
            raise ValueError(f'status_timeout is {self.status_timeout} s, expected more than {2.0 * STOP_WITHIN} s')


@dataclass(frozen=True)
class VehicleStatus:
    """What counts of px4_msgs/VehicleStatus."""

    nav_state: int
    armed: bool
    failsafe: bool
    system_id: int = 1


@dataclass(frozen=True)
class Inputs:
    """What is known now. Ages in s by arrival, inf for what never came.

    yaw_rate: what the pointing command wants, rad/s counter-clockwise, `move` whether it is to be obeyed.  own_mode:
    nav_state of the rig's own external mode while PX4 confirms it.  place_known: there is a position to hold.
    unacknowledged: commands go out and nothing comes back.
    """

    status: VehicleStatus | None = None
    status_age: float = math.inf
    attitude_age: float = math.inf
    position_age: float = math.inf
    command_age: float = math.inf
    bearing_age: float = math.inf
    yaw_rate: float = 0.0
    move: bool = False
    own_mode: int | None = None
    place_known: bool = False
    unacknowledged: bool = False

    def healthy(self, settings: GuardSettings) -> bool:
        """Whether the vehicle can be held. When this ends, PX4 takes over by itself (COM_OF_LOSS_T, or the mode's check)."""
        return (self.status is not None and self.status_age <= settings.status_timeout and self.place_known
                and self.attitude_age <= settings.attitude_timeout and self.position_age <= settings.position_timeout)


@dataclass(frozen=True)
class Decision:
    """What to send now: OffboardControlMode (`heartbeat`), and a setpoint with this yaw rate; 0 holds still."""

    heartbeat: bool
    setpoint: bool
    yaw_rate: float
    reason: str


@dataclass
class BodyGuard:
    """Call `step` at 20 Hz or more."""

    settings: GuardSettings = field(default_factory=GuardSettings)
    _rate: float = 0.0
    _time: float | None = None
    _resumed: float = -math.inf    # when this process came back from a stall

    def step(self, time: float, inputs: Inputs) -> Decision:
        """Decide for `time` (s, monotonic). Steps back count as 0 s, long ones as 0.1 s."""
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.1)
        if self._time is not None and time - self._time > STALL:
            self._resumed = time
        self._time = time
        heartbeat = inputs.healthy(self.settings)
        forbidden = self._forbidden(time, inputs)
        if forbidden:
            self._rate = 0.0
            return Decision(heartbeat, False, 0.0, forbidden)
        halt = self._halt(inputs)
        limit, change = self.settings.max_rate, self.settings.max_acceleration * dt
        wanted = 0.0 if halt else min(max(inputs.yaw_rate, -limit), limit)
        self._rate = min(max(wanted, self._rate - change), self._rate + change)
        return Decision(heartbeat, True, self._rate, halt or 'turning as commanded')

    def _forbidden(self, time: float, inputs: Inputs) -> str:
        """Why no setpoint may leave, empty when one may."""
        status, settings = inputs.status, self.settings
        if status is None or not inputs.status_age <= settings.status_timeout:
            return 'no fresh vehicle_status'
        if time - inputs.status_age < self._resumed:
            return 'after a stall: waiting for the next vehicle_status'
        own = inputs.own_mode is not None and inputs.own_mode in EXTERNAL_MODES and status.nav_state == inputs.own_mode
        if status.nav_state != OFFBOARD and not own:
            return f'the pilot has not handed over (nav_state {status.nav_state})'
        if status.failsafe:
            return 'failsafe'
        return '' if inputs.place_known else 'no position to hold'

    def _halt(self, inputs: Inputs) -> str:
        """Why the vehicle must stand still, empty when it may turn."""
        settings = self.settings
        reasons = {
            'vehicle_status is overdue': not inputs.status_age <= settings.status_timeout - STOP_WITHIN,
            'not armed': not inputs.status.armed,
            'no fresh attitude': not inputs.attitude_age <= settings.attitude_timeout,
            'no fresh position': not inputs.position_age <= settings.position_timeout,
            'no fresh pointing command': not inputs.command_age <= settings.command_timeout,
            'no fresh bearing': not inputs.bearing_age <= settings.bearing_timeout,
            'commands are not acknowledged': inputs.unacknowledged,
            'the body is not to move': not inputs.move,
            'the yaw rate is no number': not math.isfinite(inputs.yaw_rate)}
        return next((reason for reason, holds in reasons.items() if holds), '')
