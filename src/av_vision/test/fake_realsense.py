"""A D435i made of the SDK's own software device: what the driver sees is the real SDK."""

from __future__ import annotations

import threading
import time

import numpy as np
import pyrealsense2 as rs

WIDTH, HEIGHT, RATE = 640, 480, 30
DEPTH_MM = 1500


class FakeRealSense:
    """Colour frames whose first pixel counts frames, depth of DEPTH_MM, gyro and accelerometer, until `stop`."""

    def __init__(self):
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, 'Software D435i')
        self.device.register_info(rs.camera_info.serial_number, '0815')
        self._colour = self.device.add_sensor('RGB Camera')
        self._stereo = self.device.add_sensor('Stereo Module')
        self._motion = self.device.add_sensor('Motion Module')
        self._profiles = [self._video(self._colour, rs.stream.color, 0, rs.format.bgr8, 3),
                          self._video(self._stereo, rs.stream.depth, 1, rs.format.z16, 2)]
        self._stereo.add_read_only_option(rs.option.depth_units, 0.001)
        self._gyro = self._motion_stream(rs.stream.gyro, 2)
        self._accel = self._motion_stream(rs.stream.accel, 3)
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
        self._profiles[1].register_extrinsics_to(self._profiles[0], extrinsics)
        self.device.create_matcher(rs.matchers.default)
        self._stop, self._thread = threading.Event(), None
        self.is_blind = False    # gives depth alone

    def start(self):
        self._stop.clear()
        self._thread = threading.Thread(target=self._feed, daemon=True)
        self._thread.start()

    def stop(self):
        self._stop.set()
        if self._thread:
            self._thread.join()

    def _video(self, sensor, kind, uid, form, bytes_per_pixel):
        lens = rs.intrinsics()
        lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = WIDTH, HEIGHT, 605.0, 606.0, 321.0, 243.0
        lens.model, lens.coeffs = rs.distortion.inverse_brown_conrady, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt, stream.intrinsics = kind, 0, uid, form, lens
        stream.width, stream.height, stream.fps, stream.bpp = WIDTH, HEIGHT, RATE, bytes_per_pixel
        return rs.video_stream_profile(sensor.add_video_stream(stream))

    def _motion_stream(self, kind, uid):
        stream = rs.motion_stream()
        stream.type, stream.index, stream.uid, stream.fps, stream.fmt = kind, 0, uid, 200, rs.format.motion_xyz32f
        return rs.motion_stream_profile(self._motion.add_motion_stream(stream))

    def _feed(self):
        colour, number = np.zeros((HEIGHT, WIDTH, 3), np.uint8), 0
        depth = np.full((HEIGHT, WIDTH), DEPTH_MM, np.uint16)
        while not self._stop.is_set():
            colour[0, 0] = number % 256
            for sensor, profile, pixels, size in ((self._stereo, self._profiles[1], depth, 2),
                                                  (self._colour, self._profiles[0], colour, 3)):
                frame = rs.software_video_frame()
                frame.pixels, frame.stride, frame.bpp, frame.profile = pixels.copy(), WIDTH * size, size, profile
                frame.timestamp, frame.domain = 5000.0 + 1e3 * number / RATE, rs.timestamp_domain.hardware_clock
                frame.frame_number = number
                if size == 2:
                    frame.depth_units = 0.001
                if size == 2 or not self.is_blind:
                    sensor.on_video_frame(frame)
            for profile, value in ((self._accel, (0.0, -9.81, 0.0)), (self._gyro, (0.1, 0.2, 0.3))):
                motion = rs.software_motion_frame()
                vector = rs.vector()
                vector.x, vector.y, vector.z = value
                motion.data, motion.profile, motion.frame_number = vector, profile, number
                motion.timestamp, motion.domain = 5000.0 + 1e3 * number / RATE, rs.timestamp_domain.hardware_clock
                self._motion.on_motion_frame(motion)
            number += 1
            time.sleep(1.0 / RATE)
