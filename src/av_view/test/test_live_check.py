"""The guided test of a rig that runs, on rigs by formulas: what is wrong is named by the step that shows it."""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from faulty_rig import turning_rig
from formula_rig import CENTRE, FOCAL, HEIGHT, WIDTH
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from test_doctor import PAIR, RATE, SQUARE, clap

from av_audio.messages import audio_frame
from av_common.config_reader import load
from av_common.microphone_array import MicrophoneArray
from av_common.rig import Rig
from av_common.stamps import to_stamp
from av_evaluation.faults import Faults
from av_view.doctor.cameras import draw_marker, find_marker
from av_view.doctor.live import LiveCheck
from av_vision.messages import image_message

CONFIG = Path(__file__).resolve().parents[3] / 'config'
INFO = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model='plumb_bob', d=[0.0] * 5,
                  k=[FOCAL, 0.0, CENTRE[0], 0.0, FOCAL, CENTRE[1], 0.0, 0.0, 1.0])


def check_of(tmp_path, array='two_microphones', **options):
    """A check of a rig whose sensors look along the body."""
    description = tmp_path / 'rig.yaml'
    description.write_text(f'array: {{file: {CONFIG}/arrays/{array}.yaml}}\n')
    rig = load(Rig, description)
    check = LiveCheck(rig, **options)
    INFO.header.frame_id = rig.camera.optical_frame
    check.on_camera_info(INFO)
    return check, {step.title: step for step in check.steps()}


def picture(azimuth=0.0, elevation=0.0, side=0.1, distance=1.0, roll=0.0):
    """A level pinhole camera's picture of the marker, which faces it at a distance (m), its side in m, angles in degrees."""
    a, e, r = np.radians([azimuth, elevation, roll])
    marker = draw_marker(200)
    half = 0.5 * side * len(marker) / 200
    corners = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    turned = corners @ np.array([[math.cos(r), -math.sin(r)], [math.sin(r), math.cos(r)]])  # clockwise as it is seen
    centre = distance * np.array([-math.tan(a), math.tan(e) / math.cos(a)])
    pixels = CENTRE + FOCAL * (centre + turned) / distance * [1.0, -1.0]
    edge = len(marker) - 1.0
    warp = cv2.getPerspectiveTransform(np.float32([[0, 0], [edge, 0], [edge, edge], [0, edge]]), np.float32(pixels))
    seen = cv2.warpPerspective(marker, warp, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=120)
    noise = np.random.default_rng(3).normal(0.0, 3.0, seen.shape)
    return np.clip(seen + noise, 0, 255).astype(np.uint8)


def show(check, image, frame='camera_optical_frame'):
    for number in range(16):
        check.on_image(image_message(Header(stamp=to_stamp(10.0 + 0.25 * number), frame_id=frame), image))


def words(found):
    return ' '.join(f'{one.level} {one.words}' for one in found)


@pytest.mark.parametrize(('azimuth', 'elevation', 'roll'), [(0, 0, 0), (20, -8, 30), (-28, 12, -80), (5, 3, 175)])
def test_the_marker_is_where_it_is_shown(azimuth, elevation, roll):
    seen = picture(azimuth, elevation, roll=roll)
    for mirrored in (False, True):
        found = find_marker(seen[:, ::-1] if mirrored else seen)
        assert found.mirrored == mirrored and abs(math.degrees(found.roll) - roll) < 2.0
        column = WIDTH - 1 - found.column if mirrored else found.column
        assert math.degrees(math.atan2(CENTRE[0] - column, FOCAL)) == pytest.approx(azimuth, abs=0.3)
        assert found.side == pytest.approx(0.1 * FOCAL, rel=0.05)


def test_a_camera_of_16_bits_sees_the_marker():
    assert find_marker(40 * picture(5, 3).astype(np.uint16)) is not None


def test_noise_has_no_marker():
    assert find_marker(np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)) is None


@pytest.mark.parametrize(('image', 'said'), [
    (picture(3, 2), 'ok '), (picture()[:, ::-1], 'error the picture is mirrored'),
    (picture()[::-1, ::-1], r'turned by [+-]1[78]\d deg'), (picture()[::-1], 'mirrored error the picture is turned by'),
    (picture(17, 0), r'azimuth \+1[67] deg'), (picture(0, -19), 'elevation -19 deg'),
    (picture(roll=90), r'turned by \+(89|90) deg')])
def test_a_marker_ahead_shows_how_the_camera_is_mounted(tmp_path, image, said):
    check, steps = check_of(tmp_path)
    show(check, image)
    assert re.search(said, words(steps['camera'].judge(False)))


@pytest.mark.parametrize(('focal', 'found'), [(1.0, False), (0.75, True), (1.3, True)])
def test_a_marker_of_known_size_shows_the_focal_length(tmp_path, focal, found):
    check, steps = check_of(tmp_path, marker_side=0.1 / focal)  # as a picture with another focal length shows it
    show(check, picture())
    assert ('focal length' in words(steps['camera'].judge(False))) == found


