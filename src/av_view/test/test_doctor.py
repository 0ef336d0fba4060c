"""Findings on made-up machines: each fault is named with its remedy, and what is in order passes."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.signal import butter, resample_poly, sosfilt

from av_common.microphone_array import MicrophoneArray
from av_common.rig import load_rig
from av_view.cli import doctor
from av_view.doctor import program
from av_view.doctor.cameras import judge_images
from av_view.doctor.files import detector_settings, judge_files
from av_view.doctor.finding import Finding
from av_view.doctor.machine import judge_clock, judge_detector, judge_load, judge_middleware, judge_px4
from av_view.doctor.microphones import judge_clap, judge_silence, judge_sound

CONFIG = Path(__file__).resolve().parents[3] / 'config'
RATE = 48_000
PAIR = MicrophoneArray.load(CONFIG / 'arrays' / 'two_microphones.yaml')
RIG = load_rig(CONFIG / 'rig.yaml')
SQUARE = MicrophoneArray.load(CONFIG / 'arrays' / 'quadrotor_square.yaml')


def levels(found):
    return [finding.level for finding in found]


def noise(channels=2, level=0.01, seconds=1.0):
    return np.random.default_rng(4).normal(0.0, level, (int(seconds * RATE), channels)).astype(np.float32)


def clap(array, azimuth, distance=3.0, seed=7):
    """A decaying burst at a point, delayed to each microphone by its distance in fractions of a sample, and noise."""
    rng = np.random.default_rng(seed)
    burst = rng.normal(0.0, 0.5, 400) * np.exp(-np.arange(400) / 80.0)
    source = distance * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    delays = np.linalg.norm(array.positions - source, axis=1) / 343.2
    frequencies = np.fft.rfftfreq(RATE, 1.0 / RATE)
    spectrum = np.fft.rfft(burst, RATE) * (frequencies < 12_000)
    heard = [np.fft.irfft(spectrum * np.exp(-2j * np.pi * frequencies * (0.4 + delay)), RATE) for delay in delays]
    return (np.stack(heard, axis=1) + rng.normal(0.0, 1e-3, (RATE, array.channels))).astype(np.float32)


def test_living_microphones_pass():
    assert levels(judge_sound(noise(), RATE, RATE * 1.00002)) == ['ok']


@pytest.mark.parametrize(('change', 'words'), [
    (lambda sound: sound * np.array([1.0, 0.0]), 'channel 1 is dead'), (lambda sound: sound[:, [0, 0]], 'identical'),
    (lambda sound: np.clip(200.0 * sound, -1.0, 1.0), 'clips'), (lambda sound: sound + np.array([0.0, 0.3]), 'offset'),
    (lambda sound: 1e-4 * sound, 'quiet')])
def test_faults_of_channels_are_named_with_a_remedy(change, words):
    found = judge_sound(change(noise()).astype(np.float32), RATE, RATE)
    assert any(words in finding.words and finding.remedy for finding in found), found


def test_a_device_that_runs_at_another_rate_is_an_error():
    assert levels(judge_sound(noise(), RATE, 44_100.0)) == ['error']


@pytest.mark.parametrize(('given', 'asked'), [(48_000, 96_000), (16_000, 48_000), (32_000, 96_000), (8_000, 44_100)])
def test_a_rate_that_a_sound_server_makes_up_is_found(given, asked):
    sound = resample_poly(np.random.default_rng(1).normal(0.0, 0.03, (3 * given, 2)), asked // 100, given // 100, axis=0)
    (finding,) = judge_sound(sound, asked, asked)
    named = int(re.search(r'made from (\d+) Hz or less', finding.words)[1])
    assert finding.level == 'warning' and given <= named <= 1.5 * given and str(named) in finding.remedy


@pytest.mark.parametrize('corner', [2_000.0, 8_000.0, 20_000.0])
@pytest.mark.parametrize('rate', [48_000, 96_000])
def test_a_microphone_that_hears_little_above_a_frequency_is_no_sound_server(rate, corner):
    sound = sosfilt(butter(2, corner, fs=rate, output='sos'), np.random.default_rng(1).normal(0.0, 0.1, (3 * rate, 2)), axis=0)
    converter = np.random.default_rng(2).normal(0.0, 1e-4, sound.shape)
    assert levels(judge_sound(sound + converter, rate, rate)) == ['ok']


def test_a_device_is_not_blamed_for_a_busy_machine():
    assert judge_silence(12.0, 11.0, 2).level == 'unknown' and 'unplug' not in judge_silence(12.0, 11.0, 2).remedy
    assert judge_silence(12.0, 0.5, 2).level == 'error' and 'unplug' in judge_silence(12.0, 0.5, 2).remedy


def test_the_detector_is_timed_as_the_node_uses_it(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(program, 'judge_detector', lambda ms, rate, name: seen.append((ms, rate, name)))
    parameters = tmp_path / 'params.yaml'
    for regions in (1, 3):
        parameters.write_text(f'/**/detector_node: {{ros__parameters: {{regions: {regions}}}}}')
        program._detector(detector_settings(RIG, [parameters]), (480, 640), 15.0)
    assert '(1 regions)' in seen[0][2] and '(3 regions)' in seen[1][2] and seen[0][0] > 0.0


def test_the_machine_is_timed_with_the_camera_of_the_rig(monkeypatch):
    """A thermal detector searches all of each image, whose size the description tells."""
    seen = []
    monkeypatch.setattr(program, '_detector', lambda settings, size, rate: seen.append((settings.camera_kind, size)))
    program.machine(load_rig(CONFIG / 'rig_thermal.yaml'), [CONFIG / 'rig_params.yaml'])
    assert seen == [('thermal', (256, 320))]


@pytest.mark.parametrize('array', [PAIR, SQUARE])
@pytest.mark.parametrize('azimuth', [90.0, -60.0, 40.0])
def test_a_clap_shows_that_the_order_is_right(array, azimuth):
    assert judge_clap(clap(array, math.radians(azimuth)), RATE, array, math.radians(azimuth)).level == 'ok'


@pytest.mark.parametrize('order', [order for order in itertools.permutations(range(4)) if order != (0, 1, 2, 3)])
def test_a_clap_shows_any_wrong_order_and_the_right_one(order):
    """Channel k holds microphone order[k]; the remedy selects the channels so that each microphone has its place."""
    azimuth = math.radians(25.0)
    heard = clap(SQUARE, azimuth)[:, list(order)]
    found = judge_clap(heard, RATE, SQUARE, azimuth)
    assert found.level == 'error' and 'order' in found.words
    chosen = json.loads(found.remedy[found.remedy.index('['):found.remedy.index(']') + 1])
    assert judge_clap(heard[:, chosen], RATE, SQUARE, azimuth).level == 'ok'


def test_exchanged_ears_are_found():
    found = judge_clap(clap(PAIR, math.pi / 2)[:, ::-1], RATE, PAIR, math.pi / 2)
    assert found.level == 'error' and '[1, 0]' in found.remedy


def test_a_clap_that_says_nothing_is_said_to_say_nothing():
    assert judge_clap(clap(PAIR, 0.0), RATE, PAIR, 0.0).level == 'unknown'  # both ears at once
    assert 'no clap' in judge_clap(noise(), RATE, PAIR, math.pi / 2).words
    wrong = MicrophoneArray(np.array([[0.0, 0.5, 0.0], [0.0, -0.5, 0.0]]))  # a file in other units
    assert 'fits no order' in judge_clap(clap(PAIR, math.pi / 2), RATE, wrong, math.pi / 2).words


def pictures(level=120.0, count=5, size=(480, 640)):
    rng = np.random.default_rng(1)
    return [np.clip(rng.normal(level, 5.0, (*size, 3)), 0, 255).astype(np.uint8) for _ in range(count)]


def test_a_good_camera_passes():
    assert levels(judge_images(np.arange(30) / 15.0, pictures(), 15.0, (640, 480))) == ['ok']


@pytest.mark.parametrize(('times', 'images', 'words'), [
    ([], [], 'no images'), (np.arange(10) / 5.0, pictures(), '5.0 pictures'),
    (np.arange(10) / 15.0, pictures(size=(360, 640)), '640x360'), (np.arange(10) / 15.0, pictures(2.0), 'dark'),
    (np.arange(10) / 15.0, pictures(254.0), 'overexposed'), (np.arange(10) / 15.0, pictures()[:1] * 4, 'the same')])
def test_faults_of_cameras_are_named(times, images, words):
    found = judge_images(times, images, 15.0, (640, 480))
    assert any(words in finding.words and finding.remedy for finding in found), found


def test_the_machine():
    assert judge_clock(True, 1.8e9).level == 'ok' and judge_clock(False, 1.8e9).level == 'warning'
    assert judge_clock(True, 100.0).level == 'error' and judge_clock(None, 1.8e9).level == 'unknown'
    assert [judge_detector(ms, 10.0, 'it').level for ms in (50.0, 200.0, 900.0)] == ['ok', 'warning', 'error']
    assert judge_load(0.2, 4).level == 'ok' and judge_load(9.0, 2).level == 'warning'


def test_the_middleware():
    good = {'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': '7'}
    assert levels(judge_middleware(good, 8_000_000)) == ['ok'] == levels(judge_middleware(good, None))
    for change in ({'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp'}, {'ROS_DOMAIN_ID': '200'}, {'ROS_DOMAIN_ID': 'x'},
                   {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}):
        (finding,) = judge_middleware(good | change, 8_000_000)
        assert finding.level != 'ok' and finding.remedy.startswith('export')
    assert levels(judge_middleware(good, 212_992)) == ['warning']


@pytest.mark.parametrize(('facts', 'words'), [
    ((True, True, True, ['/left/fmu/out/vehicle_status']), ''), ((True, True, True, ['/rosout']), 'nothing comes'),
    ((True, True, False, []), 'does not run'), ((True, False, False, []), 'no agent'), ((False, True, True, []), 'px4_msgs')])
def test_the_link_to_px4(facts, words):
    found = judge_px4(*facts)
    assert levels(found) == ['ok'] if not words else any(words in one.words and one.remedy for one in found), found


def test_the_shipped_files_agree():
    found, rig = judge_files(CONFIG / 'rig.yaml', [CONFIG / 'rig_params.yaml'])
    assert levels(found) == ['ok'] and rig is not None


@pytest.mark.parametrize('name', ['rig_thermal', 'rig_gimbal', 'rig_two_cameras'])
def test_a_camera_is_described_once(name):
    """Its size and field of view need not be in the parameters, too."""
    found, _ = judge_files(CONFIG / f'{name}.yaml', [CONFIG / 'rig_params.yaml'])
    assert not any('camera_node' in finding.words for finding in found), found


@pytest.mark.parametrize(('parameters', 'words'), [
    ('/**/audio_node: {ros__parameters: {channels: [0, 1, 2]}}', 'captures 3'),
    ('/**/camera_node: {ros__parameters: {width: 1280, height: 720}}', '1280x720'),
    ('/**/camera_node: {ros__parameters: {horizontal_fov_deg: 50.0}}', 'a view of 50'),
    ('/**/doa_node: {ros__parameters: {band_low: 300.0, band_high: 300.1}}', 'wider band'),
    ('/**/doa_node: {ros__parameters: {window: 4.0}}', 'window is 4 s'),
    ('/**/audio_node: {ros__parameters: {sample_rate: -1}}', 'sample_rate'), ('[', 'params.yaml')])
def test_files_that_contradict_each_other(parameters, words, tmp_path):
    file = tmp_path / 'params.yaml'
    file.write_text(parameters)
    found, _ = judge_files(CONFIG / 'rig.yaml', [file])
    assert any(words in finding.words and finding.remedy for finding in found), found


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('rpy_deg: [0.0, 0.0, 0.0]', 'rpy_deg: [0.0, 0.0, 90.0]', 'the camera looks'),
    ('rpy_deg: [0.0, 0.0, 0.0]', 'rpy_deg: [90.0, 0.0, 0.0]', 'above one another'),
    ('position: [0.0, 0.0, 0.10]', 'position: [0.0, 0.0, 8.0]', 'from the middle of the body'),
    ('position: [0.0, 0.0, 0.10]', 'position: [0.0, 0.0, 100.0]', 'expected metres')])
def test_an_array_that_does_not_fit_the_rig(old, new, words, tmp_path):
    text = (CONFIG / 'rig.yaml').read_text().replace('arrays/', f'{CONFIG}/arrays/')
    assert old in text
    (tmp_path / 'rig.yaml').write_text(text.replace(old, new, 1))
    found, _ = judge_files(tmp_path / 'rig.yaml', [CONFIG / 'rig_params.yaml'])
    assert any(words in finding.words and finding.remedy for finding in found), found


def test_another_array_file_than_that_of_the_rig_is_an_error(tmp_path):
    file = tmp_path / 'params.yaml'
    file.write_text(f'/**/doa_node: {{ros__parameters: {{array_file: {CONFIG}/arrays/respeaker_4.yaml}}}}')
    found, _ = judge_files(CONFIG / 'rig.yaml', [file])
    assert 'error' in levels(found) and any('respeaker_4' in finding.words for finding in found)


def test_the_camera_is_opened_as_the_node_does(tmp_path):
    """A file stands for a camera: OpenCV opens both."""
    file, parameters = tmp_path / 'video.avi', tmp_path / 'params.yaml'
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*'MJPG'), 15.0, (640, 480))
    for image in pictures(count=8) * 40:
        writer.write(image)
    writer.release()
    parameters.write_text(f'/**/camera_node: {{ros__parameters: {{device: "{file}"}}}}')
    assert levels(program.camera(RIG, [parameters], 0.3)) == ['ok']
    parameters.write_text(f'/**/camera_node: {{ros__parameters: {{device: "{file}", pixel_format: Y16}}}}')
    (finding,) = program.camera(RIG, [parameters], 0.3)
    assert finding.level == 'error' and 'no images of Y16' in finding.words
    parameters.write_text(f'/**/camera_node: {{ros__parameters: {{device: "{tmp_path}/none"}}}}')
    (finding,) = program.camera(RIG, [parameters], 0.3)
    assert finding.level == 'error' and 'absent or in use' in finding.words


def test_a_machine_without_the_device_is_told_so(tmp_path):
    parameters = tmp_path / 'params.yaml'
    parameters.write_text('/**/audio_node: {ros__parameters: {device: no such device}}')
    (finding,) = program.microphones(RIG, [parameters], 0.1, None)
    assert finding.level == 'error' and finding.remedy


def test_a_realsense_is_listed_with_its_usb():
    """By a software device of Intel's SDK."""
    rs = pytest.importorskip('pyrealsense2', reason='pyrealsense2 is not installed')
    device = rs.software_device()
    for key, value in (('name', 'Software D435i'), ('serial_number', '0815'), ('usb_type_descriptor', '2.1')):
        device.register_info(getattr(rs.camera_info, key), value)
    (finding,) = program.realsense_devices(rs, [device])
    assert finding.level == 'warning' and 'realsense:0815' in finding.words and 'USB 2.1' in finding.words
    assert program.realsense_devices(rs, []) == []


