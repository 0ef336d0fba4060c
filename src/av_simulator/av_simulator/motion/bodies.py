"""Bodies that carry the rig: how they follow a path, or a target, how they tilt, and the wind that moves them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded
from av_sim_bridge.vehicle import GRAVITY
from av_simulator.trajectories import Position, velocity

UP = np.array([0.0, 0.0, 1.0])  # in ENU
MOST_SPEED = 60.0    # m/s, of the rig; sound allows 0.4 of its speed together with that of a target
MOST_TILT = 1.0      # rad, of a mast
# Of turbulence.
FEET = 0.3048  # m
LEAST_HEIGHT, MOST_HEIGHT = 10.0 * FEET, 1000.0 * FEET  # m, range of the model
MOST_WIND = 60.0  # m/s, of the air
LEAST_AIRSPEED = 1.0  # m/s; turbulence that does not pass by would not change
PURSUIT_GAIN = 0.5  # 1/s, velocity towards the place that is aimed for, over the distance to it
PURSUIT_LAG = 0.5  # s, in which the velocity reaches what is wanted


class Kinematics(NamedTuple):
    """Position and its derivatives, and the body's z axis.

    Parameters:
        position (m, (3,)), velocity (m/s, (3,)), acceleration (m/s^2, (3,)): in ENU.
        up ((3,)): unit vector of the body's z axis in ENU.
    """

    position: NDArray
    velocity: NDArray
    acceleration: NDArray
    up: NDArray = UP


# A body in motion: its state after a step (s), at whose end it shall be somewhere, in air of a velocity (m/s, (3,)) in ENU.
Moving = Callable[[float, Kinematics, NDArray], Kinematics]


@dataclass(frozen=True)
class Level:
    """A body that is exactly on its path and level, whatever the wind."""

    def begin(self, path: Kinematics, air: NDArray) -> tuple[Kinematics, Moving]:
        """The state at the beginning, in equilibrium, and the body in motion.

        Parameters:
            path: where the body shall be.
            air (m/s, (3,)): velocity of the air in ENU.
        """
        return path, lambda dt, path, air: path


@dataclass(frozen=True)
class Quadrotor:
    """A quadrotor that flies along its path: it accelerates, and stands against the wind, by tilting its thrust.

    Position and velocity are controlled as PX4 1.16 does with its default gains, and thrust turns where it is needed by PX4's
    attitude loop: angle over `attitude_lag`, at most 220 deg/s (MC_ROLLRATE_MAX), with a lag of the rate of 0.05 s.

    Parameters:
        drag (1/s): drag over mass and airspeed; 0.2 to 0.5 for small quadrotors (Faessler, Franchi and Scaramuzza 2018).
        max_tilt_deg (deg): largest tilt that is commanded.
        attitude_lag (s): time constant of the tilt, the inverse of MC_ROLL_P.
    """

    drag: float = bounded(0.3, low=0.0, high=5.0)
    max_tilt_deg: float = bounded(35.0, low=1.0, high=80.0)
    attitude_lag: float = bounded(0.15, low=0.01, high=2.0)

    def begin(self, path: Kinematics, air: NDArray) -> tuple[Kinematics, Moving]:
        """See Level."""
        body = _Quadrotor(self, path, air)
        return path._replace(up=body.up), body.step


class _Quadrotor:
    """State of a quadrotor: position, velocity, direction of its thrust, rate of that, and the controller's integral."""

    P = np.array([0.95, 0.95, 1.0])             # 1/s, MPC_XY_P and MPC_Z_P
    VELOCITY_P = np.array([1.8, 1.8, 4.0])      # 1/s, MPC_XY_VEL_P_ACC and MPC_Z_VEL_P_ACC
    VELOCITY_I = np.array([0.4, 0.4, 2.0])      # 1/s^2, MPC_XY_VEL_I_ACC and MPC_Z_VEL_I_ACC
    RATE_LAG = 0.05                             # s
    MOST_RATE = math.radians(220.0)             # rad/s
    LEAST_UPWARDS = 0.3                         # of gravity: the thrust never ceases

    def __init__(self, body: Quadrotor, path: Kinematics, air: NDArray) -> None:
        self._body, self._path = body, path    # where the body shall be now
        self._slope = math.tan(math.radians(body.max_tilt_deg))
        self._position, self._velocity, self._rate = path.position, path.velocity, np.zeros(3)
        self._integral = body.drag * (path.velocity - air)
        thrust, _ = self._limited(path.acceleration + self._integral + GRAVITY * UP)
        self.up = thrust / math.hypot(*thrust)

    def step(self, dt: float, path: Kinematics, air: NDArray) -> Kinematics:
        path, self._path = self._path, path
        error = path.velocity + self.P * (path.position - self._position) - self._velocity
        thrust, limited = self._limited(path.acceleration + self.VELOCITY_P * error + self._integral + GRAVITY * UP)
        if not limited:
            self._integral = self._integral + dt * self.VELOCITY_I * error
        self._tilt(dt, thrust / math.hypot(*thrust))
        acceleration = max(float(thrust @ self.up), 0.0) * self.up - GRAVITY * UP - self._body.drag * (self._velocity - air)
        self._position = self._position + dt * self._velocity + 0.5 * dt**2 * acceleration
        self._velocity = within(self._velocity + dt * acceleration, MOST_SPEED)
        return Kinematics(self._position, self._velocity, acceleration, self.up)

    def _limited(self, thrust: NDArray) -> tuple[NDArray, bool]:
        """The thrust (m/s^2, (3,)) within the limit of the tilt, and whether it was beyond."""
        upwards = max(float(thrust[2]), self.LEAST_UPWARDS * GRAVITY)
        sideways, most = math.hypot(thrust[0], thrust[1]), upwards * self._slope
        share = min(1.0, most / sideways) if sideways > 0.0 else 1.0
        return np.array([share * thrust[0], share * thrust[1], upwards]), share < 1.0

    def _tilt(self, dt: float, wanted: NDArray) -> None:
        """Turn the thrust towards a direction ((3,))."""
        axis = np.cross(self.up, wanted)
        sine = math.hypot(*axis)
        rate = np.zeros(3)
        if sine > 1e-12:
            angle = math.atan2(sine, float(self.up @ wanted))
            rate = min(angle / self._body.attitude_lag, self.MOST_RATE) / sine * axis
        self._rate = self._rate + (1.0 - math.exp(-dt / self.RATE_LAG)) * (rate - self._rate)
        up = self.up + dt * np.cross(self._rate, self.up)
        self.up = up / math.hypot(*up)


