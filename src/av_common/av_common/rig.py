"""Description of the rig, as in `config/rig.yaml`: array and cameras, and where they are mounted on the body."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.config_reader import bounded, load
from av_common.frames import BASE_FRAME, FLU_TO_OPTICAL, MAP_FRAME, ODOM_FRAME, rotation_from_rpy
from av_common.microphone_array import MicrophoneArray

Vector = tuple[float, float, float]
CAMERAS = ('camera', 'second_camera')  # that a rig may have
FARTHEST_M = 10.0  # of a sensor on a body: beyond it, directions from both differ by 6 deg at 100 m


@dataclass(frozen=True)
class Mount:
    """A frame on the body.

    Parameters:
        position (m): origin in the body's frame.
        rpy_deg (degrees): fixed-axis roll, pitch, yaw of the rotation from this frame to the body's.

    Raises ValueError for a position that is not on the body, or more than a turn.
    """

    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if max(map(abs, self.position)) > FARTHEST_M:
            raise ValueError(f'position is {list(self.position)}, expected metres, at most {FARTHEST_M:g} from the body')
        if max(map(abs, self.rpy_deg)) > 360.0:
            raise ValueError(f'rpy_deg is {list(self.rpy_deg)}, expected degrees, at most 360')

    @cached_property
    def rotation(self) -> NDArray:
        """Rotation matrix (3, 3) from the mounted frame to the body's."""
        return rotation_from_rpy(*np.deg2rad(self.rpy_deg))

    def to_body(self, points: NDArray) -> NDArray:
        """Points (n, 3) in m of the mounted frame in the body's frame."""
        return np.asarray(points) @ self.rotation.T + np.array(self.position)


@dataclass(frozen=True)
class ArrayMount:
    """A microphone array and where it is mounted.

    Parameters:
        file: the array file, with positions in the array's frame.
        frame: name of the array's frame.
        mount: the frame on the body.
        full_scale_db_spl (dB): sound pressure level at which a sample reaches 1, for simulation.
    """

    file: Path
    frame: str = 'microphones'
    mount: Mount = field(default_factory=Mount)
    full_scale_db_spl: float = bounded(94.0, low=40.0, high=180.0)

    @cached_property
    def geometry(self) -> MicrophoneArray:
        """The array of the file. Raises OSError or ValueError that name the file."""
        return MicrophoneArray.load(self.file)

    @property
    def positions(self) -> NDArray:
        """Positions (m, 3) in m of the microphones in the body's frame."""
        return self.mount.to_body(self.geometry.positions)


@dataclass(frozen=True)
class CameraMount:
    """A camera and where it is mounted: on the body, or on the gimbal of a rig that has one.

    Parameters:
        kind: visible or thermal, which selects the detector.
        palette: of a thermal camera: white_hot or black_hot, which are grey levels by the camera's own gain (mono8), or raw,
            counts (mono16).
        frame, optical_frame: names of the camera's frame (x forward) and of its optical frame (z forward).
        mount: the frame on the body or on the gimbal.
        width, height (pixels): size of the image.
        horizontal_fov_deg (degrees): field of view without distortion.
        distortion: k1 k2 p1 p2 [k3 ...] as in `PinholeCamera`.

    Raises ValueError as `PinholeCamera`.
    """

    kind: str = bounded('visible', choices=('visible', 'thermal'))
    palette: str = bounded('white_hot', choices=('white_hot', 'black_hot', 'raw'))
    frame: str = 'camera_link'
    optical_frame: str = 'camera_optical_frame'
    mount: Mount = field(default_factory=Mount)
    width: int = bounded(640, low=16, high=8192)
    height: int = bounded(480, low=16, high=8192)
    horizontal_fov_deg: float = bounded(70.0, low=1.0, high=150.0)
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _ = self.model    # raises for the file, rather than at the first image

    @cached_property
    def model(self) -> PinholeCamera:
        """The camera in its optical frame."""
        ideal = PinholeCamera.from_fov(self.width, self.height, np.deg2rad(self.horizontal_fov_deg))
        return PinholeCamera(self.width, self.height, ideal.fx, ideal.fy, ideal.cx, ideal.cy, self.distortion)

    @property
    def images(self) -> str:
        """What the detector is told of the images: visible, thermal, or black_hot for thermal ones with dark heat."""
        return 'black_hot' if (self.kind, self.palette) == ('thermal', 'black_hot') else self.kind

    @cached_property
    def optical_to_body(self) -> NDArray:
        """Rotation matrix (3, 3) from the optical frame to the frame that carries the camera."""
        return self.mount.rotation @ FLU_TO_OPTICAL.T


