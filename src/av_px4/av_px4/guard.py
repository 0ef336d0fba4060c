"""Guard of the body motion: the only code that decides whether a setpoint or a heartbeat is sent, and with what yaw rate.

PX4 1.16 accepts setpoints over DDS in any mode, even Hold, and every version mixes those of several senders in OFFBOARD. So
one is sent only while a fresh status says that the pilot has handed over (`handover.py`), pointing is enabled, and nobody
else sends any. The guard can neither arm nor select a mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from av_common.stopping import COMMAND_LIFETIME_S, STOP_WITHIN, YawAnswer, fastest_stoppable
from av_px4.handover import EXTERNAL_MODES, OFFBOARD, Handover, VehicleStatus

PX4 = YawAnswer()                  # to a yaw rate, as flown
MARGIN = 0.05                      # s, part of STOP_WITHIN that is reserved for the period of the steps
MAX_ACCELERATION = math.radians(900.0)    # rad/s^2, largest change of the yaw rate: by 30 deg/s within 1/30 s
LARGEST_RATE = math.radians(100.0)        # rad/s; it takes a ninth of a second to 0
COMMAND_TIMEOUT = COMMAND_LIFETIME_S - MARGIN    # s, age from which a pointing command is stale
ATTITUDE_TIMEOUT = 0.2             # s, 20 periods of PX4's attitude
POSITION_TIMEOUT = 0.5             # s, 25 periods of PX4's local position
STATUS_TIMEOUT = 1.5               # s, three periods of PX4's vehicle_status
INTERRUPTED = 0.45                 # s without a heartbeat after which PX4 may have left OFFBOARD: COM_OF_LOSS_T is 0.5 or more
PATIENCE = 1.0                     # s of missing inputs before PX4 is told that the own mode cannot run; it waits 1.2 s itself
STALL = 0.8                        # s between steps, or between messages of PX4, after which it may have left any mode
WAITS = 'after an interruption: waiting for the next vehicle_status'
DRAINED = 0.1                      # s after an interruption in which what PX4 said meanwhile arrives from the queues


@dataclass(frozen=True)
class Inputs:
    """State of the vehicle and of the rig. Ages count from the arrival of new data; inf for an input that never arrived.

    Parameters:
        status: newest status, None before the first
        status_age (s): age of vehicle_status
        attitude_age (s): age of the attitude
        position_age (s): age of the local position
        command_age (s): age of the pointing command
        bearing_age (s): age of the bearing's newest measurement
        yaw_rate (rad/s): commanded yaw rate, counter-clockwise
        enabled: whether the pointing command is one that may turn the body
        own_mode: nav_state of the rig's external mode while PX4 confirms it, else None
        place_known: whether a position to hold is known
        others: who else steers the vehicle; empty if nobody does
        unacknowledged: whether acknowledgements of the gimbal commands have stopped
    """

    status: VehicleStatus | None = None
    status_age: float = math.inf
    attitude_age: float = math.inf
    position_age: float = math.inf
    command_age: float = math.inf
    bearing_age: float = math.inf
    yaw_rate: float = 0.0
    enabled: bool = False
    own_mode: int | None = None
    place_known: bool = False
    others: str = ''
    unacknowledged: bool = False

    def unable(self, patience: float = 0.0) -> str:
        """Why the vehicle cannot hold its position, so that PX4 takes over (COM_OF_LOSS_T, arming check); empty if it can.

        Parameters:
            patience (s): time for which an input may be stale: what has just come may be the first after a stall of the agent
        """
        reasons = {
            'no fresh vehicle_status': not (self.status and self.status_age <= STATUS_TIMEOUT + patience),
            'no fresh attitude': not self.attitude_age <= ATTITUDE_TIMEOUT + patience,
            'no fresh position': not self.position_age <= POSITION_TIMEOUT + patience,
            'no position to hold': not self.place_known}
        return next((reason for reason, holds in reasons.items() if holds), '')


@dataclass(frozen=True)
class Decision:
    """Result of one step of the guard.

    Parameters:
        heartbeat: whether OffboardControlMode is sent
        setpoint: whether a trajectory setpoint that holds the position is sent
        yaw_rate (rad/s): yaw rate of that setpoint, counter-clockwise; 0 holds the heading
        reason: explanation for `px4/state`
        withheld: why no heartbeat is sent, so that the pilot cannot select OFFBOARD; empty if it is
    """

    heartbeat: bool = False
    setpoint: bool = False
    yaw_rate: float = 0.0
    reason: str = 'not started'
    withheld: str = 'not started'


class BodyGuard:
    """The guard of the body motion. `step` must be called at 20 Hz or more.

    Raises ValueError for a rate from which the body could not be stopped in time.

    Parameters:
        max_rate (rad/s): maximum yaw rate
        offboard: whether it takes part in OFFBOARD; the rig's own mode needs no permission but the pilot's selection
    """

    def __init__(self, max_rate: float = math.radians(30.0), offboard: bool = False) -> None:
        if not 0.0 < max_rate <= LARGEST_RATE + 1e-9:
            raise ValueError(f'a yaw rate of {math.degrees(max_rate):.1f} deg/s, expected more than 0 and at most '
                             f'{math.degrees(LARGEST_RATE):.0f}, from which the body stops within {STOP_WITHIN - MARGIN} s')
        self.max_rate, self.offboard = max_rate, offboard
        self.handover = Handover()
        self.decision = Decision()
        self._rate = 0.0
        self._time: float | None = None
        self._beat: float | None = None    # when the last heartbeat was sent
        self._resumed = -math.inf          # end of the last interruption, of heartbeats or of this process
        self._turning = 0.0                # yaw rate a dead time from now, by what was sent

    def step(self, time: float, inputs: Inputs) -> Decision:
        """Decide what is sent. The interval since the last step is limited to 0..0.1 s.

        Parameters:
            time (s): current time, monotonic
            inputs: state of the vehicle and of the rig
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.1)
        stalled = (self._time is not None and time - self._time > STALL) or inputs.attitude_age > STALL
        self._time = time
        self._turning += (self._rate - self._turning) * (1.0 - math.exp(-dt / PX4.lag))
        if inputs.status is not None:
            self.handover.update(inputs.status, self.decision.heartbeat, bool(inputs.others))
        withheld = self._refusal(OFFBOARD, inputs) if self.offboard else 'offboard is false'
        withheld = withheld or inputs.unable()
        in_offboard = inputs.status is not None and inputs.status.nav_state == OFFBOARD
        silent = in_offboard and not withheld and self._beat is not None and time - self._beat > INTERRUPTED
        if stalled or silent:
            self._resumed, self._beat = time, None
        waits = self.waits(time, inputs)
        if waits and in_offboard:
            withheld = withheld or WAITS
        self._beat = self._beat if withheld else time
        forbidden = self._forbidden(waits, inputs)
        yaw_rate = 0.0 if forbidden else self._steer(dt, inputs)
        # What turned the body before is ended by one setpoint that holds it, before others take its place.
        ends = (bool(forbidden and self._rate) and self._serves(inputs) and inputs.place_known
                and forbidden not in ('failsafe', WAITS))
        self._rate = yaw_rate
        self.decision = Decision(not withheld, not forbidden or ends, yaw_rate,
                                 forbidden or self._halt(inputs) or 'turning as commanded', withheld)
        return self.decision

    def stop(self) -> None:
        """Send nothing until the next step."""
        self.decision, self._rate = Decision(), 0.0

    def waits(self, time: float, inputs: Inputs) -> bool:
        """Whether PX4 may have left the mode unnoticed, at `time` (s), since this process or the link to PX4 stood still."""
        return ((self._time is not None and time - self._time > STALL) or time - inputs.status_age <= self._resumed
                or time - self._resumed < DRAINED)

    def unwilling(self, inputs: Inputs) -> str:
        """Why the rig's own mode cannot run, in the state of `inputs`; empty if it can."""
        own = EXTERNAL_MODES[0] if inputs.own_mode is None else inputs.own_mode
        return self._refusal(own, inputs) or inputs.unable(PATIENCE)

    def _serves(self, inputs: Inputs) -> bool:
        """Whether a fresh status says that the vehicle is in a mode that this rig may serve."""
        if inputs.status is None or not inputs.status_age <= STATUS_TIMEOUT:
            return False
        mode = inputs.status.nav_state
        return (mode == OFFBOARD and self.offboard) or (mode == inputs.own_mode and mode in EXTERNAL_MODES)

    def _refusal(self, mode: int, inputs: Inputs) -> str:
        """Why this rig may not serve a mode; empty if it may."""
        if inputs.others:
            return inputs.others
        selected = inputs.status is not None and mode in (inputs.status.nav_state, inputs.status.intended)
        if selected and (refusal := self.handover.refusal(mode)):
            return refusal
        if inputs.status is not None and inputs.status.failsafe:
            return 'failsafe'
        # While it steers already the body is held though pointing ends: else PX4 would take it for a fault.
        steers = self.decision.setpoint and inputs.status is not None and inputs.status.nav_state == mode
        enabled = inputs.enabled and inputs.command_age <= COMMAND_TIMEOUT
        return '' if enabled or steers else 'pointing is not enabled'

    def _forbidden(self, waits: bool, inputs: Inputs) -> str:
        """Reason why no setpoint may be sent, empty if one may."""
        status = inputs.status
        if status is None or not inputs.status_age <= STATUS_TIMEOUT:
            return 'no fresh vehicle_status'
        if not self._serves(inputs):
            return f'the pilot has not handed over (nav_state {status.nav_state})'
        if status.failsafe:
            return 'failsafe'
        if waits:
            return WAITS
        return self._refusal(status.nav_state, inputs) or ('' if inputs.place_known else 'no position to hold')

    def _steer(self, dt: float, inputs: Inputs) -> float:
        """The yaw rate (rad/s): 0 where something is missing, and in time before it is."""
        limit, change = self.max_rate, MAX_ACCELERATION * dt
        wanted = 0.0 if self._halt(inputs) else self._slowed(min(max(inputs.yaw_rate, -limit), limit), dt, inputs)
        rate = min(max(wanted, self._rate - change), self._rate + change)
        # Braking begins so early that 0 is commanded STOP_WITHIN after the newest command, measurement or attitude.
        left = STOP_WITHIN - MARGIN - max(inputs.command_age, inputs.bearing_age, inputs.attitude_age)
        ceiling = MAX_ACCELERATION * max(left, 0.0)
        return min(max(rate, -ceiling), ceiling)

    def _slowed(self, wanted: float, dt: float, inputs: Inputs) -> float:
        """A yaw rate (rad/s), less where an old command or measurement would drive the body on. The opposite rate brakes it."""
        if wanted * self._turning < 0.0:
            return wanted
        left = STOP_WITHIN - max(inputs.command_age, inputs.bearing_age) - dt
        ceiling = fastest_stoppable(abs(self._turning), left, dt, MAX_ACCELERATION, PX4) if dt else 0.0
        return min(max(wanted, -ceiling), ceiling)

    @staticmethod
    def _halt(inputs: Inputs) -> str:
        """Reason why the yaw rate must be 0, empty if the vehicle may turn."""
        reasons = {
            'vehicle_status is overdue': not inputs.status_age <= STATUS_TIMEOUT - STOP_WITHIN,
            'not armed': not (inputs.status and inputs.status.armed),
            'no fresh attitude': not inputs.attitude_age <= ATTITUDE_TIMEOUT,
            'no fresh position': not inputs.position_age <= POSITION_TIMEOUT,
            'no fresh pointing command': not inputs.command_age <= COMMAND_TIMEOUT,
            'no fresh measurement': not inputs.bearing_age <= STOP_WITHIN,
            'commands are not acknowledged': inputs.unacknowledged,
            'the body is not to move': not inputs.enabled,
            'the yaw rate is no number': not math.isfinite(inputs.yaw_rate)}
        return next((reason for reason, holds in reasons.items() if holds), '')
