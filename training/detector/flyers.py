"""What else flies: airplanes, birds and helicopters of random build, as MJCF geometry about 2 m long, nose along x."""

from __future__ import annotations

import numpy as np
from mjcf import Rng, colour, geom, rod
from numpy.typing import NDArray


def airplane(rng: Rng) -> list[str]:
    """An airliner with swept wings and engines, or a small one with straight wings, mostly white or light grey."""
    paint = colour(rng) if rng.random() < 0.3 else np.append(np.full(3, rng.uniform(0.7, 1.0)), 1.0)
    wing_paint = paint if rng.random() < 0.7 else colour(rng)
    thick, span, sweep = rng.uniform(0.07, 0.13), rng.uniform(0.7, 1.1), rng.uniform(0.0, 0.7) if rng.random() < 0.7 else 0.0
    height, root = rng.choice([-0.5, 0.0, 0.9]) * thick, rng.uniform(-0.05, 0.3)
    parts = [rod(np.array([-0.75, 0, 0]), np.array([0.85, 0, 0]), thick, paint),
             rod(np.array([-1.0, 0, 0.04]), np.array([-0.7, 0, 0]), 0.6 * thick, paint)]
    if rng.random() < 0.3:  # painted in two colours
        parts.append(geom('box', [0.8, 1.02 * thick, 0.4 * thick], [0, 0, -0.7 * thick], colour(rng)))
    for side in (-1, 1):
        tip = np.array([root - sweep * span, side * span, height + rng.uniform(0.0, 0.12)])
        parts += blade(np.array([root, 0, height]), tip, rng.uniform(0.1, 0.18), wing_paint)
        parts += blade(np.array([-0.85, 0, 0.05]), np.array([-0.9 - 0.4 * sweep, side * 0.38, 0.07]), 0.08, wing_paint)
        if sweep and rng.random() < 0.8:
            place = np.array([root - 0.35 * sweep * span - 0.02, side * 0.35 * span, height - 0.1])
            parts.append(rod(place, place + np.array([0.22, 0, 0]), rng.uniform(0.045, 0.075), colour(rng)))
    parts += blade(np.array([-0.8, 0, 0]), np.array([-1.0, 0, rng.uniform(0.3, 0.45)]), 0.12, wing_paint)
    if not sweep:
        parts.append(geom('cylinder', [0.22, 0.005], [0.9, 0, 0], np.append(colour(rng)[:3], 0.2), 'euler="0 90 0"'))
    if rng.random() < 0.3:
        parts += [rod(np.array([x, y, -0.05]), np.array([x, y, -0.25]), 0.02, colour(rng))
                  for x, y in ((0.6, 0.0), (-0.05, 0.12), (-0.05, -0.12))]
    return parts


def bird(rng: Rng) -> list[str]:
    """A body, two wings of two joints at any moment of a stroke, a tail; mostly dark."""
    coat = colour(rng, 0.08) if rng.random() < 0.35 else np.append(rng.uniform(0.02, 0.25) * np.array([1.0, 0.9, 0.8]), 1.0)
    wing_coat = coat if rng.random() < 0.7 else colour(rng, 0.08)
    stroke, bend, chord = rng.uniform(-0.7, 0.9), rng.uniform(-0.6, 0.2), rng.uniform(0.1, 0.24)
    inner, outer = rng.uniform(0.35, 0.6), rng.uniform(0.35, 0.8)
    parts = [geom('ellipsoid', [0.42, 0.12, 0.12], [0, 0, 0], coat), geom('sphere', [0.09], [0.42, 0, 0.05], coat)]
    parts += blade(np.array([-0.3, 0, 0]), np.array([-0.7, 0, 0]), rng.uniform(0.06, 0.2), coat, (0.0, 1.0, 0.0))
    for side in (-1, 1):
        elbow = np.array([rng.uniform(0.0, 0.2), side * inner * np.cos(stroke), inner * np.sin(stroke)])
        tip = elbow + np.array([rng.uniform(-0.4, 0.0), side * outer * np.cos(stroke + bend), outer * np.sin(stroke + bend)])
        parts += blade(np.array([0.1, 0, 0.04]), elbow, chord, wing_coat) + blade(elbow, tip, 0.75 * chord, wing_coat)
    return parts


def helicopter(rng: Rng) -> list[str]:
    """A cabin, a boom with fin and tail rotor, a main rotor as a disc or two blades, skids or wheels."""
    paint = colour(rng)
    wide, low = rng.uniform(0.16, 0.26), rng.uniform(0.18, 0.28)
    hub = np.array([0.25, 0, low + rng.uniform(0.08, 0.16)])
    radius, turn = rng.uniform(0.8, 1.15), rng.uniform(0, np.pi)
    parts = [geom('ellipsoid', [rng.uniform(0.4, 0.6), wide, low], [0.3, 0, 0], paint),
             rod(np.array([0.0, 0, 0.08]), np.array([-1.0, 0, 0.15]), rng.uniform(0.04, 0.09), paint),
             rod(np.array([0.25, 0, 0.0]), hub, 0.05, paint),
             geom('cylinder', [radius, 0.006], list(hub), np.append(np.full(3, rng.uniform(0, 0.5)), rng.uniform(0.03, 0.2))),
             geom('cylinder', [rng.uniform(0.12, 0.2), 0.01], [-1.0, 0.06, 0.2], np.append(np.full(3, 0.3), 0.4),
                  'euler="90 0 0"')]
    if rng.random() < 0.6:
        sweep = radius * np.array([np.cos(turn), np.sin(turn), 0.0])
        parts.append(rod(hub - sweep, hub + sweep, 0.018, colour(rng)))
    parts += blade(np.array([-0.95, 0, 0.1]), np.array([-1.1, 0, 0.42]), 0.08, paint)
    for side in (-1, 1):
        parts.append(rod(np.array([-0.1, side * 0.25, -low - 0.12]), np.array([0.7, side * 0.25, -low - 0.12]), 0.025, paint))
        parts += [rod(np.array([x, side * 0.1, -0.7 * low]), np.array([x, side * 0.25, -low - 0.12]), 0.02, paint)
                  for x in (0.1, 0.5)]
    return parts


def blade(start: NDArray, end: NDArray, chord: float, paint: NDArray, along: tuple[float, ...] = (1.0, 0.0, 0.0)) -> list[str]:
    """A wing from root to tip, narrower there, of rods side by side."""
    across = chord * np.array(along)
    return [rod(start + place * across, end + 0.55 * place * across, 0.022, paint) for place in np.linspace(-1.0, 1.0, 7)]
