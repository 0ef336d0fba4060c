"""How credible it is that a detector finds a target."""

from __future__ import annotations

HALF_SIZE_PX = 8.0        # a target as wide as this is found every second time in clear air
HALF_TRANSMISSION = 0.15  # a large target is found every second time when this much contrast is left
LEAST = 0.05              # below this a detector reports nothing


def score(size_px: float, transmission: float, visible_fraction: float = 1.0) -> float:
    """How credible a detection is, 0..1: rises smoothly with apparent size, contrast and the part in view.

    c = f * h(size / HALF_SIZE_PX) * h(transmission / HALF_TRANSMISSION) with Hill's h(x) = x^2 / (1 + x^2), and 0
    where c would be below LEAST.
    """
    def hill(x: float) -> float:
        return x * x / (1.0 + x * x)

    value = visible_fraction * hill(size_px / HALF_SIZE_PX) * hill(transmission / HALF_TRANSMISSION)
    return float(value) if value >= LEAST else 0.0