@dataclass(frozen=True)
class Mast:
    """The top of a mast that leans, and sways in the wind as a damped oscillator. It is fixed at its foot.

    The top of an evenly loaded cantilever tilts by 4/3 of its displacement over the height.

    Parameters:
        height (m): height of the rig above the foot.
        lean_deg (deg, (east, north)): tilt without wind.
        bend_deg (deg): tilt by a steady wind of 10 m/s; it grows with the square of the speed.
        frequency (Hz): natural frequency; 0.3 to 2 Hz for masts of 5 to 30 m.
        damping: ratio of the critical damping; 0.005 to 0.05 for steel and aluminium.
    """

    height: float = bounded(8.0, low=0.5, high=200.0)
    lean_deg: tuple[float, float] = bounded((0.0, 0.0), low=-45.0, high=45.0)
    bend_deg: float = bounded(3.0, low=0.0, high=45.0)
    frequency: float = bounded(0.5, low=0.05, high=10.0)
    damping: float = bounded(0.02, low=0.0, high=1.0)

    def begin(self, path: Kinematics, air: NDArray) -> tuple[Kinematics, Moving]:
        """See Level."""
        mast = _Mast(self, air)
        return mast.kinematics(path, np.zeros(2)), mast.step


class _Mast:
    """State of a mast: tilt to east and north beyond its lean (rad, (2,)), and its rate."""

    REFERENCE = 10.0    # m/s

    def __init__(self, mast: Mast, air: NDArray) -> None:
        self._mast = mast
        self._omega = 2.0 * math.pi * mast.frequency
        self._lean = np.radians(mast.lean_deg)
        self._tilt, self._rate = self._bend(air), np.zeros(2)

    def step(self, dt: float, path: Kinematics, air: NDArray) -> Kinematics:
        acceleration = self._omega**2 * (self._bend(air) - self._tilt) - 2.0 * self._mast.damping * self._omega * self._rate
        self._rate = within(self._rate + dt * acceleration, MOST_SPEED / self._mast.height)
        self._tilt = within(self._tilt + dt * self._rate, MOST_TILT)    # after the rate: an undamped mast keeps its energy
        return self.kinematics(path, acceleration)

    def _bend(self, air: NDArray) -> NDArray:
        return within(math.radians(self._mast.bend_deg) / self.REFERENCE**2 * math.hypot(air[0], air[1]) * air[:2], MOST_TILT)

    def kinematics(self, path: Kinematics, acceleration: NDArray) -> Kinematics:
        moved = 0.75 * self._mast.height * np.array([self._tilt, self._rate, acceleration])
        moved = np.column_stack([moved, np.zeros(3)])
        up = np.array([*np.tan(within(self._lean + self._tilt, MOST_TILT)), 1.0])
        return Kinematics(path.position + moved[0], path.velocity + moved[1], path.acceleration + moved[2],
                          up / np.linalg.norm(up))


