"""Pictures made in a process of their own: in the sound's, both would wait for the interpreter and be late."""

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
from av_simulator.rendering.stage import Stage
from av_simulator.rendering.view import View

MOST_WAITING = 2       # views; more would only be late
PATIENCE = 60.0        # s that the first picture may take: a slow machine loads libraries and compiles shaders meanwhile
FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class Shot:
    """A finished picture: encoded as JPEG, with what the visual oracle reports, and its depth (mm) as PNG of 16 bit."""

    view: View
    jpeg: bytes
    boxes: list[OracleBox]
    depth: bytes = b''


class Studio:
    """Takes views, gives shots, in order, whenever they are ready. To be used by one thread."""

    def __init__(self, stage: Stage, kind: str, jpeg_quality: int, first: View, depth: bool = False):
        """Begin to make ready with the view `first`, of which no shot comes; `depth`: with every shot."""
        self._waiting, self._opened = 0, False
        context = multiprocessing.get_context('spawn')    # a fork would take threads' locks along
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other, stage, kind, jpeg_quality, first, depth),
                                        name='camera', daemon=True)
        self._process.start()
        other.close()

    def open(self, keep_waiting: Callable[[], bool]) -> None:
        """Wait until it is ready. Raises what keeps it from working, TimeoutError after a minute."""
        for _ in range(int(PATIENCE / 0.05)):
            if self._connection.poll(0.05):
                self._receive()
                self._opened = True
                return
            if not keep_waiting():
                return
        raise TimeoutError(f'camera: no picture within {PATIENCE:.0f} s')

    @property
    def busy(self) -> bool:
        """Whether a shot is on its way."""
        return self._waiting > 0

    def ask(self, view: View) -> bool:
        """Ask for a shot; False where too many wait already."""
        if self._waiting >= MOST_WAITING:
            return False
        self._connection.send(view)
        self._waiting += 1
        return True

    def ready(self, timeout: float = 0.0) -> list[Shot]:
        """Shots that are done; with a timeout in s, waits for the first one. Raises what keeps the camera from working."""
        shots = []
        while self._waiting and self._connection.poll(timeout):
            shots.append(self._receive())
            self._waiting -= 1
            timeout = 0.0
        return shots

    def close(self) -> list[Shot]:
        """End the process; the shots that were still on their way."""
        shots = []
        try:
            while self._opened and self._waiting and (done := self.ready(timeout=5.0)):
                shots += done
        finally:
            self._connection.close()
            self._process.join(5.0 if self._opened else 0.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        return shots

    def _receive(self) -> Shot | None:
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


def _work(connection: Connection, stage: Stage, kind: str, jpeg_quality: int, first: View, depth: bool) -> None:
    """Of the process: make shots of the views that come until nobody is there any more."""
    for number in (signal.SIGINT, signal.SIGTERM):    # may go to the whole group; the simulator says when it ends
        signal.signal(number, signal.SIG_IGN)
    logging.basicConfig(format='[%(name)s] %(message)s', stream=sys.stderr)
    # Pictures are small; the other cores belong to the rig, and threads of Mesa's renderer cost a quarter more work.
    cv2.setNumThreads(1)
    os.environ.setdefault('LP_NUM_THREADS', '0')
    try:
        renderer = stage.renderer(kind)
        if renderer.render(first).depth is None and depth:
            raise RuntimeError('camera: depth needs the 3D scene, which this renderer does not have')
        connection.send(None)
        while True:
            view = connection.recv()
            picture = renderer.render(view)
            jpeg = cv2.imencode('.jpg', picture.bgr, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1].tobytes()
            png = cv2.imencode('.png', picture.depth_mm, FAST_PNG)[1].tobytes() if depth else b''
            connection.send(Shot(view, jpeg, picture.boxes, png))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:    # noqa: BLE001 (whatever it is, the simulator has to know)
        connection.send(error)
