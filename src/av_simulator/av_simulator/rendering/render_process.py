"""Images rendered in a process of their own: in one process with the sound, both would wait for the interpreter."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

import cv2

from av_sim_bridge.wire.oracle import OracleBox
from av_simulator.rendering.renderer_factory import RendererFactory
from av_simulator.rendering.view import View

MOST_WAITING = 2       # views; more would only add delay
PATIENCE = 60.0        # s that the first image may take: a slow machine loads libraries and compiles shaders meanwhile
FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class CameraFrame:
    """One rendered view, encoded for the wire.

    Parameters:
        view: what was rendered.
        jpeg: the image.
        boxes: the visual oracle's report.
        depth: depth (mm) as PNG of 16 bit; empty without.
    """

    view: View
    jpeg: bytes
    boxes: list[OracleBox]
    depth: bytes = b''


class RenderProcess:
    """Renders views in another process and returns them in order as they become ready. To be used by one thread.

    Parameters:
        factory: makes the renderer in that process.
        kind: of renderer, see `RendererFactory.make`.
        jpeg_quality (0 to 100): of the images.
        first: view with which the renderer is warmed up; no frame is returned of it.
        depth: whether every frame has depth.
    """

    def __init__(self, factory: RendererFactory, kind: str, jpeg_quality: int, first: View, depth: bool = False) -> None:
        self._waiting, self._opened = 0, False
        context = multiprocessing.get_context('spawn')    # a fork would take threads' locks along
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other, factory, kind, jpeg_quality, first, depth),
                                        name='camera', daemon=True)
        self._process.start()
        other.close()

    def open(self, keep_waiting: Callable[[], bool]) -> None:
        """Wait until the renderer is ready. Raises what keeps it from working, TimeoutError after a minute."""
        for _ in range(int(PATIENCE / 0.05)):
            if self._connection.poll(0.05):
                self._receive()
                self._opened = True
                return
            if not keep_waiting():
                return
        raise TimeoutError(f'camera: no image within {PATIENCE:.0f} s')

    @property
    def busy(self) -> bool:
        """Whether a frame is on its way."""
        return self._waiting > 0

    def request(self, view: View) -> bool:
        """Request a frame; False where too many are waited for already."""
        if self._waiting >= MOST_WAITING:
            return False
        self._connection.send(view)
        self._waiting += 1
        return True

    def ready(self, timeout: float = 0.0) -> list[CameraFrame]:
        """Shots that are done; with a timeout in s, waits for the first one. Raises what keeps the camera from working."""
        frames = []
        while self._waiting and self._connection.poll(timeout):
            frames.append(self._receive())
            self._waiting -= 1
            timeout = 0.0
        return frames

    def close(self) -> list[CameraFrame]:
        """End the process; the frames that were still on their way."""
        frames = []
        try:
            while self._opened and self._waiting and (done := self.ready(timeout=5.0)):
                frames += done
        finally:
            self._connection.close()
            self._process.join(5.0 if self._opened else 0.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        return frames

    def _receive(self) -> CameraFrame:
        """The next result of the process; its first one, of the warm-up, holds nothing."""
        try:
            result = self._connection.recv()
        except EOFError:
            self._waiting = 0
            self._process.join()
            raise RuntimeError(f'camera: its process ended with exit code {self._process.exitcode}') from None
        if isinstance(result, Exception):
            self._waiting = 0
            raise result
        return result


def _work(connection: Connection, factory: RendererFactory, kind: str, jpeg_quality: int, first: View, depth: bool) -> None:
    """Body of the process: render the views that come until the connection is closed."""
    for number in (signal.SIGINT, signal.SIGTERM):    # may go to the whole group; the simulator says when it ends
        signal.signal(number, signal.SIG_IGN)
    logging.basicConfig(format='[%(name)s] %(message)s', stream=sys.stderr)
    # Images are small; the other cores belong to the rig, and threads of Mesa's renderer cost a quarter more work.
    cv2.setNumThreads(1)
    os.environ.setdefault('LP_NUM_THREADS', '0')
    try:
        renderer = factory.make(kind)
        if renderer.render(first).depth is None and depth:
            raise RuntimeError('camera: depth needs the 3D scene, which this renderer does not have')
        connection.send(None)
        while True:
            view = connection.recv()
            image = renderer.render(view)
            jpeg = cv2.imencode('.jpg', image.bgr, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1].tobytes()
            png = b'' if not depth or image.depth_mm is None else cv2.imencode('.png', image.depth_mm, FAST_PNG)[1].tobytes()
            connection.send(CameraFrame(view, jpeg, image.boxes, png))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:    # noqa: BLE001 (whatever it is, the simulator has to know)
        connection.send(error)
