"""Files as cameras, and devices that vanish."""

import re
import struct
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from av_vision.sources import Capture, CapturedImage, SourceError
from av_vision.sources.files import FileSource, Recording
from av_vision.sources.image_file import IMAGE_SUFFIXES
from av_vision.sources.v4l2 import DeviceSource


class Clock:
    """Time that passes while somebody waits."""

    def __init__(self, now):
        self.now = now

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds


@pytest.fixture
def video(tmp_path):
    path = tmp_path / 'video.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 50.0, (64, 48))
    for k in range(20):
        writer.write(np.full((48, 64, 3), 10 * k, np.uint8))
    writer.release()
    return path


def test_a_video_gives_its_frames_at_its_rate(video):
    recording = Recording(video)
    assert (recording.rate, recording.count) == (50.0, 20)
    levels = [image.mean() for _, image in recording.frames()]
    assert levels == pytest.approx(10.0 * np.arange(20), abs=3.0)
    assert [index for index, _ in recording.frames(lambda k: k % 6 == 0)] == [0, 6, 12, 18]


def test_a_folder_of_images_in_order_of_names(tmp_path):
    for k in (3, 1, 2):
        cv2.imwrite(str(tmp_path / f'{k}.png'), np.full((4, 4), 1000 * k, np.uint16))
    (tmp_path / 'notes.txt').write_text('no image')
    frames = [image for _, image in Recording(tmp_path, rate=5.0).frames()]
    assert [int(image[0, 0]) for image in frames] == [1000, 2000, 3000]
    assert frames[0].dtype == np.uint16


@pytest.mark.parametrize('depth', [np.uint8, np.uint16])
@pytest.mark.parametrize('suffix', sorted(IMAGE_SUFFIXES))
def test_an_image_is_measured_before_it_is_read(tmp_path, suffix, depth):
    """Whatever OpenCV writes is read in its own depth; what claims to be larger than a camera's image is not."""
    path, image = tmp_path / f'image{suffix}', np.full((30, 44), 200, depth)
    if suffix not in ('.pgm', '.png', '.tif', '.tiff') and depth is np.uint16:
        pytest.skip('a format of 8 bits')
    cv2.imwrite(str(path), image)
    (_, read), = Recording(path).frames()
    assert read.shape[:2] == (30, 44) and read.dtype == depth
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(SourceError, match=re.escape(str(path))):
        list(Recording(path).frames())


