"""Cameras of Intel's SDK, by a software device of it."""

from __future__ import annotations

import pytest

from av_view.doctor.program import realsense_devices


def test_a_realsense_is_listed_with_its_usb():
    rs = pytest.importorskip('pyrealsense2', reason='pyrealsense2 is not installed')
    device = rs.software_device()
    for key, value in (('name', 'Software D435i'), ('serial_number', '0815'), ('usb_type_descriptor', '2.1')):
        device.register_info(getattr(rs.camera_info, key), value)
    (finding,) = realsense_devices(rs, [device])
    assert finding.level == 'warning' and 'realsense:0815' in finding.words and 'USB 2.1' in finding.words
    assert realsense_devices(rs, []) == []
