"""A formula rig whose description is wrong: what its sensors send does not fit what the stage is told of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from formula_rig import CENTRE, HEIGHT, WIDTH, FormulaRig, Source, azimuth_of, unit, vector, wrapped
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from av_common.stamps import to_seconds, to_stamp
from av_evaluation.faults import Faults


@dataclass
class FaultyRig(FormulaRig):
    """See `Faults`. Its cameras are fixed on the body; those of sight are of the camera `faulty`."""

    faults: Faults = field(default_factory=Faults)
    faulty: str = 'camera'
    _first: Any = None  # orientation

    def _rotation_of(self, frame: str, time: float) -> NDArray | None:
        described = super()._rotation_of(frame, time)
        if frame != self.faulty or described is None:
            return described
        return Rotation.from_euler('z', -self.faults.camera_yaw_deg, degrees=True).as_matrix() @ described

    def pixel(self, t: float, source: int = 0, camera: str = 'camera') -> NDArray | None:
        """The place in the image as it is sent."""
        place, wrong = super().pixel(t, source, camera), self.faults
        if place is None or camera != self.faulty:
            return place
        roll = math.radians(wrong.rolled_deg + 180.0 * wrong.upside_down)
        turn = np.array([[math.cos(roll), math.sin(roll)], [-math.sin(roll), math.cos(roll)]])
        place = CENTRE + wrong.focal * np.array([-1.0 if wrong.mirrored else 1.0, 1.0]) * (turn @ (place - CENTRE))
        return place if 0.0 <= place[0] < WIDTH and 0.0 <= place[1] < HEIGHT else None

    def send(self, kind: str, message: Any, captured: float, takes: float) -> None:
        """Put a message on its way, with its faults."""
        wrong = self.faults
        if kind == 'doa':
            for one in message.hypotheses:
                if math.isfinite(one.cosine):
                    front = abs(one.azimuth) < 0.5 * math.pi
                    cosine = (-1.0 if wrong.swapped else 1.0) * wrong.spacing * one.cosine + wrong.delay
                    one.cosine = min(max(cosine, -1.0), 1.0)
                    apart = math.asin(one.cosine)
                    one.azimuth = apart if front else math.copysign(math.pi, apart) - apart
        elif kind == 'odometry' and wrong.yaw_sign < 0:
            message.pose.pose.orientation.z *= -1.0    # of a level rig
            message.twist.twist.angular.z *= -1.0
        elif kind == 'odometry' and (wrong.frozen or wrong.stuck):
            self._first = self._first or message.pose.pose.orientation
            message.pose.pose.orientation = self._first
            if wrong.stuck:
                message.twist.twist.angular = vector(np.zeros(3))
        elif kind in ('detections', 'visibility') and message.header.frame_id == self.faulty and wrong.late:
            message.header.stamp = to_stamp(to_seconds(message.header.stamp) + wrong.late)
            takes = max(takes, wrong.late + 0.02)
        super().send(kind, message, captured, takes)


def lies(rig: FormulaRig, after: float, until: float = math.inf, in_world: bool = False) -> float:
    """Share of outputs that are resolved, sure to 10 deg, and wrong by more than 10 deg and 3 sigma, in body or world."""
    outputs, wrong = rig.between(after, until), 0
    for moment in rig.following(after, until):
        bearing, truth = moment.bearing, rig.sources[0].direction(moment.t) if in_world else rig.body(moment.t)
        azimuth, variance = ((bearing.azimuth_world, bearing.covariance_world[0]) if in_world else
                             (bearing.azimuth, bearing.azimuth_variance))
        error = abs(wrapped(math.degrees(azimuth) - azimuth_of(truth)))
        wrong += (bearing.resolved and variance < math.radians(10.0) ** 2
                  and error > max(10.0, 3.0 * math.degrees(math.sqrt(variance))))
    return wrong / max(len(outputs), 1)


def drone(seed: int) -> Source:
    """One that flies back and forth ahead, heard and seen."""
    r = np.random.default_rng([3, seed])
    wide, fast, period, short, phase = r.uniform((9.0, 3.0, 7.0, 3.0, 0.0), (18.0, 6.0, 13.0, 5.0, 6.0))
    return Source(lambda t: unit(wide * math.sin(math.tau * t / period + phase) + fast * math.sin(math.tau * t / short), 8.0))


def turning(seed: int, largest: float = 20.0) -> Callable[[float], Rotation]:
    """Attitude of a body that turns to and fro, by up to `largest` (deg)."""
    r = np.random.default_rng([4, seed])
    angle, period = r.uniform(0.6 * largest, largest), r.uniform(5.0, 8.0)
    return lambda t: Rotation.from_euler('z', angle * math.sin(math.tau * t / period), degrees=True)


def turning_rig(faults: Faults, seed: int, largest: float = 20.0, **options: Any) -> FaultyRig:
    """A rig with faults that turns to and fro below a drone.

    Parameters:
        faults: what is wrong.
        seed: of everything.
        largest (deg): that it turns to either side.
        options: further fields of `FaultyRig`.
    """
    return FaultyRig([drone(seed)], seed=seed, faults=faults, attitude=turning(seed, largest), **options)
