"""Images of the project's simulator with exact boxes: its scenes, its air, its lens, its drones at 2 to 40 m.

Seeds differ from those of every scenario, so that the scenarios stay unseen.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from clips import HEIGHT, INFRARED_SIZE, WIDTH
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import SCENES
from av_simulator.rendering.view import Drone, RenderedImage, View
from av_vision.image import AutomaticGain

FIRST_SEED = 9000
PADDING = (10.0, 9.0)  # pixels that labels of infrared clips are wider and higher than the object
LEAST_CONTRAST = 20.0  # of 255, of what is labelled in a thermal image
KINDS = ('woodland', 'field', 'urban', 'woodland', 'field', 'indoors', 'urban')


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
                boxes = np.pad(boxes_of(image, 6.0), ((0, 0), (1, 0))).tolist()    # of class 0
                index.append({'clip': f'V_SIM_{world:03d}', 'frame': number, 'split': 'train', 'boxes': boxes})
    (folder / 'index.json').write_text(json.dumps(index))


def build_thermal(store: Path, index: Path, worlds: int = 80, images: int = 24) -> None:
    """Render thermal images (n, 256, 320) once, every other world as raw counts, in the form that `ThermalFrames` reads.

    Parameters:
        store, index: files of the images, and of their worlds and boxes.
        worlds, images: number of scenes, and of images of each.
    """
    dx, dy = 0.5 * np.array(PADDING)
    frames, entries = [], []
    for world in range(worlds):
        for number, image in enumerate(fly(world, images, 'raw' if world % 2 else 'white_hot')):
            frames.append(AutomaticGain().apply(image.bgr, 0.0))
            x1, y1, x2, y2 = boxes_of(image, least=3.0).T
            boxes = np.column_stack([np.zeros_like(x1), x1 - dx, y1 - dy, x2 + dx, y2 + dy])
            seen = [box.tolist() for box in boxes if stands_out(frames[-1], box[1:])]
            entries.append({'clip': f'IR_SIM_{world:03d}', 'frame': number, 'boxes': seen})
    np.save(store, np.stack(frames))
    index.write_text(json.dumps(entries))


def stands_out(image: NDArray[np.uint8], box: NDArray) -> bool:
    """Whether a tenth of an object differs from its surroundings in a label's box (4,): it may be as warm as they are."""
    around = np.rint(box).astype(int)
    dx, dy = np.ceil(0.5 * np.array(PADDING)).astype(int)
    x1, y1, x2, y2 = around + np.array([dx, dy, -dx, -dy])
    rim = np.zeros(image.shape, bool)
    rim[max(around[1], 0):around[3], max(around[0], 0):around[2]] = True
    rim[y1:y2 + 1, x1:x2 + 1] = False
    off = np.abs(image[y1:y2 + 1, x1:x2 + 1] - np.median(image[rim]))
    return bool(np.percentile(off, 90) > LEAST_CONTRAST)


def fly(world: int, images: int, palette: str = '') -> Iterator[RenderedImage]:
    """Images of one scene, by a thermal camera where a palette is given: camera and two drones are somewhere else in each."""
    rng = np.random.default_rng([FIRST_SEED, world, *([1] if palette else [])])
    kind = KINDS[world % len(KINDS)]
    size, fov = (INFRARED_SIZE, (24, 60)) if palette else ((WIDTH, HEIGHT), (45, 90))
    camera = PinholeCamera.from_fov(*size, np.radians(rng.uniform(*fov)))
    drones = [(float(rng.uniform(0.3, 0.8)), int(rng.choice([4, 4, 6]))) for _ in range(2)]
    renderer = SceneRenderer(camera, SCENES[kind](), drones, FIRST_SEED + world, palette=palette)
    nearest, farthest = (4.0, 40.0) if palette else (2.0, 30.0)
    reach = (nearest, nearest + 3.0) if kind == 'indoors' else (nearest, farthest)
    for number in range(images):
        yield renderer.render(random_view(rng, camera, number, drones, reach))
    renderer.close()


def random_view(rng: np.random.Generator, camera: PinholeCamera, number: int, drones: list[tuple[float, int]],
                reach: tuple[float, float]) -> View:
    """A camera near the ground that points along the horizon or up, drones at random pixels and distances, sometimes fog."""
    position = np.array([*rng.uniform(-2, 2, 2), rng.uniform(0.5, 2.5)])
    flu = rotation_from_rpy(rng.normal(0, 0.05), rng.uniform(-0.5, 0.15), rng.uniform(-np.pi, np.pi))
    rotation = flu @ FLU_TO_OPTICAL.T
    fog = float(rng.exponential(0.05)) if rng.random() < 0.5 else 0.0
    placed = []
    for k, (size, rotors) in enumerate(drones):
        pixel = rng.uniform([20, 20], [camera.width - 20, camera.height - 20])
        distance = np.exp(rng.uniform(*np.log(reach)))
        place = position + distance * (rotation @ camera.rays(pixel[None])[0])
        place[2] = max(place[2], 0.4)
        attitude = rotation_from_rpy(*rng.normal(0, 0.2, 2), rng.uniform(-np.pi, np.pi))
        placed.append(Drone(FIRST_TARGET + k, place, attitude, size, rotors, rng.uniform(0, 6.28, rotors)))
    return View(number, 0.1 * number, position, rotation, Atmosphere(fog), placed)


def boxes_of(image: RenderedImage, least: float = 0.0) -> NDArray[np.float32]:
    """Boxes (k, 4) of the visible drones of an image that are at least some pixels wide."""
    boxes = [truth.box for truth in image.truth if truth.box and truth.visible_fraction > 0.4]
    boxes = np.array(boxes, np.float32).reshape(-1, 4) + np.array([0, 0, 1, 1], np.float32)
    return boxes[boxes[:, 2] - boxes[:, 0] >= least]
