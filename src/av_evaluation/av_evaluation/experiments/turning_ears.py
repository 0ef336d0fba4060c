"""A rig with two measured ears that turns amid strong reflections until it declares front or back: closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_common.freshness import Instant
from av_evaluation.hearing.places import (
    REFLECTION_DELAY_S,
    REFLECTION_GAIN,
    REFLECTIONS,
    Head,
    at_ears,
    diffuse_tail,
    towards,
)
from av_evaluation.hearing.signals import drone_files, load_clip
from av_evaluation.runs.offline_rig import OfflineRig
from av_fusion.tracker import MultiTargetTracker
from av_pointing.controller import PointingController
from av_pointing.stage import PointingStage
from av_sim_bridge.vehicle import VehicleState
from av_simulator.motion.axes import YawAxis, YawResponse

STEP_S = 0.05  # half a hop of the windows
RESPONSE = YawResponse(math.radians(60.0), math.radians(120.0))  # of the simulator's rigs
STEADY = math.radians(20.0)  # rad/s
SNR_DB = (10.0, 20.0)  # range of the draw
HEAD = cache(Head)
# Yaw rate (rad/s) at a time (s), None for that which pointing commands.
TURNS: dict[str, Callable[[float], float] | None] = {
    'pointed': None, 'steady': lambda time: STEADY, 'steps': lambda time: 2.0 * STEADY * (time % 2.0 < 1.0)}


class Ears:
    """Sound at a head that turns: direct, with reflections from fixed directions of the world, and a diffuse tail.

    Parameters:
        head: measured ears.
        voice (n,): sound of the source, at the head's rate.
        rng: random numbers of the room.
    """

    def __init__(self, head: Head, voice: NDArray, rng: Generator) -> None:
        self._head, self._voice, self._rng, self._next = head, voice, rng, 0
        self.azimuth = float(rng.uniform(-math.pi, math.pi))
        self._paths = [(self.azimuth, 0, 1.0)]  # azimuth (rad), delay (samples), gain
        for _ in range(rng.integers(*REFLECTIONS)):
            self._paths.append((rng.uniform(-math.pi, math.pi), round(rng.uniform(*REFLECTION_DELAY_S) * head.rate),
                                rng.uniform(*REFLECTION_GAIN)))
        self._tail = diffuse_tail(rng, head.responses[0], head.rate)
        self._pending = np.zeros((self._tail.shape[1], 2))
        self._noise = at_ears(voice[:head.rate], head.responses[0]).std() * 10.0 ** (-0.05 * rng.uniform(*SNR_DB))

    def hear(self, begin: float, end: float) -> NDArray:
        """Sound (n, 2) of the next STEP_S, in which the head turns from one yaw (rad) to another."""
        count = round(STEP_S * self._head.rate)
        heard = np.concatenate([self._pending, np.zeros((count, 2))])
        yaw = np.linspace(begin, end, count)
        for azimuth, delay, gain in self._paths:
            dry = gain * self._voice[np.arange(self._next - delay, self._next - delay + count) % len(self._voice)]
            for share, response in towards(azimuth - yaw, self._head.azimuths, self._head.responses):
                self._add(heard, share * dry, response)
        self._add(heard, self._voice[np.arange(self._next, self._next + count) % len(self._voice)], self._tail)
        self._next, self._pending = self._next + count, heard[count:]
        sound = heard[:count] + self._noise * self._rng.normal(size=(count, 2))
        return (0.02 / self._noise * sound).astype(np.float32)

    @staticmethod
    def _add(heard: NDArray, dry: NDArray, response: NDArray) -> None:
        heard[:len(dry) + response.shape[1] - 1] += signal.fftconvolve(dry[:, None], response.T, axes=0)


def turned_until_resolved(seed: int, turns: str, data: Path, longest_s: float) -> tuple[float, float, float]:
    """Time (s) of the first resolved bearing, its azimuth and the true one (rad, in the body); inf without one.

    Parameters:
        seed: of the place, the room and the recording.
        turns: one of TURNS.
        data: folder of recordings and measured responses.
        longest_s (s): after which nothing is waited for.

    Raises FileNotFoundError.
    """
    head, rng = HEAD(data), np.random.default_rng([17, seed])
    clips = drone_files(data)
    ears = Ears(head, load_clip(clips[seed % len(clips)], head.rate), rng)
    rig = OfflineRig(head.array, MultiTargetTracker())
    axis, pointing, now = YawAxis(RESPONSE, 0.0, 0.0), PointingStage(PointingController()), 0.0
    while now < longest_s:
        rate = TURNS[turns]
        if rate is not None:
            axis.command(rate(now), now)
        begin, now = axis.angle, now + STEP_S
        sound = ears.hear(begin, axis.step(STEP_S, now))
        state = VehicleState(now, np.zeros(3), attitude_wxyz=np.array([math.cos(0.5 * axis.angle), 0.0, 0.0,
                             math.sin(0.5 * axis.angle)]), rate_flu=np.array([0.0, 0.0, axis.rate]))
        odometry = rig.on_state(state)
        rig.on_samples(sound, head.rate, now)
        rig.advance(now)
        if rig.bearing is not None:
            if rig.bearing.resolved:
                return now, rig.bearing.azimuth, ears.azimuth - axis.angle
            pointing.on_odometry(odometry, Instant(now, now))
            command = pointing.on_bearing(rig.bearing, Instant(now, now))
            if rate is None:
                axis.command(command.yaw_rate, now)
    return math.inf, 0.0, 0.0
