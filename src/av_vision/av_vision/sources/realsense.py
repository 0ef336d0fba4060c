"""RealSense cameras and recordings of them, read by Intel's SDK."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from av_common.camera import PinholeCamera
from av_common.clock import SenderClock
from av_vision.sources.capture import STALE_S, Frame, SourceError

TIMEOUT_MS = round(1e3 * STALE_S)
PARTIAL_S = 10.0  # of frames without colour, depth where that is wanted, or a valid time: streams begin within a few seconds
Motion = Callable[[float, tuple[float, float, float], tuple[float, float, float]], None]


def sdk() -> ModuleType:
    """pyrealsense2; raises SourceError where it is not installed."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise SourceError(f'device=realsense needs the Python package pyrealsense2: {error}') from error
    return pyrealsense2


@dataclass
class RealSenseSource:
    """The colour images of a RealSense camera, optionally with aligned depth and motion.

    Parameters:
        serial: serial number of the camera; empty for the first one.
        width, height (pixels), rate (1/s): mode of the streams.
        exposure_ms (ms): exposure time; 0 keeps the device's setting.
        depth: whether to capture depth aligned to the colour image.
        on_motion: function that the thread of the SDK calls with time (s), angular velocity (rad/s) and acceleration
            (m/s^2) in the camera's optical frame.
        device: existing device of the SDK to use instead, such as a software device.
        now: clock of the caller in s.
    """

    serial: str = ''
    width: int = 640
    height: int = 480
    rate: float = 30.0
    exposure_ms: float = 0.0
    depth: bool = False
    on_motion: Motion | None = None
    device: Any = None
    now: Callable[[], float] = time.time
    _running: list[Any] = field(default_factory=list)

    def open(self) -> None:
        """Start the streams; raises SourceError when the device or its mode is not available."""
        self._rs = sdk()
        try:
            self._start()
        except RuntimeError as error:
            raise SourceError(f'RealSense {self.serial}: {error}') from error

    def read(self) -> Frame:
        """The next colour image, with the depth that belongs to it; raises SourceError when no such frames arrive."""
        begun = time.monotonic()
        while time.monotonic() - begun < PARTIAL_S:
            try:
                frames = self._queue.wait_for_frames(TIMEOUT_MS)
            except RuntimeError as error:
                raise SourceError(f'RealSense {self.serial} delivers no more frames: {error}') from error
            if frames.get_color_frame() and (frames.get_depth_frame() or not self.depth):
                taken = self._clock.date(1e-3 * frames.get_color_frame().get_timestamp(), self.now())
                if taken is not None:  # images without a valid time are skipped
                    return self._captured(frames, taken)
        raise SourceError(f'RealSense {self.serial} delivers no more images of all its streams, or none with a valid time')

    def close(self) -> None:
        """Stop the streams, also while another thread reads; allowed when they are stopped or the device is unplugged."""
        while self._running:
            with suppress(IndexError):    # another thread was faster
                sensor = self._running.pop()
                for end in (sensor.stop, sensor.close):
                    with suppress(RuntimeError):    # it does not stream yet, or was unplugged
                        end()

    def _start(self) -> None:
        rs = self._rs
        device = self.device or self._find()
        self._queue, self._align = rs.syncer(), rs.align(rs.stream.color)
        self._clock, self._motion_clock = SenderClock(), SenderClock()
        self._depth_unit = 1e-3
        for sensor in device.query_sensors():
            wanted = [profile for profile in sensor.get_stream_profiles() if self._wants(profile)]
            if not wanted:
                continue
            one_each = {(profile.stream_type(), profile.stream_index()): profile for profile in reversed(wanted)}
            if self.exposure_ms > 0.0 and sensor.supports(rs.option.exposure) and not sensor.is_depth_sensor():
                sensor.set_option(rs.option.exposure, 10.0 * self.exposure_ms)  # in 0.1 ms, as in V4L2
            if sensor.is_depth_sensor():
                self._depth_unit = sensor.as_depth_sensor().get_depth_scale()
            sensor.open(list(one_each.values()))
            self._running.append(sensor)
            motion = all(profile.is_motion_stream_profile() for profile in one_each.values())
            sensor.start(self._on_motion if motion else self._queue)
        if not self._running:
            raise SourceError(f'no colour stream of {self.width}x{self.height} at {self.rate:g}/s; see rs-enumerate-devices')

    def _find(self) -> Any:
        rs = self._rs
        context = rs.context()
        devices = [device for device in context.query_devices()
                   if self.serial in ('', device.get_info(rs.camera_info.serial_number))]
        if not devices:
            raise SourceError(f'no RealSense{" " + self.serial if self.serial else ""} is plugged in')
        return devices[0]

    def _wants(self, profile: Any) -> bool:
        rs = self._rs
        kind = profile.stream_type()
        if kind in (rs.stream.gyro, rs.stream.accel):
            return self.on_motion is not None
        if kind not in ((rs.stream.color, rs.stream.depth) if self.depth else (rs.stream.color,)):
            return False
        video = profile.as_video_stream_profile()
        right_form = profile.format() in (rs.format.bgr8, rs.format.z16)
        mine = (video.width(), video.height(), video.fps()) == (self.width, self.height, int(self.rate or 30))
        return bool(right_form and mine)

    def _captured(self, frames: Any, taken: float) -> Frame:
        if self.depth:
            frames = self._align.process(frames)
        colour = frames.get_color_frame()
        depth = None
        if self.depth and frames.get_depth_frame():
            raw = np.asanyarray(frames.get_depth_frame().get_data())
            depth = raw.copy() if self._depth_unit == 1e-3 else np.rint(raw * (1e3 * self._depth_unit)).astype(np.uint16)
        return Frame(np.asanyarray(colour.get_data()).copy(), taken, self._camera(colour), depth)

    def _camera(self, colour: Any) -> PinholeCamera:
        lens = colour.profile.as_video_stream_profile().intrinsics
        # The SDK's inverse models go from pixels to rays; their coefficients are zero on all D400 cameras.
        coefficients = tuple(lens.coeffs) if lens.model == self._rs.distortion.brown_conrady and any(lens.coeffs) else ()
        return PinholeCamera(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy, coefficients)

    def _on_motion(self, frame: Any) -> None:
        data = frame.as_motion_frame().get_motion_data()
        value = (data.x, data.y, data.z)
        if frame.get_profile().stream_type() == self._rs.stream.accel:
            self._acceleration = value
        elif self.on_motion is not None and hasattr(self, '_acceleration'):
            taken = self._motion_clock.date(1e-3 * frame.get_timestamp(), self.now())
            if taken is not None:
                self.on_motion(taken, value, self._acceleration)
