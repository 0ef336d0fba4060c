"""A simulated vehicle that answers late, bearings that arrive late, and the loop that pointing closes over both."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.freshness import Instant
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.stage import PointingStage
from av_simulator.motion.axes import YawAxis, YawResponse

STEP_S = 0.005
TICK_HZ = 30.0    # of commands without messages
RESET_S = 8.0
START_S, EPOCH_S = 100.0, 1.7e9    # of the simulated steady clock, and of ROS time
Direction = Callable[[float], float]


@dataclass(frozen=True)
class Conditions:
    """What a loop is closed over.

    Parameters:
        dead_time, lag (s), fastest (rad/s): of the vehicle, see `YawResponse`; those of PX4 in SITL by default.
        gain: reached rate relative to the commanded one.
        bearing_age (s): age of bearings on their arrival.
        age_jitter (s): standard deviation of the ages of bearings and odometry, at most the age; messages keep their order.
        stamped: bearings are stamped with the time of what they show; otherwise with that of their arrival.
        bearing_rate, odometry_rate (Hz): of the messages.
        irregular: largest share by which an interval between bearings differs from the mean one.
        odometry_age (s): age of odometry on its arrival.
        noise (rad): standard deviation of bearings.
        stalls (s): longest of the stalls of the process that gives commands, of which there are two a second; 0 for none.
        world: bearings carry the direction in the world, too.
        drift (rad/s): rate at which the vehicle turns besides.
        reset (rad): by which the estimator of the heading corrects itself, and with it all directions in the world, at RESET_S.
        seed: of noise and jitter.
    """

    dead_time: float = 0.1
    lag: float = 0.4
    gain: float = 1.0
    bearing_age: float = 0.1
    age_jitter: float = 0.0
    stamped: bool = True
    bearing_rate: float = 20.0
    odometry_rate: float = 50.0
    odometry_age: float = 0.01
    irregular: float = 0.0
    noise: float = 0.0
    stalls: float = 0.0
    world: bool = True
    drift: float = 0.0
    reset: float = 0.0
    fastest: float = math.inf
    seed: int = 1


@dataclass
class Loop:
    """What happened.

    Attributes:
        time (s), yaw, error (rad), command (rad/s): histories of the simulation's steps.
        newest (s): arrival of the newest measurement.
    """

    time: list[float] = field(default_factory=list)
    yaw: list[float] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    command: list[float] = field(default_factory=list)
    newest: float = math.nan

    def rms_deg(self, since: float) -> float:
        """Root mean square of the body's error (deg) from `since` (s) on."""
        chosen = np.array(self.error)[np.array(self.time) >= since]
        return float(np.degrees(np.sqrt(np.mean(chosen**2))))

    def turned_deg(self, since: float) -> float:
        """Turn (deg) of the body from `since` (s) to the end."""
        return float(np.degrees(self.yaw[-1] - np.interp(since, self.time, self.yaw)))

    def overshoot_deg(self) -> float:
        """Largest error (deg) of the sign opposite to the first."""
        errors: NDArray = np.array(self.error) * -np.sign(self.error[0])
        return float(np.degrees(max(errors.max(), 0.0)))


