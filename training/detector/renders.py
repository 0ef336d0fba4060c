"""How well a detector does on images with something pasted into them, and on those of the simulator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from clips import HEIGHT, WIDTH, Frames
from material import CROWD
from measure import BANDS, Row, match
from numpy.typing import NDArray
from painted import Rng, branches, insect, log_uniform, sunlit
from pasting import crowd, paste
from simulated import boxes_of
from tight import without_padding

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import SCENES
from av_simulator.rendering.view import Drone, RenderedImage, View
from av_vision import Detector
from av_vision.bearing import bearings_of_boxes

BEFORE_THINGS = {8: '0.75', 12: '0.85'}  # aims by the least size
LEAST_COUNT = 120
SUN, SUN_SIZES = 60, (12.0, 60.0)        # images, and sizes in pixels of the drones in them
CLUTTER = 80                             # images of each kind
Sprites = list[NDArray[np.uint8]]
Shot = tuple[RenderedImage, PinholeCamera, Drone, View]


@dataclass
class Pasted:
    """An image into which something was pasted: its box (1, 5), and how much there was to see behind it."""

    image: NDArray[np.uint8]
    box: NDArray[np.float32]
    behind: float

    def overlaps(self, detector: Detector) -> tuple[NDArray, NDArray]:
        """IoU with, and distance in pixels to, the box, of what is detected."""
        return match(without_padding(detector.detect(self.image).boxes, detector.model.box_padding), self.box[:, 1:])


def pasted_into(rng: Rng, frames: Frames, sprites: Sprites, size: float, width: int = HEIGHT, sun: bool = False) -> Pasted:
    """A sprite of `size` pixels in a square of a random frame, or `width` pixels of repeated frames, the sun beside it."""
    frame = frames.image(int(rng.integers(len(frames))))
    canvas = np.ascontiguousarray(np.tile(frame, (1, 2, 1))[:, :width] if width > WIDTH else frame[:, :HEIGHT])
    if sun:
        canvas = sunlit(rng, canvas)
    made = np.empty((0, 5), np.float32)
    while not len(made):
        x = int(rng.integers(0, canvas.shape[1] - HEIGHT + 1))
        crop = canvas[:, x:x + HEIGHT].copy()
        made = paste(rng, crop, made, sprites, size, 0.8 if sun else 1.0, np.full(3, 255.0 if sun else 0.0), 0)
    left, top, right, bottom = made[0, 1:].astype(int)
    behind = crowd(canvas, x + left, top, right - left, bottom - top)
    canvas[:, x:x + HEIGHT] = crop
    return Pasted(canvas, made + np.array([0, x, 0, x, 0], np.float32), behind)


def rendered(detector: Detector, frames: Frames, sprites: Sprites, width: int, count: int) -> list[Row]:
    """Recall of drones of builds never trained on, pasted over frames of clips never trained on, by size and background.

    At the sizes that have aims before woods at least `LEAST_COUNT` are shown: most frames are mostly sky.
    """
    rows: list[Row] = []
    for low, high in BANDS:
        found, near, behind = [], 0, []
        rng, shown = np.random.default_rng([low, width]), max(count, LEAST_COUNT if low in BEFORE_THINGS else 0)
        for _ in range(shown):
            size = log_uniform(rng, low, high)
            one = pasted_into(rng, frames, sprites, size, width)
            overlap, off = one.overlaps(detector)
            good = overlap >= 0.3
            behind.append(one.behind)
            found.append(bool(good.any()))
            near += bool((off[good] <= max(5.0, 0.1 * size)).any())
        right, crowded = np.array(found), np.array(behind) > CROWD
        before, sky = share(right[crowded]), share(right[~crowded])
        print(f'  {low:3}-{high:3} px: {right.mean():.3f}, centre within 5 px or a tenth of its size {near / shown:.3f}; '
              f'before sky {sky:.3f} of {np.sum(~crowded)}, before other things {before:.3f} of {np.sum(crowded)}', flush=True)
        if aim := BEFORE_THINGS.get(low):
            rows.append((f'rendered drones of {low} to {high} pixels before woods, fields, houses', aim,
                         f'{before:.2f} of {np.sum(crowded)}'))
    return rows


def against_sun(detector: Detector, frames: Frames, sprites: Sprites, count: int) -> Iterator[Row]:
    """Recall of the same drones where the sun stands in the image and its glare lies over them."""
    rng = np.random.default_rng(7)
    low, high = SUN_SIZES
    shown = (pasted_into(rng, frames, sprites, log_uniform(rng, low, high), sun=True) for _ in range(count))
    right = [bool((one.overlaps(detector)[0] >= 0.3).any()) for one in shown]
    yield f'rendered drones of {low:.0f} to {high:.0f} pixels against the sun', '', f'{share(right):.2f} of {count}'


def clutter(detector: Detector, frames: Frames, others: Sprites, count: int) -> Iterator[Row]:
    """Share of images in which leaves, insects and other things that are no drones are taken for one."""
    rng = np.random.default_rng(8)
    kinds = {'leaves and branches': ([branches(rng) for _ in range(20)], (60.0, 300.0)),
             'insects near the camera': ([insect(rng) for _ in range(20)], (8.0, 60.0)),
             'rendered balloons, kites, poles': (others, (12.0, 150.0))}
    for kind, (sprites, sizes) in kinds.items():
        shown = (pasted_into(rng, frames, sprites, log_uniform(rng, *sizes)) for _ in range(count))
        wrong = [bool((one.overlaps(detector)[0] > 0).any()) for one in shown]
        yield f'{kind} taken for a drone', '< 0.08', f'{share(wrong):.3f} of {count}'
    wrong = [len(detector.detect(shot[0].bgr)) > 0 for shot in simulator_images('urban', 0.0, count, 6, drones=False)]
    yield 'simulated streets with parked cars, a false drone', '< 0.08', f'{share(wrong):.3f} of {count}'


def share(right: NDArray | list[bool]) -> float:
    """The share that is true; NaN of none."""
    return float(np.mean(right)) if len(right) else np.nan


def simulator_images(kind: str, fog: float, count: int, seed: int, drones: bool = True) -> list[Shot]:
    """A drone of 0.5 m at 3 to 20 m, anywhere in view of the rig's camera, in a scene of the simulator, or the scene alone."""
    rng = np.random.default_rng(seed)
    camera = PinholeCamera(640, 480, 457.0, 457.0, 319.5, 239.5, (-0.08, 0.02, 0.0005, -0.0003, 0.0))
    renderer = SceneRenderer(camera, SCENES[kind](), [(0.5, 4)], seed)
    made = []
    for number in range(count):
        position = np.array([0.08, 0.0, 1.55])
        rotation = rotation_from_rpy(0.0, np.radians(-8.0), rng.uniform(-np.pi, np.pi)) @ FLU_TO_OPTICAL.T
        pixel = rng.uniform([30, 30], [610, 300])
        place = position + rng.uniform(3.0, 20.0) * (rotation @ camera.rays(pixel[None])[0])
        attitude = rotation_from_rpy(*rng.normal(0, 0.1, 2), rng.uniform(-np.pi, np.pi))
        drone = Drone(FIRST_TARGET, place, attitude, 0.5, 4, rng.uniform(0, 6.28, 4))
        view = View(number, 0.1 * number, position, rotation, Atmosphere(fog), [drone] if drones else [])
        made.append((renderer.render(view), camera, drone, view))
    renderer.close()
    return made


