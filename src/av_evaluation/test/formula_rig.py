"""A rig among sources of sound, as messages by formulas: nothing of the suite but messages and the makers of stages.

Truth and measurements are plain geometry: x is forward, y left, z up; a rotation turns vectors of the body into the world.
A pair of microphones on the body's y axis measures the cosine to that axis, a square in the xy plane and an upright triangle in
the xz plane the projection of the direction on it, eight in space the direction. Windows last 0.5 s and begin every 0.1 s, so
that errors of neighbours are correlated. A pinhole camera measures pixels.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.frames import BASE_FRAME
from av_common.gimbal_history import GimbalHistory
from av_common.parameters import node_parameters
from av_common.rig import GimbalMount
from av_common.stamps import to_seconds, to_stamp
from av_fusion.settings import make_tracker
from av_fusion.stage import FusionOutput, make_fusion_stage
from av_interfaces.msg import Bearing, Doa, DoaArray, FusionState, GimbalState, TrackArray, Visibility

START = 1000.0                                  # s, of the stamps
STEP, HOP, IMAGE_PERIOD = 0.02, 0.1, 0.08       # s
WINDOW, SOUND_TAKES, SIGHT_TAKES = 0.5, 0.05, 0.1       # s: length of a window, and from its end, or the exposure, to arrival
COSINE_SIGMA = math.sin(math.radians(1.5))      # of one window, in projections of the direction
FOCAL, WIDTH, HEIGHT, BOX, SCORE = 457.0, 640, 480, 15.0, 0.9       # pixels: 70 degrees wide
CENTRE = np.array([0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)])  # pixels
MOUNT_SIGMA = 0.003                             # rad, of the camera's orientation on its carrier
PIXEL_SIGMA = math.sqrt((1.0 + (0.08 * BOX) ** 2) / SCORE)  # of such a box; 12 % more than `av_vision.bearing` states
RESOLUTION = math.radians(10.0)                 # sources closer than this are heard as the louder one
OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])   # from x forward to z forward
MEASURED = {'pair': [1], 'square': [0, 1], 'upright': [0, 2], 'eight': [0, 1, 2]}   # axes of a direction, by the array

Signal = Callable[[float], float]


def always(_time: float) -> bool:
    """At all times."""
    return True


def never(_time: float) -> bool:
    """At no time."""
    return False


def unit(azimuth_deg: float, elevation_deg: float = 0.0) -> NDArray:
    """Unit vector (3,) of an azimuth and an elevation in degrees."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)])


def wrapped(degrees: float) -> float:
    """The same angle within half a turn of 0."""
    return math.remainder(degrees, 360.0)


def azimuth_of(vector: NDArray) -> float:
    """Azimuth of a vector (3,) in degrees."""
    return math.degrees(math.atan2(vector[1], vector[0]))


def vector(values: NDArray) -> Vector3:
    """A message of three numbers."""
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def quaternion(rotation: Rotation) -> Quaternion:
    """A message of a rotation."""
    x, y, z, w = map(float, rotation.as_quat())
    return Quaternion(x=x, y=y, z=z, w=w)


@dataclass
class Source:
    """What is heard and seen of a place. Functions take the time (s) since the start.

    Parameters:
        direction: unit vector (3,) in the world.
        heard, seen: whether the microphones hear it, and whether it can be seen.
        drone_probability, fundamental: of each window's message; NaN while unknown.
        confidence, score: of directions, and of detections.
    """

    direction: Callable[[float], NDArray]
    heard: Callable[[float], bool] = always
    seen: Callable[[float], bool] = always
    drone_probability: Signal = lambda t: math.nan
    fundamental: float = math.nan
    confidence: float = 0.9
    score: float = SCORE
    errors: list[NDArray] = field(default_factory=list)

    @classmethod
    def at(cls, azimuth_deg: float, elevation_deg: float = 0.0, rate_deg: float = 0.0, **options: Any) -> Source:
        """One that circles evenly, or stands where the rate (deg/s) is 0."""
        return cls(lambda t: unit(azimuth_deg + rate_deg * t, elevation_deg), **options)


class Moment(NamedTuple):
    """One output of the stage, `t` s since the start."""

    t: float
    bearing: Bearing
    state: FusionState
    targets: TrackArray


