"""Files as cameras, and devices that vanish."""

import base64
import os
import re
import struct
import time
import zlib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from std_msgs.msg import Header

from av_vision import Capture, DeviceSource, FileSource, Frame, Recording, SourceError, image_from_message, image_message

# Situations of users, which are not part of the repository.
FIELD_CASES = Path(__file__).resolve().parents[4] / 'shared' / 'data' / 'field_cases'


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
    levels = [frame.image.mean() for frame in recording.frames()]
    assert levels == pytest.approx(10.0 * np.arange(20), abs=3.0)
    assert [frame.index for frame in recording.frames(lambda time: round(50 * time) % 6 == 0)] == [0, 6, 12, 18]


def test_a_folder_of_images_in_order_of_names(tmp_path):
    for k in (3, 1, 2):
        cv2.imwrite(str(tmp_path / f'{k}.png'), np.full((4, 4), 1000 * k, np.uint16))
    (tmp_path / 'notes.txt').write_text('no image')
    frames = [frame.image for frame in Recording(tmp_path, rate=5.0).frames()]
    assert [int(image[0, 0]) for image in frames] == [1000, 2000, 3000]
    assert frames[0].dtype == np.uint16


@pytest.mark.parametrize('depth', [np.uint8, np.uint16])
@pytest.mark.parametrize('suffix', ['.bmp', '.jpeg', '.jpg', '.pgm', '.png', '.pnm', '.ppm', '.tif', '.tiff', '.webp'])
def test_whatever_opencv_writes_is_read_in_its_own_depth(tmp_path, suffix, depth):
    path, image = tmp_path / f'image{suffix}', np.full((30, 44), 200, depth)
    if suffix not in ('.pgm', '.png', '.pnm', '.ppm', '.tif', '.tiff') and depth is np.uint16:
        pytest.skip('a format of 8 bits')
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if suffix == '.ppm' else image)
    read, = [frame.image for frame in Recording(path).frames()]
    assert read.shape[:2] == (30, 44) and read.dtype == depth
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(SourceError, match=re.escape(str(path))):
        list(Recording(path).frames())


@pytest.mark.parametrize(('name', 'kind', 'channels'), [
    ('deep.png', np.uint16, 3), ('deep.png', np.uint16, 4), ('celsius.tiff', np.float64, 1), ('signed.tiff', np.int16, 1),
    ('counts.tiff', np.int32, 1), ('light.tiff', np.float32, 3)])
def test_images_of_any_depth_can_be_published(tmp_path, name, kind, channels):
    """Radiometric and edited images have other depths than cameras."""
    counts = np.arange(600).reshape(20, 30)[..., None].repeat(channels, 2)
    cv2.imwrite(str(tmp_path / name), counts.astype(kind))
    frame, = Recording(tmp_path).frames()
    received = image_from_message(image_message(Header(), frame.image))
    assert np.array_equal(received, counts[..., :min(channels, 3)].squeeze())


@pytest.mark.parametrize('codec', ['FFV1', 'MPNG'])
def test_a_video_of_counts_keeps_all_their_bits_or_says_that_it_does_not(tmp_path, codec):
    """Raw counts of a thermal camera differ by hundreds of 65,536: in 8 bits two grey levels are left, as if big-endian."""
    counts = np.random.default_rng(0).integers(7000, 7600, (5, 48, 64)).astype(np.uint16)
    options = [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    path = tmp_path / 'counts.mkv'
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 10.0, (64, 48), options)
    for image in counts:
        writer.write(image)
    writer.release()
    recording = Recording(path)
    assert np.array_equal([frame.image for frame in recording.frames()], counts) != ('8; for counts' in recording.problem)


# 24 interlaced images of MPEG-2, each brighter than the one before.
INTERLACED = (
    'c-n>3u}cDB7{~GFH8WEviv~Br?fw91b#RCqTLK4H2^_)@Oi#ERq%DG`n`_85gl79kTD_sgCC=g1_qgY2@yFxzlatT;J;ft3pN1;u*8Wt9%;I87hITLWMMY'
    '|odvj|4+?8j$4&4Q_34UMSTDz5#g^6%KF>GJIR8oQ$B;43bBtj$_0V*CMCU`+22P*DXeyf=hyf6VO?r)jk1&ISt(S7&MC?$Ad0#r1-tEW`R1_bh;p(hPJt'
    'sxH@1|R%Q@Pfo4s2G*_C*_3+P%)YdF;|EJs2KZ9@WKSB7{@}y3ULG~CUyRw^1=kDnD|2Y3Q<HAeIfc9fhr;)B850c6-yzO8i6WeA!3Cnfr{Wno}Aety0IH'
    '~;Nr2CeJZ*9<|o4cgh!RpQ5`v|qtuqc4F@wJ+}Z-&psJJ')


