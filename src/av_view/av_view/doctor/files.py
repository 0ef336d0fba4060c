"""The rig's files against each other: array, camera, and the parameters of the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from av_audio.start_check import check_ages, check_hearing
from av_common.parameter_files import parameters_for
from av_common.parameters import check_parameter_file, node_modules, node_parameters
from av_common.rig import Rig, load_rig
from av_view.doctor.finding import Finding

AREA = 'files'
SPACINGS = (0.03, 0.6)  # m, between the outermost microphones
FOV_TOLERANCE_DEG = 3.0  # an error of 1.5 deg at the edge of the picture
FARTHEST = 3.0  # m, of a microphone from the middle of the body
UPRIGHT, ALIGNED = 0.8, 0.87  # cosines of the array's axis with the vertical, and with the camera's direction


def judge_files(rig_file: str | Path, parameter_files: Sequence[str | Path]) -> tuple[list[Finding], Rig | None]:
    """Judge the rig's description and the parameters; also the rig, where it can be read.

    Parameters:
        rig_file: description of the rig.
        parameter_files: those of the nodes, later ones win.
    """
    try:
        rig = load_rig(rig_file)
        array = rig.array.geometry
        for file in parameter_files:
            check_parameter_file(file, [f'/{name}' for name in node_modules()])
        audio = node_parameters('av_audio', 'audio_node', parameter_files)
        camera = camera_settings(rig, parameter_files)
        hearing = node_parameters('av_audio', 'doa_node', parameter_files)
        check_ages(hearing.window, hearing.hop)
        check_hearing(hearing, array)
    except (OSError, ValueError) as error:
        return [Finding(AREA, 'error', str(error), 'correct the file, or write another: ros2 run av_view setup')], None
    found = [*_array_findings(array, list(audio.channels)), *_mount_findings(rig, hearing.array_file),
             *_camera_findings(rig, camera)]
    return found or [Finding(AREA, 'ok', f'{Path(rig_file).name}: {array.channels} microphones ({array.name}), camera '
                             f'{rig.camera.width}x{rig.camera.height}, {rig.camera.horizontal_fov_deg:.0f} degrees')], rig


def camera_settings(rig: Rig, parameter_files: Sequence[str | Path], **given: Any) -> Any:
    """The parameters of camera_node as a launch gives them, but for those `given`. Raises as `node_parameters`."""
    described = {name: getattr(rig.camera, name) for name in ('width', 'height', 'horizontal_fov_deg')}
    return _launched('camera_node', described, parameter_files, **given)


def detector_settings(rig: Rig, parameter_files: Sequence[str | Path]) -> Any:
    """The parameters of detector_node as a launch gives them. Raises as `node_parameters`."""
    return _launched('detector_node', {'camera_kind': rig.camera.images}, parameter_files)


def _launched(node: str, described: dict[str, Any], parameter_files: Sequence[str | Path], **given: Any) -> Any:
    """The parameters of a node: those of the rig's description, then of the files, then those `given`."""
    files = {name for file in parameter_files for name in parameters_for(file, f'/{node}')}
    described = {name: value for name, value in described.items() if name not in files}
    return node_parameters('av_vision', node, parameter_files, {**described, **given})


def _array_findings(array: Any, channels: list[int]) -> list[Finding]:
    found = []
    captured = 2 if channels == [-1] else len(channels)  # of a device: 0 and 1
    if captured != array.channels:
        found.append(Finding(AREA, 'error', f'{array.name} has {array.channels} microphones, audio_node captures {captured}',
                             f'set channels of audio_node to {array.channels} channels, in the order of the array file'))
    if not SPACINGS[0] <= array.aperture <= SPACINGS[1]:
        found.append(Finding(AREA, 'warning', f'the microphones of {array.name} are {array.aperture:.3f} m apart; 0.1 to 0.2 m '
                             'suit drones', 'measure again; positions are in metres'))
    return found


def _mount_findings(rig: Rig, array_file: str) -> list[Finding]:
    """The array against the rig: which file counts, where it is, and what it can tell apart there."""
    found, array = [], rig.array
    if array_file and Path(array_file).resolve() != array.file.resolve():
        found.append(Finding(AREA, 'error', f'doa_node uses {array_file}, the rig\'s description {array.file}',
                             'remove array_file from the parameters: the launch sets it'))
    far = float(np.linalg.norm(array.positions, axis=1).max())
    if far > FARTHEST:
        found.append(Finding(AREA, 'warning', f'a microphone is {far:.1f} m from the middle of the body',
                             'are the position of the array, and those in its file, in metres?'))
    if array.geometry.basis.shape[1] == 1:
        axis = array.mount.rotation @ array.geometry.basis[:, 0]
        ahead = rig.camera.mount.rotation[:, 0] if rig.gimbal is None else np.array([1.0, 0.0, 0.0])
        if abs(axis[2]) > UPRIGHT:
            found.append(Finding(AREA, 'error', f'the microphones of {array.geometry.name} are above one another: they tell no '
                                 'azimuth', 'mount them side by side, or correct rpy_deg of the array'))
        elif abs(axis @ ahead) > ALIGNED:
            found.append(Finding(AREA, 'warning', f'the microphones of {array.geometry.name} are in line with the direction in '
                                 'which the camera looks, where they are least accurate',
                                 'mount them across, or correct rpy_deg of the array'))
    return found


def _camera_findings(rig: Rig, camera: Any) -> list[Finding]:
    found = []
    described = rig.camera.width, rig.camera.height
    if (camera.width, camera.height) != described:
        found.append(Finding(AREA, 'warning', f"camera_node asks for {camera.width}x{camera.height} pixels, the rig's camera "
                             f'has {described[0]}x{described[1]}', 'make width and height agree in both files'))
    if not camera.calibration_file and abs(camera.horizontal_fov_deg - rig.camera.horizontal_fov_deg) > FOV_TOLERANCE_DEG:
        found.append(Finding(AREA, 'error', f'camera_node has a view of {camera.horizontal_fov_deg:.0f} degrees, the '
                             f"rig's camera one of {rig.camera.horizontal_fov_deg:.0f}", 'make horizontal_fov_deg agree in '
                             'both files, or calibrate: docs/guides/camera_and_detector.md'))
    return found
