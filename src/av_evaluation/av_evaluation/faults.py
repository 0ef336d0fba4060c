"""Rigs whose description is wrong, on drawn measurements: what is told of them, when, and how much their bearings lie."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import Field, dataclass, fields
from itertools import count, pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from std_msgs.msg import Header

from av_common.angles import angles_to_direction, wrap
from av_common.config_reader import load
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.experiments.measurement_simulation import LEFT, MeasurementSimulation, Scan
from av_fusion.consistency.events import Fault
from av_fusion.consistency.monitor import ConsistencyMonitor
from av_fusion.measurement.measurements import Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.settings import make_tracker
from av_fusion.stage import FusionOutput, FusionStage
from av_interfaces.msg import Bearing
from av_simulator.config_files import find_config, shipped
from av_simulator.scenario import Scenario, Target

SIGHT_SCANS, SOUND_SCANS = 1, 3  # from capture, or the centre of a window, to arrival, at ten scans a second


@dataclass
class Faults:
    """What is wrong. Defaults are a rig as described.

    Parameters:
        swapped: the microphones are exchanged.
        camera_yaw_deg: the camera is turned by this to the left of what is said.
        mirrored, upside_down: the image.
        rolled_deg: the camera is turned by this about its axis, clockwise as seen from behind it.
        late: s by which images are stamped after their capture.
        yaw_sign: -1 for odometry that turns the wrong way.
        delay: added to each cosine, by a channel that is late.
        spacing, focal: true over described distance of the microphones, and focal length.
        frozen: orientations in the odometry are the first one, while its rates go on.
        stuck: orientations in the odometry are the first one, and its rates 0.
    """

    swapped: bool = False
    camera_yaw_deg: float = 0.0
    mirrored: bool = False
    upside_down: bool = False
    rolled_deg: float = 0.0
    late: float = 0.0
    yaw_sign: int = 1
    delay: float = 0.0
    spacing: float = 1.0
    focal: float = 1.0
    frozen: bool = False
    stuck: bool = False


class FaultyRig:
    """A fusion stage fed with the measurements of a level rig, with its faults.

    Attributes:
        monitor: says what is wrong.

    Parameters:
        simulation: draws the measurements, ten scans a second.
        faults: what is wrong.
    """

    def __init__(self, simulation: MeasurementSimulation, faults: Faults) -> None:
        self._simulation, self._faults = simulation, faults
        tracker = make_tracker(node_parameters('av_fusion', 'fusion_node'))
        self.monitor = ConsistencyMonitor(tracker.motion)
        # In the place of messages and a `MeasurementConverter`: what is drawn is measured already.
        converter: Any = SimpleNamespace(doa=lambda message, *_: message.measured,
                                         detections=lambda message, *_: message.measured)
        self._stage = FusionStage(tracker, converter, consistency=self.monitor)
        self._bearings: list[Bearing] = []

    def steps(self) -> Iterator[float]:
        """Go through the scenario; gives the time (s) after each step."""
        scans = list(self._simulation.scans())
        seen = max(SIGHT_SCANS, math.ceil(10.0 * self._faults.late))
        for k, scan in enumerate(scans):
            self._stage.tracker.add_pose(self._pose(scan.time))
            if k >= seen:
                self._note(self._stage.on_detections(self._image(scans[k - seen]), scan.time))
            if k >= SOUND_SCANS:
                self._note(self._stage.on_doa(self._sound(scans[k - SOUND_SCANS]), scan.time))
            yield scan.time

    def lies(self, after: float, until: float, in_world: bool = False) -> float:
        """Share of a time (s) with bearings that are resolved, sure to 10 deg, and off by more than 10 deg and 3 sigma."""
        bearings = [bearing for bearing in self._bearings if after <= to_seconds(bearing.header.stamp) < until]
        wrong = 0
        for bearing in bearings:
            time = to_seconds(bearing.header.stamp)
            x, y, _ = self._simulation.truth(time)[0]
            azimuth, variance = ((bearing.azimuth_world - self._simulation.yaw(time), bearing.covariance_world[0]) if in_world
                                 else (bearing.azimuth, bearing.azimuth_variance))
            sure = bearing.state != Bearing.STATE_NONE and bearing.resolved and variance < math.radians(10.0) ** 2
            wrong += sure and abs(wrap(azimuth - math.atan2(y, x))) > max(math.radians(10.0), 3.0 * math.sqrt(variance))
        return wrong / max(len(bearings), 1)

    def _note(self, output: FusionOutput | None) -> None:
        if output is not None:
            self._bearings.append(output.bearing)

    def _pose(self, time: float) -> Pose:
        yaw, wrong = self._simulation.yaw, self._faults
        rate = 0.0 if wrong.stuck else wrong.yaw_sign * (yaw(time + 1e-3) - yaw(time)) / 1e-3
        return Pose.level(time, yaw(0.0) if wrong.frozen or wrong.stuck else wrong.yaw_sign * yaw(time), rate)

    def _sound(self, scan: Scan) -> Any:
        """The directions of a window, of a pair with the faults of its microphones."""
        wrong, measured = self._faults, list[DoaMeasurement]()
        for doa in scan.doas:
            if doa.cone is not None:
                cosine = (-1.0 if wrong.swapped else 1.0) * wrong.spacing * doa.cone.cosine + wrong.delay
                cone = Cone(LEFT, min(max(cosine, -1.0), 1.0), doa.cone.variance)
                doa = DoaMeasurement.of_cone(doa.time, cone, doa.confidence, doa.window)
            measured.append(doa)
        return SimpleNamespace(header=Header(stamp=to_stamp(scan.time)), measured=tuple(measured))

    def _image(self, scan: Scan) -> Any:
        """The detections of an image, with the faults of the camera, whose description is turned."""
        wrong, time = self._faults, scan.time + self._faults.late
        c, s = math.cos(math.radians(wrong.camera_yaw_deg)), math.sin(math.radians(wrong.camera_yaw_deg))
        image = scan.image._replace(time=time, detections=tuple(map(self._displaced, scan.image.detections)),
                                    view=((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
        return SimpleNamespace(header=Header(stamp=to_stamp(time)), measured=image)

    def _displaced(self, found: Detection) -> Detection:
        """Where a detection is by what is told of the camera; the image has the tangents of its angles."""
        wrong = self._faults
        y, z = math.tan(found.azimuth), math.tan(found.elevation) / math.cos(found.azimuth)  # to the left, and up
        roll = math.radians(wrong.rolled_deg + 180.0 * wrong.upside_down)
        y, z = math.cos(roll) * y + math.sin(roll) * z, math.cos(roll) * z - math.sin(roll) * y
        azimuth = math.atan((-wrong.focal if wrong.mirrored else wrong.focal) * y)
        return found._replace(azimuth=float(wrap(azimuth - math.radians(wrong.camera_yaw_deg))),
                              elevation=math.atan(wrong.focal * z * math.cos(azimuth)))


# By the field of `Faults`, words that name it.
NAMES = {'swapped': 'microphones are exchanged', 'camera_yaw_deg': 'camera is turned', 'mirrored': 'mirrored or upside down',
         'upside_down': 'mirrored or upside down', 'rolled_deg': 'camera is rolled', 'late': 'images are stamped',
         'yaw_sign': 'yaw of the odometry', 'delay': 'one channel is late', 'spacing': 'times as far apart',
         'focal': 'focal length', 'frozen': 'heading is not known', 'stuck': 'heading of the odometry is frozen'}
FOR_PAIR = ('swapped', 'delay', 'spacing')
SINGLE = (Faults(swapped=True), Faults(camera_yaw_deg=15.0), Faults(camera_yaw_deg=-22.0), Faults(camera_yaw_deg=40.0),
          Faults(camera_yaw_deg=-90.0), Faults(camera_yaw_deg=180.0), Faults(mirrored=True), Faults(upside_down=True),
          Faults(rolled_deg=90.0), Faults(rolled_deg=-90.0), Faults(late=0.3), Faults(late=0.15), Faults(yaw_sign=-1),
          Faults(delay=0.3), Faults(delay=-0.45), Faults(spacing=1.5), Faults(focal=0.8),
          Faults(frozen=True))
SMALL = (Faults(camera_yaw_deg=6.0), Faults(late=0.08), Faults(delay=0.08), Faults(spacing=1.15), Faults(focal=0.9))
TWO = (Faults(swapped=True, camera_yaw_deg=15.0), Faults(swapped=True, yaw_sign=-1),
       Faults(mirrored=True, camera_yaw_deg=-15.0), Faults(camera_yaw_deg=20.0, late=0.3),
       Faults(yaw_sign=-1, camera_yaw_deg=15.0), Faults(delay=-0.3, spacing=1.4))

class Told(NamedTuple):
    """What was told of a rig.

    Parameters:
        fault: the first that is certain, or the first suspected; None where nothing was told.
        first, certain (s): when something was first told, and for certain; inf where it was not.
        before, after: share of the time in which the bearing lies, until and since the first of both; in body and world.
    """

    fault: Fault | None
    first: float
    certain: float
    before: tuple[float, float]
    after: tuple[float, float]


def title(faults: Faults) -> str:
    """What is wrong, as in the table."""
    return ', '.join(f'{one.name}={getattr(faults, one.name)}' for one in _wrong(faults)) or 'nothing'


def named(faults: Faults, fault: Fault) -> bool:
    """Whether one of the explanations that are told says only what is wrong."""
    words = {NAMES[one.name] for one in _wrong(faults)}
    said = [{name for name in NAMES.values() if name in one} for one in fault.text.split('; or ')]
    return any(one and one <= words for one in said)


def _wrong(faults: Faults) -> list[Field[Any]]:
    """The fields that differ from a rig as described."""
    return [one for one in fields(faults) if getattr(faults, one.name) != one.default]


def flight(seed: int, seconds: float) -> Scenario:
    """A drone that flies back and forth 20 m ahead of the rig, for some seconds."""
    r = np.random.default_rng([3, seed])
    wide, fast, period, short, phase = r.uniform((9.0, 3.0, 7.0, 3.0, 0.0), (18.0, 6.0, 13.0, 5.0, 6.0))

    def path(times: ArrayLike) -> NDArray[np.float64]:
        t = np.atleast_1d(np.asarray(times, float))
        azimuth = np.radians(wide * np.sin(math.tau * t / period + phase) + fast * np.sin(math.tau * t / short))
        return 20.0 * angles_to_direction(azimuth, np.full(len(t), math.radians(8.0)))

    return Scenario('faults', (Target(path),), seconds, seed)


def turning(seed: int) -> Callable[[float], float]:
    """Yaw (rad) of a body that turns to and fro by up to 20 deg, by time (s)."""
    r = np.random.default_rng([4, seed])
    angle, period = math.radians(r.uniform(12.0, 20.0)), r.uniform(5.0, 8.0)
    return lambda t: angle * math.sin(math.tau * t / period)


def try_fault(faults: Faults, seed: int, seconds: float, array: str = 'pair') -> Told:
    """What is told of a rig with faults that turns to and fro below a drone, within `seconds`.

    Parameters:
        faults: what is wrong.
        seed: of everything.
        seconds (s): length of the run.
        array: 'pair', or 'square' of microphones.
    """
    rig = FaultyRig(MeasurementSimulation(flight(seed, seconds), seed, turning(seed), pair=array == 'pair', sound_clutter=0.0,
                                          sight_clutter=0.0), faults)
    found: Fault | None = None
    first = certain = math.inf
    for t in rig.steps():
        fault = rig.monitor.fault
        if fault is not None and (found is None or fault.is_certain > found.is_certain):
            found, first = fault, min(first, t)
            certain = t if fault.is_certain else certain
    cut = min(first, seconds)
    before, after = ((rig.lies(begin, end), rig.lies(begin, end, in_world=True))
                     for begin, end in pairwise((0.0, cut, math.inf)))
    return Told(found, first, certain, before, after)


def scenarios(hours: float) -> Iterator[tuple[str, int]]:
    """Scenarios and seeds of runs that last as long as that together: each scenario in turn."""
    lengths = {name: load(Scenario, find_config(name, 'scenarios')).duration for name in shipped('scenarios')}
    left = 3600.0 * hours
    for seed in count():
        for name, length in lengths.items():
            if left <= 0.0:
                return
            left -= length
            yield name, seed


def faultless(scenario: str, seed: int) -> tuple[float, dict[str, bool]]:
    """Draw a scenario's measurements for a rig as described that turns to and fro, among up to four birds.

    Returns its length (s), and what was told all the same, with whether it was certain.

    Parameters:
        scenario: name or file.
        seed: of everything; odd ones have a pair of microphones, even ones four in space.
    """
    content = load(Scenario, find_config(scenario, 'scenarios'))
    r = np.random.default_rng([5, seed])
    angle, period, birds = r.uniform(0.0, 1.0), r.uniform(5.0, 20.0), int(r.integers(5))
    drawn = MeasurementSimulation(content, seed, lambda time: angle * math.sin(math.tau * time / period), pair=seed % 2 == 1,
                                  birds=birds)
    motion = RigMotion()
    monitor = ConsistencyMonitor(motion)
    told: dict[str, bool] = {}
    for scan in drawn.scans():
        yaw = drawn.yaw(scan.time)
        motion.add(Pose.level(scan.time, yaw, (drawn.yaw(scan.time + 1e-3) - yaw) / 1e-3))
        if scan.doas:
            monitor.add_doas(scan.doas)
        monitor.add_camera(scan.image)
        fault = monitor.advance(scan.time)
        if fault is not None:
            text = next(name for name in NAMES.values() if name in fault.text)
            told[text] = fault.is_certain or told.get(text, False)
    return content.duration, told


def cases(array: str, quick: bool) -> Iterator[Faults]:
    """The rows of the table: single faults, small ones and pairs.

    Parameters:
        array: kind of array.
        quick: single faults only.
    """
    for faults in (*SINGLE, *(() if quick else (*SMALL, *TWO)), Faults()):
        if array == 'pair' or not any(one.name in FOR_PAIR for one in _wrong(faults)):
            yield faults
