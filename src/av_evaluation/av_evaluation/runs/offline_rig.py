"""The stages of the rig, fed with arrays instead of messages: for simulated runs and for recorded material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from av_audio.drone_classifier import load_model
from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage
from av_bags import topics
from av_common.frames import BASE_FRAME
from av_common.gimbal_history import GimbalHistory
from av_common.microphone_array import MicrophoneArray
from av_common.rig import CAMERAS, CameraMount, Mount
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_stamp
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.replay.pipeline import Pipeline
from av_fusion.measurement.converter import MeasurementConverter, fixed_rotations, gimbal_rotations
from av_fusion.settings import Tracker
from av_fusion.stage import FusionStage
from av_interfaces.msg import Bearing, TrackArray
from av_sim_bridge.messages import odometry_message
from av_sim_bridge.vehicle import VehicleState
from av_sim_bridge.wire.gimbal import GimbalSample
from av_vision.messages import image_message
from av_vision.stage import DetectionStage

CAMERA, ON_BODY, HEARING = CameraMount(), Mount(), LocalizerSettings()  # the defaults


class OfflineRig:
    """Passes samples, images and poses through the stages of the rig and records what follows. Times are in s.

    Attributes:
        log: truth, measurements and bearings.
        tracker: estimates the bearing.
        hearing, fusion: the stages.
        bearing, targets: the newest bearing, and all tracks; None before the first.

    Parameters:
        array: microphones.
        tracker: estimates the bearing.
        camera: on the body, or on the gimbal.
        array_mount: the array's on the body.
        detection: detects in images; None where only detections are given.
        estimators: further methods of `LocalizerSettings`, whose directions go to the log only.
        settings: of the localizer.
        ego_noise: of the rig alone.
        gimbal: whether a gimbal carries the camera.
    """

    def __init__(self, array: MicrophoneArray, tracker: Tracker, camera: CameraMount = CAMERA,
                 array_mount: Mount = ON_BODY, detection: DetectionStage | None = None, estimators: Sequence[str] = (),
                 settings: LocalizerSettings = HEARING, ego_noise: NoiseRecording | None = None,
                 gimbal: bool = False) -> None:
        self.tracker = tracker
        self.bearing: Bearing | None = None
        self.targets: TrackArray | None = None
        rotations = {'microphones': array_mount.rotation, 'camera': camera.optical_to_body}
        history = GimbalHistory() if gimbal else None
        rotation_of = (fixed_rotations(rotations) if history is None
                       else gimbal_rotations(rotations, {'camera': camera.optical_to_body}, history))
        converter = MeasurementConverter(rotation_of, cameras={CAMERAS[0]: camera.model})
        if detection is not None:
            detection.mount(rotation_of, camera.model)
        self.log = RunLog(keeps_events=True)
        self.fusion = FusionStage(tracker, converter, observer=self.log, gimbal=history)
        self.hearing = DoaStage(array, settings, ego_noise, drone_model=load_model(''))
        others = {method: DoaStage(array, replace(settings, method=method), ego_noise) for method in estimators}
        seeing = {} if detection is None else {CAMERAS[0]: detection}
        self._pipeline = Pipeline(self.hearing, seeing, self.fusion, None, self.log, converter, self._publish, others)
        self._heard = 0  # samples

    def on_samples(self, samples: NDArray, sample_rate: int, arrival: float) -> None:
        """The next samples (n, channels) of all microphones, which follow the ones before."""
        header = Header(stamp=to_stamp(self._heard / sample_rate), frame_id='microphones')
        frame = audio_frame(samples.astype(np.float32, copy=False), self._heard, sample_rate, header)
        self._heard += len(samples)
        self._take(topics.AUDIO, frame, arrival)

    def on_image(self, image: NDArray[np.uint8], time: float, arrival: float) -> None:
        """An image (height, width, 3), BGR, captured at `time`."""
        self._take(topics.IMAGE, image_message(Header(stamp=to_stamp(time), frame_id='camera'), image), arrival)

    def on_detections(self, make: Callable[[Header], Detection2DArray], time: float, arrival: float) -> None:
        """Detections of an image captured at `time`; `make` gives the message for its header."""
        self._take(topics.DETECTIONS, make(Header(stamp=to_stamp(time), frame_id='camera')), arrival)

    def on_state(self, state: VehicleState) -> Odometry:
        """The rig's pose and velocities in the world, known at once; returns the message."""
        odometry = odometry_message(Header(stamp=to_stamp(state.time)), BASE_FRAME, state)
        self._take(topics.ODOMETRY, odometry, state.time)
        return odometry

    def on_gimbal(self, sample: GimbalSample, arrival: float) -> None:
        """The measured orientation of the gimbal that carries the camera."""
        message = gimbal_message('gimbal', sample.time, sample.orientation_wxyz, sample.variance, measured=True)
        self._take(topics.GIMBAL, message, arrival)

    def advance(self, now: float) -> None:
        """Give the bearings that are due until `now` without a measurement."""
        self._pipeline.advance(now)

    def _take(self, name: str, message: Any, arrival: float) -> None:
        self._pipeline.take(name, message, arrival)
        if self._pipeline.problems:
            raise ValueError('; '.join(sorted(self._pipeline.problems)))

    def _publish(self, name: str, time: float, message: Any) -> None:
        if name == topics.BEARING:
            self.bearing = message
        elif name == topics.TARGETS:
            self.targets = message
