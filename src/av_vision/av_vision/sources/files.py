"""Sources that play videos and folders of images like a camera."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
from numpy.typing import NDArray

from av_common.files import check_file
from av_vision.encoded_image import MOST_PIXELS
from av_vision.sources.capture import CapturedImage, SourceError
from av_vision.sources.image_file import IMAGE_SUFFIXES, read_image


def image_files(folder: Path) -> list[Path]:
    """The images in a folder in the order of their names; raises SourceError when there are none."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        raise SourceError(f'the folder {folder} holds no images ({", ".join(sorted(IMAGE_SUFFIXES))})')
    return files


class Recording:
    """A video, an image or a folder of images, read frame by frame.

    Parameters:
        path: the file or folder.
        rate (1/s): frames per second; 0 uses the rate of the video, or 30.

    Attributes:
        rate (1/s): frames per second.
        count: number of frames; 0 if unknown.

    Raises SourceError for a path, video or image that cannot be read.
    """

    def __init__(self, path: str | Path, rate: float = 0.0) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise SourceError(f'{self.path} does not exist, expected a video, an image or a folder of images')
        is_image = self.path.suffix.lower() in IMAGE_SUFFIXES
        self._files = image_files(self.path) if self.path.is_dir() else [self.path] if is_image else []
        if self._files:
            self.rate, self.count = rate or 30.0, len(self._files)
            return
        video = self._open_video()
        self.rate = rate or video.get(cv2.CAP_PROP_FPS) or 30.0
        self.count = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        readable = video.grab()
        video.release()
        if not readable:
            raise SourceError(f'{self.path} holds no images that can be read')

    def frames(self, wanted: Callable[[int], bool] = lambda index: True) -> Iterator[tuple[int, NDArray]]:
        """Frames as (index, image) in order; frames for which `wanted(index)` is false are not decoded."""
        if self._files:
            for index, path in enumerate(self._files):
                if wanted(index):
                    yield index, read_image(path)
            return
        video = self._open_video()
        index = 0
        while video.grab():
            if wanted(index):
                good, image = video.retrieve()
                if good:
                    yield index, image
            index += 1
        video.release()

    def _open_video(self) -> cv2.VideoCapture:
        try:
            check_file(self.path)  # OpenCV would wait for a pipe
        except OSError as error:
            raise SourceError(str(error)) from error
        video = cv2.VideoCapture(str(self.path))
        if not video.isOpened():
            raise SourceError(f'{self.path} ({self.path.stat().st_size} bytes) cannot be opened as a video')
        width, height = (int(video.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MOST_PIXELS:
            raise SourceError(f'{self.path} has images of {width}x{height} pixels, expected at most {MOST_PIXELS} pixels')
        return video


class FileSource:
    """Plays a recording in real time. The time of a frame is the start time plus its time in the file.

    Frames that are late by more than a period are skipped and counted in `skipped`.

    Parameters:
        path: video, image or folder of images.
        rate (1/s): frames per second; 0 uses the rate of the video, or 30.
        loop: whether the file starts again at its end.
        now: clock of the caller in s.
        wait: function that is called with the seconds until the next frame is due; None for an interruptible wait.
    """

    def __init__(self, path: str | Path, rate: float = 0.0, loop: bool = False, now: Callable[[], float] = time.time,
                 wait: Callable[[float], object] | None = None) -> None:
        self.skipped = 0
        self._recording = Recording(path, rate)
        self._loop = loop
        self._now = now
        self._closed = threading.Event()
        self._wait = wait or self._closed.wait

    def open(self) -> None:
        """Start at the first frame, now."""
        self._closed.clear()
        self._start = self._now()
        self._frames = self._recording.frames(self._in_time)
        self._last = -1

    def read(self) -> CapturedImage | None:
        """The next frame at its time; None at the end of a file that is not looped."""
        while (item := next(self._frames, None)) is None:
            if not self._loop or self._last < 0:
                return None
            self._start += (self._last + 1) / self._recording.rate
            self._frames, self._last = self._recording.frames(self._in_time), -1
        self._last, image = item
        due = self._start + self._last / self._recording.rate
        self._wait(max(due - self._now(), 0.0))
        return CapturedImage(image, due)

    def close(self) -> None:
        """Stop waiting."""
        self._closed.set()

    def _in_time(self, index: int) -> bool:
        late = self._now() - self._start - index / self._recording.rate > 1.0 / self._recording.rate
        self.skipped += late
        self._last = index
        return not late
