"""Random sequences of measurements for tracker and pointing controller: every command is finite and within its limits.

A sequence mixes valid measurements with invalid ones: stamps that are stale, in the future, repeated, out of order or nan;
absurd angles and variances; empty lists.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

from av_common.track import State, Targets, Track
from av_evaluation.metrics.command_limits import CommandLimits
from av_fusion.baseline.gated_tracker import GatedTracker
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import ZERO, Quaternion, Vector, combined, quaternion_of, rotation
from av_fusion.multi_target.multi_target_filter import MultiTargetFilter
from av_fusion.multi_target.tracker import MultiTargetTracker
from av_pointing.controller import Ages, PointingController

ABSURD = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e300, 1e9, -1e9, math.pi, -math.pi)
TRACKERS = MultiTargetTracker, MultiTargetTracker, GatedTracker  # the default one in two of three sequences
STEP = 0.02
WEIGHT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Broken:
    """A sequence that broke a limit.

    Parameters:
        seed: of the sequence, which repeats it.
        reason: the first fault.
    """

    seed: int
    reason: str


class Sequence:
    """One random sequence for a tracker and a pointing controller.

    Parameters:
        seed: of the random draws.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._random = Random(seed)
        self._tracker = self._random.choice(TRACKERS)()
        self._pointing, self._ages = PointingController(), Ages()
        self._now = self._random.choice([0.0, 1000.0, 1.7e9])
        self._absurd = self._random.choice([0.02, 0.2, 0.7])
        self._limits = CommandLimits(self._pointing.settings)
        self._sent: list[DoaMeasurement | CameraMeasurement] = []

    def run(self, messages: int = 20) -> Broken | None:
        """Run a number of measurements; returns the first fault, or None."""
        try:
            for _ in range(messages):
                elapsed = self._step()
                reason = self._check(elapsed)
                if reason:
                    return Broken(self.seed, reason)
        except Exception as error:  # noqa: BLE001  every exception is a fault
            return Broken(self.seed, f'{type(error).__name__}: {error}')
        return None

    def _step(self) -> float:
        """Send one measurement and advance the time; returns the time step (s) of the controller."""
        kind = self._random.randrange(4)
        if kind == 0:
            self._tracker.add_pose(self._pose())
        elif kind == 1 and self._sent and self._chance(0.3):
            self._send(self._sent[self._random.randrange(len(self._sent))])
        elif kind == 2:
            self._send(CameraMeasurement(self._stamp(), tuple(self._detection() for _ in range(self._random.randrange(4))),
                                         self._value(0.6, 0.1), self._value(0.5, 0.1), self._value(0.5, 0.3),
                                         rotation(self._attitude()) if self._chance(0.95) else (ZERO,) * 3))
        else:
            stamp = self._stamp()
            self._send(*(self._doa(stamp) for _ in range(self._random.choice((1, 1, 2, 4)))))
        passed = self._random.choices((0.0, STEP, 0.05, 0.5, -0.1, 30.0), (0.1, 0.5, 0.3, 0.06, 0.03, 0.01))[0]
        self._now += passed
        self._pointing.enabled = self._chance(0.9)
        self._track = self._tracker.estimate(self._now)
        track = self._track if self._chance(0.9) else self._wild_track()
        self._ages = Ages(abs(self._now - track.time), *(
            0.0 if self._chance(0.5) else age + max(passed, 0.0) for age in self._ages[1:3]))
        self._command = self._pointing.step(self._now, track if self._chance(0.95) else None, self._ages)
        return max(passed, 0.0)

    def _check(self, elapsed: float) -> str:
        """The fault of track or command after a step of `elapsed` (s), '' for none."""
        track, command = self._track, self._command
        if track.state != State.NONE and not all(map(math.isfinite, (
                track.azimuth, track.azimuth_world, track.azimuth_world_rate, track.azimuth_variance, track.front_probability,
                track.elevation, track.elevation_world, track.elevation_world_rate, *track.covariance_world[:3]))):
            return f'track is not finite: {track}'
        if track.state != State.NONE and not (track.azimuth_variance > 0.0 and -math.pi <= track.azimuth <= math.pi):
            return f'track is impossible: {track}'
        reason = check_targets(self._tracker.targets(track))
        if not reason and isinstance(self._tracker, MultiTargetTracker):
            reason = check_weights(self._tracker.filter)
        if reason:
            return reason
        if not math.isfinite(track.requested_rotation):
            return f'requested rotation {track.requested_rotation}'
        if command.yaw_rate != 0.0 and not self._ages.body_left > 0.0:
            return f'the body moves by old data: {self._ages}'
        return self._limits.check(command, elapsed)

    def _send(self, *messages: DoaMeasurement | CameraMeasurement) -> None:
        """Send an image, or the directions of one window."""
        self._sent.extend(messages)
        self._tracker.add_doas([message for message in messages if isinstance(message, DoaMeasurement)])
        for message in messages:
            if isinstance(message, CameraMeasurement):
                self._tracker.add_camera(message)

    def _doa(self, stamp: float) -> DoaMeasurement:
        hypotheses = tuple(self._hypothesis() for _ in range(self._random.randrange(4)))
        axis = self._unit(self._vector(1.0))
        cone = Cone(axis, self._value(0.0, 0.5), self._variance()) if len(hypotheses) == 2 else None
        return DoaMeasurement(stamp, hypotheses, self._value(0.7, 0.3), self._value(0.5, 0.1), cone, self._value(0.5, 0.3),
                              self._value(200.0, 100.0), self._value(30.0, 10.0))

    def _chance(self, probability: float) -> bool:
        return self._random.random() < probability

    def _value(self, mean: float, sigma: float) -> float:
        return self._random.choice(ABSURD) if self._chance(self._absurd) else self._random.gauss(mean, sigma)

    def _angle(self) -> float:
        return self._value(0.0, 2.0)

    def _variance(self) -> float:
        return self._random.choice(ABSURD) if self._chance(self._absurd) else 10.0 ** self._random.uniform(-8, 2)

    def _stamp(self) -> float:
        if self._chance(self._absurd):
            return self._random.choice([math.nan, math.inf, 0.0, -5.0, self._now + 1e6, self._now - 1e6])
        late = self._random.choices((0.0, -0.05, -0.3, -2.0, 0.1, 4.0, -6.0), (0.5, 0.2, 0.1, 0.05, 0.05, 0.05, 0.05))
        return self._now + late[0]

    def _vector(self, sigma: float) -> Vector:
        return self._value(0.0, sigma), self._value(0.0, sigma), self._value(0.0, sigma)

    def _unit(self, vector: Vector) -> Vector:
        length = math.hypot(*vector)
        return combined(1.0 / length, vector, 0.0, ZERO) if 0.0 < length < math.inf and self._chance(0.95) else vector

    def _attitude(self) -> Quaternion:
        return quaternion_of((self._random.gauss(0.0, 1.0), self._random.gauss(0.0, 1.0), self._random.gauss(0.0, 1.0)))

    def _pose(self) -> Pose:
        return Pose(self._stamp(), self._attitude() if self._chance(0.95) else (*self._vector(1.0), 0.5),
                    self._vector(1.0), self._vector(10.0), None if self._chance(0.1) else self._vector(100.0))

    def _hypothesis(self) -> Hypothesis:
        return Hypothesis(self._angle(), self._variance(), self._value(0.2, 0.3), self._variance())

    def _detection(self) -> Detection:
        return Detection(self._angle(), self._variance(), self._value(0.6, 0.3), self._value(0.2, 0.3), self._variance())

    def _wild_track(self) -> Track:
        return Track(self._stamp(), State(self._random.randrange(4)), azimuth=self._angle(), elevation=self._angle(),
                     azimuth_variance=self._variance(), elevation_variance=self._variance(),
                     azimuth_world_rate=self._value(0.0, 1.0), resolved=self._chance(0.5),
                     requested_rotation=self._value(0.0, 1.0))


