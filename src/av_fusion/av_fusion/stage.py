"""The fusion stage: messages of the sensors and their times of arrival in, bearing and state of the fusion out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from av_common.camera import PinholeCamera
from av_common.cue import cue_direction
from av_common.freshness import FUTURE_S
from av_common.gimbal_history import GimbalHistory, NotYetKnownError, sample_of
from av_common.stamps import to_seconds, to_stamp
from av_common.track_messages import bearing_message, state_message, targets_message
from av_fusion.checkpoints import Checkpoints
from av_fusion.contested_inputs import DETECTIONS, DOA, ODOMETRY, ContestedInputs
from av_fusion.filter.azimuth_posterior import azimuth_posterior
from av_fusion.filter.fixed_emitters import FixedEmitters, FixedEmitterSettings
from av_fusion.measurement.converter import MeasurementConverter, RotationOf
from av_fusion.measurement.gimbal import blurred
from av_fusion.measurement.input_gate import InputGate
from av_fusion.measurement.odometry import pose_of
from av_fusion.observer import FusionObserver
from av_fusion.settings import make_tracker
from av_fusion.stage_settings import FusionStageSettings
from av_fusion.tracker_protocol import Tracker
from av_interfaces.msg import AzimuthPosterior, Bearing, DoaArray, FusionState, GimbalState, TrackArray, Visibility

MOST_WAITING = 20  # measurements of each input that wait for a transform
CUE_PERIOD_S = 1.0  # cues repeat what is known: one of this time is used
CUE_SIGMA = math.radians(10.0)  # of a cue's direction: headings, positions, and motion since its time
CUE_WRONG = 0.2  # probability that a cue concerns another target
LONGEST_SILENCE_S = 60.0  # longer pauses between inputs are not filled by `outputs_until`


class FusionOutput(NamedTuple):
    """The messages that follow from one input or from the passing of time."""

    bearing: Bearing
    state: FusionState
    targets: TrackArray


class FusionStage:
    """Feeds a tracker from messages and reports its track.

    Each usable direction of arrival or image gives an output immediately; without them `on_time` gives `rate` outputs a second.
    Times are in s of one clock. Arrivals must not decrease, except for a restart of the clock.

    Attributes:
        emitters: sources at fixed places that are no targets.
        gate: decides which messages are used, and counts the others.
        untransformed: number of measurements that were not used because their sensor's orientation came too late.

    Parameters:
        tracker: estimates the track.
        converter: converts messages to measurements in the body frame.
        settings: see `FusionStageSettings`.
        observer: is called with measurements and tracks, or None.
        gimbal: orientations of the gimbal that carries the camera, added to by `on_gimbal`; None without one.
        checkpoints: keeps states of the tracker, to return to where an input has a second source; None to keep none.
    """

    def __init__(self, tracker: Tracker, converter: MeasurementConverter, settings: FusionStageSettings | None = None,
                 observer: FusionObserver | None = None, gimbal: GimbalHistory | None = None,
                 checkpoints: Checkpoints | None = None) -> None:
        self.settings = settings or FusionStageSettings()
        self.tracker, self.converter = tracker, converter
        self.emitters = FixedEmitters(self.settings.fixed_emitters, tracker.motion)
        self.gate = InputGate((DOA, DETECTIONS, ODOMETRY), self.settings.clock_tolerance)
        self._checkpoints = checkpoints
        self._observer = observer
        self._period = 1.0 / self.settings.rate
        self._visibility = (-math.inf, math.nan)  # stamp of the image, visibility
        self._last_output = self._cued = -math.inf
        self._gimbal = gimbal
        self._contested = ContestedInputs(self.gate)
        self.untransformed = 0
        self._waiting: dict[str, deque[tuple[Any, float]]] = {name: deque(maxlen=MOST_WAITING) for name in (DOA, DETECTIONS)}

    def on_doa(self, message: DoaArray, arrival: float) -> FusionOutput | None:
        """Use directions of arrival; None if their stamp belongs to another clock.

        Parameters:
            message: directions of arrival of one window.
            arrival (s): time of its arrival.
        """
        return self._queue(DOA, message, arrival)

    def on_detections(self, message: Detection2DArray, arrival: float) -> FusionOutput | None:
        """Use the detections of an image, or their absence; None if stamp, frame or camera cannot be used.

        An image whose camera moves waits for up to `transform_wait` until the camera's orientation is known.

        Parameters:
            message: detections in one image.
            arrival (s): time of its arrival.
        """
        return self._queue(DETECTIONS, message, arrival)

    def on_gimbal(self, message: GimbalState, arrival: float) -> FusionOutput | None:
        """Note the gimbal's orientation, and use the images that waited for it.

        Parameters:
            message: the orientation.
            arrival (s): time of its arrival.

        Raises ValueError for one that cannot be used.
        """
        if self._gimbal is None:
            return None
        self._gimbal.add(sample_of(message, self.settings.base_frame, ''), arrival)
        return self._use_waiting(arrival)

    def on_visibility(self, message: Visibility) -> None:
        """Store the visibility for images of about the same time."""
        self._visibility = (to_seconds(message.header.stamp), message.visibility)

    def on_camera_info(self, message: CameraInfo) -> None:
        """Take the camera model that detections refer to."""
        self.converter.set_camera_info(message)

    def on_odometry(self, message: Odometry, arrival: float) -> None:
        """Use the rig's attitude.

        Parameters:
            message: attitude and yaw rate of the rig in ENU.
            arrival (s): time of its arrival.
        """
        pose = pose_of(message) if self._accept(ODOMETRY, message, arrival) else None
        if pose is None or not self._contested.use_pose(self.tracker, pose, arrival):
            return
        jump = self.tracker.add_pose(pose)
        if jump is not None:
            self.emitters.turn_world(jump)

    def on_cue(self, message: PointStamped, arrival: float) -> None:
        """Decide between mirror images by a place where other rigs have a target; bearings become no more precise by it.

        One in the body's frame is an order to look there, which says nothing about where the target is.

        Parameters:
            message: the place, seen from the rig.
            arrival (s): time of its arrival.

        Raises ValueError for a place that is none, and for a stamp of another clock.
        """
        direction, stamp = cue_direction(message), to_seconds(message.header.stamp)
        if not -self.settings.clock_tolerance <= stamp - arrival <= FUTURE_S:
            raise ValueError(f'stamp of a cue {stamp - arrival:+.2f} s from its arrival')
        if message.header.frame_id == self.settings.base_frame or 0.0 <= arrival - self._cued < CUE_PERIOD_S:
            return
        self._cued = arrival
        for density in self.tracker.densities():
            density.mixture.weigh_by_cue(direction, CUE_SIGMA**2, CUE_WRONG)

    @property
    def due(self) -> float:
        """When the next output is due if no measurement arrives before."""
        return self._last_output + self._period

    def on_time(self, now: float) -> FusionOutput | None:
        """The periodic output, None before it is due."""
        used = self._use_waiting(now)
        waiting = self._last_output <= now < self.due - 0.1 * self._period  # timers are not exact
        return used if waiting else self._output(now)

    def outputs_until(self, now: float) -> Iterator[FusionOutput]:
        """The periodic outputs that are due until `now`, each at its own time; for replay, which has no timer."""
        if now - self._last_output > LONGEST_SILENCE_S:
            self._last_output = now - self._period
        while self.due <= now:
            yield self._output(self.due)

    def posterior(self, now: float) -> AzimuthPosterior:
        """Where the targets may be at `now`; without sectors for a tracker that has no posterior."""
        densities = self.tracker.densities()
        probability = azimuth_posterior(densities, self.tracker.motion, now).tolist() if densities else []
        return AzimuthPosterior(header=Header(stamp=to_stamp(now), frame_id=self.settings.base_frame), probability=probability)

    def missing(self, now: float) -> list[str]:
        """Names of inputs without recent messages; odometry also where its attitude is old, frozen or not known."""
        silent = self.gate.silent(now, self.settings.missing_after)
        return silent if ODOMETRY in silent or self.tracker.motion.is_known(now) else [*silent, ODOMETRY]

    def _accept(self, name: str, message: Any, arrival: float) -> bool:
        contested_before, stamp = self.gate.sources.is_contested(name, arrival), to_seconds(message.header.stamp)
        accepted = self.gate.accept(name, stamp, arrival)
        if self.gate.sources.is_contested(name, arrival) and not contested_before:
            self._undo(name, arrival)
        return accepted or self.gate.continues(name, stamp, arrival)

    def _undo(self, name: str, now: float) -> None:
        """Return to the state from before an input had two sources: first messages of the second one were used."""
        self._waiting.get(name, deque()).clear()
        if self._checkpoints is not None:
            self.tracker, self.emitters = self._checkpoints.before(now) or (self.tracker, self.emitters)
            self._contested.resume(self.tracker)

    def _queue(self, name: str, message: Any, arrival: float) -> FusionOutput | None:
        if not self._accept(name, message, arrival):
            return None
        self._waiting[name].append((message, arrival))
        return self._use_waiting(arrival)

    def _use_waiting(self, now: float) -> FusionOutput | None:
        """Use the messages for which the orientation of the sensor is known by now, in their order."""
        used = False
        for name, use in ((DOA, self._use_doa), (DETECTIONS, self._use_detections)):
            waiting = self._waiting[name]
            while waiting:
                message, arrival = waiting[0]
                try:
                    used = use(message, arrival) or used
                except NotYetKnownError:
                    if arrival <= now < arrival + self.settings.transform_wait:
                        break
                    self.untransformed += 1
                except ValueError:
                    waiting.popleft()
                    raise
                waiting.popleft()
        return self._output(now) if used else None

    def _use_doa(self, message: DoaArray, arrival: float) -> bool:
        measurements = self._contested.use_doas(self.tracker, self.converter.doa(message), to_seconds(message.header.stamp),
                                                arrival)
        if measurements is None:
            return False
        measurements = self.emitters.judge(measurements)
        if self._observer is not None:
            self._observer.on_doa(measurements, arrival)
        self.tracker.add_doas([measurement for measurement in measurements
                               if measurement.confidence >= self.settings.min_doa_confidence])
        return True

    def _use_detections(self, message: Detection2DArray, arrival: float) -> bool:
        stamp, visibility = self._visibility
        time = to_seconds(message.header.stamp)
        measurement = self.converter.detections(
            message, visibility if abs(time - stamp) < self.settings.visibility_age else math.nan)
        if measurement is not None:
            measurement = self._contested.use_image(self.tracker, measurement, arrival)
        if measurement is None:
            return False
        if self._gimbal is not None:
            measurement = blurred(measurement, self._gimbal.variance(time))
        if self._observer is not None:
            self._observer.on_camera(measurement, message, arrival)
        self.emitters.see(measurement)
        self.tracker.add_camera(measurement)
        return True

    def _output(self, now: float) -> FusionOutput:
        self._last_output = now
        track = self.tracker.estimate(now)
        track, targets = self._contested.supported(track, self.tracker.targets(track), now)
        if self._checkpoints is not None:
            self._checkpoints.keep((self.tracker, self.emitters), now)
        if self._observer is not None:
            self._observer.on_track(track, now)
        frame = self.settings.base_frame
        return FusionOutput(bearing_message(track, frame), state_message(track, self.missing(now), frame),
                            targets_message(targets, frame))


def make_fusion_stage(parameters: Any, rotation_of: RotationOf,
                      camera: PinholeCamera | None = None, observer: FusionObserver | None = None,
                      tracker: Tracker | None = None, gimbal: GimbalHistory | None = None,
                      checkpoints: Checkpoints | None = None) -> FusionStage:
    """A stage from the parameters of fusion_node.

    Parameters:
        parameters: the node's parameters, or those of `av_common.parameters.node_parameters`.
        rotation_of: see `RotationOf`.
        camera: intrinsics until a CameraInfo arrives; None while unknown.
        observer: see `FusionStage`.
        tracker: used instead of the one that the parameters describe.
        gimbal, checkpoints: see `FusionStage`.
    """
    converter = MeasurementConverter(rotation_of, parameters.target_classes, camera)
    emitters = FixedEmitterSettings(parameters.fixed_emitters.enabled, parameters.fixed_emitters.learn_after,
                                    parameters.sound_delay, parameters.sight_delay)
    settings = FusionStageSettings(parameters.base_frame, parameters.rate, parameters.min_sound_confidence,
                                   fixed_emitters=emitters)
    return FusionStage(tracker or make_tracker(parameters), converter, settings, observer, gimbal, checkpoints)
