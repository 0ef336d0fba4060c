"""A guided test of a rig that runs: claps from two sides, a turn, a marker ahead, and a walk around it with marker and sound.

Each step tests one part of the description with what a person does, whose direction is known: the order of the microphones, the
heading, the camera. The walk lets the model of the set-up that fusion uses compare sound and sight.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection2DArray

from av_audio.messages import samples_of
from av_common.angles import wrap
from av_common.gimbal_history import GimbalHistory, NotYetKnownError, sample_of
from av_common.microphone_array import MicrophoneArray
from av_common.rig import CAMERAS, Rig
from av_common.stamps import to_seconds
from av_common.track import DRONE
from av_fusion.consistency.monitor import ConsistencyMonitor
from av_fusion.measurement.converter import MeasurementConverter, fixed_rotations, gimbal_rotations, pose_of
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_doas
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import direction
from av_interfaces.msg import AudioFrame, DoaArray, GimbalState
from av_view.doctor.cameras import Marker, find_marker
from av_view.doctor.finding import Finding
from av_view.doctor.microphones import DIRECTIONS, claps, judge_order
from av_vision.detections import Detections
from av_vision.messages import detections_message, image_from_message

CLASS = 'marker'  # of a sighting of the marker
PICTURE_PERIOD_S = 0.2  # between two pictures that are searched
CLAPS, TO_SIDE = 3, math.radians(35.0)  # claps of a step; from the asked side up to which a direction agrees
QUARTER, STILL = math.radians(60.0), math.radians(10.0)  # a turn that is enough, and one that is none
DRIFT = math.radians(5.0) / 60.0  # rad/s, of a rig that stands
STANDING_S = 10.0  # for which it must stand to say so
PICTURES = 15  # with the marker, that are enough
AHEAD, LEVEL = math.radians(10.0), math.radians(15.0)  # to which a person places the marker
SIDE_TOLERANCE = 0.15  # of its size at a distance that a person measures
LEAST_WALK, SWEEP = 50, math.radians(20.0)  # sightings and directions of sound, some 10 s of each; how far it must go
LOST_S = 2.0  # after the marker's last picture, from which detections count


@dataclass
class Observed:
    """What came since a step began; times in s, angles in rad in the body.

    Parameters:
        rate (Hz): of the samples.
        sound: blocks of samples (n, channels).
        heard, seen: directions of windows, and images with the marker or a target.
        headings: times and headings.
        markers: with the direction (azimuth, elevation) of each, NaN while the camera is not known.
    """

    rate: float = math.nan
    sound: list[NDArray] = field(default_factory=list)
    heard: list[DoaMeasurement] = field(default_factory=list)
    seen: list[CameraMeasurement] = field(default_factory=list)
    headings: list[tuple[float, float]] = field(default_factory=list)
    markers: list[tuple[Marker, float, float]] = field(default_factory=list)


class Step(NamedTuple):
    """One step.

    Parameters:
        title, prompt: name, and what the person is asked to do.
        seconds (s): that it takes at most.
        judge: findings of what was observed, none while it does not suffice; its argument is whether the time is over.
    """

    title: str
    prompt: str
    seconds: float
    judge: Callable[[bool], list[Finding]]


class LiveCheck:
    """Takes the messages of a rig, and judges them step by step.

    Attributes:
        observed: since the step began.
        statuses: newest status of each node that is not well.

    Parameters:
        rig: description of the rig.
        marker_side, marker_distance (m): of the marker as it is held ahead of the camera; a side of 0 is not known.
        namespace: of the rig, whose statuses count.
    """

    def __init__(self, rig: Rig, marker_side: float = 0.0, marker_distance: float = 1.0, namespace: str = '') -> None:
        self._marker_side, self._distance = marker_side, marker_distance
        self._array = MicrophoneArray(rig.array.positions, rig.array.geometry.name)  # along the axes of the body
        self._namespace = namespace.strip('/')
        self._gimbal = GimbalHistory()
        fixed = {rig.array.frame: rig.array.mount.rotation}
        seeing = {camera.optical_frame: camera.optical_to_body for camera in rig.cameras.values()}
        self._converter = MeasurementConverter(
            fixed_rotations(fixed | seeing) if rig.gimbal is None else gimbal_rotations(fixed, seeing, self._gimbal),
            [DRONE, CLASS])
        self._motion = RigMotion()
        self._monitor = ConsistencyMonitor(self._motion)
        self._pictured = self._marked = -math.inf
        self._standing: deque[tuple[float, float]] = deque(maxlen=20_000)
        self.statuses: dict[str, Finding] = {}
        self.observed = Observed()

    def steps(self) -> list[Step]:
        """What a person is asked to do, in turn."""
        array = self._array
        spans = {side: float(np.ptp(array.positions @ direction(math.radians(DIRECTIONS[side]), 0.0)))
                 for side in ('left', 'ahead')}
        sides = ('left', 'right') if spans['left'] > 0.5 * spans['ahead'] else ('ahead', 'behind')
        return [
            Step('rig', 'waiting for the topics of the rig', 15.0, self._judge_topics),
            *(Step('microphones', f'clap {CLAPS} times {_words(side)} the rig, from 2 m, at its height', 25.0,
                   partial(self._judge_claps, side)) for side in sides),
            Step('heading', 'turn the rig to its left (counter-clockwise seen from above) by a quarter, and leave it there',
                 30.0, self._judge_turn),
            Step('camera', f'hold the marker upright, {self._distance:g} m straight ahead of the rig', 30.0,
                 self._judge_marker),
            Step('sound and sight', 'walk to and fro ahead of the rig with marker and loudspeaker, or fly the drone; then turn '
                 'the rig to and fro', 60.0, self._judge_walk)]

    def begin(self) -> None:
        """A step begins."""
        self.observed = Observed()

    def on_audio(self, message: AudioFrame) -> None:
        """Take a block of samples."""
        self.observed.rate = float(message.sample_rate)
        self.observed.sound.append(samples_of(message))

    def on_doa(self, message: DoaArray) -> None:
        """Take the directions of a window; whatever sounds is what the person does."""
        found = [one._replace(drone_probability=math.nan) for one in self._converter.doa(message)]
        self.observed.heard += found[:1]
        self._monitor.add_doas(usable_doas(found))
        self._monitor.advance(to_seconds(message.header.stamp))

    def on_odometry(self, message: Odometry) -> None:
        """Take the rig's attitude. Raises ValueError for none."""
        pose = pose_of(message)
        self._motion.add(pose)
        self.observed.headings.append((pose.time, self._motion.yaw(pose.time)))

    def on_gimbal(self, message: GimbalState, arrival: float) -> None:
        """Take the gimbal's orientation, which arrived at a time (s)."""
        self._gimbal.add(sample_of(message), arrival)

    def on_camera_info(self, message: CameraInfo) -> None:
        """Take the camera model."""
        self._converter.set_camera_info(message)

    def on_image(self, message: Image) -> None:
        """Search a picture for the marker, a few times a second."""
        time = to_seconds(message.header.stamp)
        if 0.0 <= time - self._pictured < PICTURE_PERIOD_S:
            return
        self._pictured, marker = time, find_marker(image_from_message(message))
        if marker is None:
            return
        self._marked = time
        half = 0.5 * marker.side
        box = [marker.column - half, marker.row - half, marker.column + half, marker.row + half]
        best = self._see(detections_message(message.header, Detections(np.array([box]), np.ones(1), (CLASS,)), ['']))
        self.observed.markers.append((marker, *(best or (math.nan, math.nan))))

    def on_detections(self, message: Detection2DArray) -> None:
        """Take the detections of the rig's own detector, while the marker is not seen."""
        if not 0.0 <= to_seconds(message.header.stamp) - self._marked < LOST_S:
            self._see(message)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Take the statuses of nodes."""
        for status in message.status:
            self.statuses.pop(status.name, None)
            namespace = status.name.partition(':')[0].strip('/').rpartition('/')[0]
            if status.level != DiagnosticStatus.OK and namespace == self._namespace:
                self.statuses[status.name] = Finding('nodes', 'warning' if status.level == DiagnosticStatus.WARN else 'error',
                                                     f'{status.name}: {status.message}')

    def _see(self, message: Detection2DArray) -> tuple[float, float] | None:
        """Use the detections of an image; the direction of the best."""
        try:
            measurement = self._converter.detections(message)
        except NotYetKnownError:
            return None
        if measurement is None or measurement.best is None:
            return None
        self.observed.seen.append(measurement)
        self._monitor.add_camera(measurement)
        return measurement.best.azimuth, measurement.best.elevation

    def _judge_topics(self, over: bool) -> list[Finding]:
        came = {'audio/frames': self.observed.sound, 'odometry': self.observed.headings,
                'camera/image_raw': [self._pictured] if math.isfinite(self._pictured) else []}
        missing = [name for name, some in came.items() if not some]
        if missing and not over:
            return []
        return [_missing(name) for name in missing] or [Finding('rig', 'ok', f'{", ".join(came)} come')]

    def _judge_claps(self, side: str, over: bool) -> list[Finding]:
        """The order of the channels by most of the claps, and whether doa_node hears what the channels tell."""
        array, azimuth, observed = self._array, math.radians(DIRECTIONS[side]), self.observed
        blocks = [block for block in observed.sound if block.shape[1] == array.channels]
        if observed.sound and not blocks:
            return [Finding('microphones', 'error', f'{observed.sound[0].shape[1]} channels come, {array.name} has '
                            f'{array.channels}', 'set array_file of doa_node, or channels of audio_node')]
        heard = claps(np.concatenate(blocks), observed.rate) if blocks else []
        if len(heard) < CLAPS and not over:
            return []
        if not heard:
            return [Finding('microphones', 'unknown', f'no clap was heard {_words(side)} the rig', 'clap louder or closer')]
        judged = [judge_order(clap, observed.rate, array, azimuth) for clap in heard[:CLAPS]]
        words = [one.words for one in judged]
        verdict = max(judged, key=lambda one: words.count(one.words))
        self._standing += observed.headings
        if verdict.level != 'ok' or not observed.heard:
            return [verdict]
        best = max(observed.heard, key=lambda one: one.confidence)
        off = min(abs(float(wrap(one.azimuth - azimuth))) for one in best.hypotheses)
        return [verdict] if off < TO_SIDE else [verdict, Finding(
            'microphones', 'warning', f'doa_node hears the claps {_words(side)} the rig {math.degrees(off):.0f} deg off',
            'do walls reflect? Clap again in the open; is the mount of the array right?')]

    def _judge_turn(self, over: bool) -> list[Finding]:
        headings = self.observed.headings
        if not headings:
            return [_missing('odometry')] if over else []
        times, yaws = np.array(headings).T
        yaws = np.unwrap(yaws)
        turned = float(yaws[-1] - yaws[0])
        if not over and (abs(turned) < QUARTER or np.ptp(yaws[times > times[-1] - 1.0]) > 0.2 * STILL):
            return []
        words = f'the odometry turned by {math.degrees(turned):+.0f} deg while the rig turned to its left'
        if abs(turned) < STILL:
            return [Finding('heading', 'error', words, 'is the heading frozen, or was the rig not turned? With a heading '
                            'that does not turn each bearing in the world is wrong'), *self._drift()]
        if turned < 0.0:
            return [Finding('heading', 'error', words, 'odometry in ENU: counter-clockwise is positive (REP-103)')]
        return [Finding('heading', 'ok', words) if QUARTER <= turned <= 2.0 * QUARTER else
                Finding('heading', 'warning', words, 'a quarter is 90 deg: was it turned so far?'), *self._drift()]

    def _drift(self) -> list[Finding]:
        """Whether the heading moved while the person clapped, and the rig stood."""
        if len(self._standing) < 3 or self._standing[-1][0] - self._standing[0][0] < STANDING_S:
            return []
        time, heading = np.array(self._standing).T
        rate = float(np.polyfit(time - time[0], np.unwrap(heading), 1)[0])
        return [Finding('heading', 'warning', f'the heading drifts by {60.0 * math.degrees(rate):+.0f} deg a minute while the '
                        'rig stands', 'calibrate the gyroscope, or give the estimator a magnetometer or a second GNSS antenna')
                ] if abs(rate) > DRIFT else []

    def _judge_marker(self, over: bool) -> list[Finding]:
        markers = self.observed.markers
        if len(markers) < PICTURES and not over:
            return []
        if len(markers) < 3:
            return [Finding('camera', 'unknown', 'the marker was not seen',
                            'print it larger, hold it closer, upright and in light')]
        mirrored = np.median([marker.mirrored for marker, _, _ in markers]) > 0.5
        roll = _middle([marker.roll for marker, _, _ in markers if marker.mirrored == mirrored])
        azimuth, elevation = (_middle([one[k] for one in markers]) for k in (1, 2))
        found = []
        if mirrored:
            found.append(Finding('camera', 'error', 'the picture is mirrored', 'the camera driver\'s flip'))
        if abs(roll) > math.radians(20.0):
            found.append(Finding('camera', 'error', f'the picture is turned by {math.degrees(roll):+.0f} deg clockwise',
                                 'the roll in camera: mount: rpy_deg of the rig, or the camera driver\'s flip'))
        for name, angle, most in (('azimuth', azimuth, AHEAD), ('elevation', elevation, LEVEL)):
            if abs(angle) > most:
                found.append(Finding('camera', 'warning', f'the marker ahead is seen at {name} {math.degrees(angle):+.0f} deg',
                                     'yaw and pitch in camera: mount: rpy_deg of the rig; or was it not straight ahead?'))
        if math.isnan(azimuth):
            found.append(_missing('camera/camera_info'))
        found += self._judge_size([marker.side for marker, _, _ in markers])
        return found or [Finding('camera', 'ok', f'the picture is upright, and the marker ahead is seen at azimuth '
                                 f'{math.degrees(azimuth):+.0f}, elevation {math.degrees(elevation):+.0f} deg')]

    def _judge_size(self, sides: list[float]) -> list[Finding]:
        """The focal length by the size of the marker, where that is known."""
        camera = self._converter.cameras.get(CAMERAS[0])
        if camera is None or not self._marker_side > 0.0:
            return []
        ratio = float(np.median(sides)) * self._distance / (self._marker_side * camera.fx)
        return [Finding('camera', 'warning', f'the marker is {ratio:.2f} times as large as the focal length says at '
                        f'{self._distance:g} m', 'horizontal_fov_deg or calibration_file of the camera')
                ] if abs(math.log(ratio)) > SIDE_TOLERANCE else []

    def _judge_walk(self, over: bool) -> list[Finding]:
        fault = self._monitor.fault
        if fault is not None and (fault.is_certain or over):
            return [Finding('sound and sight', 'error' if fault.is_certain else 'warning', fault.text, fault.mend)]
        if not over:
            return []
        seen, heard = [sight.best.azimuth for sight in self.observed.seen if sight.best is not None], len(self.observed.heard)
        counts = f'{len(seen)} sightings and {heard} directions of sound'
        if min(len(seen), heard) < LEAST_WALK or np.ptp(seen) < SWEEP:
            return [Finding('sound and sight', 'unknown', f'{counts} are too few, or too near to each other',
                            'walk slowly from one edge of the view to the other')]
        return [Finding('sound and sight', 'ok', f'{counts}: nothing contradicts the description')]


def _words(side: str) -> str:
    return f'to the {side} of' if side in ('left', 'right') else {'ahead': 'in front of', 'behind': 'behind'}[side]


def _missing(topic: str) -> Finding:
    return Finding('rig', 'error', f'nothing comes on {topic}',
                   'start the rig beside this: ros2 launch av_fusion rig.launch.py source:=hardware rig:=RIG; --namespace')


def _middle(angles: list[Any]) -> float:
    """Median angle (rad) around the circle, without those that are not known; NaN of none."""
    known = np.array([angle for angle in angles if math.isfinite(angle)])
    cosine, sine = (np.median(part(known)) if len(known) else math.nan for part in (np.cos, np.sin))
    return math.atan2(sine, cosine)
