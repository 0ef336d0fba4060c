"""Modes of cameras, read from what v4l2-ctl prints and from a software device of Intel's SDK."""

from __future__ import annotations

import pytest

from av_view.doctor.camera_modes import Mode, judge_modes, modes_of_realsense, modes_of_v4l2
from av_view.doctor.program import realsense_devices

PRINTED = """ioctl: VIDIOC_ENUM_FMT
\tType: Video Capture

\t[0]: 'MJPG' (Motion-JPEG, compressed)
\t\tSize: Discrete 1280x720
\t\t\tInterval: Discrete 0.033s (30.000 fps)
\t\tSize: Discrete 640x480
\t\t\tInterval: Discrete 0.033s (30.000 fps)
\t\t\tInterval: Discrete 0.067s (15.000 fps)
\t[1]: 'YUYV' (YUYV 4:2:2)
\t\tSize: Discrete 1280x720
\t\t\tInterval: Discrete 0.100s (10.000 fps)
"""
MODES = [Mode(640, 480, 15.0), Mode(640, 480, 30.0), Mode(1280, 720, 10.0), Mode(1280, 720, 30.0)]


def test_modes_of_all_formats_are_read():
    assert modes_of_v4l2(PRINTED) == MODES
    assert modes_of_v4l2('') == [] == modes_of_v4l2('\t\tSize: Stepwise 32x32 - 1920x1080 with step 2/2')


@pytest.mark.parametrize(('wanted', 'level', 'words'), [
    ((640, 480, 15.0), 'ok', '4 modes'), ((1280, 720, 0.0), 'ok', '1280x720'), ((1280, 720, 60.0), 'warning', 'at most 30'),
    ((800, 600, 30.0), 'error', 'nearest are 640x480, 1280x720')])
def test_what_is_asked_for_is_compared_with_what_there_is(wanted, level, words):
    (finding,) = judge_modes(MODES, *wanted)
    assert finding.level == level and words in finding.words and (level == 'ok' or finding.remedy)
    assert judge_modes([], *wanted) == []


def test_a_realsense_is_listed_with_its_modes_and_its_usb():
    rs = pytest.importorskip('pyrealsense2', reason='pyrealsense2 is not installed')
    device = rs.software_device()
    for key, value in (('name', 'Software D435i'), ('serial_number', '0815'), ('usb_type_descriptor', '2.1')):
        device.register_info(getattr(rs.camera_info, key), value)
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.width, stream.height, stream.fps = rs.stream.color, 0, 1, 640, 480, 30
    stream.bpp, stream.fmt, stream.intrinsics = 3, rs.format.bgr8, rs.intrinsics()
    device.add_sensor('RGB Camera').add_video_stream(stream)
    assert modes_of_realsense(device, rs.stream.color) == [Mode(640, 480, 30.0)]
    (finding,) = realsense_devices(rs, [device])
    assert finding.level == 'warning' and 'realsense:0815' in finding.words and 'USB 2.1' in finding.words
    assert realsense_devices(rs, []) == []
