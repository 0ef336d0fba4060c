"""Configuration of a renderer as plain data, which can be sent to another process."""

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


@dataclass(frozen=True)
class RendererFactory:
    """Creates renderers for one camera in one scene.

    Parameters:
        camera: pinhole model of the camera.
        scene: solids, ground and sky.
        drones: size (m) and number of rotors of each drone.
        obstacles: solids in addition to those of the scene.
        seed: seed of all random properties of the scene.
        air_c (deg C): temperature of the air, for thermal images.
        palette: of a thermal camera, see `ThermalCamera`; empty for a visible one.
    """

    camera: PinholeCamera
    scene: Scene
    drones: tuple[tuple[float, int], ...]
    obstacles: tuple[Solid, ...]
    seed: int
    air_c: float
    palette: str = ''

    def make(self, kind: str = 'auto', samples: int = 0, everything: bool = False) -> Renderer:
        """A new renderer, which only the calling thread may use.

        Raises ValueError for an unknown kind, RuntimeError if `scene` does not work on this machine.

        Parameters:
            kind: `scene` (3D, MuJoCo), `flat` (OpenCV, without OpenGL), or `auto` (`scene` if it works, else `flat`).
            samples: samples per pixel for antialiasing, 0 for none.
            everything: whether segmentation and temperatures are rendered for every view.
        """
        if kind not in RENDERERS:
            raise ValueError(f'renderer: {kind!r}, expected one of {", ".join(RENDERERS)}')
        if kind != 'flat':
            try:
                return SceneRenderer(self.camera, self.scene, list(self.drones), self.seed, list(self.obstacles),
                                     self.air_c, samples, everything, self.palette)
            except RuntimeError as error:
                if kind == 'scene':
                    raise
                log.warning('using flat images instead of the 3D scene: %s', error)
        return FlatRenderer(self.camera, self.scene, self.seed, self.obstacles)
