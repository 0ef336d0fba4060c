"""The modes that a camera offers, and whether the wanted one is among them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from av_view.doctor.finding import Finding

AREA = 'camera'
LEAST_SHARE = 0.95  # of the rate that was asked for
MOST_LISTED = 6
SIZE = re.compile(r'Size: Discrete (\d+)x(\d+)')
INTERVAL = re.compile(r'Interval: Discrete [\d.]+s \(([\d.]+) fps\)')


class Mode(NamedTuple):
    """A size (pixels) and a rate (Hz) of images."""

    width: int
    height: int
    rate: float

    def __str__(self) -> str:
        return f'{self.width}x{self.height} at {self.rate:g}'


def modes_of_v4l2(text: str) -> list[Mode]:
    """The discrete modes in what `v4l2-ctl --list-formats-ext` prints, of all formats together."""
    found, size = set(), (0, 0)
    for line in text.splitlines():
        if sized := SIZE.search(line):
            size = int(sized[1]), int(sized[2])
        elif timed := INTERVAL.search(line):
            found.add(Mode(*size, float(timed[1])))
    return sorted(found)


def modes_of_realsense(device: Any, colour: Any) -> list[Mode]:
    """The colour modes of a device of Intel's SDK.

    Parameters:
        device: the device.
        colour: the SDK's `stream.color`.
    """
    profiles: Iterable[Any] = (profile for sensor in device.query_sensors() for profile in sensor.get_stream_profiles()
                               if profile.stream_type() == colour)
    videos = [profile.as_video_stream_profile() for profile in profiles]
    return sorted({Mode(video.width(), video.height(), float(video.fps())) for video in videos})


def judge_modes(modes: Sequence[Mode], width: int, height: int, rate: float) -> list[Finding]:
    """Judge whether a camera offers what camera_node asks for; nothing for a camera without a list of modes.

    Parameters:
        modes: those that it offers.
        width, height (pixels), rate (Hz): what is asked for; a rate of 0 for any.
    """
    if not modes:
        return []
    fitting = [mode for mode in modes if (mode.width, mode.height) == (width, height)]
    if any(mode.rate >= LEAST_SHARE * rate for mode in fitting):
        return [Finding(AREA, 'ok', f'{max(fitting)} is among its {len(modes)} modes')]
    if fitting:
        return [Finding(AREA, 'warning', f'{width}x{height} comes with at most {max(fitting).rate:g} images a second, {rate:g} '
                        'are asked for', f'set rate of camera_node to {max(fitting).rate:g}, or choose a smaller size')]
    near = sorted(modes, key=lambda mode: (abs(mode.width - width) + abs(mode.height - height), -mode.rate))
    listed = list(dict.fromkeys(f'{mode.width}x{mode.height}' for mode in near))[:MOST_LISTED]
    return [Finding(AREA, 'error', f'the camera has no mode of {width}x{height}; the nearest are {", ".join(listed)}',
                    f'set width and height of camera_node, and of the rig\'s camera, to {near[0].width} and {near[0].height}')]
