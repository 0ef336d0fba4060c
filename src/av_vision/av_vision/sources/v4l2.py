"""Cameras that OpenCV opens: V4L2 devices (USB cameras, capture cards), or anything with an OpenCV address."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2

from av_vision.sources.capture import CapturedImage, SourceError

OLDEST_S = 1.0


@dataclass
class DeviceSource:
    """A camera by its index ('0') or path ('/dev/video0'). `rate` and `exposure_ms` of 0 leave it to the device.

    Stamps are the driver's, which count on the monotonic clock from the capture; a driver without them gives the arrival.
    """

    device: str
    width: int = 640
    height: int = 480
    rate: float = 0.0
    exposure_ms: float = 0.0
    now: Callable[[], float] = time.time

    def open(self) -> None:
        """Open and configure; raises SourceError for a device that is absent, busy or silent."""
        self._video = cv2.VideoCapture(int(self.device) if self.device.isdigit() else self.device, cv2.CAP_ANY)
        if not self._video.isOpened():
            raise SourceError(f'camera {self.device} cannot be opened: it is absent or in use')
        wanted = {cv2.CAP_PROP_FRAME_WIDTH: self.width, cv2.CAP_PROP_FRAME_HEIGHT: self.height,
                  cv2.CAP_PROP_FPS: self.rate or 30.0, cv2.CAP_PROP_BUFFERSIZE: 1}
        if self.exposure_ms > 0.0:
            # V4L2 counts exposure in units of 0.1 ms; 1 is its word for manual exposure.
            wanted |= {cv2.CAP_PROP_AUTO_EXPOSURE: 1, cv2.CAP_PROP_EXPOSURE: 10.0 * self.exposure_ms}
        for name, value in wanted.items():
            self._video.set(name, value)

    def read(self) -> CapturedImage:
        """The next image; raises SourceError when the device is gone."""
        good, image = self._video.read()
        arrival = self.now()
        if not good or image is None:
            raise SourceError(f'camera {self.device} gives no more images: unplugged?')
        age = time.monotonic() - 1e-3 * self._video.get(cv2.CAP_PROP_POS_MSEC)
        return CapturedImage(image, arrival - age if 0.0 <= age < OLDEST_S else arrival)

    def close(self) -> None:
        """Give the device back."""
        if hasattr(self, '_video'):
            self._video.release()
