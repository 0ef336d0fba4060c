"""All that a renderer has to know beforehand, as plain data that can be handed to another process."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from av_common.camera import PinholeCamera
from av_simulator.rendering.painter import Painter
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import Renderer

log = logging.getLogger('simulator')

RENDERERS = ('auto', 'scene', 'painter')


@dataclass(frozen=True)
class Stage:
    """What stands before a camera. drones: size in m and number of rotors of each.  air_c: temperature in degrees Celsius."""

    camera: PinholeCamera
    scene: Scene
    drones: tuple[tuple[float, int], ...]
    obstacles: tuple[Solid, ...]
    seed: int
    air_c: float

    def renderer(self, kind: str = 'auto', samples: int = 0, everything: bool = False) -> Renderer:
        """What makes pictures of views, to be used by the calling thread.

        kind: `scene` (3D, MuJoCo), `painter` (flat, needs no OpenGL) or `auto`.  samples: per pixel, against jagged
        edges.  everything: segmentation and thermal picture of every view. Raises RuntimeError where `scene` cannot be.
        """
        if kind not in RENDERERS:
            raise ValueError(f'renderer: {kind!r}, one of {", ".join(RENDERERS)} expected')
        if kind != 'painter':
            try:
                return SceneRenderer(self.camera, self.scene, list(self.drones), self.seed, list(self.obstacles),
                                     self.air_c, samples, everything)
            except RuntimeError as error:
                if kind == 'scene':
                    raise
                log.warning('painting instead of rendering: %s', error)
        return Painter(self.camera, self.scene, self.seed, self.obstacles)
