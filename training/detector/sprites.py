"""Rendered objects to be pasted into images: quadrotors of random build, and things in the air that are none.

Every object is random geometry of our own, rendered by MuJoCo before black and before white; the two images give colour
and transparency (blurred rotor discs shine through): alpha = 1 - (white - black).
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault('MUJOCO_GL', 'egl')

import mujoco
import numpy as np
from flyers import airplane, bird, helicopter
from mjcf import UP, Rng, colour, geom, rod
from numpy.typing import NDArray

SIZE = 288


def multirotor(rng: Rng) -> list[str]:
    """A quadrotor (sometimes with six or eight arms), arms about 1 m long: the render is scaled to the sprite anyway."""
    arms = rng.choice([4, 4, 4, 4, 4, 6, 8])
    first = rng.choice([np.pi / arms, np.pi / arms, 0.0])
    stretch = rng.uniform(0.75, 1.25)
    angles = first + 2.0 * np.pi * np.arange(arms) / arms
    tips = np.stack([np.cos(angles) * stretch, np.sin(angles), np.full(arms, rng.uniform(-0.05, 0.2))], 1)
    body, arm, rotor = colour(rng), colour(rng), colour(rng)
    half = [rng.uniform(0.2, 0.5), rng.uniform(0.15, 0.35), rng.uniform(0.06, 0.2)]
    parts = [geom(rng.choice(['ellipsoid', 'box']), half, [0, 0, rng.uniform(-0.05, 0.1)], body)]
    radius = rng.uniform(0.35, min(0.75, 0.95 * np.pi / arms * 1.3))
    thickness = rng.uniform(0.02, 0.07)
    blurred = rng.random() < 0.75
    for tip in tips:
        parts.append(rod(np.zeros(3), tip, thickness, arm))
        parts.append(geom('cylinder', [rng.uniform(0.06, 0.12), 0.08], tip + 0.05 * UP, arm))
        hub = tip + 0.14 * UP
        if blurred:
            parts.append(geom('cylinder', [radius, 0.008], hub, np.append(rotor[:3], rng.uniform(0.05, 0.35))))
        if not blurred or rng.random() < 0.3:
            turn = rng.uniform(0, np.pi)
            blade = radius * np.array([np.cos(turn), np.sin(turn), 0.0])
            parts.append(rod(hub - blade, hub + blade, 0.02, rotor))
        if rng.random() < 0.15:
            parts.append(geom('sphere', [0.05], tip - 0.06 * UP, np.append(rng.random(3), 1.0)))
    if rng.random() < 0.6:  # landing gear
        depth, width = rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.5)
        gear = colour(rng)
        for side in (-width, width):
            parts += [rod(np.array([x, 0.5 * side, 0]), np.array([x, side, -depth]), 0.025, gear) for x in (-0.2, 0.2)]
            parts.append(rod(np.array([-0.4, side, -depth]), np.array([0.4, side, -depth]), 0.025, gear))
    if rng.random() < 0.6:  # camera or payload
        parts.append(geom(rng.choice(['sphere', 'box']), [rng.uniform(0.06, 0.16)] * 3, [0.2, 0, -0.25], colour(rng)))
    return parts


def not_a_drone(rng: Rng) -> list[str]:
    """A balloon, a kite, a pole, a clump."""
    shade = colour(rng)
    match rng.integers(4):
        case 0:
            return [geom('ellipsoid', [0.5, 0.5, rng.uniform(0.4, 0.7)], [0, 0, 0], shade),
                    rod(np.zeros(3), np.array([0, 0, -1.0]), 0.01, shade)]
        case 1:
            return [geom('box', [rng.uniform(0.3, 1), rng.uniform(0.3, 1), 0.02], [0, 0, 0], shade)]
        case 2:
            tilt = rng.normal(size=3)
            end = tilt / np.linalg.norm(tilt)
            return [rod(-end, end, rng.uniform(0.01, 0.06), shade)]
        case _:
            return [geom(rng.choice(['sphere', 'ellipsoid', 'box']), list(rng.uniform(0.1, 0.5, 3)),
                         list(rng.uniform(-0.4, 0.4, 3)), colour(rng)) for _ in range(rng.integers(2, 9))]


def scene(parts: list[str], background: float, rng: Rng) -> mujoco.MjModel:
    """The model of an object in even light from a random side, before a plain background."""
    # Seeded alike for both backgrounds by the caller.
    light = rng.normal(size=3)
    light[2] = -abs(light[2]) - 0.3
    direction = ' '.join(f'{value:.3f}' for value in light)
    shine, ambient = rng.uniform(0.3, 0.9), rng.uniform(0.1, 0.6)
    return mujoco.MjModel.from_xml_string(f'''<mujoco><visual>
      <headlight ambient="{ambient} {ambient} {ambient}" diffuse="0.1 0.1 0.1" specular="0.1 0.1 0.1"/>
      <global offwidth="{SIZE}" offheight="{SIZE}" fovy="12"/></visual>
      <asset><texture type="skybox" builtin="flat" width="8" height="8" rgb1="{background} {background} {background}"
      rgb2="{background} {background} {background}"/></asset>
      <worldbody><light directional="true" dir="{direction}" diffuse="{shine} {shine} {shine}" castshadow="false"/>
      {''.join(parts)}</worldbody></mujoco>''')


KINDS = {'other': not_a_drone, 'drone': multirotor, 'bird': bird, 'airplane': airplane, 'helicopter': helicopter}
# Builds of each kind, the last tenth of them for tests; then more for training, from fewer sides, because builds are learnt by
# heart; then those by which the threshold is chosen.
BUILDS = {'other': 120, 'drone': 400, 'bird': 80, 'airplane': 120, 'helicopter': 60}
MORE = {'drone': 1200, 'bird': 200, 'airplane': 360, 'helicopter': 140}
CHOOSE = {'drone': 40}


def render(build: int, kind: str, views: int = 8) -> list[NDArray[np.uint8]]:
    """Sprites (h, w, 4) BGRA, cut to the object's outline, of one object seen from several sides."""
    rng = np.random.default_rng([build, list(KINDS).index(kind)])
    parts = KINDS[kind](rng)
    # Most drones are seen from below or from the side.
    sides = [(rng.uniform(0, 360), float(np.clip(rng.normal(8, 28), -85, 85)), rng.uniform(12, 16)) for _ in range(views)]
    images = []
    for background in (0.0, 1.0):
        model = scene(parts, background, np.random.default_rng([build, 2]))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with mujoco.Renderer(model, SIZE, SIZE) as renderer:
            shots = []
            for azimuth, elevation, distance in sides:
                camera = mujoco.MjvCamera()
                camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
                renderer.update_scene(data, camera)
                shots.append(renderer.render().astype(np.int16))
        images.append(shots)
    return [sprite for black, white in zip(*images, strict=True) if (sprite := cut(black, white)) is not None]


