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
from av_bags.feed import CLOCK_TOLERANCE_S
from av_common.microphone_array import MicrophoneArray
from av_common.stamps import to_seconds
from av_common.track import Track
from av_evaluation.replay.messages import MessageMaker
from av_evaluation.replay.run_recorder import Journal
from av_fusion.baseline.gated_tracker import GatedTracker
from av_fusion.filter.tracker import BayesTracker
from av_fusion.measurement.converter import Senses
from av_fusion.measurement.odometry import add_odometry
from av_pointing.controller import PointingController
from av_vision import visibility
from av_vision.image import image_from_message
from av_vision.watching import Watcher
from av_vision.yolo import Detector

# As fusion_node: an input without messages for so long is missing, a visibility that far from the picture is not of it.
SILENT_S = 1.0
VISIBILITY_AGE_S = 1.0
LONGEST_SILENCE_S = 60.0

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


class Fusing:
    """fusion_node: all senses to one track. A measurement gives one at once, silence one each `1/rate` s."""

    def __init__(self, tracker: BayesTracker | GatedTracker, senses: Senses, journal: Journal, rate: float,
                 least_confidence: float) -> None:
        self._tracker, self._senses, self._journal = tracker, senses, journal
        self._period, self._least_confidence = 1.0 / rate, least_confidence
        self._visibility = (-math.inf, math.nan)  # time of the image, visibility
        self._came = dict.fromkeys((names.DOA, names.DETECTIONS, names.ODOMETRY), -math.inf)
        self._published = -math.inf
        self.foreign: dict[str, int] = {}

    @property
    def due(self) -> float:
        """When the next track comes, if no measurement comes before."""
        return self._published + self._period

    def wait(self, now: float) -> Iterator[Track]:
        """The tracks that come until `now` without a measurement."""
        if now - self._published > LONGEST_SILENCE_S:  # the bag's beginning, or a hole in it
            self._published = now - self._period
        while self.due <= now:
            yield self._estimate(self.due)

    def move(self, odometry: Any, now: float) -> None:
        """How the rig stands: nothing follows from that alone."""
        if self._is_timely(names.ODOMETRY, odometry, now):
            add_odometry(self._tracker, odometry)

    def take(self, name: str, message: Any, now: float) -> Track | None:
        """The track that follows from a message, if one does."""
        if name == names.VISIBILITY:
            self._visibility = (to_seconds(message.header.stamp), message.visibility)
        elif self._is_timely(name, message, now):
            return self._hear(message, now) if name == names.DOA else self._see(message, now)
        return None

    def missing(self, now: float) -> list[str]:
        """Inputs without messages."""
        return [name for name, came in self._came.items() if now - came > SILENT_S]

    def _hear(self, message: Any, now: float) -> Track:
        sounds = self._senses.sounds(message)
        self._journal.hear(sounds, now)
        for sound in sounds:
            if sound.confidence >= self._least_confidence:
                self._tracker.add_sound(sound)
        return self._estimate(now)

    def _see(self, message: Any, now: float) -> Track | None:
        judged, visibility = self._visibility
        near = abs(to_seconds(message.header.stamp) - judged) < VISIBILITY_AGE_S
        look = self._senses.look(message, visibility if near else math.nan)
        if look is None:
            return None
        self._journal.see(look, message, now)
        self._tracker.add_look(look)
        return self._estimate(now)

    def _is_timely(self, name: str, message: Any, now: float) -> bool:
        self._came[name] = now
        timely = abs(to_seconds(message.header.stamp) - now) <= CLOCK_TOLERANCE_S
        if not timely:
            self.foreign[name] = self.foreign.get(name, 0) + 1
        return timely

    def _estimate(self, now: float) -> Track:
        self._published = now
        track = self._tracker.estimate(now)
        self._journal.follow(track, now)
        return track


class Pointing:
    """pointing_node: tracks to commands, one for each. The rig does not obey: what it did is in the bag."""

    def __init__(self, controller: PointingController) -> None:
        self._controller = controller

    def take(self, track: Track, now: float) -> Output:
        """The command that follows a bearing."""
        return names.COMMAND, now, self._controller.step(now, track)
