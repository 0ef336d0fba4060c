"""A substitute for experiments with a physical rig, made of real recordings; the notes of each run name what is rendered.

`filmed:CLIP` is real video of a drone, in which the shipped detector detects. A real drone's sound is rendered through the
measured responses of a head at the labelled azimuths. The lens is covered for a part of each clip.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from av_common.parameters import node_parameters
from av_common.rig import CameraMount
from av_evaluation.hearing.places import KEMAR, at_ears, calibrated_ears, read_responses, towards, with_own_noise
from av_evaluation.hearing.signals import SOUNDS, drone_files, load_clip
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.runs.offline_rig import OfflineRig
from av_fusion.measurement.geometry import detections_in_body
from av_fusion.tracker import MultiTargetTracker
from av_sim_bridge.vehicle import VehicleState
from av_vision.stage import DetectionStage, make_detection_stage

# Clips that the shipped detector was not trained on.
CLIPS = tuple(f'V_DRONE_{number:03d}' for number in (
    44, 98, 40, 100, 52, 79, 46, 80, 53, 47, 58, 19, 59, 49, 43, 20, 50, 38))
CALIBRATING = SOUNDS / 'DRONE_022.flac'  # the recording by which the ears are calibrated
FILMED = 'filmed:'
VIDEO_HZ = 30.0
CAMERA = CameraMount(width=640, height=512)  # pixels of the clips
COVERED = (0.3, 0.85)  # share of a clip
CUT = math.radians(5.0)  # a larger step of the label between two frames is a cut: some clips are spliced


def detection_stage(model: str, camera_kind: str = 'visible') -> DetectionStage:
    """The stage of detector_node. Raises ModelError or ValueError.

    Parameters:
        model: the detector by name or file; '' for the shipped one.
        camera_kind: visible, thermal or black_hot.
    """
    return make_detection_stage(node_parameters('av_vision', 'detector_node', (), {
        'model': model, 'camera_kind': camera_kind, 'threads': 1}))


def filmed(clip: str, data: Path, estimators: tuple[str, ...], model: str = '') -> tuple[RunLog, list[str]]:
    """A real clip with real sound.

    Parameters:
        clip: name of the clip.
        data: folder of the recordings.
        estimators: further methods of direction finding to record.
        model: the detector, see `detection_stage`.

    Raises FileNotFoundError without the recordings, OSError for a video that cannot be read.
    """
    truth = labelled_azimuths(data / 'drone_detection' / 'labels' / f'{clip}.csv')
    first, end = longest_take(truth)
    truth = truth[first:end]
    known = read_responses(data / KEMAR)
    azimuths, responses, rate = known
    array = calibrated_ears(known, [load_clip(data / CALIBRATING, rate)[:2 * rate]])
    voice = load_clip(_recording(data, clip), rate)
    sound = with_own_noise(moving_through(voice, truth, azimuths, responses, rate))
    rig = OfflineRig(array, MultiTargetTracker(), CAMERA, detection=detection_stage(model), estimators=estimators)
    per_frame, standing = round(rate / VIDEO_HZ), VehicleState(0.0, np.zeros(3))    # at the origin
    film = cv2.VideoCapture(str(data / 'drone_detection' / 'video' / f'{clip}.mp4'))
    for _ in range(first):
        film.grab()
    for number, azimuth in enumerate(truth):
        read, image = film.read()
        if not read:
            break
        now = (number + 1) / VIDEO_HZ
        rig.on_samples(sound[number * per_frame:(number + 1) * per_frame], rate, now)
        if number % 2 == 0:
            covered = COVERED[0] <= number / len(truth) < COVERED[1]
            rig.on_image(np.zeros_like(image) if covered else image.astype(np.uint8, copy=False), now, now)
        rig.log.rig.add(now, *standing.position, *standing.attitude_wxyz)
        rig.log.target.add(now, 10.0 * math.cos(azimuth), 10.0 * math.sin(azimuth), 0.0)
        rig.on_state(replace(standing, time=now))
        rig.advance(now)
    if not len(rig.log.fused):
        raise OSError(f'{clip}: no image can be read')
    return rig.log, [
        'real video and detector, real drone sound through measured ears at the labelled azimuths; the lens covered for '
        f'{100 * (COVERED[1] - COVERED[0]):.0f} % of the time']


def labelled_azimuths(file: Path) -> NDArray:
    """Azimuths (n,) in rad for each frame of a clip, interpolated between its labels. Raises FileNotFoundError."""
    if not file.exists():
        raise FileNotFoundError(f'{file}: the recordings are not there')
    rows = [line.split(',') for line in file.read_text().splitlines()[1:]]
    frames = np.array([int(row[0]) for row in rows])
    boxes = np.array([[float(value) for value in row[2:6]] for row in rows])
    labels = detections_in_body(CAMERA.model, boxes[:, :2] + 0.5 * boxes[:, 2:], boxes[:, 2:], np.ones(len(boxes)),
                                CAMERA.optical_to_body)
    _, first = np.unique(frames, return_index=True)
    azimuths = np.array([detection.azimuth for detection in labels])[first]
    return np.interp(np.arange(frames.max() + 1), frames[first], azimuths)


def longest_take(azimuths: NDArray) -> tuple[int, int]:
    """First frame, and the one after the last, of the longest part without a cut, by the labelled azimuths (n,) in rad."""
    cuts = np.flatnonzero(np.abs(np.diff(azimuths)) > CUT) + 1
    edges = np.concatenate([[0], cuts, [len(azimuths)]])
    longest = int(np.argmax(np.diff(edges)))
    return int(edges[longest]), int(edges[longest + 1])


def moving_through(recording: NDArray, truth: NDArray, azimuths: NDArray, responses: NDArray, rate: int) -> NDArray:
    """Sound (n, 2) of a source that moves along azimuths, at the two ears of a head.

    Parameters:
        recording (m,): sound of the source, repeated as needed.
        truth (rad, (frames,)): azimuths of the source at VIDEO_HZ.
        azimuths (rad, (k,)), responses (k, 2, taps): measured directions and impulse responses.
        rate (Hz): sample rate of recording and responses.
    """
    per_frame = round(rate / VIDEO_HZ)
    count = per_frame * len(truth)
    recording = np.resize(recording, count)
    at_frames = np.arange(len(truth)) * per_frame + per_frame / 2
    azimuth = np.interp(np.arange(count), at_frames, np.unwrap(truth))
    sound = np.zeros((count, 2), np.float32)
    for share, response in towards(azimuth, azimuths, responses):
        sound += at_ears(share * recording, response).astype(np.float32)
    return 0.3 * sound / np.abs(sound).max()


def _recording(data: Path, name: str) -> Path:
    """One of the drone recordings, by the number in a name. Raises FileNotFoundError."""
    files = [file for file in drone_files(data) if file.name != CALIBRATING.name]
    return files[int(''.join(filter(str.isdigit, name)) or 0) % len(files)]