def within(vector: NDArray, most: float) -> NDArray:
    """The vector, shortened to the length `most` where it is longer."""
    return vector * min(1.0, most / max(math.hypot(*vector), 1e-9))


Body = Annotated[Any, {'level': Level, 'quadrotor': Quadrotor, 'mast': Mast}]


@dataclass(frozen=True)
class Vibration:
    """Vibration of the body: an even oscillation about and along each of its axes, 120 degrees apart.

    Parameters:
        angle_deg (deg): amplitude of the rotation about each axis.
        acceleration (m/s^2): amplitude of the acceleration along each axis.
        frequency (Hz): frequency, such as that of the rotors' turns.
    """

    angle_deg: float = bounded(0.0, low=0.0, high=5.0)
    acceleration: float = bounded(0.0, low=0.0, high=100.0)
    frequency: float = bounded(70.0, low=0.1, high=100.0)

    def turned(self, times: NDArray) -> NDArray:
        """Rotation vectors (rad, (k, 3)) in the body's frame at times (s, (k,))."""
        return math.radians(self.angle_deg) * np.sin(self._phases(times))

    def moved(self, times: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Displacements (m), velocities (m/s) and accelerations (m/s^2), each (k, 3), at times (s, (k,))."""
        omega, phases = 2.0 * math.pi * self.frequency, self._phases(times)
        return (-self.acceleration / omega**2 * np.sin(phases), -self.acceleration / omega * np.cos(phases),
                self.acceleration * np.sin(phases))

    def _phases(self, times: NDArray) -> NDArray:
        return 2.0 * math.pi * self.frequency * times[:, np.newaxis] + np.radians([0.0, 120.0, 240.0])


def turbulence(height: float) -> tuple[float, float, float]:
    """Length scales (m) of horizontal and of vertical turbulence at a height (m), and the latter's sigma over the former's."""
    feet = min(max(height, LEAST_HEIGHT), MOST_HEIGHT) / FEET
    shear = 0.177 + 0.000823 * feet
    return feet / shear**1.2 * FEET, feet * FEET, shear**0.4


class Gusts:
    """Wind at a body that moves through frozen turbulence: along the mean wind, across it, and vertical.

    It is the continuous Dryden model at low altitude (MIL-F-8785C, 3.7; MIL-HDBK-1797, app. A). The spectra are 1 / (1 + T s)
    along the wind and (1 + sqrt(3) T s) / (1 + T s)^2 across it and upwards, where T is the length scale over the airspeed.

    Parameters:
        velocity (m/s, (3,)): mean velocity in ENU.
        relative: standard deviation of horizontal turbulence relative to the mean speed.
        key: seed.
    """

    def __init__(self, velocity: Sequence[float], relative: float, key: Sequence[int]):
        self._mean = np.array(velocity, float)
        self._sigma = relative * float(np.linalg.norm(self._mean))
        along = np.array([*self._mean[:2], 0.0])
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
        self._axes = np.stack([along, np.cross(UP, along), UP], axis=1)
        self._random = np.random.default_rng(key)
        self._fast, self._slow = self._random.standard_normal(3), np.zeros(3)

    def step(self, dt: float, height: float, velocity: NDArray) -> NDArray:
        """Velocity (m/s, (3,)) of the air in ENU after `dt` (s).

        Parameters:
            dt (s): time since the step before.
            height (m): height of the body above ground.
            velocity (m/s, (3,)): velocity of the body.
        """
        if self._sigma == 0.0:
            return self._mean
        airspeed = max(float(np.linalg.norm(velocity - self._mean)), LEAST_AIRSPEED)
        horizontal, vertical, share = turbulence(height)
        kept = np.exp(-dt * airspeed / np.array([horizontal, horizontal, vertical]))
        self._fast = kept * self._fast + np.sqrt(1.0 - kept**2) * self._random.standard_normal(3)
        self._slow += (1.0 - kept) * (self._fast - self._slow)
        across = (math.sqrt(3.0) * self._fast + (1.0 - math.sqrt(3.0)) * self._slow) / math.sqrt(2.0)
        gust = self._sigma * np.array([self._fast[0], across[1], share * across[2]])
        air = self._mean + self._axes @ gust
        return within(air, MOST_WIND)


@dataclass(frozen=True)
class Pursuit:
    """The rig flies after a target, by the target's true position: sensors and estimates of the rig do not fly it.

    Parameters:
        target: index of the target.
        distance (m): horizontal distance that is kept.
        height (m): height above the target that is kept.
        floor (m): least height above ground.
        max_speed (m/s), max_acceleration (m/s^2): limits.
        begin (s): time of the start; before, the rig follows its trajectory.
    """

    target: int = bounded(0, low=0, high=99)
    distance: float = bounded(10.0, low=1.0, high=1000.0)
    height: float = bounded(-1.0, low=-100.0, high=100.0)
    floor: float = bounded(1.5, low=0.0, high=1000.0)
    max_speed: float = bounded(12.0, above=0.0, high=60.0)
    max_acceleration: float = bounded(4.0, above=0.0, high=50.0)
    begin: float = bounded(0.0, low=0.0)

    def path(self, target: Position, now: Kinematics, dt: float, time: float) -> Kinematics:
        """Where the rig shall be.

        Parameters:
            target: trajectory of the target.
            now: where the rig should be until now.
            dt (s): time since then.
            time (s): the time.
        """
        place, ahead = target(np.array([time]))[0], velocity(target, time)[0]
        away = now.position[:2] - place[:2]
        distance = max(float(np.linalg.norm(away)), 1e-6)
        goal = np.array([*(place[:2] + self.distance / distance * away), max(place[2] + self.height, self.floor)])
        wanted = within(ahead + PURSUIT_GAIN * (goal - now.position), self.max_speed)
        acceleration = within((wanted - now.velocity) / PURSUIT_LAG, self.max_acceleration)
        speed = now.velocity + dt * acceleration
        return Kinematics(now.position + 0.5 * dt * (now.velocity + speed), speed, acceleration)
