"""Collects the facts that the checks judge: from devices, files and the system."""

from __future__ import annotations

import importlib.util
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from av_audio.device_process import load_sounddevice
from av_audio.device_source import WARM_UP_S
from av_audio.device_source import DeviceSource as SoundDevice
from av_audio.ring_buffer import RingBuffer
from av_common.parameters import node_parameters
from av_common.rig import Rig
from av_view.doctor.cameras import judge_images
from av_view.doctor.files import camera_settings, detector_settings
from av_view.doctor.finding import Finding
from av_view.doctor.machine import judge_clock, judge_detector, judge_load, judge_middleware, judge_px4
from av_view.doctor.microphones import judge_clap, judge_silence, judge_sound
from av_vision.sources.capture import DeviceSource as Camera
from av_vision.sources.capture import SourceError
from av_vision.sources.realsense import RealSenseSource, sdk
from av_vision.stage import make_detection_stage

KEPT_IMAGES = 10  # of which differences are taken
AGENTS = ('MicroXRCEAgent', 'micro-xrce-dds-agent')
ROUNDS = 14  # of a detector, of which the second half is timed
LATE_S = 10.0  # for which samples are waited for on a busy machine


def devices() -> list[Finding]:
    """The microphones and cameras that there are."""
    found = []
    try:
        inputs = [one for one in load_sounddevice().query_devices() if one['max_input_channels'] > 0]
        names = '; '.join(f'{one["index"]}: {one["name"]} ({one["max_input_channels"]} channels, '
                          f'{one["default_samplerate"]:.0f} Hz)' for one in inputs)
        found.append(Finding('microphones', 'ok', names) if inputs else Finding(
            'microphones', 'error', 'no capture device is found', 'plug it in; sudo usermod -aG audio $USER, and log in again'))
    except ImportError as error:
        found.append(Finding('microphones', 'error', str(error), 'sudo apt-get install libportaudio2; pip install sounddevice'))
    return [*found, *_cameras()]


def _cameras() -> list[Finding]:
    """The cameras, those of Intel's SDK also by their serial numbers and their USB."""
    videos = {f'/dev/{one.name}': (one / 'name').read_text().strip()
              for one in sorted(Path('/sys/class/video4linux').glob('video*'))}
    try:
        depth = realsense_devices(sdk())
    except SourceError as error:
        depth = [Finding('camera', 'warning', str(error), 'pip install pyrealsense2')
                 ] if any('RealSense' in name for name in videos.values()) else []
    named = [Finding('camera', 'ok', '; '.join(f'{path}: {name}' for path, name in videos.items()))] if videos else []
    return [*named, *depth] or [Finding('camera', 'error', 'no camera is found',
                                        'plug it in; sudo usermod -aG video $USER, and log in again')]


def realsense_devices(rs: Any, devices: Iterable[Any] | None = None) -> list[Finding]:
    """The cameras that Intel's SDK finds.

    Parameters:
        rs: the SDK.
        devices: of the SDK, instead of those that are plugged in.
    """
    found = []
    for device in rs.context().query_devices() if devices is None else devices:
        facts = {key: device.get_info(getattr(rs.camera_info, key))
                 for key in ('name', 'serial_number', 'usb_type_descriptor') if device.supports(getattr(rs.camera_info, key))}
        words = f'realsense:{facts.get("serial_number", "")}: {facts.get("name", "RealSense")}'
        usb = facts.get('usb_type_descriptor', '')
        found.append(Finding('camera', 'warning', f'{words}, at USB {usb}', 'a port and a cable of USB 3, without a hub')
                     if usb.startswith('2') else Finding('camera', 'ok', words))
    return found


def microphones(rig: Rig, parameter_files: Sequence[str | Path], seconds: float, clap: float | None) -> list[Finding]:
    """Listen as audio_node does, with a word before the clap.

    Parameters:
        rig: the description, for the array.
        parameter_files: of audio_node.
        seconds (s): to listen.
        clap (rad): azimuth of a clap; None without one.
    """
    settings = node_parameters('av_audio', 'audio_node', parameter_files, {'source': 'device'})
    channels = [0, 1] if list(settings.channels) == [-1] else list(settings.channels)
    source = SoundDevice(settings.device, settings.sample_rate, channels)
    capacity = int((seconds + 5.0) * settings.sample_rate) * len(channels) * 4
    buffer = RingBuffer(len(channels), capacity)
    try:
        source.start(buffer)
    except ValueError as error:
        return [Finding('microphones', 'error', str(error), 'set device, sample_rate and channels of audio_node; all '
                        'microphones are channels of one device: two USB microphones have two clocks')]
    if clap is not None:
        print(f'clap once from {math.degrees(clap):.0f} degrees, now', file=sys.stderr, flush=True)
    try:
        blocks, end = [np.zeros((0, len(channels)))], time.monotonic() + WARM_UP_S + seconds + LATE_S
        while sum(map(len, blocks)) < seconds * settings.sample_rate and time.monotonic() < end:
            time.sleep(0.05)
            while buffer.available:
                blocks.append(buffer.read()[1])
    finally:
        source.stop()
    samples = np.concatenate(blocks)
    if not len(samples):
        return [judge_silence(WARM_UP_S + seconds + LATE_S, os.getloadavg()[0], os.cpu_count() or 1)]
    delivered = settings.sample_rate * (1.0 + 1e-6 * source.ppm)
    array = rig.array.geometry if rig.array.geometry.channels == len(channels) else None
    found = judge_sound(samples, settings.sample_rate, delivered, array)
    if clap is not None and array is not None:
        found.append(judge_clap(samples, settings.sample_rate, array, clap))
    return found