def cut(black: NDArray, white: NDArray) -> NDArray[np.uint8] | None:
    """BGRA of an object rendered before black and before white, cut to where it is denser than a fifth."""
    alpha = 255 - np.clip((white - black).mean(axis=2), 0, 255)
    visible = np.clip(black * (255.0 / np.maximum(alpha, 1.0))[..., None], 0, 255)
    sprite = np.dstack([visible[..., ::-1], alpha]).astype(np.uint8)
    rows, columns = np.flatnonzero((alpha > 50).any(1)), np.flatnonzero((alpha > 50).any(0))
    if rows.size < 8 or columns.size < 8:
        return None
    return sprite[rows[0]:rows[-1] + 1, columns[0]:columns[-1] + 1]


def build_bank(cache: Path, use: str) -> dict[str, list[NDArray[np.uint8]]]:
    """The sprites of each kind for one use (train, validation, test), rendered once: {'drone': [...], 'bird': [...], ...}."""
    bank: dict[str, list] = {}
    for kind, first in BUILDS.items():
        tested, more = round(0.9 * first), first + MORE.get(kind, 0)
        parts = {'train': [(range(tested), 8), (range(first, more), 4)], 'test': [(range(tested, first), 8)],
                 'validation': [(range(more, more + CHOOSE.get(kind, 0)), 8)]}
        bank[kind] = [sprite for builds, views in parts[use] if builds for sprite in stored(cache, kind, builds, views)]
    return bank


def stored(cache: Path, kind: str, builds: range, views: int) -> list[NDArray[np.uint8]]:
    """The sprites of some builds from their file, which is made where it is missing."""
    file = cache / f'sprites_{kind}_{builds.start}.npz'
    if not file.exists():
        print(f'rendering {len(builds)} builds: {kind}', flush=True)
        rendered = ((build, view, sprite) for build in builds for view, sprite in enumerate(render(build, kind, views)))
        np.savez_compressed(file, **{f'{build:04d}/{view}': sprite for build, view, sprite in rendered})
    return list(np.load(file).values())
