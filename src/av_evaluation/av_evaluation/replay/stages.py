"""The rig's nodes without nodes: each stage takes messages and the time at which they came, and gives what follows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from av_audio.stage import DoaStage
from av_bags import topics as names
from av_evaluation.replay.messages import MessageMaker
from av_vision.stage import DetectionStage

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


class DetectionReplay:
    """Results of a DetectionStage in the form of outputs; `problems` holds why images were skipped."""

    def __init__(self, stage: DetectionStage, make: MessageMaker) -> None:
        self._stage, self._make = stage, make
        self.problems: set[str] = set()

    def take(self, image: Any, now: float) -> Iterator[Output]:
        """Visibility and detections in an image."""
        try:
            detections, visibility = self._stage.on_image(image, now)
        except ValueError as error:
            self.problems.add(f'{names.IMAGE}: {error}')
            return
        if visibility is not None:
            yield names.VISIBILITY, now, self._make.serialise(visibility, names.VISIBILITY)
        yield names.DETECTIONS, now, self._make.serialise(detections, names.DETECTIONS)
