"""All that a renderer has to know beforehand, as plain data that can be handed to another process."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from av_common.camera import PinholeCamera
from av_simulator.rendering.flat_renderer import FlatRenderer
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import Renderer

log = logging.getLogger('simulator')

RENDERERS = ('auto', 'scene', 'flat')
RENAMED_RENDERERS = {'painter': 'flat'}


@dataclass(frozen=True)
class RendererFactory:
    """Makes renderers of one camera in one scene.

    Parameters:
        camera: pinhole model of the camera.
        scene: what stands in the scene, and its ground and sky.
        drones: size (m) and number of rotors of each drone.
        obstacles: solids beside those of the scene.
        seed: of everything random in the scene.
        air_c (deg C): temperature of the air, for thermal images.
    """

    camera: PinholeCamera
    scene: Scene
    drones: tuple[tuple[float, int], ...]
    obstacles: tuple[Solid, ...]
    seed: int
    air_c: float

    def make(self, kind: str = 'auto', samples: int = 0, everything: bool = False) -> Renderer:
        """A renderer, to be used by the calling thread.

        Parameters:
            kind: `scene` (3D, MuJoCo), `flat` (OpenCV, needs no OpenGL), or `auto`: `scene` where it works.
            samples: samples a pixel, against jagged edges; 0 for none beside the pixel's own.
            everything: whether segmentation and thermal image are made of every view.

        Raises ValueError for another kind, RuntimeError where `scene` does not work on this machine.
        """
        if kind in RENAMED_RENDERERS:
            raise ValueError(f'renderer: {kind!r} is now named {RENAMED_RENDERERS[kind]!r}')
        if kind not in RENDERERS:
            raise ValueError(f'renderer: {kind!r}, one of {", ".join(RENDERERS)} expected')
        if kind != 'flat':
            try:
                return SceneRenderer(self.camera, self.scene, list(self.drones), self.seed, list(self.obstacles),
                                     self.air_c, samples, everything)
            except RuntimeError as error:
                if kind == 'scene':
                    raise
                log.warning('flat images instead of the 3D scene: %s', error)
        return FlatRenderer(self.camera, self.scene, self.seed, self.obstacles)
