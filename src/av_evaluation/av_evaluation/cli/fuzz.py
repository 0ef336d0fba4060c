"""ros2 run av_evaluation fuzz: random sequences of messages against the stages; exits with 1 where one breaks a promise.

Time stalls and jumps. Stages may raise ValueError only; bearings and tracks are finite; commands are finite and within their
limits. The body moves only while a measurement that supports the bearing is young: what `measured` says must be the capture
time of a direction or detection that arrived and can be used, of an input that has one publisher, and its age and that of the
odometry are known here, independently of the stages.
"""

from __future__ import annotations

import argparse
import math
import signal
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from random import Random
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.arguments import number, whole
from av_common.frames import attitude_of, is_orientation
from av_common.freshness import FUTURE_S, Instant
from av_common.parameters import node_parameters
from av_common.rig import CAMERAS, CameraMount
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.attack.hostile import HostileValues
from av_evaluation.attack.judges import ROUNDING, CommandLimits
from av_evaluation.runs.program import processes
from av_fusion.stage import FusionOutput, make_fusion_stage
from av_interfaces.msg import Bearing, Doa, DoaArray, PointingCommand
from av_pointing.stage import make_pointing_stage

CHUNK = 100    # sequences of a process at a time
MESSAGES = 40  # of each sequence
METHODS = ('bayes', 'bayes', 'gated')    # the default one in two of three sequences
# One of 61 s is more than the stage fills with predictions (LONGEST_SILENCE_S), which take most of the time.
STEPS_S = (0.0, 0.02, 0.05, 0.5, -0.1, 5.0, 61.0, -3.0, -100.0)
STEP_SHARES = (0.1, 0.5, 0.3, 0.05, 0.02, 0.005, 0.005, 0.01, 0.01)
SHARES = (0.0, 0.0, 0.02, 0.2)    # of a message's fields that are hostile
INPUTS = {DoaArray: 'doa', Detection2DArray: 'detections', Odometry: 'odometry'}
CONTESTED_SHARE = 0.01    # of the messages with which an input gets a second publisher, for a while
FINITE = ('azimuth', 'elevation', 'azimuth_world', 'azimuth_world_rate', 'requested_rotation')
STANDS_S, OLDEST_S = 0.3, 1.0    # from the arrival of a measurement or pose, and from its capture, at which the body stands
SAME_S = 1e-6    # stamps of one measurement


@cache
def parameters(package: str, node: str, **overrides: Any) -> Any:
    """The parameters of a node, which are read from files once."""
    return node_parameters(package, node, overrides=overrides)


class Witness:
    """What has arrived, by the steady clock: knows which motion of the body is justified.

    A stamp of an input counts from its first arrival: what is sent again is no new measurement.
    """

    def __init__(self) -> None:
        self._first: dict[str, dict[float, tuple[float, float]]] = {name: {} for name in INPUTS.values()}
        self._stated: dict[float, float] = {}    # when a bearing first stated a measurement

    def note(self, message: Any, now: Instant, contested: bool) -> None:
        """Note a message on its arrival `now`, of an input that is contested or not."""
        useless = (isinstance(message, DoaArray) and not message.hypotheses) or (
            isinstance(message, Detection2DArray) and not message.detections) or (
            isinstance(message, Odometry) and not is_orientation(attitude_of(message.pose.pose.orientation)))
        try:
            stamp = to_seconds(message.header.stamp)
        except ValueError:
            return
        if not (useless or contested):
            self._first[INPUTS[type(message)]].setdefault(stamp, (now.steady, now.ros - stamp))

    def state(self, bearing: Bearing, now: Instant) -> None:
        """Note what a bearing states on its arrival `now`."""
        self._stated.setdefault(to_seconds(bearing.measured), now.steady)

    def fault(self, command: PointingCommand, bearing: Bearing | None, now: Instant) -> str:
        """Why a command must not move the body, '' where it may or does not."""
        if not command.move_body or abs(command.yaw_rate) < ROUNDING:
            return ''
        measured = -1.0 if bearing is None else to_seconds(bearing.measured)
        found = max((kept for name in ('doa', 'detections') for stamp, kept in self._first[name].items()
                     if abs(stamp - measured) < SAME_S), default=None)    # of two inputs, the one that arrived later
        if found is None:
            return f'turns on a bearing of {measured:.3f} s, of which no measurement can be used'
        arrived, late = found
        if now.steady - arrived + max(late, -FUTURE_S) > OLDEST_S + ROUNDING:    # stamps may be as far ahead as clocks
            return f'turns {now.steady - arrived + late:.2f} s after the capture of its newest measurement'
        if (age := now.steady - self._stated[measured]) > STANDS_S:
            return f'turns {age:.2f} s after a bearing stated its newest measurement first'
        age = now.steady - max((steady for steady, late in self._first['odometry'].values() if late <= STANDS_S),
                               default=-math.inf)
        return f'turns {age:.2f} s after the newest odometry' if age > STANDS_S else ''