def test_an_interlaced_video_is_played_or_said_not_to_be(tmp_path, video):
    """OpenCV 4.13 gives what is in its memory for each image of one, without an error."""
    path = tmp_path / 'interlaced.m2v'
    path.write_bytes(zlib.decompress(base64.b85decode(INTERLACED)))
    for file in (path, video):
        recording = Recording(file)
        levels = [frame.image.mean() for frame in recording.frames()]
        assert np.all(np.diff(levels) > 3.0) != ('interlaced' in recording.problem)


def test_damaged_images_of_a_video_leave_gaps_and_the_rest_is_played(video):
    """As of a camera whose cable is loose, or a link with losses: OpenCV decodes none of them, and the next ones."""
    content, rng = bytearray(video.read_bytes()), np.random.default_rng(0)
    jpegs = [found.start() for found in re.finditer(rb'\xff\xd8\xff', content)]
    for k in (0, 5, 6, 7, 12):
        content[jpegs[k] + 2:jpegs[k] + 200] = rng.integers(0, 255, 198, np.uint8).tobytes()
    video.write_bytes(content)
    recording, whole = Recording(video), [k for k in range(20) if k not in (0, 5, 6, 7, 12)]
    frames = list(recording.frames())
    assert [frame.time for frame in frames] == pytest.approx([k / 50.0 for k in whole])
    assert [frame.index for frame in Recording(video, rate=10.0).frames()] == whole
    assert [frame.image.mean() for frame in frames] == pytest.approx([10.0 * k for k in whole], abs=3.0)
    assert recording.rate == pytest.approx(50.0) and '5 images cannot be decoded' in recording.problem


@pytest.mark.parametrize('kind', [np.uint16, np.float32])
def test_a_stack_of_images_in_one_file_is_played(tmp_path, kind):
    """As programs for thermal cameras export recordings, whole or in parts; one that is cut off has the images before."""
    counts = np.random.default_rng(0).uniform(7000.0, 7600.0, (7, 48, 64)).astype(kind)
    cv2.imwritemulti(str(tmp_path / 'a_2.tiff'), list(counts[:5]))
    cv2.imwritemulti(str(tmp_path / 'a_10.TIF'), list(counts[5:]))
    for path, images in ((tmp_path / 'a_2.tiff', counts[:5]), (tmp_path, counts)):
        recording = Recording(path, rate=10.0)
        frames = list(recording.frames())
        assert np.array_equal([frame.image for frame in frames], images) and recording.count == len(images)
        assert [frame.time for frame in frames] == pytest.approx(0.1 * np.arange(len(images))) and not recording.problem


