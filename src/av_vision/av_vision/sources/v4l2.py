"""Cameras that OpenCV opens: V4L2 devices such as USB cameras and capture cards, and OpenCV addresses."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2

from av_vision.sources.capture import CapturedImage, SourceError

OLDEST_S = 1.0


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
    """

    device: str
    width: int = 640
    height: int = 480
    rate: float = 0.0
    exposure_ms: float = 0.0
    now: Callable[[], float] = time.time

    def open(self) -> None:
        """Open and configure; raises SourceError for a device that is absent or in use."""
        self._video = cv2.VideoCapture(int(self.device) if self.device.isdigit() else self.device, cv2.CAP_ANY)
        if not self._video.isOpened():
            raise SourceError(f'camera {self.device} cannot be opened: it is absent or in use')
        wanted = {cv2.CAP_PROP_FRAME_WIDTH: self.width, cv2.CAP_PROP_FRAME_HEIGHT: self.height,
                  cv2.CAP_PROP_FPS: self.rate or 30.0, cv2.CAP_PROP_BUFFERSIZE: 1}
        if self.exposure_ms > 0.0:
            # V4L2 counts exposure in units of 0.1 ms; 1 means manual exposure.
            wanted |= {cv2.CAP_PROP_AUTO_EXPOSURE: 1, cv2.CAP_PROP_EXPOSURE: 10.0 * self.exposure_ms}
        for name, value in wanted.items():
            self._video.set(name, value)

    def read(self) -> CapturedImage:
        """The next image; raises SourceError when the device delivers none."""
        good, image = self._video.read()
        arrival = self.now()
        if not good or image is None:
            raise SourceError(f'camera {self.device} delivers no more images; is it unplugged?')
        age = time.monotonic() - 1e-3 * self._video.get(cv2.CAP_PROP_POS_MSEC)
        return CapturedImage(image, arrival - age if 0.0 <= age < OLDEST_S else arrival)

    def close(self) -> None:
        """Close the device."""
        if hasattr(self, '_video'):
            self._video.release()