class Mixture:
    """Random messages for a fusion and a pointing stage.

    Parameters:
        seed: of the random draws.
    """

    def __init__(self, seed: int) -> None:
        self._random, self._steady = Random(seed), 100.0
        self._now = self._random.uniform(1e3, 2e9)    # by the clock that may step back
        self._hostile = HostileValues(self._random, lambda: self._now)
        method = self._random.choice(METHODS)
        self._fusion = make_fusion_stage(parameters('av_fusion', 'fusion_node', method=method),
                                         lambda frame, time: np.eye(3), {CAMERAS[0]: CameraMount().model})
        self._pointing = make_pointing_stage(parameters('av_pointing', 'pointing_node', enabled=True))
        self._limits, self._witness, self._before = CommandLimits(self._pointing.controller.settings, ROUNDING), Witness(), 0.0
        self._bearing: Bearing | None = None
        self._rate, self._justified = 0.0, -math.inf    # of the newest command, and when one was justified
        self._contested: dict[str, list[str]] = {}

    def run(self) -> str:
        """Use the messages of a sequence; returns the first fault, '' for none."""
        try:
            for _ in range(MESSAGES):
                step = self._random.choices(STEPS_S, STEP_SHARES)[0]
                self._now, self._steady = self._now + step, self._steady + max(step, 0.0)
                if fault := self._use(self._random.choice((self._doa, self._image, self._odometry))()):
                    return fault
        except Exception as error:  # noqa: BLE001  every exception but ValueError is a fault
            return f'{type(error).__name__}: {error}'
        return ''

    def _use(self, message: Any) -> str:
        """Give a message to the stages, and what follows; returns a fault."""
        if share := self._random.choice(SHARES):
            self._hostile.disturb(message, share)
        self._contest()
        now, outputs = Instant(self._steady, self._now), list[FusionOutput | None]()
        self._witness.note(message, now, INPUTS[type(message)] in self._contested)
        takes: dict[type, Callable[..., Any]] = {
            DoaArray: self._fusion.on_doa, Detection2DArray: self._fusion.on_detections, Odometry: self._fusion.on_odometry}
        try:
            outputs.append(takes[type(message)](message, self._now))
            if isinstance(message, Odometry):
                self._pointing.on_odometry(message, now)
        except ValueError:
            outputs.clear()
        outputs += self._fusion.outputs_until(self._now)
        for output in filter(None, outputs):
            if output.bearing.measured != Time():    # else what turns is braked, in the time that the one before left
                self._bearing = output.bearing
                self._witness.state(output.bearing, now)
            if fault := check(output) or self._obey(self._pointing.on_bearing(output.bearing, now), now):
                return fault
        return self._obey(self._pointing.on_time(now), now)

    def _contest(self) -> None:
        """Let an input have a second publisher, or none any more."""
        if self._random.random() < CONTESTED_SHARE * (5.0 if self._contested else 1.0):
            self._contested = {} if self._contested else {self._random.choice(list(INPUTS.values())): ['/genuine', '/forger']}
            self._fusion.refuse_contested(self._contested)
            self._pointing.contested = {name: nodes for name, nodes in self._contested.items() if name == 'odometry'}

    def _obey(self, command: PointingCommand, now: Instant) -> str:
        """The fault of a command."""
        elapsed, self._before = now.steady - self._before, now.steady
        fault = self._witness.fault(command, self._bearing, now)
        self._justified = self._justified if fault else now.steady
        # What turned on what was right is braked, in the time that is left.
        brakes = abs(command.yaw_rate) <= abs(self._rate) and now.steady - self._justified <= STANDS_S
        self._rate = command.yaw_rate
        return self._limits.check(command, elapsed) or ('' if brakes else fault)

    def _stamped(self, message: Any, late: float) -> Any:
        message.header.stamp, message.header.frame_id = to_stamp(self._now - late), 'sensor'
        return message

    def _doa(self) -> DoaArray:
        azimuth, variance = self._random.gauss(0.0, 1.0), 10.0 ** self._random.uniform(-5.0, 0.0)
        return self._stamped(DoaArray(window=0.5, axis=Vector3(y=1.0), hypotheses=[
            Doa(direction=Vector3(x=math.cos(a), y=math.sin(a)), azimuth=a, azimuth_variance=variance, cosine=math.sin(azimuth),
                elevation_variance=math.inf, cosine_variance=variance, confidence=self._random.random(), drone_probability=0.9)
            for a in (azimuth, math.pi - azimuth)]), 0.25)

    def _image(self) -> Detection2DArray:
        found = []
        for _ in range(self._random.randrange(3)):
            found.append(Detection2D(results=[ObjectHypothesisWithPose()]))
            found[-1].bbox.center.position.x, found[-1].bbox.center.position.y = 640.0 * self._random.random(), 240.0
            found[-1].bbox.size_x = found[-1].bbox.size_y = 30.0
            found[-1].results[0].hypothesis.class_id, found[-1].results[0].hypothesis.score = 'drone', self._random.random()
        return self._stamped(Detection2DArray(detections=found), 0.1)

    def _odometry(self) -> Odometry:
        message, half = self._stamped(Odometry(), 0.01), 0.1 * math.sin(self._now)
        message.pose.pose.orientation.w, message.pose.pose.orientation.z = math.cos(half), math.sin(half)
        return message


