"""Front and back in reverberant rooms: a rig that turns as fusion asks, in random shoebox rooms of pyroomacoustics.

The rooms share no code with the simulator. The source stands still, nothing is seen, and the rig obeys the requested rotation.
A declaration is a bearing in which front and back count as resolved; it is wrong where that is nearer to the mirrored direction
about the axis of the microphones than to the true one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_common.rig import CameraMount
from av_evaluation.hearing.places import pair, shoebox
from av_evaluation.hearing.signals import RATE, Source, band_power, bright_rotors, recordings, rotors
from av_evaluation.runs.offline_rig import OfflineRig
from av_fusion.tracker import MultiTargetTracker
from av_sim_bridge.vehicle import VehicleState

DURATION_S, STEP_S, SETTLED_S = 8.0, 0.1, 0.8
TURN_RATE = math.radians(40.0)
PLACES = 72  # of a microphone on its circle about the rig, between which responses are interpolated
T60_S, SPACING_M, DISTANCE_M, SNR_DB = (0.3, 0.7), (0.1, 0.2), (1.5, 5.0), (5.0, 20.0)
LARGEST_ORDER = 17  # of reflections; later ones are 20 dB below the first
SAME = math.radians(10.0)  # of hypotheses that are closer together it does not matter which is declared


@dataclass(frozen=True)
class Turning:
    """What fusion declared in one room.

    Parameters:
        first (s): time of the first declaration; inf without one.
        first_wrong: whether that was wrong.
        declared, wrong: number of bearings that declared a side, and of those that declared the wrong one.
        ends: whether the last bearing is undecided (0), right (1) or wrong (-1).
    """

    first: float
    first_wrong: bool
    declared: int
    wrong: int
    ends: int


class TurningRoom:
    """The sound at two microphones on a rig that turns at a place in a random room.

    Parameters:
        rng: random numbers.

    Raises ImportError without pyroomacoustics.
    """

    def __init__(self, rng: Generator) -> None:
        self.spacing = rng.uniform(*SPACING_M)
        self.responses, self.azimuth = self._random_room(rng)

    @property
    def array(self) -> MicrophoneArray:
        """The pair, left and right."""
        return pair(self.spacing)

    def _random_room(self, rng: Generator) -> tuple[NDArray, float]:
        """Responses (PLACES, taps) around the circle of the microphones, and the azimuth (rad) of the source."""
        while True:
            size, t60 = rng.uniform([4.0, 3.5, 2.5], [10.0, 8.0, 4.0]), rng.uniform(*T60_S)
            place = rng.uniform([1.0, 1.0, 1.0], [size[0] - 1.0, size[1] - 1.0, 1.8])
            azimuth = rng.uniform(-np.pi, np.pi)
            source = place + rng.uniform(*DISTANCE_M) * angles_to_direction(azimuth) + [0.0, 0.0, rng.uniform(-0.2, 0.6)]
            try:
                room = shoebox(size, t60, LARGEST_ORDER)
            except ValueError:
                continue
            if np.all(source > 0.4) and np.all(source < size - 0.4):
                break
        room.add_source(source)
        around = np.arange(PLACES) * math.tau / PLACES
        circle = 0.5 * self.spacing * np.stack([np.cos(around), np.sin(around), np.zeros(PLACES)])
        room.add_microphone_array(place[:, None] + circle)
        room.compute_rir()
        length = max(len(microphone[0]) for microphone in room.rir)
        return np.stack([np.pad(microphone[0], (0, length - len(microphone[0]))) for microphone in room.rir]), azimuth

    def heard(self, dry: NDArray, first: float, last: float) -> NDArray:
        """Sound (n, 2) while the rig turns evenly.

        Parameters:
            dry (taps - 1 + n,): sound of the source; its beginning is what still reverberates.
            first, last (rad): heading at the beginning and at the end.
        """
        count = len(dry) - self.responses.shape[1] + 1
        yaw, sound = np.linspace(first, last, count), np.zeros((count, 2))
        for channel, side in enumerate((0.5 * math.pi, -0.5 * math.pi)):
            place = (yaw + side) * PLACES / math.tau
            for index in range(math.floor(place.min()), math.floor(place.max()) + 2):
                share = np.clip(1.0 - np.abs(place - index), 0.0, None)
                sound[:, channel] += share * signal.fftconvolve(dry, self.responses[index % PLACES], 'valid')
        return sound


def turn_in_room(seed: int, data: Path) -> Turning:
    """One room: a rig that turns as fusion asks, for DURATION_S.

    Parameters:
        seed: of room, sound and noise.
        data: folder of recordings; without them rotors alone are heard.

    Raises ImportError without pyroomacoustics.
    """
    rng = np.random.default_rng([29, seed])
    room, camera = TurningRoom(rng), CameraMount()
    clips = data / 'drone_detection' / 'audio'
    sources: list[Source] = [rotors, bright_rotors] + ([recordings(clips)] if clips.is_dir() else [])
    dry = sources[seed % len(sources)](rng, SETTLED_S + DURATION_S, np.zeros(1))[:, 0]
    still = room.heard(dry, 0.0, 0.0)
    noise = rng.normal(size=still.shape)
    noise *= math.sqrt(band_power(still[:, 0]) / band_power(noise[:, 0]) * 10.0 ** (-rng.uniform(*SNR_DB) / 10.0))
    gain = 0.05 / still.std()
    rig = OfflineRig(room.array, np.eye(3), camera.model, camera.optical_to_body, MultiTargetTracker())
    yaw, step, taps = 0.0, round(STEP_S * RATE), room.responses.shape[1] - 1
    start = len(dry) - round(DURATION_S * RATE)
    resolved: list[tuple[float, bool]] = []
    ends = 0
    for number in range(round(DURATION_S / STEP_S)):
        begin = start + number * step
        wanted = 0.0 if rig.bearing is None else float(rig.bearing.requested_rotation)
        turned = yaw + float(np.clip(wanted, -TURN_RATE * STEP_S, TURN_RATE * STEP_S))
        samples = gain * (room.heard(dry[begin - taps:begin + step], yaw, turned) + noise[begin - taps:begin - taps + step])
        rate, now = (turned - yaw) / STEP_S, (number + 1) * STEP_S
        for share in np.linspace(0.1, 1.0, 10):
            rig.on_state(_state(now - STEP_S + share * STEP_S, yaw + share * (turned - yaw), rate))
        yaw = turned
        rig.on_samples(samples, RATE, number * step, now)
        rig.advance(now)
        ends = 0
        if rig.bearing is not None and rig.bearing.state and rig.bearing.resolved:
            wrong = is_other_side(rig.bearing.azimuth, room.azimuth - yaw)
            resolved.append((now, wrong))
            ends = -1 if wrong else 1
    first = resolved[0] if resolved else (math.inf, False)
    return Turning(*first, len(resolved), sum(wrong for _, wrong in resolved), ends)


def is_other_side(azimuth: float, truth: float) -> bool:
    """Whether a bearing (rad) is nearer to the mirror image of the true azimuth (rad) than to that, and these are apart."""
    error, mirrored = abs(wrap(azimuth - truth)), abs(wrap(azimuth - (math.pi - truth)))
    return bool(error > mirrored and abs(wrap(math.pi - 2.0 * truth)) > SAME)


def _state(time: float, yaw: float, rate: float) -> VehicleState:
    return VehicleState(time, np.zeros(3), attitude_wxyz=np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]),
                        rate_flu=np.array([0.0, 0.0, rate]))