def claims(suffix):
    """A file that claims 16000x16000 pixels."""
    if suffix == '.pgm':
        return b'P5 # a comment\n16000 16000 255\n'
    image = cv2.imencode(suffix, np.zeros((30, 44, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 50])[1].tobytes()
    order = '>' if suffix in ('.png', '.jpg') else '<'
    kind = 'I' if suffix in ('.png', '.bmp') else 'H'
    if suffix == '.tif':    # entries of width and height, each with its type and number
        entry = rb'([\x00\x01]\x01\x03\x00\x01\x00\x00\x00)[\x1e\x2c]\x00'
        return re.sub(entry, lambda found: found[1] + struct.pack('<H', 16000), image)
    pair = (30, 44) if suffix == '.jpg' else (44, 30)
    return image.replace(struct.pack(f'{order}2{kind}', *pair), struct.pack(f'{order}2{kind}', 16000, 16000), 1)


@pytest.mark.parametrize('suffix', ['.bmp', '.jpg', '.pgm', '.png', '.tif', '.webp'])
def test_an_image_of_absurd_size_is_refused_in_one_line(tmp_path, suffix):
    path = tmp_path / f'image{suffix}'
    path.write_bytes(claims(suffix))
    with pytest.raises(SourceError, match='image of 16000x16000 pixels') as error:
        list(Recording(path).frames())
    assert str(path) in str(error.value) and '\n' not in str(error.value)


def test_stamps_are_the_start_and_the_time_in_the_file(video):
    clock = Clock(1000.0)
    source = FileSource(video, now=clock, wait=clock.wait)
    source.open()
    images, read = [], []
    while (image := source.read()) is not None:
        images.append(image)
        read.append(clock())
        clock.wait(0.005)  # what becomes of the image takes time
    assert [image.time for image in images] == pytest.approx(1000.0 + np.arange(20) / 50.0, abs=1e-6)
    assert read == pytest.approx([image.time for image in images], abs=1e-6)


def test_a_loop_goes_on_in_time(video):
    clock = iter(np.arange(0.0, 100.0, 0.001))
    source = FileSource(video, loop=True, now=lambda: next(clock), wait=lambda seconds: None)
    source.open()
    times = [source.read().time for _ in range(45)]
    assert np.diff(times) == pytest.approx(np.full(44, 0.02), abs=1e-9)


def test_a_late_player_leaves_frames_out(video):
    now = [0.0]
    source = FileSource(video, now=lambda: now[0])
    source.open()
    assert source.read().time == 0.0
    now[0] = 0.195
    assert source.read().time == pytest.approx(0.18)
    assert source.skipped == 8


def test_files_that_are_none(tmp_path):
    empty = tmp_path / 'empty.png'
    empty.touch()
    broken = tmp_path / 'broken.mp4'
    broken.write_bytes(b'no video')
    with pytest.raises(SourceError, match='does not exist'):
        Recording(tmp_path / 'nothing.mp4')
    with pytest.raises(SourceError, match='broken.mp4'):
        Recording(broken)
    with pytest.raises(SourceError, match='0 bytes'):
        list(Recording(empty).frames())
    (tmp_path / 'folder').mkdir()
    with pytest.raises(SourceError, match='holds no images'):
        Recording(tmp_path / 'folder')


def test_an_absent_device_is_named():
    with pytest.raises(SourceError, match='/dev/video77 cannot be opened'):
        DeviceSource('/dev/video77').open()


def test_a_device_is_configured_and_its_stamps_are_of_the_capture(monkeypatch):
    settings = {}

    class Device:
        def __init__(self, address, api):
            assert address == 3

        def isOpened(self):  # noqa: N802
            return True

        def set(self, name, value):
            settings[name] = value

        def get(self, name):
            return 1e3 * (500.0 - 0.04)  # taken 40 ms ago

        def read(self):
            return True, np.zeros((2, 2, 3), np.uint8)

        def release(self):
            settings['released'] = True

    monkeypatch.setattr(cv2, 'VideoCapture', Device)
    monkeypatch.setattr('av_vision.sources.v4l2.time', SimpleNamespace(monotonic=lambda: 500.0))
    source = DeviceSource('3', 1280, 720, 60.0, 5.0, now=lambda: 1000.0)
    source.open()
    assert source.read().time == pytest.approx(1000.0 - 0.04)
    source.close()
    expected = {cv2.CAP_PROP_FRAME_WIDTH: 1280, cv2.CAP_PROP_FRAME_HEIGHT: 720, cv2.CAP_PROP_FPS: 60.0,
                cv2.CAP_PROP_BUFFERSIZE: 1, cv2.CAP_PROP_AUTO_EXPOSURE: 1, cv2.CAP_PROP_EXPOSURE: 50.0,
                'released': True}
    assert settings == expected


class Unplugged:
    """Gives three images, is lost, refuses to open twice, and comes back."""

    def __init__(self):
        self.openings, self.left = 0, 0

    def open(self):
        self.openings += 1
        self.left = 3
        if self.openings in (2, 3):
            raise SourceError('absent')

    def read(self):
        if not self.left:
            raise SourceError('unplugged')
        self.left -= 1
        time.sleep(0.01)
        return CapturedImage(np.zeros((2, 2), np.uint8), time.time())

    def close(self):
        self.left = 0


def test_unplugging_is_survived():
    images = []
    capture = Capture(Unplugged(), images.append, retry_s=0.05)
    capture.start()
    end = time.monotonic() + 60.0
    while len(images) < 6 and time.monotonic() < end:
        time.sleep(0.01)
    capture.stop()
    assert len(images) >= 6
    assert capture.reconnections >= 3