def camera(rig: Rig, parameter_files: Sequence[str | Path], seconds: float) -> list[Finding]:
    """Look as camera_node does.

    Parameters:
        rig: the description, for the camera.
        parameter_files: of camera_node.
        seconds (s): to look.
    """
    settings = camera_settings(rig, parameter_files, source='device')
    kind, _, serial = settings.device.partition(':')
    asked = settings.width, settings.height, settings.rate or 30.0, settings.exposure_ms
    source = RealSenseSource(serial, *asked) if kind == 'realsense' else Camera(
        settings.device, *asked, pixel_format=settings.pixel_format)
    times: list[float] = []
    images: list[NDArray[Any]] = []
    try:
        source.open()
        end, most = time.monotonic() + seconds, 2.0 * seconds * (settings.rate or 30.0)  # a file comes as fast as it is read
        while len(times) < 2 or (time.monotonic() < end and len(times) < most):
            captured = source.read()
            times.append(captured.time)
            images = [*images[1 - KEPT_IMAGES:], captured.image]
    except SourceError as error:
        return [Finding('camera', 'error', str(error), 'does another program use it? sudo fuser -v /dev/video*')]
    finally:
        source.close()
    return judge_images(times, images, settings.rate, (settings.width, settings.height))


def machine(rig: Rig, parameter_files: Sequence[str | Path]) -> list[Finding]:
    """Clock, processor and middleware.

    Parameters:
        rig: the description, for the camera.
        parameter_files: of camera_node and detector_node.
    """
    camera = camera_settings(rig, parameter_files)
    load = judge_load(os.getloadavg()[0], os.cpu_count() or 1)  # before the detector makes its own
    return [judge_clock(_synchronised(), time.time()), load,
            _detector(detector_settings(rig, parameter_files), (camera.height, camera.width), camera.rate or 10.0),
            *judge_middleware(os.environ, _largest_buffer())]


def px4() -> list[Finding]:
    """The link to PX4."""
    running = any(process.info['name'] in AGENTS for process in psutil.process_iter(['name']))
    command = ['ros2', 'topic', 'list', '--no-daemon', '--spin-time', '3']
    try:
        topics = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False).stdout.split()
    except (OSError, subprocess.TimeoutExpired):
        topics = []
    return judge_px4(importlib.util.find_spec('px4_msgs') is not None, any(map(shutil.which, AGENTS)), running, topics)


def _detector(settings: Any, size: tuple[int, int], rate: float) -> Finding:
    """Time on noise what detector_node does with an image: a search of as many regions as its look_time allows.

    Parameters:
        settings: parameters of detector_node.
        size: height and width of the images.
        rate (Hz): of the camera.
    """
    try:
        detector = make_detection_stage(settings).detector
    except ValueError as error:
        return Finding('processor', 'error', str(error), 'set model of detector_node')
    image, spent = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8), []
    for number in range(ROUNDS):
        begin = time.perf_counter()
        detector.detect(image, number / rate)
        spent.append(time.perf_counter() - begin)
        detector.planner.took(spent[-1])
    searched = f'{detector.planner.planned or "all"} regions'
    return judge_detector(1000.0 * float(np.median(spent[ROUNDS // 2:])), rate, f'detector_node ({searched})')


def _synchronised() -> bool | None:
    """Whether the system's clock follows a reference; None where systemd does not say."""
    command = ['timedatectl', 'show', '-p', 'NTPSynchronized', '--value']
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {'yes': True, 'no': False}.get(answer)


def _largest_buffer() -> int | None:
    try:
        return int(Path('/proc/sys/net/core/rmem_max').read_text())
    except (OSError, ValueError):
        return None