def check(output: FusionOutput) -> str:
    """The fault of what fusion states, '' for none."""
    bearing, targets = output.bearing, output.targets
    if bearing.state != Bearing.STATE_NONE and not all(math.isfinite(getattr(bearing, name)) for name in FINITE):
        return f'the bearing is not finite: {bearing}'
    ids = [track.id for track in targets.tracks]
    if len(ids) != len(set(ids)) or targets.selected not in (0, *ids):
        return f'targets {ids}, of which {targets.selected} is selected'
    for track in targets.tracks:
        if not (0.0 <= track.existence <= 1.0 and math.isfinite(track.azimuth) and math.isfinite(track.elevation)):
            return f'the target is impossible: {track}'
    return ''


def faults(seeds: Sequence[int]) -> dict[int, str]:
    """The first fault of each sequence that has one, by the seed that repeats it."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)    # of absurd numbers
        return {seed: fault for seed in seeds if (fault := Mixture(seed).run())}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sequences and print those that broke a promise, with the seeds that repeat them; Ctrl-C ends it early."""
    parser = argparse.ArgumentParser(prog='fuzz', description=__doc__)
    parser.add_argument('--sequences', type=number, default=100_000, help='number of sequences (%(default)s)')
    parser.add_argument('--seed', type=whole, default=0, help='of the first sequence (%(default)s)')
    options = parser.parse_args(arguments)
    end = options.seed + options.sequences
    jobs = [range(first, min(first + CHUNK, end)) for first in range(options.seed, end, CHUNK)]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    found, done = 0, 0
    with suppress(KeyboardInterrupt), processes() as pool:
        for seeds, faulty in zip(jobs, pool.map(faults, jobs), strict=True):
            found, done = found + len(faulty), done + len(seeds)
            for seed, fault in faulty.items():
                print(f'--seed {seed} --sequences 1: {fault}', flush=True)
    print(f'{found} of {done} sequences break a promise')
    return 1 if found or done < options.sequences else 0