@dataclass
class FormulaRig:
    """Feeds a fusion stage with what the sensors report. Functions take the time (s) since the start.

    Attributes:
        moments: all outputs.
        measured: arrival (s), kind and azimuth (degrees, in the body) of each measurement of the first source.

    Parameters:
        sources: the first is the one that figures refer to.
        attitude: rotation of the body in the world.
        array: 'pair', 'square', 'upright' or 'eight'.
        path: position (3; m) of the rig in the world.
        camera: rotation of the camera (x along its axis) on the body.
        others: those of further cameras, by their names.
        gimbal: what carries a camera that turns on the body; None where it is fixed.
        sound, sight, odometry: whether the sensor sends messages.
        visibility: of images, None where nothing is reported of it.
        sight_clutter, sound_clutter: expected number of false detections of an image, and of false directions of a window.
        lasting: standard deviation of errors of projections that all windows of a run have in common; variances count them.
        network: from kind, capture and arrival (s) to the arrivals in fact: none of a lost message, two of a doubled one.
        clock: what a sensor adds to its stamps (s), by the kind of message and time.
        parameters: of fusion_node that differ from the defaults.
        on_output, on_pose: are called with each output, and with each pose that arrives and its time (s).
        polls: how often the stage is asked for a periodic output in a step.
    """

    sources: list[Source]
    attitude: Callable[[float], Rotation] = lambda t: Rotation.identity()
    path: Callable[[float], NDArray] = lambda t: np.zeros(3)
    array: str = 'pair'
    camera: Callable[[float], Rotation] = lambda t: Rotation.identity()
    others: dict[str, Callable[[float], Rotation]] = field(default_factory=dict)
    gimbal: GimbalMount | None = None
    sound: Callable[[float], bool] = always
    sight: Callable[[float], bool] = always
    odometry: Callable[[float], bool] = always
    visibility: Callable[[float], float] | None = None
    detection_probability: float = 0.9
    sight_clutter: float = 0.0
    sound_clutter: float = 0.0
    lasting: float = 0.0
    network: Callable[[str, float, float], Sequence[float]] = lambda kind, captured, arrival: (arrival,)
    clock: Callable[[str, float], float] = lambda kind, captured: 0.0
    seed: int = 0
    parameters: dict[str, Any] = field(default_factory=dict)
    on_output: Callable[[Moment], None] = lambda moment: None
    on_pose: Callable[[Odometry, float], None] = lambda message, now: None
    polls: int = 1

    def __post_init__(self) -> None:
        self.random = np.random.default_rng([11, self.seed])
        self.moments: list[Moment] = []
        self.measured: list[tuple[float, str, float]] = []
        self.cameras = {'camera': self.camera, **self.others}
        others = np.random.default_rng([13, self.seed])
        self.misaligned = {camera: FOCAL * MOUNT_SIGMA * (others if camera in self.others else self.random).normal(size=2)
                           for camera in self.cameras}
        self._lasts = self.lasting * np.random.default_rng([12, self.seed]).normal(size=3)
        self._numbers, self._steps = count(), 0
        self._queue: list[tuple[float, int, str, Any]] = []
        given = node_parameters('av_fusion', 'fusion_node', overrides=self.parameters)
        carried: dict[str, Any] = {}
        if self.gimbal is not None:
            carried = {'gimbal': GimbalHistory(), 'tracker': make_tracker(given, self.gimbal)}
        self.stage = make_fusion_stage(given, self._rotation_of, cameras=tuple(self.cameras), **carried)
        for camera in self.cameras:
            self.stage.on_camera_info(CameraInfo(
                width=WIDTH, height=HEIGHT, distortion_model='plumb_bob', d=[0.0] * 5,
                k=[FOCAL, 0.0, CENTRE[0], 0.0, FOCAL, CENTRE[1], 0.0, 0.0, 1.0]), camera)

    @property
    def now(self) -> float:
        """Time (s) since the start."""
        return self._steps * STEP

    def body(self, t: float, source: int = 0) -> NDArray:
        """Unit vector (3,) to a source in the body."""
        return self.attitude(t).inv().apply(self.sources[source].direction(t))

    def run(self, seconds: float) -> FormulaRig:
        """Go on for `seconds`; returns the rig."""
        for _ in self.steps(seconds):
            pass
        return self

    def steps(self, seconds: float) -> Iterator[float]:
        """Go on for `seconds`, in steps; gives the time (s) of each before it begins."""
        for _ in range(round(seconds / STEP)):
            yield self.now
            self._steps += 1
            self._capture(self.now)
            while self._queue and self._queue[0][0] <= self.now + 1e-9:
                _, _, kind, message = heapq.heappop(self._queue)
                self.give(kind, message, self.now)
            for _ in range(self.polls):
                self._note(self.stage.on_time(START + self.now))

    def give(self, kind: str, message: Any, now: float) -> None:
        """Hand a message to the stage at `now` (s since the start)."""
        arrival = START + now
        if kind == 'odometry':
            self.stage.on_odometry(message, arrival)
            self.on_pose(message, now)
        elif kind == 'visibility':
            self.stage.on_visibility(message, message.header.frame_id)
        elif kind == 'detections':
            self._note(self.stage.on_detections(message, arrival, message.header.frame_id))
        else:
            self._note({'doa': self.stage.on_doa, 'gimbal': self.stage.on_gimbal}[kind](message, arrival))

    def send(self, kind: str, message: Any, captured: float, takes: float) -> None:
        """Put a message on its way; it was captured at a time (s) and takes some (s)."""
        wrong = self.clock(kind, captured)
        if wrong != 0.0:
            message.header.stamp = to_stamp(START + captured + wrong)
        for arrival in self.network(kind, captured, self.now + takes):
            heapq.heappush(self._queue, (arrival, next(self._numbers), kind, message))

    def _rotation_of(self, frame: str, time: float) -> NDArray | None:
        if frame in self.cameras:
            return self.cameras[frame](time - START).as_matrix() @ OPTICAL.T
        return np.eye(3) if frame == 'microphones' else None

    def _note(self, output: FusionOutput | None) -> None:
        if output is not None:
            moment = Moment(to_seconds(output.bearing.header.stamp) - START, *output)
            self.moments.append(moment)
            self.on_output(moment)

    def _capture(self, t: float) -> None:
        """Make the messages of what ends at `t`."""
        if self.odometry(t):
            self.send('odometry', self._pose(t), t, 0.0)
        if self.gimbal is not None:
            state = GimbalState(child_frame_id='gimbal_link', orientation=quaternion(self.camera(t)), variance=1e-6,
                                source=GimbalState.SOURCE_FEEDBACK)
            state.header.stamp, state.header.frame_id = to_stamp(START + t), BASE_FRAME
            self.send('gimbal', state, t, 0.0)
        if self._steps % round(IMAGE_PERIOD / STEP) == 0 and self.sight(t):
            for camera in self.cameras:
                self._see(t, camera)
        if self._steps % round(HOP / STEP) == 0 and self.sound(t) and t >= WINDOW:
            self.send('doa', self.doa(t - 0.5 * WINDOW), t - 0.5 * WINDOW, SOUND_TAKES)

    def _pose(self, t: float) -> Odometry:
        attitude = self.attitude(t)
        rate = (self.attitude(t - 1e-3).inv() * attitude).as_rotvec() / 1e-3
        message = Odometry(child_frame_id=BASE_FRAME)
        message.header.stamp, message.header.frame_id = to_stamp(START + t), 'odom'
        message.pose.pose.orientation, message.twist.twist.angular = quaternion(attitude), vector(rate)
        x, y, z = map(float, self.path(t))
        message.pose.pose.position = Point(x=x, y=y, z=z)
        message.twist.twist.linear = vector(attitude.inv().apply((self.path(t) - self.path(t - 1e-3)) / 1e-3))
        return message

    def doa(self, t: float) -> DoaArray:
        """The directions of the window whose centre is at `t` (s)."""
        times = t + np.linspace(-0.5 * WINDOW, 0.5 * WINDOW, 6)[:-1] + 0.05
        heard: list[tuple[float, NDArray, NDArray, Source | None]] = []
        for number, source in enumerate(self.sources):
            source.errors = [*source.errors, self.random.normal(size=3)][-round(WINDOW / HOP):]
            error = COSINE_SIGMA * np.sum(source.errors, axis=0) / math.sqrt(len(source.errors)) + self._lasts
            if source.heard(t):
                mean = np.mean([self.body(time, number) for time in times], axis=0)
                heard.append((source.confidence, mean, error, source))
        for _ in range(self.random.poisson(self.sound_clutter)):
            false = unit(self.random.uniform(-180.0, 180.0), self.random.uniform(0.0, 20.0))
            heard.append((self.random.uniform(0.4, 0.8), false, np.zeros(3), None))
        heard.sort(key=lambda one: -one[0])
        message = DoaArray(window=WINDOW, method='formula', axis=Vector3(y=float(self.array == 'pair')))
        message.header.stamp, message.header.frame_id = to_stamp(START + t), 'microphones'
        found: list[NDArray] = []
        for confidence, mean, error, one in heard:
            measured = mean[MEASURED[self.array]]
            if all(np.linalg.norm(measured - other) > math.sin(RESOLUTION) for other in found):
                message.hypotheses += self._images(len(found), confidence, mean + error, one, t)
                found.append(measured)
                if one is not None and one is self.sources[0]:
                    self.measured.append((self.now + SOUND_TAKES, 'sound', math.degrees(message.hypotheses[-1].azimuth)))
        return message

    def _images(self, group: int, confidence: float, v: NDArray, source: Source | None, t: float) -> list[Doa]:
        """The directions that a measured projection may stem from."""
        values = {'confidence': confidence, 'ambiguity_group': group, 'cosine': math.nan, 'cosine_variance': math.nan,
                  'drone_probability': source.drone_probability(t) if source else math.nan,
                  'fundamental': source.fundamental * (1.0 + 0.03 * self.random.normal()) if source else math.nan}
        values['fundamental_variance'] = (0.03 * values['fundamental']) ** 2
        variance, level = COSINE_SIGMA**2 + self.lasting**2, math.hypot(v[0], v[1])
        if self.array == 'pair':
            cosine = min(max(float(v[1]), -1.0), 1.0)
            apart = math.asin(cosine)
            values |= {'cosine': cosine, 'cosine_variance': variance, 'elevation_variance': math.inf,
                       'azimuth_variance': variance / max(1.0 - cosine**2, 0.02), 'end_fire': abs(cosine) > 0.95}
            places = [(apart, 0.0), (math.copysign(math.pi, apart) - apart, 0.0)]
        elif self.array == 'upright':
            beside, up = math.sqrt(max(1.0 - v[0]**2 - v[2]**2, 0.0)), math.asin(min(max(v[2], -1.0), 1.0))
            values |= {'azimuth_variance': variance / max(beside**2, 0.02), 'elevation_variance': variance / math.cos(up)**2}
            places = [(math.atan2(side * beside, v[0]), up) for side in (1.0, -1.0)]
        else:
            up = math.acos(min(level, 1.0)) if self.array == 'square' else math.atan2(v[2], level)
            steep = max(math.sin(up) ** 2, 0.02) if self.array == 'square' else 1.0
            values |= {'azimuth_variance': variance / max(level**2, 0.02), 'elevation_variance': variance / steep}
            places = [(math.atan2(v[1], v[0]), up)]
        return [Doa(azimuth=azimuth, elevation=up, direction=vector(unit(math.degrees(azimuth), math.degrees(up))), **values)
                for azimuth, up in places]

    def _see(self, t: float, camera: str) -> None:
        message = Detection2DArray()
        message.header.stamp, message.header.frame_id = to_stamp(START + t), camera
        clear = 1.0 if self.visibility is None else self.visibility(t)
        for number, source in enumerate(self.sources):
            place = self.pixel(t, number, camera) if source.seen(t) else None
            if place is not None and self.random.random() < self.detection_probability * clear:
                place = place + PIXEL_SIGMA * self.random.normal(size=2) + self.misaligned[camera]
                message.detections.append(detection(place[0], place[1], source.score))
                if number == 0:
                    ray = OPTICAL.T @ [*((place - CENTRE) / FOCAL), 1.0]
                    self.measured.append((t + SIGHT_TAKES, 'sight', azimuth_of(self.cameras[camera](t).apply(ray))))
        for _ in range(self.random.poisson(self.sight_clutter)):
            message.detections.append(detection(self.random.uniform(0, WIDTH), self.random.uniform(0, HEIGHT),
                                                self.random.uniform(0.2, 0.5)))
        if self.visibility is not None:
            note = Visibility(visibility=float(clear), range=math.nan)
            note.header = message.header
            self.send('visibility', note, t, SIGHT_TAKES)
        self.send('detections', message, t, SIGHT_TAKES)

    def pixel(self, t: float, source: int = 0, camera: str = 'camera') -> NDArray | None:
        """Column and row (2,) of a source in the image of a camera; None where it is not in view."""
        x, y, z = OPTICAL @ self.cameras[camera](t).inv().apply(self.body(t, source))
        if z <= 0.0:
            return None
        place = FOCAL / z * np.array([x, y]) + CENTRE
        return place if 0.0 <= place[0] < WIDTH and 0.0 <= place[1] < HEIGHT else None

    def following(self, after: float = 0.0, until: float = math.inf) -> list[Moment]:
        """Outputs of a time (s) in which something is followed."""
        return [moment for moment in self.between(after, until) if moment.bearing.state != Bearing.STATE_NONE]

    def between(self, after: float = 0.0, until: float = math.inf) -> list[Moment]:
        """Outputs of a time (s)."""
        return [moment for moment in self.moments if after <= moment.t < until]

    def followed(self, after: float = 0.0, until: float = math.inf) -> float:
        """Share of the outputs of a time (s) in which something is followed."""
        return len(self.following(after, until)) / max(len(self.between(after, until)), 1)


def detection(column: float, row: float, score: float) -> Detection2D:
    """A box of BOX pixels around a place."""
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = 'drone', float(score)
    found = Detection2D(results=[result])
    found.bbox.center.position.x, found.bbox.center.position.y = float(column), float(row)
    found.bbox.size_x = found.bbox.size_y = BOX
    return found
