"""Rendering in a separate process: in one process with the sound, both would compete for the interpreter's lock."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

import cv2
import numpy as np

from av_common.camera import PinholeCamera
from av_sim_bridge.wire.oracle import OracleBox
from av_simulator.rendering.flat_renderer import FlatRenderer
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import View

MOST_WAITING = 2       # maximum number of requested views; more would only add delay
PATIENCE = 60.0        # s, limit for the first image, which includes loading of libraries and compilation of shaders
LAST = 5.0             # s, limit for what is outstanding when the simulation ends, and for the end of the process
HUNG = 20.0            # s, limit for a further one: a scene on a core that thirty others share takes half of it
FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]
log = logging.getLogger('simulator')

RENDERERS = ('auto', 'scene', 'flat')
Renderer = SceneRenderer | FlatRenderer    # the same view gives the same image
RendererFactory = Callable[..., Renderer]    # `make_renderer` but for `kind` and `everything`


def make_renderer(camera: PinholeCamera, scene: Scene, drones: Sequence[tuple[float, int]], obstacles: Sequence[Solid],
                  seed: int, air_c: float, palette: str = '', kind: str = 'auto', everything: bool = False) -> Renderer:
    """A new renderer for one camera in one scene, which only the calling thread may use.

    Raises ValueError for an unknown kind and a lens that does not fill the image, RuntimeError if `scene` does not work here.

    Parameters:
        camera: pinhole model of the camera.
        scene: solids, ground and sky.
        drones: size (m) and number of rotors of each drone.
        obstacles: solids in addition to those of the scene.
        seed: seed of all random properties of the scene.
        air_c (deg C): temperature of the air, for thermal images.
        palette: of a thermal camera, see `ThermalCamera`; empty for a visible one.
        kind: `scene` (3D, MuJoCo), `flat` (OpenCV, without OpenGL), or `auto` (`scene` if it works, else `flat`).
        everything: whether segmentation and temperatures are rendered for every view.
    """
    if kind not in RENDERERS:
        raise ValueError(f'renderer: {kind!r}, expected one of {", ".join(RENDERERS)}')
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * (camera.width - 1, camera.height - 1)
    if np.isnan(camera.rays(corners)).any():
        raise ValueError(f'camera: a lens with the distortion {camera.distortion} does not fill '
                         f'{camera.width} x {camera.height} pixels')
    if kind != 'flat':
        try:
            return SceneRenderer(camera, scene, drones, seed, obstacles, air_c, everything, palette)
        except RuntimeError as error:
            if kind == 'scene':
                raise
            log.warning('using flat images instead of the 3D scene: %s', error)
    return FlatRenderer(camera, scene, seed, obstacles, thermal=bool(palette))


@dataclass(frozen=True)
class CameraFrame:
    """One rendered view, encoded for the wire.

    Parameters:
        view: the view that was rendered.
        encoded: the image as JPEG, raw counts of a thermal camera as 16-bit PNG.
        boxes: report of the visual oracle.
        depth: depth (mm) as 16-bit PNG, empty if not requested.
    """

    view: View
    encoded: bytes
    boxes: list[OracleBox]
    depth: bytes = b''


class RenderProcess:
    """Renders views in another process and returns the frames in order. Must be used by one thread only.

    Parameters:
        factory: creates the renderer in that process.
        kind: kind of renderer, see `make_renderer`.
        first: view for the warm-up of the renderer, whose frame is discarded.
        depth: whether every frame includes depth.
    """

    def __init__(self, factory: RendererFactory, kind: str, first: View, depth: bool = False) -> None:
        self._waiting, self._answers = 0, False    # views without a frame; whether one is worth waiting for
        self._progress = time.monotonic()    # s, when the newest frame came, or was requested where none was outstanding
        context = multiprocessing.get_context('spawn')    # a fork would copy locks held by other threads
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other, factory, kind, first, depth),
                                        name='camera', daemon=True)
        self._process.start()
        other.close()

    def open(self, keep_waiting: Callable[[], bool]) -> None:
        """Wait until the renderer is ready, or until `keep_waiting` returns False.

        Raises the renderer's exception, RuntimeError if the process ends, and TimeoutError after PATIENCE.
        """
        for _ in range(int(PATIENCE / 0.05)):
            if self._connection.poll(0.05):
                self._receive()
                self._answers = True
                return
            if not keep_waiting():
                return
        raise TimeoutError(f'camera: no image within {PATIENCE:.0f} s')

    @property
    def busy(self) -> bool:
        """Whether a requested frame is outstanding."""
        return self._waiting > 0

    def request(self, view: View) -> bool:
        """Request a frame; False if MOST_WAITING frames are outstanding.

        Raises RuntimeError if the process has ended, and TimeoutError once none came for HUNG.
        """
        if self._waiting >= MOST_WAITING:
            if time.monotonic() - self._progress > HUNG:
                self._answers = False
                raise TimeoutError(f'camera: no image within {HUNG:.0f} s')
            return False
        if not self._waiting:
            self._progress = time.monotonic()
        try:
            self._connection.send(view)
        except OSError:
            raise self._ended() from None
        self._waiting += 1
        return True

    def ready(self, timeout: float = 0.0) -> list[CameraFrame]:
        """Completed frames; waits up to `timeout` (s) for the first one. Raises the renderer's exception."""
        frames = []
        while self._waiting and self._connection.poll(timeout):
            frames.append(self._receive())
            self._progress = time.monotonic()
            self._waiting -= 1
            timeout = 0.0
        return frames

    def close(self) -> list[CameraFrame]:
        """End the process and return the outstanding frames; one that is hung is killed at once."""
        frames: list[CameraFrame] = []
        try:
            while self._answers and self._waiting:
                done = self.ready(timeout=LAST)
                self._answers, frames = bool(done), frames + done
        finally:
            self._connection.close()
            self._process.join(LAST if self._answers else 0.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        return frames

    def _receive(self) -> CameraFrame:
        """The next result of the process; the first one, of the warm-up, is None."""
        try:
            result = self._connection.recv()
        except (EOFError, OSError):
            raise self._ended() from None
        if isinstance(result, Exception):
            self._waiting = 0
            raise result
        return result

    def _ended(self) -> RuntimeError:
        """The error to raise when the connection broke off."""
        self._waiting = 0
        self._process.join()
        return RuntimeError(f'camera: its process ended with exit code {self._process.exitcode}')


def _work(connection: Connection, factory: RendererFactory, kind: str, first: View, depth: bool) -> None:
    """Main function of the process: render views from the connection until it is closed."""
    for number in (signal.SIGINT, signal.SIGTERM):    # sent to the whole process group; the simulator ends this process
        signal.signal(number, signal.SIG_IGN)
    logging.basicConfig(format='[%(name)s] %(message)s', stream=sys.stderr)
    # Images are small: one core suffices, and threads of Mesa's renderer would need 25 % more processor time.
    cv2.setNumThreads(1)
    os.environ.setdefault('LP_NUM_THREADS', '0')
    try:
        renderer = factory(kind=kind)
        if renderer.render(first).depth is None and depth:
            raise RuntimeError('camera: depth requires the renderer `scene`')
        connection.send(None)
        while True:
            view = connection.recv()
            image = renderer.render(view)
            raw = image.bgr.dtype == np.uint16
            data = cv2.imencode('.png' if raw else '.jpg', image.bgr, FAST_PNG if raw else JPEG)[1].tobytes()
            png = b'' if not depth or image.depth_mm is None else cv2.imencode('.png', image.depth_mm, FAST_PNG)[1].tobytes()
            connection.send(CameraFrame(view, data, image.boxes, png))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:    # noqa: BLE001 (every exception is raised again in the simulator)
        connection.send(error)
