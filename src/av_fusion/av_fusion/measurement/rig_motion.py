"""The rig's attitude and path over recent time, so that a late measurement is turned by the attitude at its capture time."""

from __future__ import annotations

import math
from typing import NamedTuple

from av_common.frames import yaw_of
from av_common.quaternions import Quaternion, Rows, Vector, between, inverse, product, quaternion_of, rotation, vector_of
from av_common.timeline import Timeline
from av_fusion.measurement.vectors import IDENTITY, ZERO, combined, dot, heading, turn_between, turned

KEPT_S = 5.0  # length of the history, in which a jump is reported
EXTRAPOLATE_S = 0.3  # longest extrapolation of the newest pose by its rates, but for poses that come more rarely
KNOWN_S = 1.0  # age of the newest pose up to which the attitude counts as known
LARGEST_GAP_S = 0.5  # between two poses, over which their rates tell how far the rig turned meanwhile
JUMP_RAD, ANGULAR_ACCELERATION = math.radians(10.0), 20.0  # of a rotation beyond the rates (rad, rad/s^2) that is a jump
JUMP_M, ACCELERATION = 1.0, 30.0  # of a displacement beyond the velocity (m, m/s^2) that is a jump
FROZEN_RAD, FROZEN_SHARE = math.radians(10.0), 0.2  # rotation by the rates, of which a live attitude shows more than this share


class Pose(NamedTuple):
    """Where the rig is and how it moves.

    Parameters:
        time (s): when.
        attitude: unit quaternion (w, x, y, z), from the body (FLU) to the world (ENU).
        rate (rad/s): angular velocity in the body frame.
        velocity (m/s): in the body frame.
        position (m): in the world, None where it is not known.
    """

    time: float
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)
    rate: Vector = ZERO
    velocity: Vector = ZERO
    position: Vector | None = None

    @classmethod
    def level(cls, time: float, yaw: float, yaw_rate: float = 0.0) -> Pose:
        """A level rig that stands at the origin, at `yaw` (rad) and turning at `yaw_rate` (rad/s)."""
        return cls(time, (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)), (0.0, 0.0, yaw_rate))


class _Stored(NamedTuple):
    """A pose in the history; rate (rad/s), velocity (m/s) and path (m) in the world."""

    attitude: Quaternion
    rate: Vector
    velocity: Vector
    path: Vector


