"""The RealSense source through the real SDK: a software device, and a recording of it."""

import time
from typing import ClassVar

import numpy as np
import pytest

pytest.importorskip('pyrealsense2', reason='pyrealsense2 is not installed')

from fake_realsense import DEPTH_MM, RATE, FakeRealSense

from av_vision import Capture, RealSenseSource, SourceError


@pytest.fixture
def camera():
    fake = FakeRealSense()
    yield fake
    fake.stop()


class DeviceTime:
    """A clock that gives the device's own stamps, however late they arrive."""

    observed: ClassVar = []

    def __init__(self, **_):
        self.observed.clear()

    def date(self, stamp, arrival):
        self.observed.append((stamp, arrival))
        return stamp


def test_colour_depth_intrinsics_and_stamps(camera, monkeypatch):
    monkeypatch.setattr('av_vision.sources.realsense.SenderClock', DeviceTime)
    motion = []
    source = RealSenseSource(device=camera.device, depth=True, on_motion=lambda *sample: motion.append(sample),
                             now=lambda: 1000.0)
    source.open()
    camera.start()
    images = [source.read() for _ in range(8)]
    source.close()
    assert images[0].image.shape == (480, 640, 3)
    assert np.median(images[0].depth) == DEPTH_MM
    assert (images[0].camera.fx, images[0].camera.cy) == (605.0, 243.0)
    steps = np.diff([image.time for image in images])
    frames = np.diff([int(image.image[0, 0, 0]) for image in images])
    assert steps == pytest.approx(frames % 256 / RATE, abs=1e-6)
    assert {arrival for _, arrival in DeviceTime.observed} == {1000.0}
    assert motion[-1][1] == pytest.approx((0.1, 0.2, 0.3))
    assert motion[-1][2] == pytest.approx((0.0, -9.81, 0.0))


def test_without_depth_or_motion_they_are_left_alone(camera):
    source = RealSenseSource(device=camera.device)
    source.open()
    camera.start()
    assert source.read().depth is None
    source.close()


def test_a_camera_that_falls_silent_is_told_and_taken_up_again(camera, monkeypatch):
    monkeypatch.setattr('av_vision.sources.realsense.TIMEOUT_MS', 300)
    images = []
    capture = Capture(RealSenseSource(device=camera.device), images.append, retry_s=0.1)
    camera.start()
    capture.start()
    wait_for(lambda: len(images) > 3)
    camera.stop()
    wait_for(lambda: 'no more frames' in capture.problem)
    before = len(images)
    camera.start()
    wait_for(lambda: len(images) > before + 3 and not capture.problem)
    capture.stop()
    assert capture.reconnections >= 1


def test_a_camera_whose_colour_ends_is_told_and_taken_up_again(camera, monkeypatch):
    monkeypatch.setattr('av_vision.sources.realsense.PARTIAL_S', 0.5)
    images = []
    capture = Capture(RealSenseSource(device=camera.device, depth=True), images.append, retry_s=0.1)
    camera.start()
    capture.start()
    wait_for(lambda: len(images) > 3)
    camera.is_blind = True
    wait_for(lambda: 'no more images of all' in capture.problem)
    camera.is_blind, before = False, len(images)
    wait_for(lambda: len(images) > before + 3 and not capture.problem)
    capture.stop()


def test_a_camera_whose_times_are_refused_is_told_and_can_be_stopped(camera, monkeypatch):
    monkeypatch.setattr('av_vision.sources.realsense.SenderClock.date', lambda *_: None)
    monkeypatch.setattr('av_vision.sources.realsense.PARTIAL_S', 0.3)
    source = RealSenseSource(device=camera.device)
    capture = Capture(source, pytest.fail, retry_s=0.1)
    camera.start()
    capture.start()
    wait_for(lambda: 'none with a valid time' in capture.problem)
    monkeypatch.setattr('av_vision.sources.realsense.PARTIAL_S', 60.0)
    wait_for(lambda: source._running)
    source.close()
    capture.stop()
    assert not capture._thread.is_alive()


def test_a_camera_that_is_stopped_before_it_streams_does_not_begin_to(camera):
    """As between two steps of another thread, in which it would stream unseen from then on, and be busy when opened again."""
    source = RealSenseSource(device=camera.device)
    sensor = camera.device.query_sensors()[0]
    sensor.open(sensor.get_stream_profiles()[0])
    source._running.append(sensor)
    source.close()
    with pytest.raises(RuntimeError):
        sensor.start(lambda frame: None)
    source.open()
    camera.start()
    assert source.read().image.shape == (480, 640, 3)
    source.close()


def test_no_camera_is_an_error_that_says_so():
    with pytest.raises(SourceError, match='no RealSense 4711 is plugged in'):
        RealSenseSource(serial='4711').open()


def wait_for(condition, limit_s=10.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, 'the condition was not met in time'
        time.sleep(0.02)