TWO_USB = """
class PortAudioError(Exception): pass
def query_devices(device=None):
    names = ['USB PnP Sound Device: Audio (hw:1,0)', 'USB PnP Sound Device: Audio (hw:2,0)']
    devices = [{'index': index, 'name': name, 'max_input_channels': 1} for index, name in enumerate(names)]
    return devices if device is None else devices[device]
"""


@pytest.mark.parametrize('device', ['USB', '0', 'hw:1,0'])
def test_two_usb_microphones_are_no_array_and_that_is_said(device, tmp_path, monkeypatch):
    """Each is a device of one channel, with a clock of its own."""
    (tmp_path / 'sounddevice.py').write_text(TWO_USB)
    monkeypatch.setenv('PYTHONPATH', f'{tmp_path}{os.pathsep}{os.environ["PYTHONPATH"]}')
    parameters = tmp_path / 'params.yaml'
    parameters.write_text(f"/**/audio_node: {{ros__parameters: {{device: '{device}', channels: [0, 1]}}}}")
    (finding,) = program.microphones(RIG, [parameters], 0.1, None)
    assert finding.level == 'error' and 'channels of one device' in finding.remedy


def run(capsys, monkeypatch, finding, *words):
    monkeypatch.setattr(program, 'machine', lambda *_: [finding])
    with pytest.raises(SystemExit) as end:
        doctor.main(['--only', 'files', 'machine', *words])
    return end.value.code, capsys.readouterr().out


def test_the_program_says_it_in_words_in_json_and_by_its_exit_code(capsys, monkeypatch):
    bad = Finding('clock', 'error', 'the clock has not been set', 'sudo date')
    code, text = run(capsys, monkeypatch, bad)
    assert code == 1 and 'ERROR' in text and '-> sudo date' in text
    code, text = run(capsys, monkeypatch, bad, '--json')
    assert code == 1 and json.loads(text)['errors'] == 1 and json.loads(text)['findings'][1]['remedy'] == 'sudo date'
    assert run(capsys, monkeypatch, Finding('clock', 'warning', 'w', 'r'))[0] == 0


@pytest.mark.parametrize('words', [['--clap', 'sideways'], ['--only', 'weather'], ['--seconds', 'long']] + [
    [f'--{name}={value}'] for name in ('clap', 'seconds') for value in ('nan', 'inf', '-inf', '1e308', '-1e9', '')])
def test_arguments_that_cannot_be_used_end_with_2(words, monkeypatch):
    monkeypatch.setattr(sys, 'stderr', sys.stdout)
    with pytest.raises(SystemExit) as end:
        doctor.main(words)
    assert end.value.code == 2
