"""Noise that is no source: what the microphones add themselves, and the level of all noise against a source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from av_sim_bridge.sound.levels import spl_to_pascal
from av_sim_bridge.sound.stream import CHUNK, Stream, white_noise


@dataclass(frozen=True)
class Snr:
    """Power of a source over that of all noise at one microphone, both inside `band_hz`, with the source at `distance_m` in the open."""

    ratio_db: float
    distance_m: float = 10.0
    source: int = 0
    band_hz: tuple[float, float] = (200.0, 4000.0)


@dataclass(frozen=True)
class Noise:
    """`self_noise_db_spl` is each microphone's own noise, white up to half the sample rate.

    With `snr`, the levels here only set the ratios between the kinds of noise, and their sum is scaled.
    """

    self_noise_db_spl: float = 30.0
    snr: Snr | None = None

    def stream(self, sample_rate: int, microphones: int, key: Sequence[int]) -> Stream:
        """The noise of all microphones, (microphones, CHUNK) a chunk, in Pa, not yet scaled to `snr`."""
        own = white_noise([*key, 0], microphones)
        level = spl_to_pascal(self.self_noise_db_spl)
        return Stream(lambda index: level * own.read(index * CHUNK, (index + 1) * CHUNK))
