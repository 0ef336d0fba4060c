"""How far what is heard is the target: a reflection, or another source, is heard for seconds on end."""

from __future__ import annotations

import math

from av_fusion.measurement.measurements import DoaMeasurement

MEMORY_S = 60.0  # so long a comparison counts
USUAL_S = 3.0  # what is usually so counts like comparisons of so many seconds
TOLERANCE = math.radians(5.0)  # an array may be turned so far, and a target move between two pictures
SUSPICION = 0.1  # of a comparison before its result is known


class Trust:
    """Learns from what was seen how often something else than the target is heard; `usual` is believed before.

    The mean of a beta distribution with exponential forgetting; each comparison counts by the probability that the sound
    came from elsewhere, and by the time since the one before.
    """

    def __init__(self, usual: float) -> None:
        self._usual = self._otherwise = usual
        self._elsewhere = self._all = 0.0
        self._time = -math.inf

    def otherwise(self, confidence: float) -> float:
        """Probability that something else than the target is heard, in the long run, in sounds of this confidence.

        Confidence says how often windows are misled, each for itself; what of it lasts grows with the square.
        """
        return 1.0 - (1.0 - self._otherwise) * (1.0 - (1.0 - confidence) ** 2) if self._usual > 0.0 else 0.0

    def compare(self, sound: DoaMeasurement, time: float, azimuth: float) -> None:
        """Learn from a sound and the direction (body, rad) where the target was seen at its `time`."""
        seconds = min(abs(time - self._time), 0.5)
        self._time = time
        miss, variance = min(((math.remainder(h.azimuth - azimuth, math.tau), h.azimuth_variance) for h in sound.hypotheses),
                             key=lambda pair: abs(pair[0]))
        variance += TOLERANCE**2
        fit = math.exp(-0.5 * miss * miss / variance) * math.sqrt(math.tau / variance) / len(sound.hypotheses)  # to uniform
        kept = math.exp(-seconds / MEMORY_S)
        self._elsewhere = kept * self._elsewhere + seconds * SUSPICION / (SUSPICION + (1.0 - SUSPICION) * fit)
        self._all = kept * self._all + seconds
        self._otherwise = (self._usual * USUAL_S + self._elsewhere) / (USUAL_S + self._all)
