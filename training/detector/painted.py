"""Painted images: skies over land, and branches before them. Nothing real, much variety."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Rng = np.random.Generator


def painted_background(rng: Rng, side: int) -> NDArray[np.uint8]:
    """A sky of two colours with clouds, often with ground, woods or blocks below: nothing real, much variety."""
    height = np.linspace(0.0, 1.0, side)[:, None, None]
    blue = np.array([rng.uniform(120, 255), rng.uniform(90, 230), rng.uniform(50, 220)])
    image = np.ones((side, side, 1)) * (blue * (1 - height) + (blue + rng.uniform(-60, 60, 3)) * height)
    image += rng.uniform(0, 60) * (noise(rng, side, rng.uniform(1.0, 2.0)) - 0.4)[..., None]
    if rng.random() < 0.65:
        for _ in range(rng.integers(1, 4)):  # layers of land, nearer ones below
            horizon = rng.uniform(0.1, 1.0) + rng.uniform(0, 0.25) * (noise(rng, side, rng.uniform(0.6, 1.8))[0] - 0.5)
            land = height[..., 0] > horizon[None]
            texture = noise(rng, side, rng.uniform(0.2, 1.2))[..., None] * rng.uniform(20, 140)
            image = np.where(land[..., None], rng.uniform(10, 170, 3) - 40 + texture, image)
    for _ in range(rng.integers(0, 5) if rng.random() < 0.5 else 0):  # trunks, poles, houses
        x, y = rng.integers(0, side, 2)
        w, h = int(log_uniform(rng, 2, side / 3)), int(log_uniform(rng, 4, side))
        cv2.rectangle(image, (int(x), int(y)), (int(x) + w, int(y) + h), tuple(rng.uniform(0, 255, 3)), -1)
    return np.clip(image, 0, 255).astype(np.uint8)


def noise(rng: Rng, side: int, smoothness: float) -> NDArray[np.float32]:
    """Fractal noise (side, side) in 0-1: random grids of doubling fineness, amplitude falling with it."""
    total, weight = np.zeros((side, side), np.float32), 0.0
    for octave in range(1, 8):
        cells, amplitude = 2**octave, 2.0 ** (-smoothness * octave)
        grid = rng.random((cells + 1, cells + 1), np.float32)
        total += amplitude * cv2.resize(grid, (side, side), interpolation=cv2.INTER_CUBIC)
        weight += amplitude
    return np.clip(total / weight, 0, 1)


def branches(rng: Rng, side: int = 256) -> NDArray[np.uint8]:
    """Twigs with buds or leaves (side, side, 4) BGRA: what is dark, thin and crossed before a sky and no drone."""
    image = np.zeros((side, side, 4), np.uint8)
    bark = rng.uniform(0, 90) * np.array([0.7, 0.85, 1.0]) + rng.uniform(0, 30, 3)
    leaf = bark if rng.random() < 0.5 else rng.uniform([0, 20, 20], [60, 150, 160])
    leaves, spread = rng.uniform(0.0, 0.9), rng.uniform(0.3, 0.9)
    heading = rng.uniform(0, 2 * np.pi)
    start = side * (0.5 - 0.6 * np.array([np.cos(heading), np.sin(heading)]) + rng.uniform(-0.3, 0.3, 2))
    growing = [(start, heading, side * rng.uniform(0.12, 0.3), rng.uniform(1.5, 6.0))]
    while growing:
        place, heading, length, thick = growing.pop()
        end = place + length * np.array([np.cos(heading), np.sin(heading)])
        cv2.line(image, tuple(map(int, place)), tuple(map(int, end)), (*bark, 255), max(round(thick), 1), cv2.LINE_AA)
        if rng.random() < leaves and thick < 3.0:
            axes = tuple(int(size) for size in rng.uniform(1, 5, 2))
            cv2.ellipse(image, tuple(map(int, end)), axes, rng.uniform(0, 180), 0, 360, (*leaf, 255), -1, cv2.LINE_AA)
        if length > 0.02 * side and len(growing) < 60:
            growing += [(end, heading + rng.normal(0, spread), length * rng.uniform(0.55, 0.95), 0.75 * thick)
                        for _ in range(rng.integers(1, 4))]
    return image


def insect(rng: Rng, side: int = 96) -> NDArray[np.uint8]:
    """An insect near the camera (side, side, 4) BGRA: a dark body and pale wings, out of focus, drawn out by its flight."""
    image = np.zeros((side, side, 4), np.uint8)
    middle, body = (side // 2, side // 2), rng.uniform(10, 90, 3)
    length, angle = side * rng.uniform(0.12, 0.25), rng.uniform(0, 180)
    for turn in (-35, 35):
        axes = (int(0.9 * length), int(0.3 * length))
        cv2.ellipse(image, middle, axes, angle + 90 + turn, 0, 360, (*rng.uniform(120, 220, 3), 110), -1, cv2.LINE_AA)
    cv2.ellipse(image, middle, (int(length), int(0.35 * length)), angle, 0, 360, (*body, 255), -1, cv2.LINE_AA)
    streak = max(int(side * rng.uniform(0.0, 0.3)), 1)
    kernel = np.zeros((streak, streak), np.float32)
    cv2.line(kernel, (0, int(rng.integers(streak))), (streak - 1, int(rng.integers(streak))), 1.0)
    alpha = cv2.GaussianBlur(image[..., 3].astype(np.float32), (0, 0), side * rng.uniform(0.02, 0.06))
    image[..., 3] = np.clip(cv2.filter2D(alpha, -1, kernel / max(kernel.sum(), 1.0)), 0, 255)
    image[..., :3][image[..., :3].sum(2) == 0] = body  # what the blur reaches
    return image


def sunlit(rng: Rng, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image with the sun in its upper half: a saturated disc and glare that falls off with the distance from it."""
    height, width = image.shape[:2]
    x, y, radius = rng.uniform(0, width), rng.uniform(0, 0.5 * height), rng.uniform(0.02, 0.05) * width
    rows, columns = np.mgrid[:height, :width]
    away = np.hypot(columns - x, rows - y) / radius
    glare = np.where(away < 1.0, 255.0, 200.0 / np.maximum(away, 1.0) ** rng.uniform(0.6, 1.2))
    return np.clip(image + glare[..., None] * rng.uniform([0.75, 0.9, 1.0], 1.0), 0, 255).astype(np.uint8)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