@pytest.mark.parametrize(('array', 'order', 'level'), [
    ('two_microphones', [0, 1], 'ok'), ('two_microphones', [1, 0], 'error'),
    ('quadrotor_square', [0, 1, 2, 3], 'ok'), ('quadrotor_square', [2, 1, 0, 3], 'error')])
def test_claps_show_the_order_of_the_channels(tmp_path, array, order, level):
    check, steps = check_of(tmp_path, array)
    microphones = MicrophoneArray.load(CONFIG / 'arrays' / f'{array}.yaml')
    assert not steps['microphones'].judge(False)  # the last of both: to the right
    for number in range(3):
        sound = clap(microphones, math.radians(-90.0), seed=number)[:, order]
        check.on_audio(audio_frame(sound, number * RATE, RATE, Header(stamp=to_stamp(float(number)))))
    found = steps['microphones'].judge(False)
    assert found[0].level == level and (level == 'ok' or 'order' in found[0].words)


def test_steps_around_an_odd_clap_follow_most_claps(tmp_path):
    check, steps = check_of(tmp_path, 'quadrotor_square')
    for number, azimuth in enumerate((-90.0, 40.0, -90.0)):  # a step behind the person
        check.on_audio(audio_frame(clap(SQUARE, math.radians(azimuth), seed=number), number * RATE, RATE,
                                   Header(stamp=to_stamp(float(number)))))
    assert steps['microphones'].judge(False)[0].level == 'ok'


@pytest.mark.parametrize(('gain', 'drift', 'said'), [
    (1.0, 0.0, 'ok '), (-1.0, 0.0, 'REP-103'), (0.0, 0.0, 'frozen'), (1.0, 12.0, 'drifts by +12')])
def test_a_turn_shows_the_heading(tmp_path, gain, drift, said):
    check, steps = check_of(tmp_path)

    def pose(time, turned):
        heading = math.radians(gain * turned + drift * time / 60.0) + 3.0  # over the seam of pi
        message = Odometry(header=Header(stamp=to_stamp(time)))
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(0.5 * heading), math.cos(0.5 * heading)
        check.on_odometry(message)

    check.begin()
    for time in np.arange(0.0, 20.0, 0.05):
        pose(float(time), 0.0)
    check.on_audio(audio_frame(clap(PAIR, math.radians(-90.0)), 0, RATE, Header()))
    steps['microphones'].judge(True)
    check.begin()
    for time in np.arange(20.0, 26.0, 0.05):
        pose(float(time), 90.0 * min((float(time) - 20.0) / 3.0, 1.0))
    found = steps['heading'].judge(True)
    assert said in ' '.join(f'{words([one])} {one.remedy}' for one in found)


@pytest.mark.parametrize(('faults', 'said'), [
    (Faults(), 'nothing contradicts'), (Faults(swapped=True), 'exchanged'), (Faults(camera_yaw_deg=18.0), 'camera is turned'),
    (Faults(yaw_sign=-1), 'yaw of the odometry')])
def test_a_walk_around_the_rig_shows_what_contradicts(tmp_path, faults, said):
    """By messages of a rig with the fault, whose loudspeaker is seen."""
    check, steps = check_of(tmp_path)
    check.on_camera_info(CameraInfo(header=Header(frame_id='camera'), width=INFO.width, height=INFO.height,
                                    distortion_model=INFO.distortion_model, d=INFO.d, k=INFO.k))
    check._converter._rotation_of = lambda frame, time: rig._rotation_of(frame, time)
    rig = turning_rig(faults, 5)
    give = rig.give

    def both(kind, message, now):
        take = {'doa': check.on_doa, 'odometry': check.on_odometry, 'detections': check.on_detections}.get(kind)
        if take is not None:
            take(message)
        give(kind, message, now)
    rig.give = both
    check.begin()
    rig.run(45.0)
    assert said in words(steps['sound and sight'].judge(True))


def test_what_does_not_come_and_nodes_that_are_not_well_are_said(tmp_path):
    check, steps = check_of(tmp_path)
    assert not steps['rig'].judge(False)
    assert [one.level for one in steps['rig'].judge(True)] == ['error'] * 3
    for level, left in ((DiagnosticStatus.ERROR, 1), (DiagnosticStatus.OK, 0)):
        check.on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name='rig: fusion_node', level=level, message='odd')]))
        assert len(check.statuses) == left
    for title in ('microphones', 'heading', 'camera', 'sound and sight'):
        assert steps[title].judge(True)[0].level in ('unknown', 'error')


def test_only_nodes_of_the_rig_are_told(tmp_path):
    check, _ = check_of(tmp_path, namespace='/left')
    names = ('left/fusion_node: status', 'left_two/fusion_node: status', 'fusion_node: status', 'far/left/fusion_node: status')
    check.on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name=name, level=DiagnosticStatus.ERROR) for name in names]))
    assert list(check.statuses) == [names[0]]
