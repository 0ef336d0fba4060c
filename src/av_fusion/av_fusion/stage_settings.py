"""Settings of the fusion stage."""

from __future__ import annotations

from dataclasses import dataclass, field

from av_fusion.filter.fixed_emitters import FixedEmitterSettings


@dataclass(frozen=True)
class FusionStageSettings:
    """Settings of a `FusionStage`.

    Parameters:
        base_frame: frame of the rig's body, in which bearings are given.
        rate (Hz): rate of outputs while no measurement arrives.
        min_doa_confidence: directions of arrival of lower confidence are not used.
        clock_tolerance (s): a stamp this long before the time of arrival, or FUTURE_S later, belongs to another clock and is
            not used.
        missing_after (s): an input without messages for this long is reported as missing.
        visibility_age (s): largest difference between the stamps of a visibility and of an image to which it applies.
        transform_wait (s): how long a measurement waits for the orientation of its sensor at its capture time.
        fixed_emitters: how sources at fixed places are learnt.
    """

    base_frame: str = 'base_link'
    rate: float = 20.0
    min_doa_confidence: float = 0.0
    clock_tolerance: float = 2.0
    missing_after: float = 1.0
    visibility_age: float = 1.0
    transform_wait: float = 0.15
    fixed_emitters: FixedEmitterSettings = field(default_factory=FixedEmitterSettings)