def simulator(detector: Detector, threshold: float, count: int) -> None:
    """Recall in clear air, confidence against fog, error of bearings."""
    for kind in ('woodland', 'field', 'urban'):
        for fog in (0.0, 0.03, 0.06, 0.12, 0.25, 0.5):
            hits, visible, best, errors = 0, 0, [], []
            for image, camera, drone, view in simulator_images(kind, fog, count, 5):
                boxes = boxes_of(image)
                if not len(boxes) and fog == 0.0:
                    continue
                visible += 1
                found = detector.detect(image.bgr)
                truth = np.pad(boxes if len(boxes) else np.zeros((1, 4), np.float32), ((0, 0), (1, 0)))
                overlap, _ = match(without_padding(found.boxes, detector.model.box_padding), truth[:, 1:])
                good = np.flatnonzero(overlap >= 0.3)
                best.append(float(found.scores[good[0]]) if good.size else 0.0)
                if good.size and found.scores[good[0]] >= threshold:
                    hits += 1
                    seen = bearings_of_boxes(camera, found.centres[good[:1]], found.sizes[good[:1]], [1.0])
                    away = FLU_TO_OPTICAL.T @ view.to_optical(drone.position[None])[0]
                    errors.append(np.degrees(seen.azimuth[0] - np.arctan2(away[1], away[0])))
            rms = np.sqrt(np.mean(np.square(errors))) if errors else np.nan
            print(f'  {kind:9} fog {fog:4.2f}/m: found {hits / max(visible, 1):.3f} of {visible}, '
                  f'mean score {np.mean(best):.3f}, '
                  f'azimuth error {rms:.3f} deg RMSE', flush=True)
