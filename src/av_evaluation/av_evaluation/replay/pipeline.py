"""The stages of the rig one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from av_bags import topics as names
from av_common.stamps import to_seconds
from av_common.track_messages import track_of_bearing
from av_evaluation.replay.messages import MessageMaker
from av_evaluation.replay.run_recorder import Journal
from av_evaluation.replay.stages import DetectionReplay, DoaReplay, Output
from av_fusion.measurement.converter import MeasurementConverter
from av_fusion.stage import FusionOutput, FusionStage
from av_pointing.stage import PointingStage


class Chain:
    """Takes what the bag holds by the rig's names of its topics, each with the time at which it came.

    `tell` is given what follows, as the parts of an `Output`. A stage that is None is not computed: what it would say is
    expected from the bag. Times must not fall.
    """

    def __init__(self, converter: MeasurementConverter, journal: Journal, hearing: DoaReplay | None,
                 seeing: DetectionReplay | None, fusing: FusionStage | None, pointing: PointingStage | None, make: MessageMaker,
                 tell: Callable[[str, float, Any], None]) -> None:
        self._converter, self._journal, self._make, self._tell = converter, journal, make, tell
        self._hearing, self._seeing, self._fusing, self._pointing = hearing, seeing, fusing, pointing

    @property
    def due(self) -> float:
        """When something is said next, even if nothing comes."""
        return math.inf if self._fusing is None else self._fusing.due

    def wait(self, now: float) -> None:
        """Nothing came until `now`."""
        for output in self._fusing.outputs_until(now) if self._fusing is not None else ():
            self._say(output)

    def take(self, name: str, content: Any, now: float) -> None:
        """A message, or what it means."""
        if name == names.AUDIO and self._hearing is not None:
            self._fuse(self._hearing.take(content, now))
        elif name == names.MOTORS and self._hearing is not None:
            self._hearing.on_motor_speeds(content)
        elif name == names.IMAGE and self._seeing is not None:
            self._fuse(self._seeing.take(content, now))
        elif name == names.ODOMETRY:
            if self._fusing is not None:
                self._fusing.on_odometry(content, now)
        elif self._fusing is None:
            self._follow(name, content, now)
        elif name == names.VISIBILITY:
            self._fusing.on_visibility(content)
        else:
            take = self._fusing.on_doa if name == names.DOA else self._fusing.on_detections
            output = take(content, now)
            if output is not None:
                self._say(output)

    def _follow(self, name: str, content: Any, now: float) -> None:
        """Take a message when the bearings are recorded ones."""
        if name == names.DOA:
            self._journal.on_doa(self._converter.doa(content), now)
        elif name == names.DETECTIONS:
            measurement = self._converter.detections(content)
            if measurement is not None:
                self._journal.on_camera(measurement, content, now)
        elif name == names.BEARING:
            self._journal.on_track(track_of_bearing(content), now)
            self._point(content, now)

    def _fuse(self, outputs: Iterable[Output]) -> None:
        """Take what the senses say, read as its reader will find it: with the precision of its fields."""
        for name, now, data in outputs:
            self._tell(name, now, data)
            self.take(name, self._make.deserialise(name, data), now)

    def _say(self, output: FusionOutput) -> None:
        """Tell of a track and the command that follows."""
        now = to_seconds(output.bearing.header.stamp)
        self._tell(names.STATE, now, output.state)
        self._tell(names.BEARING, now, output.bearing)
        self._point(output.bearing, now)

    def _point(self, bearing: Any, now: float) -> None:
        if self._pointing is not None:
            self._tell(names.COMMAND, now, self._pointing.on_bearing(bearing, now))
