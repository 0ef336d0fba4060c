"""The rig's nodes without nodes: each stage takes messages and the time at which they came, and gives what follows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_audio.doa_messages import doa_array
from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import Localizer, LocalizerSettings
from av_bags import topics as names
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_seconds
from av_evaluation.replay.messages import MessageMaker
from av_vision import visibility
from av_vision.image import image_from_message
from av_vision.watching import Watcher
from av_vision.yolo import Detector

Output = tuple[str, float, Any]  # the rig's name of the topic, time in s, its bytes or what they are made of


class Hearing:
    """doa_node: audio frames to directions of arrival. `problems` holds what was wrong with frames left out.

    `blades` of a rotor of the rig's own turn the motors' speeds into the tones to leave out; 0 listens to all. `ego_noise`
    is what the rig alone sounds like.
    """

    def __init__(self, array: MicrophoneArray, settings: LocalizerSettings, make: MessageMaker, blades: int = 0,
                 ego_noise: NoiseRecording | None = None) -> None:
        self._array, self._settings, self._make, self._blades = array, settings, make, blades
        self._ego_noise = ego_noise
        self._blade_pass_hz = np.zeros(0)
        self._localizer: Localizer | None = None
        self.problems: set[str] = set()

    def turn(self, motor_speeds: Any) -> None:
        """The rig's own rotors turn at these speeds (rad/s)."""
        if self._blades:
            speeds = np.abs(np.asarray(motor_speeds.data, float))
            self._blade_pass_hz = self._blades * speeds[np.isfinite(speeds)] / (2.0 * np.pi)

    def take(self, frame: Any, now: float) -> Iterator[Output]:
        """Directions of the windows that a frame completes."""
        try:
            estimates = self._process(frame)
        except ValueError as error:
            self.problems.add(f'{names.AUDIO}: {error}')
            self._localizer = None
            return
        start = to_seconds(frame.header.stamp)
        for estimate in estimates:
            time = max(0.0, start + (estimate.centre_sample - frame.first_sample) / frame.sample_rate)
            message = doa_array(estimate, self._array, time, frame.header.frame_id, self._settings.window_s,
                                self._settings.method)
            yield names.DOA, now, self._make.serialise(message, names.DOA)

    def _process(self, frame: Any) -> list:
        channels = self._array.channels
        if frame.channels != channels:
            raise ValueError(f'{frame.channels} channels, but the array {self._array.name} has {channels} microphones')
        if self._localizer is None or self._localizer.sample_rate != frame.sample_rate:
            self._localizer = Localizer(self._array, frame.sample_rate, self._settings, self._ego_noise)
        self._localizer.blade_pass_hz = self._blade_pass_hz
        samples = np.asarray(frame.samples, np.float32).reshape(-1, channels)
        return self._localizer.process(samples, frame.first_sample)


class Seeing:
    """detector_node: pictures to detections and visibility; here none is left out, however long one takes.

    `ground` (h, w) holds the distances in m to what pixels show, None where they are unknown; how far one can see is
    told `rate` times a second for things `distance` m away. `still` judges each picture by itself.
    """

    def __init__(self, detector: Detector, track_gap: float, make: MessageMaker, rate: float = 0.0,
                 distance: float = 10.0, ground: NDArray | None = None, still: bool = False) -> None:
        self._watcher, self._make = Watcher(detector, track_gap, still), make
        self._rate, self._distance, self._ground = rate, distance, ground
        self._next = -math.inf
        self.problems: set[str] = set()

    def take(self, picture: Any, now: float) -> Iterator[Output]:
        """What is seen in a picture."""
        time = to_seconds(picture.header.stamp)
        try:
            image = image_from_message(picture)
            found, tracks = self._watcher.look(image, time)
        except ValueError as error:
            self.problems.add(f'{names.IMAGE}: {error}')
            return
        if self._rate > 0.0 and time >= self._next:
            self._next = time + 1.0 / self._rate
            ground = self._ground if self._ground is not None and self._ground.shape == image.shape[:2] else None
            seen = visibility.estimate(image, ground, self._distance)
            yield names.VISIBILITY, now, self._make.serialise(self._make.visibility(seen, picture.header))
        yield names.DETECTIONS, now, self._make.serialise(self._make.detections(found, tracks, picture.header))