def test_a_video_that_is_cut_off_says_so(video):
    """As where a disk was full, or a download ended early."""
    recording = Recording(video)
    assert len(list(recording.frames())) == 20 and recording.problem == ''
    video.write_bytes(video.read_bytes()[:video.stat().st_size * 6 // 10])
    recording = Recording(video)
    assert len(list(recording.frames())) < 15
    assert re.search(r'end at 0\.[0-9] of 0\.4 s: is it cut off', recording.problem)


@pytest.mark.parametrize('rate', [1.0, 10.0, 25.0, 60.0])
def test_a_video_of_one_image_is_whole(tmp_path, rate):
    writer = cv2.VideoWriter(str(tmp_path / 'one.mp4'), cv2.VideoWriter.fourcc(*'mp4v'), rate, (64, 48))
    writer.write(np.full((48, 64, 3), 90, np.uint8))
    writer.release()
    recording = Recording(tmp_path / 'one.mp4')
    assert len(list(recording.frames())) == 1 and recording.problem == ''


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
    """By its header, or as the pixels that it claims are not there."""
    path = tmp_path / f'image{suffix}'
    path.write_bytes(claims(suffix))
    with pytest.raises(SourceError, match='image of 16000x16000 pixels|of no known format') as error:
        list(Recording(path).frames())
    assert str(path) in str(error.value) and '\n' not in str(error.value)


def test_stamps_are_the_start_and_the_time_in_the_file(video):
    clock = Clock(1000.0)
    source = FileSource(video, now=clock, wait=clock.wait, steady=clock)
    source.open()
    images, read = [], []
    while (image := source.read()) is not None:
        images.append(image)
        read.append(clock())
        clock.wait(0.005)  # what becomes of the image takes time
    assert [image.time for image in images] == pytest.approx(1000.0 + np.arange(20) / 50.0, abs=1e-6)
    assert read == pytest.approx([image.time for image in images], abs=1e-6)


@pytest.mark.parametrize('step', [3600.0, -3600.0])
def test_a_clock_that_is_set_while_a_video_plays_leaves_no_frame_out_and_waits_for_none(video, step):
    """As sound of the same recording goes on."""
    clock, set_back = Clock(5.0), [0.0]
    source = FileSource(video, now=lambda: clock() + 1000.0 + set_back[0], wait=clock.wait, steady=clock)
    source.open()
    times = []
    while (image := source.read()) is not None:
        times.append(image.time)
        set_back[0] = step
    assert times == pytest.approx(1005.0 + np.arange(20) / 50.0, abs=1e-6)
    assert source.skipped == 0 and clock() == pytest.approx(5.0 + 19 / 50.0)


def test_a_loop_goes_on_in_time(video):
    clock = iter(np.arange(0.0, 100.0, 0.001))
    source = FileSource(video, loop=True, now=lambda: 0.0, steady=lambda: next(clock), wait=lambda seconds: None)
    source.open()
    times = [source.read().time for _ in range(45)]
    assert np.diff(times) == pytest.approx(np.full(44, 0.02), abs=1e-9)


def test_a_late_player_leaves_frames_out(video):
    now = [0.0]
    source = FileSource(video, now=lambda: now[0], steady=lambda: now[0])
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
    monkeypatch.setattr('av_vision.sources.capture.time', SimpleNamespace(monotonic=lambda: 500.0))
    source = DeviceSource('3', 1280, 720, 60.0, 5.0, now=lambda: 1000.0)
    source.open()
    assert source.read().time == pytest.approx(1000.0 - 0.04)
    source.close()
    expected = {cv2.CAP_PROP_FRAME_WIDTH: 1280, cv2.CAP_PROP_FRAME_HEIGHT: 720, cv2.CAP_PROP_FPS: 60.0,
                cv2.CAP_PROP_BUFFERSIZE: 1, cv2.CAP_PROP_AUTO_EXPOSURE: 1, cv2.CAP_PROP_EXPOSURE: 50.0,
                'released': True}
    assert settings == expected


class GreyDevice:
    """A thermal camera behind OpenCV: raw counts of 16 bits where they are asked for, as its driver allows."""

    formats = ('Y16 ',)

    def __init__(self, address, api):
        self.settings = {}

    def isOpened(self):  # noqa: N802
        return True

    def set(self, name, value):
        known = name != cv2.CAP_PROP_FOURCC or value in [cv2.VideoWriter.fourcc(*one) for one in self.formats]
        self.settings[name] = value if known else cv2.VideoWriter.fourcc(*'YUYV')

    def get(self, name):
        return self.settings.get(name, 0.0)

    def read(self):
        raw = self.settings.get(cv2.CAP_PROP_CONVERT_RGB, 1) == 0
        return True, np.full((256, 320), 7300, np.uint16) if raw else np.zeros((256, 320, 3), np.uint8)

    def release(self):
        pass


def test_raw_counts_of_a_thermal_camera_are_asked_for(monkeypatch):
    monkeypatch.setattr(cv2, 'VideoCapture', GreyDevice)
    source = DeviceSource('0', 320, 256, pixel_format='Y16')
    source.open()
    image = source.read().image
    assert (image.dtype, image.shape, image[0, 0]) == (np.uint16, (256, 320), 7300)
    with pytest.raises(SourceError, match='no images of GREY'):
        DeviceSource('0', 320, 256, pixel_format='GREY').open()
    monkeypatch.setattr(GreyDevice, 'read', lambda self: (True, np.zeros((256, 320, 3), np.uint8)))
    with pytest.raises(SourceError, match='not Y16'):
        source.read()


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
        return Frame(np.zeros((2, 2), np.uint8), time.time())

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


def test_errors_of_drivers_and_libraries_are_survived(tmp_path):
    """A camera that is unplugged while an image is converted raises what its SDK raises; names need not be UTF-8."""
    class Failing(Unplugged):
        def read(self):
            if self.openings == 1:
                raise RuntimeError('of the\nSDK')
            return super().read()

    images = []
    capture = Capture(Failing(), images.append, retry_s=0.05)
    capture.start()
    wait_for(lambda: images)
    capture.stop()
    (tmp_path / os.fsdecode(b'\xfe.png')).write_bytes(b'none')
    capture = Capture(FileSource(tmp_path), images.append)
    capture.start()
    wait_for(lambda: b'?.png (4 bytes) cannot be read' in capture.problem.encode())
    capture.stop()


def wait_for(condition, limit_s=60.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, 'the condition was not met in time'
        time.sleep(0.01)


def test_images_are_played_in_the_order_of_their_numbers(tmp_path):
    """As people count: 2 before 10, also in the middle of a name; what macOS leaves beside each file is none."""
    names = ['cam-9 shot1.png', 'Cam-9 shot2.png', 'cam-9 shot2 (1).png', 'cam-9 shot2.5.png', 'cam-9 shot10.png',
             'cam-09 shot11.png', 'cam-10 shot1.PNG', 'dusk.png']
    for number, name in enumerate(names):
        cv2.imwrite(str(tmp_path / name), np.full((4, 4), number, np.uint8))
        (tmp_path / f'._{name}').write_bytes(b'\0\5\26\7 resource fork')
    assert [int(frame.image[0, 0]) for frame in Recording(tmp_path).frames()] == list(range(8))


def test_the_numbered_folder_of_the_field():
    folder = FIELD_CASES / 'folders' / 'numbers'
    if not folder.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    files = {int(path.stem.split('_')[1]): path for path in folder.iterdir() if not path.name.startswith('.')}
    for number, frame in zip((1, 2, 3, 9, 10, 11, 12, 20, 100), Recording(folder).frames(), strict=True):
        assert np.array_equal(frame.image, cv2.imread(str(files[number]), cv2.IMREAD_UNCHANGED)), number


def test_an_unreadable_image_leaves_a_gap_in_time_and_is_named(tmp_path):
    for k in range(5):
        cv2.imwrite(str(tmp_path / f'{k}.jpg'), np.full((8, 8), 20 * k, np.uint8))
    (tmp_path / '2.jpg').write_bytes((tmp_path / '2.jpg').read_bytes()[:30])
    recording = Recording(tmp_path, rate=4.0)
    assert [frame.time for frame in recording.frames()] == [0.0, 0.25, 0.75, 1.0]
    assert '1 of 5 images left out' in recording.problem and '2.jpg' in recording.problem


def element(name, content):
    """An element of EBML, of which Matroska and webm are made (RFC 8794), its size in eight bytes."""
    return bytes.fromhex(name) + (len(content) | 1 << 56).to_bytes(8, 'big') + content


def write_uneven(path, times_ms, known=True):
    """A Matroska video (RFC 9559) of one JPEG for each time in ms; without known sizes and duration as a browser streams it."""
    track = element('D7', b'\1') + element('73C5', b'\1') + element('83', b'\1') + element('86', b'V_MJPEG') + element(
        'E0', element('B0', b'\x40') + element('BA', b'\x30'))
    info = element('2AD7B1', (10**6).to_bytes(3, 'big')) + (
        element('4489', struct.pack('>d', times_ms[-1] + 40.0)) if known else b'')
    clusters = b''
    for k, time_ms in enumerate(times_ms):
        jpeg = cv2.imencode('.jpg', np.full((48, 64, 3), 10 * k, np.uint8))[1].tobytes()
        clusters += element('1F43B675', element('E7', int(time_ms).to_bytes(4, 'big')) + element('A3', b'\x81\0\0\x80' + jpeg))
    content = element('1549A966', info) + element('1654AE6B', element('AE', track)) + clusters
    head = element('1A45DFA3', element('4282', b'matroska') + element('4287', b'\4') + element('4285', b'\2'))
    path.write_bytes(head + (element('18538067', content) if known else bytes.fromhex('1853806701FFFFFFFFFFFFFF') + content))
    return path


@pytest.mark.parametrize('known', [True, False])
def test_frames_have_the_time_of_the_container(tmp_path, known):
    times = np.array([0, 40, 80, 400, 433, 1500, 1517, 1534, 2600])
    recording = Recording(write_uneven(tmp_path / 'phone.mkv', times.tolist(), known))
    frames = list(recording.frames())
    assert [frame.time for frame in frames] == pytest.approx(1e-3 * times, abs=1e-6)
    assert [frame.image.mean() for frame in frames] == pytest.approx(10.0 * np.arange(9), abs=3.0)
    assert recording.rate == pytest.approx(8 / 2.6)
    clock = Clock(50.0)
    source = FileSource(recording.path, loop=True, now=clock, wait=clock.wait, steady=clock)
    source.open()
    again = 50.0 + 2.6 + 1.066    # the last frame lasts as long as the one before
    assert [source.read().time for _ in range(11)] == pytest.approx([*(50.0 + 1e-3 * times), again, again + 0.04], abs=1e-6)
    assert source.skipped == 0
    assert [frame.time for frame in Recording(recording.path, rate=10.0).frames()] == pytest.approx(0.1 * np.arange(9))


def test_times_that_do_not_rise_are_made_up_for(tmp_path):
    recording = Recording(write_uneven(tmp_path / 'odd.mkv', [0, 100, 100, 100, 500]))
    times = [frame.time for frame in recording.frames()]
    assert times[:2] == pytest.approx([0.0, 0.1]) and times[-1] == pytest.approx(0.5)
    assert np.all(np.diff(times) > 0.05)


@pytest.mark.parametrize(('name', 'last'), [('vfr.mp4', 5.967), ('irregular_live.webm', 6.364), ('cfr12.mp4', 11.967)])
def test_the_times_of_the_videos_of_the_field(name, last):
    path = FIELD_CASES / 'video' / name
    if not path.exists():
        pytest.skip('needs ../shared/data/field_cases')
    times = [frame.time for frame in Recording(path).frames()]
    assert times[0] == 0.0 and times[-1] == pytest.approx(last, abs=1e-3)
    assert np.all(np.diff(times) > 0.0)


@pytest.mark.parametrize('name', ['a:b.avi', 'rtsp:x y.avi', '%02d.avi', 'a?b#c.avi'])
def test_a_video_may_have_any_name(tmp_path, video, monkeypatch, name):
    video.rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert len(list(Recording(name).frames())) == 20
    monkeypatch.setenv('HOME', str(tmp_path))
    assert Recording(f'~/{name}').path == tmp_path / name


def test_names_that_are_not_utf8_end_no_process(tmp_path, video):
    """OpenCV 4.13 ends it for a video. Images are read without it."""
    other = video.rename(tmp_path / os.fsdecode(b'\xff.avi'))
    with pytest.raises(SourceError, match=r'udcff.avi. is not UTF-8'):
        Recording(other)
    cv2.imwrite(str(tmp_path / '0.png'), np.zeros((8, 8), np.uint8))
    (tmp_path / os.fsdecode(b'\xfe.png')).write_bytes(b'none')
    recording = Recording(tmp_path)
    assert len(list(recording.frames())) == 1 and b'?.png' in recording.problem.encode()


def test_a_player_waits_for_the_common_beginning_and_joins_in_late(video):
    clock, answers = Clock(10.0), iter([None, None, 10.5])
    source = FileSource(video, now=clock, wait=clock.wait, steady=clock, begin=lambda: next(answers))
    source.open()
    assert source.read().time == 10.5
    late = FileSource(video, now=Clock(20.0), wait=lambda seconds: None, begin=lambda: 19.805, steady=Clock(7.0))
    late.open()
    image = late.read()
    assert image.time == pytest.approx(19.985) and image.image.mean() == pytest.approx(90.0, abs=3.0)