def check_targets(targets: Targets) -> str:
    """The fault of a list of targets, '' for none."""
    ids = [target.id for target in targets.targets]
    if ids != sorted(set(ids)) or targets.selected not in (0, *ids):
        return f'targets {ids}, of which {targets.selected} is selected'
    for target in targets.targets:
        possible = 0.0 <= target.existence <= 1.0 and 0.0 <= target.identity <= 1.0
        if not possible or not all(map(math.isfinite, (target.track.azimuth, target.track.elevation))):
            return f'target is impossible: {target}'
    return ''


def check_weights(targets: MultiTargetFilter) -> str:
    """The fault of the weights of a filter's tracks, '' for none: with the background they sum to one."""
    for track in targets.tracks:
        weights = [component.weight for component in track.mixture.components]
        if min(weights, default=0.0) < 0.0 or not abs(sum(weights) + track.mixture.background - 1.0) < WEIGHT_TOLERANCE:
            return f'weights of track {track.id}: {weights}, background {track.mixture.background}'
    return ''


def fuzz(first: int, count: int, messages: int = 20) -> list[Broken]:
    """Run sequences and return those with faults.

    Parameters:
        first: seed of the first sequence.
        count: of sequences, with consecutive seeds.
        messages: measurements in each.
    """
    found = (Sequence(seed).run(messages) for seed in range(first, first + count))
    return [broken for broken in found if broken is not None]
