"""Model of a detector's score for a target in the image."""

from __future__ import annotations

HALF_SIZE_PX = 8.0        # width of a target with a score of 0.5 in clear air
HALF_TRANSMISSION = 0.15  # contrast at which a large target has a score of 0.5
LEAST = 0.05              # score below which a detector reports nothing


def score(size_px: float, transmission: float, visible_fraction: float = 1.0) -> float:
    """Score (0 to 1) of a detection, increasing smoothly with apparent size, contrast and visible fraction f.

    The score is f * h(size / HALF_SIZE_PX) * h(transmission / HALF_TRANSMISSION) with Hill's function
    h(x) = x^2 / (1 + x^2), and 0 below LEAST.

    Parameters:
        size_px (px): width of the target.
        transmission (0 to 1): contrast relative to clear air and good light.
        visible_fraction (0 to 1): fraction of the target that is visible.
    """
    def hill(x: float) -> float:
        return x * x / (1.0 + x * x)

    value = visible_fraction * hill(size_px / HALF_SIZE_PX) * hill(transmission / HALF_TRANSMISSION)
    return float(value) if value >= LEAST else 0.0
