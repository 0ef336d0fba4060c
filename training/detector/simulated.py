"""Images of the project's simulator with exact boxes: its scenes, its air, its lens, its drones at 2 to 30 m.

Seeds differ from those of every scenario, so that the scenarios stay unseen.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from clips import HEIGHT, WIDTH
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import SCENES
from av_simulator.rendering.view import FIRST_TARGET_ID, Drone, RenderedImage, View

FIRST_SEED = 9000


def build_simulated(folder: Path, worlds: int = 210, images: int = 30) -> None:
    """Render `worlds` scenes with `images` each, once, in the form that `clips.Frames` reads."""
    if (folder / 'index.json').exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    index = []
    with (folder / 'frames.u8').open('wb') as out:
        for world in range(worlds):
            for number, image in enumerate(fly(world, images)):
                out.write(image.bgr.tobytes())
                boxes = [(0, *truth.box[:2], truth.box[2] + 1, truth.box[3] + 1) for truth in image.truth
                         if truth.box and truth.visible_fraction > 0.4 and truth.box[2] - truth.box[0] >= 5]
                index.append({'clip': f'V_SIM_{world:03d}', 'frame': number, 'split': 'train', 'boxes': boxes})
    (folder / 'index.json').write_text(json.dumps(index))


def fly(world: int, images: int) -> Iterator[RenderedImage]:
    """Images of one scene: the camera and two drones are somewhere else in each."""
    rng = np.random.default_rng([FIRST_SEED, world])
    kind = ['woodland', 'field', 'urban', 'woodland', 'field', 'indoors', 'urban'][world % 7]
    camera = PinholeCamera.from_fov(WIDTH, HEIGHT, np.radians(rng.uniform(45, 90)))
    drones = [(float(rng.uniform(0.3, 0.8)), int(rng.choice([4, 4, 6]))) for _ in range(2)]
    renderer = SceneRenderer(camera, SCENES[kind](), drones, FIRST_SEED + world)
    for number in range(images):
        yield renderer.render(random_view(rng, camera, number, drones, indoors=kind == 'indoors'))
    renderer.close()


def random_view(rng: np.random.Generator, camera: PinholeCamera, number: int, drones: list[tuple[float, int]],
                indoors: bool) -> View:
    """A camera near the ground that points along the horizon or up, drones at random pixels and distances, sometimes fog."""
    position = np.array([*rng.uniform(-2, 2, 2), rng.uniform(0.5, 2.5)])
    flu = rotation_from_rpy(rng.normal(0, 0.05), rng.uniform(-0.5, 0.15), rng.uniform(-np.pi, np.pi))
    rotation = flu @ FLU_TO_OPTICAL.T
    fog = float(rng.exponential(0.05)) if rng.random() < 0.5 else 0.0
    placed = []
    for k, (size, rotors) in enumerate(drones):
        pixel = rng.uniform([20, 20], [WIDTH - 20, HEIGHT - 20])
        distance = np.exp(rng.uniform(np.log(2.0), np.log(5.0 if indoors else 30.0)))
        place = position + distance * (rotation @ camera.rays(pixel[None])[0])
        place[2] = max(place[2], 0.4)
        attitude = rotation_from_rpy(*rng.normal(0, 0.2, 2), rng.uniform(-np.pi, np.pi))
        placed.append(Drone(FIRST_TARGET_ID + k, place, attitude, size, rotors, rng.uniform(0, 6.28, rotors)))
    return View(number, 0.1 * number, position, rotation, Atmosphere(fog), placed)


def boxes_of(image: RenderedImage) -> NDArray[np.float32]:
    """Boxes (k, 4) of the visible drones of an image."""
    boxes = [truth.box for truth in image.truth if truth.box and truth.visible_fraction > 0.4]
    return np.array(boxes, np.float32).reshape(-1, 4) + np.array([0, 0, 1, 1], np.float32)