class RigMotion:
    """Interpolates attitude and path between recent poses; without poses the rig counts as level, facing east, at rest.

    Poses are plausible (`pose_of`), and arrive in order of time: a late one is ignored, so that the history stays sorted. After
    a jump back by more than the history's length, such as a restarted bag, it is emptied. The path is the integral of the
    velocity, so that jumps of the position do not move the rig. Velocities that the sender does not fill in are taken from its
    positions.

    Where the attitude jumps although the rates do not show it, the estimator has corrected itself: the history is turned into
    the corrected world, and `add` returns that rotation; likewise with the first pose, and one after a long gap.

    Attributes:
        jumps: number of jumps.
        newest (s): time of the newest pose, -inf before the first.
        is_frozen: the attitude does not follow its own rates; until it turns again, so that it is so between two turns, too.
    """

    def __init__(self) -> None:
        self._poses: Timeline[_Stored] = Timeline(KEPT_S)
        self.jumps = 0
        self.restart()

    def restart(self) -> None:
        """Forget all poses."""
        self._poses.clear()
        self.newest, self._last = -math.inf, Pose(-math.inf)
        self._ahead = EXTRAPOLATE_S  # s, for which the rig counts as turning on by the rates of the newest pose
        self._turn_by_rates = self._turn = 0.0  # rad, rotation that was reported and that the attitude showed
        self.is_frozen = False
        self._jumped, self._jump = -math.inf, ''

    def add(self, pose: Pose, measured: float = math.inf) -> Rows | None:
        """Add a pose.

        Returns the rotation of the world where the attitude jumped or became known, else None.

        Parameters:
            pose: the pose.
            measured (s): newest capture time of what was turned into the world.
        """
        if pose.time <= self.newest:
            if pose.time > self.newest - KEPT_S:
                return None
            self._poses.clear()
        rows = rotation(pose.attitude)
        rate, velocity, path, jump = turned(rows, pose.rate), turned(rows, pose.velocity), ZERO, None
        counted = self.attitude(pose.time) if min(measured, pose.time) - self.newest > KNOWN_S else None  # without poses
        if self._poses.entries:
            dt = pose.time - self.newest
            self._ahead = max(EXTRAPOLATE_S, min(dt, KNOWN_S))
            velocity, mean = self._velocities(pose, velocity, dt)
            rate, jump = self._checked(pose, rate, dt)
            path = combined(1.0, self._poses.entries[-1][1].path, dt if dt <= KNOWN_S else 0.0, mean)
        self._poses.add(pose.time, _Stored(pose.attitude, rate, velocity, path))
        self.newest, self._last = pose.time, pose
        return jump if counted is None else turn_between(counted, rows)

    def _velocities(self, pose: Pose, velocity: Vector, dt: float) -> tuple[Vector, Vector]:
        """Velocity in the world, now and on average since the last pose: as reported, or from positions where none is.

        Notices jumps of the position.
        """
        last = self._poses.entries[-1][1].velocity
        mean = combined(0.5, velocity, 0.5, last)
        if pose.position is None or self._last.position is None:
            return velocity, mean
        moved = combined(1.0 / dt, pose.position, -1.0 / dt, self._last.position)
        if pose.velocity == ZERO:
            # Without a velocity to compare, a step is a jump where it needs an impossible acceleration.
            if self._is_jump(moved, last, dt):
                self._notice(pose.time, 'position')
                return last, last
            return moved, moved
        if pose.position != self._last.position and self._is_jump(moved, mean, dt):
            self._notice(pose.time, 'position')
        return velocity, mean

    @staticmethod
    def _is_jump(moved: Vector, expected: Vector, dt: float) -> bool:
        excess = combined(1.0, moved, -1.0, expected)
        return not math.sqrt(dot(excess, excess)) * dt <= JUMP_M + ACCELERATION * dt * dt  # NaN of differences beyond measure

    def _checked(self, pose: Pose, rate: Vector, dt: float) -> tuple[Vector, Rows | None]:
        """Compare the attitude with the rates; a jump turns the history.

        Returns the rate (rad/s), from attitudes where none is reported, and the rotation of the world by a jump or None.
        """
        last = self._poses.entries[-1][1]
        step = vector_of(product(pose.attitude, inverse(last.attitude)))
        reported = pose.rate != ZERO
        by_rates = combined(0.5 * dt, last.rate, 0.5 * dt, rate if reported else last.rate)
        if dt <= LARGEST_GAP_S:
            kept = math.exp(-dt / KNOWN_S)
            self._turn_by_rates = kept * self._turn_by_rates + math.sqrt(dot(by_rates, by_rates))
            self._turn = kept * self._turn + math.sqrt(dot(step, step))
            stands = self._turn < FROZEN_SHARE * max(self._turn_by_rates, FROZEN_RAD)
            self.is_frozen = stands and (self.is_frozen or self._turn_by_rates > FROZEN_RAD)
        expected = product(quaternion_of(by_rates), last.attitude)
        change = product(pose.attitude, inverse(expected))
        angle = vector_of(change)
        if math.sqrt(dot(angle, angle)) <= JUMP_RAD + 0.5 * ANGULAR_ACCELERATION * dt * dt + math.sqrt(dot(by_rates, by_rates)):
            return rate if reported else combined(1.0 / dt, step, 0.0, ZERO), None
        self._notice(pose.time, 'attitude')
        rows = rotation(change)
        self._poses.change(lambda s: _Stored(product(change, s.attitude), turned(rows, s.rate), turned(rows, s.velocity),
                                             turned(rows, s.path)))
        return rate, rows

    def _notice(self, time: float, what: str) -> None:
        self._jumped, self._jump = time, what
        self.jumps += 1

    @property
    def position(self) -> Vector | None:
        """The newest position (m) in the world, as it was reported; None while unknown."""
        return self._last.position

    def is_known(self, time: float) -> bool:
        """Whether the attitude at `time` (s) is known: poses reach up to it, and are alive."""
        return time - self.newest <= KNOWN_S and not self.is_frozen

    def problem(self, time: float) -> str:
        """Whether poses stopped or jumped by `time` (s), else empty; a frozen attitude is told by `HeadingWatch`."""
        if self._poses.entries and time - self.newest > KNOWN_S:
            return f'odometry stopped {time - self.newest:.1f} s ago: the rig counts as level, at its last heading'
        if 0.0 <= time - self._jumped < KEPT_S:
            return f'odometry jumped in {self._jump} ({self.jumps} times)'
        return ''

    def attitude(self, time: float) -> Rows:
        """Rotation from the body to the world at `time` (s).

        It is interpolated, and beyond the newest pose extrapolated until the next one is due, at least for EXTRAPOLATE_S. After
        KNOWN_S the rig counts as level.
        """
        if not self._poses.entries:
            return IDENTITY
        first, second, share = self._poses.around(time)
        ahead = time - self.newest
        if ahead < 0.0:
            return rotation(between(first.attitude, second.attitude, share))
        turn = combined(min(ahead, self._ahead), second.rate, 0.0, ZERO)
        attitude = product(quaternion_of(turn), second.attitude)
        return heading(yaw_of(attitude)) if ahead > KNOWN_S else rotation(attitude)

    def turn_variance(self, time: float) -> float:
        """Mean square (rad^2) of what the rig has turned by `time` (s) since its attitude is no longer extrapolated.

        It turns on or has stopped, as far as the newest pose tells; after KNOWN_S the attitude is not known.
        """
        beyond = min(time - self.newest, KNOWN_S) - self._ahead
        if not self._poses.entries or beyond <= 0.0:
            return 0.0
        _, newest = self._poses.entries[-1]
        return beyond * beyond * dot(newest.rate, newest.rate)

    def yaw(self, time: float) -> float:
        """Heading (rad) at `time` (s): azimuth of the body's x axis in the world."""
        rows = self.attitude(time)
        return math.atan2(rows[1][0], rows[0][0])

    def rate(self, time: float) -> Vector:
        """Angular velocity (rad/s) in the world, of the pose nearest before `time` (s); zero long after the newest."""
        stored = self._before(time)
        return ZERO if stored is None else stored.rate

    def velocity(self, time: float) -> Vector:
        """Velocity (m/s) in the world, of the pose nearest before `time` (s); zero long after the newest."""
        stored = self._before(time)
        return ZERO if stored is None else stored.velocity

    def _before(self, time: float) -> _Stored | None:
        return None if time - self.newest > KNOWN_S else self._poses.around(time)[0]

    def moved(self, start: float, end: float) -> Vector:
        """Displacement (m) of the rig in the world from `start` to `end` (s)."""
        if not self._poses.entries or start == end:
            return ZERO
        return combined(1.0, self.path(end), -1.0, self.path(start))

    def path(self, time: float) -> Vector:
        """Displacement (m) of the rig in the world since the first pose, at `time` (s)."""
        if not self._poses.entries:
            return ZERO
        ahead = time - self.newest
        if ahead >= 0.0:
            _, newest = self._poses.entries[-1]
            return combined(1.0, newest.path, min(ahead, KNOWN_S), newest.velocity)
        first, second, share = self._poses.around(time)
        return combined(1.0 - share, first.path, share, second.path)
