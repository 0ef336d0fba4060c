"""Sources that play videos and folders of images like a camera."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from av_common.files import MEGABYTE, check_file, one_line
from av_vision.image import MOST_PIXELS, decode_image
from av_vision.sources.capture import Frame, SourceError

FOLDER_RATE = 30.0     # images a second of a folder, and of a video that states no rate
ASK_AGAIN_S = 0.02     # whether the playback may begin
PROBED = 30            # frames whose times give the rate of a video
LEAST_INTERVAL_S = 1e-3    # between frames: a container's time that does not rise by so much is none
IMAGE_SUFFIXES = frozenset({'.bmp', '.jpeg', '.jpg', '.pgm', '.png', '.pnm', '.ppm', '.tif', '.tiff', '.webp'})
MOST_BYTES = 1000 * MEGABYTE
# FFmpeg's tag of grey pixels of 16 bits, of which OpenCV keeps 8 unless told, as it does of other depths, and of other order.
_COUNTS = b'Y1\0\x10'
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
LOST = 100     # images in a row that cannot be decoded, after which a video has ended
ALIKE = 10     # images that are the same to the bit from which on that is told: noise alone makes those of cameras differ
WHOLE = 0.9    # share of its stated length from which on a video counts as whole
CONVERT = 'convert it first, such as by ffmpeg'


def read_image(path: Path, page: int | None = None) -> NDArray:
    """The image (h, w[, channels]) in a file, BGR or grey, of 8 or 16 bits, other depths as float32.

    Parameters:
        path: the file.
        page: which of its images, from 0, where it holds several.

    Raises SourceError in one line with the path.
    """
    try:
        data = check_file(path, MOST_BYTES).read_bytes() if page is None else b''
        image = (decode_image(data, AS_STORED, any_format=True) if page is None else
                 cv2.imreadmulti(name_for_opencv(path), page, 1, flags=AS_STORED)[1][0])
    except OSError as error:
        raise SourceError(str(error)) from error
    except (ValueError, IndexError, cv2.error) as error:
        what = f'{len(data)} bytes' if page is None else f'image {page} in it'
        raise SourceError(f'{path} ({what}) cannot be read as an image: {one_line(error)}') from error
    return image if image.dtype in (np.uint8, np.uint16) else np.asarray(image, np.float32)


def pages_of(path: Path) -> Sequence[int | None]:
    """Which images a file holds, None for the only one: programs for thermal cameras write stacks of them as TIFF."""
    with suppress(SourceError, OSError, cv2.error):
        if path.suffix.lower() in ('.tif', '.tiff') and (images := cv2.imcount(name_for_opencv(check_file(path)))) > 1:
            return range(images)
    return [None]


def name_for_opencv(path: Path) -> str:
    """The path for OpenCV, which ends the process for one that is not UTF-8: for that SourceError is raised."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise SourceError(f'{str(path)!a} is not UTF-8, as OpenCV needs it: rename the file') from error
    return str(path)


def image_files(folder: Path) -> list[Path]:
    """The images in a folder, numbers in their names counted: 2 before 10. Raises SourceError when there are none.

    Hidden files are none: macOS writes a `._NAME` beside each file on disks of other systems.
    """
    files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith('.')]
    if not files:
        raise SourceError(f'the folder {folder} holds no images ({", ".join(sorted(IMAGE_SUFFIXES))})')
    return sorted(files, key=_counted)


def _counted(path: Path) -> tuple[list[tuple[int, str]], str]:
    """A key that sorts names by the numbers in them; equal numbers, such as 1 and 01, by the name."""
    parts = re.split(r'(\d+)', path.stem.casefold())    # `1` before `1.5` and `1 (2)`
    return [(int(part), '') if k % 2 else (-1, part) for k, part in enumerate(parts)], path.name


