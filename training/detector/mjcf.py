"""Geometry for MuJoCo in words: what sprites are built of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

UP = np.array([0.0, 0.0, 1.0])
Rng = np.random.Generator


def geom(kind: str, size: list[float], place: list[float], colour: NDArray, more: str = '') -> str:
    """One MJCF geom; numbers in metres."""
    text = (' '.join(f'{value:.4f}' for value in values) for values in (size, place, colour))
    size_text, place_text, colour_text = text
    return f'<geom type="{kind}" size="{size_text}" pos="{place_text}" rgba="{colour_text}" {more}/>'


def rod(start: NDArray, end: NDArray, radius: float, colour: NDArray) -> str:
    """A capsule from one point to another."""
    numbers = ' '.join(f'{value:.4f}' for value in (*start, *end))
    return f'<geom type="capsule" size="{radius:.4f}" fromto="{numbers}" rgba="{" ".join(f"{c:.3f}" for c in colour)}"/>'


def colour(rng: Rng, spread: float = 0.12) -> NDArray:
    """Mostly black, grey or white as real airframes are, sometimes anything."""
    base = rng.random(3) if rng.random() < 0.2 else np.full(3, rng.choice([0.05, 0.15, 0.35, 0.6, 0.9]))
    return np.append(np.clip(base + rng.uniform(-spread, spread, 3), 0.0, 1.0), 1.0)
