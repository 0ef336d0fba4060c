"""Further estimators of directions, on the same sound as the rig's own."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from av_audio.stage import DoaStage
from av_evaluation.replay.pipeline import transmitted
from av_evaluation.runs.measurement_record import MeasurementRecord
from av_fusion.measurement.converter import MeasurementConverter
from av_interfaces.msg import AudioFrame


class EstimatorComparison:
    """Records the most confident direction of each window by each estimator.

    Parameters:
        stages: by the estimator's name.
        converter: converts directions to measurements.
        record: gets the measurements.
    """

    def __init__(self, stages: Mapping[str, DoaStage], converter: MeasurementConverter, record: MeasurementRecord) -> None:
        self._stages, self._converter, self._record = stages, converter, record

    def on_audio(self, frame: AudioFrame, arrival: float) -> None:
        """Use a frame that arrives at `arrival` (s); one that cannot be used is reported by the rig's own stage."""
        for method, stage in self._stages.items():
            with suppress(ValueError):
                for directions in stage.on_audio(frame, arrival):
                    measurements = self._converter.doa(transmitted(directions))
                    self._record.doa.setdefault(method, []).extend(measurements[:1])