class Recording:
    """A video, an image or a folder of images, read frame by frame.

    The time of a frame is that in the video's container, which need not have a constant rate. Images of a folder, and frames
    of a video with `rate`, follow each other evenly. An image that cannot be read leaves a gap. A TIFF may hold several.

    Parameters:
        path: the file or folder; ~ is the user's home.
        rate (1/s): frames per second; 0 uses the time in the video, or 30 for a folder.

    Attributes:
        rate (1/s): frames per second, of a video the mean of its beginning.
        count: number of frames; 0 if unknown.
        problem: what the last `frames` did not read as it is; empty where all was read, and while nothing tells.

    Raises SourceError for a path, video or image that cannot be read.
    """

    def __init__(self, path: str | Path, rate: float = 0.0) -> None:
        try:
            self.path = Path(path).expanduser().absolute()    # FFmpeg takes `a:b.mp4` for a protocol
        except RuntimeError as error:
            raise SourceError(f'{path}: {error}') from error
        if not self.path.exists():
            raise SourceError(f'{path} does not exist, expected a video, an image or a folder of images')
        self._problems: dict[str, str] = {}    # by kind
        self._even = rate
        is_image = self.path.suffix.lower() in IMAGE_SUFFIXES
        files = image_files(self.path) if self.path.is_dir() else [self.path] if is_image else []
        self._files = [(file, page) for file in files for page in pages_of(file)]
        if self._files:
            self.rate, self.count = rate or FOLDER_RATE, len(self._files)
            return
        self.count = 0
        (first, begin), (last, end) = self._probe()
        self.rate = rate or ((last - first) / (end - begin) if last > first else FOLDER_RATE)

    @property
    def problem(self) -> str:
        """See the class."""
        found = [text for text in tuple(self._problems.values()) if text]    # another thread may read on meanwhile
        text = f'{self.path}: {"; ".join(found)}' if found else ''
        return text.encode(errors='replace').decode()    # names of files need not be UTF-8, messages must

    def frames(self, wanted: Callable[[float], bool] = lambda time: True) -> Iterator[Frame]:
        """Frames in order; those for whose time (s) `wanted` is false are not decoded. Raises SourceError."""
        self._problems = {}
        return self._images(wanted) if self._files else self._video(wanted)

    def _images(self, wanted: Callable[[float], bool]) -> Iterator[Frame]:
        lost: list[str] = []
        for index, (path, page) in enumerate(self._files):
            if not wanted(index / self.rate):
                continue
            try:
                yield Frame(read_image(path, page), index / self.rate, index=index)
            except SourceError as error:
                lost.append(str(error))
                if len(lost) == len(self._files):
                    raise
                self._problems['lost'] = f'{len(lost)} of {self.count} images left out: {lost[0]}'

    def _video(self, wanted: Callable[[float], bool]) -> Iterator[Frame]:
        video, first, stated, alike = self._open_video(), None, 0.0, 0
        try:
            for read, (index, stated) in enumerate(self._times(video)):
                self._problems['lost'] = f'{index - read} images cannot be decoded' if index > read else ''
                at = index / self._even if self._even else stated
                if wanted(at):
                    good, image = video.retrieve()
                    if good:
                        first = image if first is None else first
                        alike = alike + 1 if alike >= 0 and np.array_equal(image, first) else -1
                        self._problems['alike'] = (
                            f'all {alike} images so far are the same to the bit, as OpenCV reads interlaced videos; if it is '
                            f'one, {CONVERT} -i IN -vf bwdif OUT.mp4') if alike >= ALIKE else ''
                        yield Frame(image, at, index=index)
            rate = max(video.get(cv2.CAP_PROP_FPS), 1.0)
            if stated * rate + 1.0 < WHOLE * self.count:
                self._problems['cut'] = f'its images end at {stated:.1f} of {self.count / rate:.1f} s: is it cut off?'
        finally:
            video.release()

    @staticmethod
    def _times(video: cv2.VideoCapture) -> Iterator[tuple[int, float]]:
        """Numbers of the frames that can be decoded, and their times (s) in the container.

        Where it states none, or not a later one, the interval before counts.
        """
        stated = video.get(cv2.CAP_PROP_FPS)
        interval, last, good = 1.0 / stated if 1.0 <= stated <= 500.0 else 1.0 / FOLDER_RATE, -float('inf'), -1
        for index in count():
            if not video.grab():
                if index - good > LOST:
                    return
                continue
            good, time = index, 1e-3 * video.get(cv2.CAP_PROP_POS_MSEC)
            if time - last < LEAST_INTERVAL_S:
                time = last + interval
            elif last >= 0.0:
                interval = time - last
            last = time
            yield index, time

    def _probe(self) -> tuple[tuple[int, float], tuple[int, float]]:
        """Numbers and times (s) of the first frame of the video, and of one soon after it."""
        video = self._open_video()
        self.count = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        times = list(islice(self._times(video), PROBED))
        video.release()
        if not times:
            raise SourceError(f'{self.path} holds no images that can be read')
        return times[0], times[-1]

    def _open_video(self) -> cv2.VideoCapture:
        try:
            check_file(self.path)  # OpenCV would wait for a pipe
        except OSError as error:
            raise SourceError(str(error)) from error
        video = cv2.VideoCapture(name_for_opencv(self.path))
        if not video.isOpened():
            raise SourceError(f'{self.path} ({self.path.stat().st_size} bytes) cannot be opened as a video')
        kind = (int(video.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF).to_bytes(4, 'little')
        bits = kind[3] if kind[:3] == _COUNTS[:3] else kind[0] if kind[1:] == _COUNTS[2::-1] else 8
        if kind == _COUNTS:
            video.set(cv2.CAP_PROP_CONVERT_RGB, 0.0)
        elif bits > 8:
            self._problems['bits'] = (f'of grey pixels of {bits} bits OpenCV keeps 8; for counts {CONVERT} -i IN '
                                      '-pix_fmt gray16le -c:v ffv1 OUT.mkv')
        width, height = (int(video.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MOST_PIXELS:
            raise SourceError(f'{self.path} has images of {width}x{height} pixels, expected at most {MOST_PIXELS} pixels')
        return video


class FileSource:
    """Plays a recording in real time. The time of a frame is the beginning of the playback plus its time in the file.

    Frames that are late by more than the interval before them are skipped and counted in `skipped`. A clock of the caller that
    is set meanwhile changes neither the pace nor the stamps.

    Attributes:
        recording: what is played.

    Parameters:
        path: video, image or folder of images.
        rate (1/s): frames per second; 0 uses the time in the video, or 30 for a folder.
        loop: whether the file starts again at its end.
        now: clock of the caller in s.
        wait: function that is called with the seconds until the next frame is due; None for an interruptible wait.
        begin: the beginning (s) on that clock, None while it is not known; by default when the source is opened.
        steady: clock of the pace in s.
    """

    def __init__(self, path: str | Path, rate: float = 0.0, loop: bool = False, now: Callable[[], float] = time.time,
                 wait: Callable[[float], object] | None = None, begin: Callable[[], float | None] | None = None,
                 steady: Callable[[], float] = time.monotonic) -> None:
        self.skipped = 0
        self.recording = Recording(path, rate)
        self._loop = loop
        self._now, self._steady = now, steady
        self._closed = threading.Event()
        self._wait = wait or self._closed.wait
        self._begin = begin or now

    def open(self) -> None:
        """Start at the first frame at the beginning, for which this waits."""
        self._closed.clear()
        while (begin := self._begin()) is None and not self._closed.is_set():
            self._wait(ASK_AGAIN_S)
        now = self._now()
        self._start = now if begin is None else begin
        self._offset = now - self._steady()    # of the caller's clock
        self._rewind()

    def read(self) -> Frame | None:
        """The next frame at its time; None at the end of a file that is not looped, and once it is closed."""
        while not self._closed.is_set():
            frame = next(self._frames, None)
            if frame is not None:
                due = self._start + frame.time
                self._wait(max(due - self._offset - self._steady(), 0.0))
                return None if self._closed.is_set() else replace(frame, time=due)
            if not self._loop or self._last < 0.0:
                return None
            self._start += self._last + self._interval
            self._rewind()
        return None

    def close(self) -> None:
        """Stop waiting."""
        self._closed.set()

    def _rewind(self) -> None:
        self._frames, self._last, self._interval = self.recording.frames(self._in_time), -1.0, 1.0 / self.recording.rate

    def _in_time(self, at: float) -> bool:
        """Whether a frame at a time (s) in the file is not late."""
        if self._last >= 0.0:
            self._interval = at - self._last
        self._last = at
        late = self._steady() + self._offset - self._start - at > self._interval
        self.skipped += late
        return not late
