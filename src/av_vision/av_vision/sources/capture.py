"""Cameras that OpenCV opens, such as V4L2 devices, read by a thread that reopens a camera after it was unplugged."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.files import one_line

STALE_S = 2.0   # without an image, after which camera_node and detector_node warn
OLDEST_S = 1.0  # age from which a driver's time is none of CLOCK_MONOTONIC


class SourceError(RuntimeError):
    """A camera or file cannot be opened or read."""


@dataclass(frozen=True)
class Frame:
    """An image with the data of its source.

    Parameters:
        image (h, w[, channels]): BGR or grey, of 8 or 16 bits; in files also other depths, as float32.
        time (s): time of capture, on the caller's clock; in a recording since its beginning.
        camera: intrinsics that the device reports.
        depth (h, w; mm): depth as uint16, aligned to the image.
        index: its number in a recording, from 0.
    """

    image: NDArray
    time: float
    camera: PinholeCamera | None = None
    depth: NDArray | None = None
    index: int = 0


class Source(Protocol):
    """A camera. `open` and `read` raise SourceError; `read` waits for an image and returns None at the end of a file."""

    def open(self) -> None:
        """Begin to capture."""

    def read(self) -> Frame | None:
        """The next image."""

    def close(self) -> None:
        """Stop; harmless when not open."""


class Capture:
    """Reads a source in a thread and opens it again after it was lost.

    Parameters:
        source: camera or file.
        deliver: function that is called with each image, in the thread.
        retry_s (s): pause before the source is opened again.
    """

    def __init__(self, source: Source, deliver: Callable[[Frame], None], retry_s: float = 1.0) -> None:
        self.problem = ''
        self.finished = False
        self.reconnections = 0
        self._source = source
        self._deliver = deliver
        self._retry_s = retry_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='capture', daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the source."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._stop.is_set() and not self.finished:
            try:
                self._source.open()
                self._read_all()
            except Exception as error:  # noqa: BLE001  drivers and libraries raise others than SourceError
                text = one_line(error if isinstance(error, SourceError) else repr(error))
                self.problem = text.encode(errors='replace').decode()    # names of files need not be UTF-8, messages must
                self.reconnections += 1
                self._stop.wait(self._retry_s)
            finally:
                self._source.close()

    def _read_all(self) -> None:
        while not self._stop.is_set():
            image = self._source.read()
            if image is None:
                self.finished = True
                return
            self.problem = ''
            self._deliver(image)


@dataclass
class DeviceSource:
    """A camera that OpenCV opens.

    Stamps are the capture times of the driver on the monotonic clock; without them the time of arrival is used.

    Parameters:
        device: index ('0') or path ('/dev/video0') of the camera.
        width, height (pixels): size of the images.
        rate (1/s): frames per second; 0 for 30.
        exposure_ms (ms): exposure time; 0 keeps the device's setting.
        now: clock of the caller in s.
        pixel_format: four letters of V4L2 for grey images without conversion, Y16 or GREY; empty for colour.
    """

    device: str
    width: int = 640
    height: int = 480
    rate: float = 0.0
    exposure_ms: float = 0.0
    now: Callable[[], float] = time.time
    pixel_format: str = ''

    def open(self) -> None:
        """Open and configure; raises SourceError for a device that is absent or in use, or has not the format."""
        self._video = cv2.VideoCapture(int(self.device) if self.device.isdigit() else self.device, cv2.CAP_ANY)
        if not self._video.isOpened():
            raise SourceError(f'camera {self.device} cannot be opened: it is absent or in use')
        wanted = {cv2.CAP_PROP_FRAME_WIDTH: self.width, cv2.CAP_PROP_FRAME_HEIGHT: self.height,
                  cv2.CAP_PROP_FPS: self.rate or 30.0, cv2.CAP_PROP_BUFFERSIZE: 1}
        if self.exposure_ms > 0.0:
            # V4L2 counts exposure in units of 0.1 ms; 1 means manual exposure.
            wanted |= {cv2.CAP_PROP_AUTO_EXPOSURE: 1, cv2.CAP_PROP_EXPOSURE: 10.0 * self.exposure_ms}
        if self.pixel_format:
            code = cv2.VideoWriter.fourcc(*self.pixel_format.ljust(4))
            wanted = {cv2.CAP_PROP_FOURCC: code, **wanted, cv2.CAP_PROP_CONVERT_RGB: 0}
        for name, value in wanted.items():
            self._video.set(name, value)
        if self.pixel_format and self._video.get(cv2.CAP_PROP_FOURCC) != code:
            raise SourceError(f'camera {self.device} has no images of {self.pixel_format}; see v4l2-ctl --list-formats')

    def read(self) -> Frame:
        """The next image; raises SourceError when the device delivers none."""
        good, image = self._video.read()
        arrival = self.now()
        if not good or image is None:
            raise SourceError(f'camera {self.device} delivers no more images; is it unplugged?')
        depth = {'Y16': np.uint16, 'GREY': np.uint8}.get(self.pixel_format)
        if depth is not None and (image.dtype != depth or image.squeeze().ndim != 2):
            raise SourceError(f'camera {self.device} delivers {image.dtype} of shape {image.shape}, not {self.pixel_format}')
        image = image if depth is None else image.squeeze()
        age = time.monotonic() - 1e-3 * self._video.get(cv2.CAP_PROP_POS_MSEC)
        return Frame(image, arrival - age if 0.0 <= age < OLDEST_S else arrival)

    def close(self) -> None:
        """Close the device."""
        if hasattr(self, '_video'):
            self._video.release()