@dataclass(frozen=True)
class GimbalMount:
    """A gimbal that carries the camera: it pans first, then tilts.

    Parameters:
        frame: name of the gimbal's frame (x along the line of sight), which moves on the body.
        mount: where that frame is on the body with pan and tilt 0.
        stabilized: whether the gimbal stays level as the body rolls and pitches. Pan and tilt are then angles in
            `base_stabilized`, else in the body's frame.
        pan_limits_deg, tilt_limits_deg (degrees): least and greatest pan, counter-clockwise, and tilt, up.
        max_rate_deg (degrees/s): highest rate of each axis.
        lag (s): time constant with which the gimbal follows its commands.

    Raises ValueError for limits that exclude 0.
    """

    frame: str = 'gimbal_link'
    mount: Mount = field(default_factory=Mount)
    stabilized: bool = True
    pan_limits_deg: tuple[float, float] = (-180.0, 180.0)
    tilt_limits_deg: tuple[float, float] = (-45.0, 90.0)
    max_rate_deg: float = bounded(120.0, low=1.0, high=1000.0)
    lag: float = bounded(0.05, low=0.0, high=5.0)

    def __post_init__(self) -> None:
        for name, most in (('pan_limits_deg', 720.0), ('tilt_limits_deg', 180.0)):
            low, high = getattr(self, name)
            if not -most <= low <= 0.0 <= high <= most:
                raise ValueError(f'{name} is [{low:g}, {high:g}], expected limits around 0 within {most:g} degrees')


# What a gimbal can do whose rig's description has none.
UNDESCRIBED_GIMBAL = GimbalMount(stabilized=False, pan_limits_deg=(-150.0, 150.0), tilt_limits_deg=(-80.0, 45.0))


@dataclass(frozen=True)
class Rig:
    """The sensors that are carried by one body.

    Parameters:
        array: the microphones.
        camera: the camera.
        second_camera: another one, such as a thermal one beside a visible one; None without one.
        gimbal: the gimbal that carries the cameras; None where they are fixed to the body.

    Raises ValueError for two frames of one name, or a name that tf2 refuses.
    """

    array: ArrayMount
    camera: CameraMount = field(default_factory=CameraMount)
    second_camera: CameraMount | None = None
    gimbal: GimbalMount | None = None

    def __post_init__(self) -> None:
        named = {'array.frame': self.array.frame, **({'gimbal.frame': self.gimbal.frame} if self.gimbal else {}),
                 **{f'{name}.{key}': getattr(camera, key) for name, camera in self.cameras.items()
                    for key in ('frame', 'optical_frame')}}
        taken = dict.fromkeys((BASE_FRAME, ODOM_FRAME, MAP_FRAME), 'the name of a frame of REP-105')
        for key, frame in named.items():
            if not frame or frame.startswith('/') or len(frame.split()) != 1:
                raise ValueError(f'{key} is {frame!r}, expected a name without blanks that does not begin with a slash')
            if frame in taken:
                raise ValueError(f'{key} is {frame!r}, which is {taken[frame]}, expected names that differ')
            taken[frame] = f'{key}, too'

    @property
    def cameras(self) -> dict[str, CameraMount]:
        """The cameras by their names among CAMERAS; `camera_topic` gives their topics."""
        found = zip(CAMERAS, (self.camera, self.second_camera), strict=True)
        return {name: camera for name, camera in found if camera is not None}

    @property
    def optical_frames(self) -> dict[str, str]:
        """Optical frames of the cameras by their frames, in which nothing of an image may be (REP-103)."""
        return {camera.frame: camera.optical_frame for camera in self.cameras.values()}


def camera_topic(camera: str, topic: str) -> str:
    """The topic of one of `Rig.cameras`, as second_camera/image_raw and second_camera/detections.

    Parameters:
        camera: its name.
        topic: what it is called for the first camera, as camera/image_raw and detections.
    """
    return topic if camera == CAMERAS[0] else f'{camera}/{topic.removeprefix("camera/")}'


def camera_topics(cameras: Iterable[str], *topics: str) -> tuple[str, ...]:
    """The topics of several cameras, see `camera_topic`.

    Parameters:
        cameras: their names.
        topics: what they are called for the first camera.
    """
    return tuple([camera_topic(camera, topic) for camera in cameras for topic in topics])


def load_rig(path: str | Path) -> Rig:
    """Read the description of a rig. Raises ConfigError with file, key and value, or OSError."""
    return load(Rig, path)