class _Simulation:
    """Vehicle, messages on their way, and the process that gives the commands."""

    def __init__(self, stage: PointingStage, conditions: Conditions, target: Direction, measured_until: float) -> None:
        response = YawResponse(conditions.fastest, math.inf, conditions.dead_time, conditions.lag)
        self.loop, self.vehicle = Loop(), YawAxis(response, 0.0, 0.0)
        self._stage, self._conditions, self._target, self._measured_until = stage, conditions, target, measured_until
        self._random = np.random.default_rng(conditions.seed)
        self._on_the_way: list[tuple[float, str, float, float]] = []   # arrival, kind, capture, yaw
        self._due = {'bearing': 0.0, 'odometry': 0.0, 'tick': 0.0}
        self._stalled = self._commanded = self._yaw = 0.0
        self._newest = -math.inf
        self._arrives: dict[str, float] = {}

    def step(self, time: float) -> None:
        """Simulate STEP_S to `time` (s)."""
        c, loop = self._conditions, self.loop
        self._yaw = self.vehicle.step(STEP_S, time) + c.drift * time
        self._send('odometry', c.odometry_rate, c.odometry_age, time)
        self._send('bearing', c.bearing_rate, c.bearing_age, time)
        if c.stalls and self._random.random() < 2.0 * STEP_S:
            self._stalled = time + c.stalls * self._random.random()
        if time >= self._stalled:
            for command in self._commands(time):
                self._commanded = command.yaw_rate
                self.vehicle.command(c.gain * self._commanded, time)
        loop.time.append(time)
        loop.yaw.append(self._yaw)
        loop.error.append(float(wrap(self._target(time) - self._yaw)))
        loop.command.append(self._commanded)

    def _send(self, kind: str, rate: float, age: float, time: float) -> None:
        if time >= self._due[kind]:
            varied = self._conditions.irregular if kind == 'bearing' else 0.0
            self._due[kind] += (1.0 + (varied * self._random.uniform(-1.0, 1.0) if varied else 0.0)) / rate
            late = max(age + min(self._conditions.age_jitter, age) * self._random.standard_normal(), 0.0)
            self._arrives[kind] = max(time + late, self._arrives.get(kind, 0.0))    # the middleware keeps the order
            self._on_the_way.append((self._arrives[kind], kind, time, self._yaw))

    def _commands(self, time: float) -> list[PointingCommand]:
        """The commands that follow from what has arrived, or from the time."""
        now, commands = Instant(START_S + time, EPOCH_S + time), []
        arrived = sorted(item for item in self._on_the_way if item[0] <= time)
        self._on_the_way = [item for item in self._on_the_way if item[0] > time]
        for _, kind, captured, yaw in arrived:
            if kind == 'odometry':
                self._stage.on_odometry(_odometry(captured, yaw + self._corrected(captured)), now)
                continue
            if time < self._measured_until:
                self._newest, self.loop.newest = max(self._newest, captured), time
            if self._newest >= 0.0:
                commands.append(self._stage.on_bearing(self._bearing(captured, time, yaw), now))
        if not commands and time >= self._due['tick']:
            commands.append(self._stage.on_time(now))
        if commands:
            self._due['tick'] = time + 1.0 / TICK_HZ
        return commands

    def _corrected(self, time: float) -> float:
        return self._conditions.reset if time >= RESET_S else 0.0

    def _bearing(self, captured: float, now: float, yaw: float) -> Bearing:
        c, target = self._conditions, self._target
        direction = target(captured) + c.noise * self._random.standard_normal()
        message = Bearing(
            state=Bearing.STATE_VISUAL_ACTIVE, resolved=True, azimuth=float(wrap(direction - yaw)), azimuth_variance=1e-3,
            azimuth_world=float(wrap(direction + self._corrected(captured))),
            azimuth_world_rate=(target(captured + 0.05) - target(captured - 0.05)) / 0.1,
            attitude_known=c.world, measured=to_stamp(EPOCH_S + self._newest))
        message.header.stamp = to_stamp(EPOCH_S + (captured if c.stamped else now))
        return message


def close_loop(stage: PointingStage, conditions: Conditions, target: Direction, seconds: float,
               measured_until: float = math.inf) -> Loop:
    """Simulate a vehicle that obeys a stage of pointing.

    Parameters:
        stage: gives the commands; enabled.
        conditions: see `Conditions`.
        target: direction (rad) of the target in the world, of time (s).
        seconds (s): to simulate.
        measured_until (s): measurements arrive before this time; bearings go on as predictions.
    """
    simulation = _Simulation(stage, conditions, target, measured_until)
    for step in range(round(seconds / STEP_S)):
        simulation.step(step * STEP_S)
    return simulation.loop


def _odometry(time: float, yaw: float) -> Odometry:
    message = Odometry()
    message.header.stamp = to_stamp(EPOCH_S + time)
    message.pose.pose.orientation.w, message.pose.pose.orientation.z = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return message
