"""Cameras that OpenCV opens: V4L2 devices such as USB cameras and capture cards, and OpenCV addresses."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

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

    def read(self) -> CapturedImage:
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
        return CapturedImage(image, arrival - age if 0.0 <= age < OLDEST_S else arrival)

    def close(self) -> None:
        """Close the device."""
        if hasattr(self, '_video'):
            self._video.release()
