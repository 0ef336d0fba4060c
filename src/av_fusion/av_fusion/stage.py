"""The fusion stage: messages of the sensors and their times of arrival in, bearing and state of the fusion out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from av_common.camera import PinholeCamera
from av_common.cue import CUE_SIGMA, cue_direction
from av_common.frames import BASE_FRAME
from av_common.freshness import FUTURE_S, is_of_clock
from av_common.gimbal_history import GimbalHistory, NotYetKnownError, sample_of
from av_common.rate_meter import MISSING_AFTER_S
from av_common.rig import CAMERAS, camera_topic
from av_common.stamps import to_seconds, to_stamp
from av_common.track import Source, State, Targets, Track
from av_common.track_messages import bearing_message, state_message, targets_message
from av_fusion.consistency.monitor import ConsistencyMonitor
from av_fusion.measurement.converter import MeasurementConverter, RotationOf, pose_of
from av_fusion.measurement.geometry import usable_odds
from av_fusion.measurement.input_gate import InputGate
from av_fusion.measurement.measurements import usable_doas
from av_fusion.posterior import azimuth_posterior
from av_fusion.settings import Tracker, make_tracker
from av_interfaces.msg import (
    AzimuthPosterior,
    Bearing,
    DoaArray,
    DoaOdds,
    FusionState,
    GimbalState,
    PointingCommand,
    TrackArray,
    Visibility,
)

DOA, ODDS, ODOMETRY, GIMBAL = 'doa', 'doa/odds', 'odometry', 'gimbal/state'
DETECTIONS, VISIBILITY, INFO = 'detections', 'visibility', 'camera/camera_info'  # of the first camera
MOST_WAITING = 20  # measurements of each input that wait for a transform
CUE_PERIOD_S = 1.0  # cues repeat what is known: one of this time is used
CUE_WRONG = 0.2  # probability that a cue concerns another target
RATE_HZ = 20.0  # of outputs while no measurement arrives: smooth for a gimbal, whose commands have the same rate
PERIOD_S = 1.0 / RATE_HZ
LONGEST_SILENCE_S = 60.0  # longer pauses between inputs are not filled by `outputs_until`
VISIBILITY_AGE_S = 1.0  # largest difference between the stamps of a visibility and of an image to which it applies
UNSEEN = (-math.inf, math.nan, 1.0)  # stamp (s), visibility and searched share of an image of which none is stated
TRANSFORM_WAIT_S = 0.15  # how long a measurement waits for the orientation of its sensor at its capture time


class FusionOutput(NamedTuple):
    """The messages that follow from one input or from the passing of time."""

    bearing: Bearing
    state: FusionState
    targets: TrackArray


class FusionStage:
    """Feeds a tracker from messages and reports its track.

    Each usable direction of arrival or image gives an output immediately; without them `on_time` gives one each PERIOD_S.
    Times are in s of one clock. Arrivals must not decrease, except for a step of the clock: then all but ids and what was
    learned of the array begins anew, since silence could not be told by stamps that are still to come.

    Attributes:
        gate: decides which messages are used, and counts the others.
        untransformed: number of measurements that were not used because their sensor's orientation came too late.
        consistency: whether the rig is as described; None where that is not asked.

    Parameters:
        tracker: estimates the track.
        converter: converts messages to measurements in the body frame.
        observer: is told of what the tracker gets and has given, also of what is not used: by `on_pose(pose)`,
            `on_doa(measurements, arrival)`, `on_camera(measurement, message, arrival)`, `on_track(track, time)`; or None.
        gimbal: orientations of the gimbal that carries the cameras, added to by `on_gimbal`; None without one.
        cameras: names of the rig's cameras.
        consistency: see the attribute.
        stop_at_faults: where the rig is surely not as described, bearings are uncertain and no motion rests on them.
    """

    def __init__(self, tracker: Tracker, converter: MeasurementConverter, observer: Any = None,
                 gimbal: GimbalHistory | None = None, cameras: Sequence[str] = CAMERAS[:1],
                 consistency: ConsistencyMonitor | None = None, stop_at_faults: bool = True) -> None:
        self.consistency, self._stop_at_faults = consistency, stop_at_faults
        self.tracker, self.converter = tracker, converter
        self._cameras = {camera_topic(camera, DETECTIONS): camera for camera in cameras}  # by the topic of their detections
        self.gate = InputGate((DOA, *self._cameras, ODOMETRY))
        self._observer = observer
        self._visibilities: dict[str, tuple[float, float, float]] = {}  # by camera, see UNSEEN
        self._odds: dict[float, tuple[float, ...]] = {}  # of windows that have not been used, by their stamps (s)
        self._last_output = self._cued = self._now = -math.inf
        self._gimbal = gimbal
        self.untransformed = 0
        self._waiting: dict[str, deque[tuple[Any, float]]] = {
            name: deque(maxlen=MOST_WAITING) for name in (DOA, *self._cameras)}

    def on_doa(self, message: DoaArray, arrival: float) -> FusionOutput | None:
        """Use directions of arrival; None if their stamp belongs to another clock.

        Parameters:
            message: directions of arrival of one window.
            arrival (s): time of its arrival.
        """
        return self._queue(DOA, message, arrival)

    def on_odds(self, message: DoaOdds) -> None:
        """Store what a window says of its strongest source until its directions come. Raises ValueError for impossible odds."""
        if ODDS not in self.gate.contested:
            self._odds[to_seconds(message.header.stamp)] = usable_odds(message)
            if len(self._odds) > MOST_WAITING:
                del self._odds[next(iter(self._odds))]

    def on_detections(self, message: Detection2DArray, arrival: float, camera: str = CAMERAS[0]) -> FusionOutput | None:
        """Use the detections of an image, or their absence; None if stamp, frame or camera cannot be used.

        An image whose camera moves waits for up to TRANSFORM_WAIT_S until the camera's orientation is known.

        Parameters:
            message: detections in one image.
            arrival (s): time of its arrival.
            camera: the camera's name.
        """
        return self._queue(camera_topic(camera, DETECTIONS), message, arrival)

    def on_gimbal(self, message: GimbalState, arrival: float) -> FusionOutput | None:
        """Note the gimbal's orientation, and use the images that waited for it.

        Parameters:
            message: the orientation.
            arrival (s): time of its arrival.

        Raises ValueError for one that cannot be used.
        """
        if self._gimbal is None or GIMBAL in self.gate.contested:
            return None
        self._follow_clock(arrival)
        self._gimbal.add(sample_of(message), arrival)
        return self._use_waiting(arrival)

    def on_visibility(self, message: Visibility, camera: str = CAMERAS[0]) -> None:
        """Store the visibility for images of a camera of about the same time.

        Parameters:
            message: the visibility.
            camera: the camera's name.
        """
        if camera_topic(camera, VISIBILITY) not in self.gate.contested:
            searched = 1.0 - message.unsearched if 0.0 <= message.unsearched <= 1.0 else 1.0
            self._visibilities[camera] = to_seconds(message.header.stamp), message.visibility, searched

    def on_camera_info(self, message: CameraInfo, camera: str = CAMERAS[0]) -> None:
        """Take the model of a camera that its detections refer to.

        Parameters:
            message: the model.
            camera: the camera's name.
        """
        if camera_topic(camera, INFO) not in self.gate.contested:
            self.converter.set_camera_info(message, camera)

    def on_odometry(self, message: Odometry, arrival: float) -> None:
        """Use the rig's attitude.

        Parameters:
            message: attitude and yaw rate of the rig in ENU.
            arrival (s): time of its arrival.

        Raises ValueError for one without attitude.
        """
        self._follow_clock(arrival)
        if not self.gate.accept(ODOMETRY, to_seconds(message.header.stamp), arrival):
            return
        pose = pose_of(message)
        if self._observer is not None:
            self._observer.on_pose(pose)
        self.tracker.add_pose(pose)

    def on_command(self, message: PointingCommand, arrival: float) -> None:
        """Note what the body is told, by which odometry is judged; bearings do not follow it.

        Parameters:
            message: the command.
            arrival (s): time of its arrival.
        """
        self._follow_clock(arrival)
        if self.consistency is not None:
            turns = message.move_body and math.isfinite(message.yaw_rate)
            self.consistency.add_command(arrival, message.yaw_rate if turns else 0.0)

    def on_cue(self, message: PointStamped, arrival: float) -> None:
        """Decide between mirror images by a place where other rigs have a target; bearings become no more precise by it.

        One in the body's frame is an order to look there, which says nothing about where the target is.

        Parameters:
            message: the place, seen from the rig.
            arrival (s): time of its arrival.

        Raises ValueError for a place that is none, and for a stamp of another clock.
        """
        direction, stamp = cue_direction(message), to_seconds(message.header.stamp)
        if not is_of_clock(stamp, arrival):
            raise ValueError(f'stamp of a cue {stamp - arrival:+.2f} s from its arrival')
        if message.header.frame_id == BASE_FRAME or 0.0 <= arrival - self._cued < CUE_PERIOD_S:
            return
        self._cued = arrival
        self.tracker.use_cue(direction, CUE_SIGMA**2, CUE_WRONG)

    @property
    def due(self) -> float:
        """When the next output is due if no measurement arrives before."""
        return self._last_output + PERIOD_S

    def on_time(self, now: float) -> FusionOutput | None:
        """The periodic output, None before it is due."""
        self._follow_clock(now)
        used = self._use_waiting(now)
        waiting = self._last_output <= now < self.due - 0.1 * PERIOD_S  # timers are not exact
        return used if waiting else self._output(now)

    def outputs_until(self, now: float) -> Iterator[FusionOutput]:
        """The periodic outputs that are due until `now`, each at its own time; for replay, which has no timer."""
        if now - self._last_output > LONGEST_SILENCE_S:
            self._last_output = now - PERIOD_S
        while self.due <= now:
            yield self._output(self.due)

    def posterior(self, now: float) -> AzimuthPosterior:
        """Where the targets may be at `now`; without sectors for a tracker that has no posterior."""
        densities = self.tracker.densities()
        probability = azimuth_posterior(densities, self.tracker.motion, now).tolist() if densities else []
        return AzimuthPosterior(header=Header(stamp=to_stamp(now), frame_id=BASE_FRAME), probability=probability)

    def missing(self, now: float) -> list[str]:
        """Names of inputs without recent messages; odometry also where its attitude is old, frozen or not known."""
        silent = self.gate.silent(now, MISSING_AFTER_S)
        return silent if ODOMETRY in silent or self.tracker.motion.is_known(now) else [*silent, ODOMETRY]

    @property
    def left_out(self) -> frozenset[str]:
        """Cameras that are not used, see `ConsistencyMonitor`; none where a user decided who knows better."""
        return self.consistency.left_out if self.consistency is not None and self._stop_at_faults else frozenset()

    def refuse_contested(self, publishers: Mapping[str, list[str]]) -> None:
        """State which inputs have more than one publisher: none of their messages is used, and every bearing is a prediction.

        Parameters:
            publishers: names of the publishers of each input that has several.
        """
        for name in publishers:
            self._waiting.get(name, deque()).clear()
        self.gate.contested = dict(publishers)

    def _follow_clock(self, now: float) -> None:
        """Forget what refers to a clock that has stepped back to `now` (s) since."""
        if now < self._now - FUTURE_S:
            self.tracker.reset()
            self.tracker.motion.restart()
            self.gate.restart()
            self._visibilities.clear()
            self._odds.clear()
            self._last_output = self._cued = -math.inf
            for waiting in self._waiting.values():
                waiting.clear()
        self._now = now

    def _queue(self, name: str, message: Any, arrival: float) -> FusionOutput | None:
        self._follow_clock(arrival)
        if not self.gate.accept(name, to_seconds(message.header.stamp), arrival):
            return None
        self._waiting[name].append((message, arrival))
        return self._use_waiting(arrival)

    def _use_waiting(self, now: float) -> FusionOutput | None:
        """Use the messages for which the orientation of the sensor is known by now, in their order."""
        used = False
        for name, waiting in self._waiting.items():
            while waiting:
                message, arrival = waiting.popleft()  # whatever it raises, it is not tried again
                try:
                    used = (self._use_doa(message, arrival) if name == DOA else
                            self._use_detections(self._cameras[name], message, arrival)) or used
                except NotYetKnownError:
                    if arrival <= now < arrival + TRANSFORM_WAIT_S:
                        waiting.appendleft((message, arrival))
                        break
                    self.untransformed += 1
        return self._output(now) if used else None

    def _use_doa(self, message: DoaArray, arrival: float) -> bool:
        odds = self._odds.pop(to_seconds(message.header.stamp), ()) if self._odds else ()
        measurements = self.converter.doa(message, odds)
        if self._observer is not None:
            self._observer.on_doa(measurements, arrival)
        measurements = usable_doas(measurements)
        if self.consistency is not None:
            self.consistency.add_doas(measurements)
        self.tracker.add_doas(measurements)
        return True

    def _use_detections(self, camera: str, message: Detection2DArray, arrival: float) -> bool:
        stamp, visibility, searched = self._visibilities.get(camera, UNSEEN)
        if abs(to_seconds(message.header.stamp) - stamp) >= VISIBILITY_AGE_S:
            _, visibility, searched = UNSEEN
        measurement = self.converter.detections(message, visibility, searched, camera)
        if measurement is None:
            return False
        if self._gimbal is not None:
            measurement = measurement.blurred(self._gimbal.variance(to_seconds(message.header.stamp)))
        if self._observer is not None:
            self._observer.on_camera(measurement, message, arrival)
        if self.consistency is not None:
            self.consistency.add_camera(measurement)
            if camera in self.left_out:
                return False
        self.tracker.add_camera(measurement)
        return True

    def _output(self, now: float) -> FusionOutput:
        self._last_output, used = now, self.left_out
        fault = self.consistency.advance(now) if self.consistency is not None else None
        if self.left_out - used:
            self.tracker.reset(learned=True)  # all that is known rests on that camera, too
        track = self.tracker.estimate(now)
        targets = self.tracker.targets(track)
        if self.gate.contested:
            reason = '; '.join(f'{name} has {len(nodes)} publishers ({", ".join(nodes)})'
                               for name, nodes in self.gate.contested.items())
            track, targets = as_predictions(track, targets, reason)
        elif self.consistency is not None and self._stop_at_faults:
            belief = self.consistency.belief
            track = belief.of(track)
            targets = targets._replace(targets=tuple([one._replace(track=belief.of(one.track)) for one in targets.targets]))
            if fault is not None and fault.is_certain:
                reason = f'the rig is not as described: {fault.text}'
                track, targets = as_predictions(track, targets, reason, sides=False)
            elif fault is not None and self.left_out:
                track = track._replace(reason=f'{track.reason}; {" and ".join(sorted(self.left_out))} not used: {fault.text}')
        if self._observer is not None:
            self._observer.on_track(track, now)
        frame = BASE_FRAME
        return FusionOutput(bearing_message(track, frame), state_message(track, self.missing(now), frame),
                            targets_message(targets, frame))


def as_predictions(track: Track, targets: Targets, reason: str, sides: bool = True) -> tuple[Track, Targets]:
    """The estimates as predictions, on which nothing moves, for a reason: one of several publishers may be a forger.

    They state no measurement, as what comes by the other inputs is judged together with what the forger's left behind.

    Parameters:
        track: what is followed.
        targets: all targets.
        reason: what is published as such.
        sides: whether front and back may be told: not by a rig that is certainly not as described.
    """
    state = State.NONE if track.state == State.NONE else State.COASTING
    predicted = _unmeasured(track, sides)._replace(state=state, reason=reason, requested_rotation=0.0, look=None,
                                                   front_probability=track.front_probability if sides else 0.5)
    return predicted, targets._replace(targets=tuple(
        [target._replace(track=_unmeasured(target.track, sides)) for target in targets.targets]))


def _unmeasured(track: Track, sides: bool) -> Track:
    return track._replace(source=Source.NOTHING, measured=0.0, resolved=track.resolved and sides)


def make_fusion_stage(parameters: Any, rotation_of: RotationOf,
                      models: Mapping[str, PinholeCamera] | None = None, observer: Any = None,
                      tracker: Tracker | None = None, gimbal: GimbalHistory | None = None,
                      cameras: Sequence[str] = CAMERAS[:1]) -> FusionStage:
    """A stage from the parameters of fusion_node.

    Parameters:
        parameters: the node's parameters, or those of `av_common.parameters.node_parameters`.
        rotation_of: see `RotationOf`.
        models: intrinsics of cameras until a CameraInfo arrives, by their names.
        observer: see `FusionStage`.
        tracker: used instead of the one that the parameters describe.
        gimbal, cameras: see `FusionStage`.
    """
    converter = MeasurementConverter(rotation_of, cameras=models)
    check = parameters.setup_check
    tracker = tracker or make_tracker(parameters)
    delays = parameters.sound_delay, parameters.sight_delay
    monitor = ConsistencyMonitor(tracker.motion, *delays, cameras) if check != 'off' else None
    return FusionStage(tracker, converter, observer, gimbal, cameras, monitor, check == 'stop')
