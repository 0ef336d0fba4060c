"""The rig's nodes without nodes: each stage takes messages and the time at which they came, and gives what follows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from numpy.typing import NDArray

from av_audio.stage import DoaStage
from av_bags import topics as names
from av_common.stamps import to_seconds
from av_evaluation.replay.messages import MessageMaker
from av_vision import visibility
from av_vision.image import image_from_message
from av_vision.watching import Watcher
from av_vision.yolo import Detector

Output = tuple[str, float, Any]  # the rig's name of the topic, time in s, its bytes or what they are made of


class DoaReplay:
    """Reports of a DoaStage in the form of outputs; `problems` holds why audio frames were skipped."""

    def __init__(self, stage: DoaStage, make: MessageMaker) -> None:
        self._stage, self._make = stage, make
        self.problems: set[str] = set()

    def on_motor_speeds(self, message: Any) -> None:
        """Take the speeds of the rig's motors."""
        self._stage.on_motor_speeds(message)

    def take(self, frame: Any, now: float) -> Iterator[Output]:
        """Directions of the windows that a frame completes."""
        try:
            messages = self._stage.on_audio(frame, now)
        except ValueError as error:
            self.problems.add(f'{names.AUDIO}: {error}')
            return
        for message in messages:
            yield names.DOA, now, self._make.serialise(message, names.DOA)


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
