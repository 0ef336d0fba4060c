"""The detection stage, from images to detections and visibility, for detector_node, replay and experiments."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from transforms3d.quaternions import quat2mat
from vision_msgs.msg import Detection2DArray

from av_common.angles import angles_to_direction
from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, attitude_of, checked_orientation
from av_common.quaternions import Quaternion, between
from av_common.stamps import to_seconds
from av_common.timeline import Timeline
from av_common.track import DRONE
from av_interfaces.msg import Bearing, Visibility
from av_vision import visibility as visibilities
from av_vision.camera_pose import CameraPose, angle_between, pixel_of
from av_vision.detections import Detections
from av_vision.image import MOST_PIXELS, AutomaticGain
from av_vision.messages import detections_message, header_of, image_from_message
from av_vision.methods import DETECTORS, ForeignDetector, is_model_file
from av_vision.models import shipped_model
from av_vision.search import BearingCue, RegionPlanner
from av_vision.temporal_detector import TemporalDetector
from av_vision.yolo.detector import Detector
from av_vision.yolo.model import DetectorSettings

BEARING_AGE_S = 2.0  # since its newest measurement, up to which a bearing tells where to look
REGIONS = 2          # of an image, where the processor's speed does not decide
RotationOf = Callable[[str, float], NDArray[np.float64] | None]
PERIOD_S = 0.5  # between estimates: what is published of them changes slowly
# Of drones in clear view, those that are found within 2 s: in 90 pieces of clips that the detector was not trained on 85 (new
# places) and 92 % (known ones). More images of the same drone do not help.
FOUND = 0.9
TURNED = math.radians(3.0)  # of a camera, after which no image is as before; attitudes have smaller errors
LATEST_S = 0.2    # how far an image may be from the newest attitude, and from a depth image of the same scene
KEEP_S = 4.0      # how long attitudes are kept
OVERTAKEN_S = 1.0  # age against the newest, up to which an image or an attitude is a late one; an older one begins anew
FROZEN_S = 5.0    # video streams repeat a still scene until their next whole picture, some seconds later


class DetectionStage:
    """Detects objects in every image and estimates visibility in some of them.

    Attributes:
        shown (h, w[, channels]): the newest image, in 8 bits; None before the first.
        detected: its detections and their tracks.
        unchanged (s): for how long all images have been the same to the bit: noise alone makes a camera's images differ.

    Distances for visibility come from depth images, or from the camera's height over flat ground; without either only the share
    of contrast that is left in the image is known.

    Parameters:
        detector: the detector and its state over images.
        kind: of the camera: visible, thermal, or black_hot, whose images are inverted first, as detectors know heat bright.
        target_distance (m): distance for which the share of contrast is reported.
        camera_height (m): height over flat ground; 0 when unknown.
    """

    def __init__(self, detector: TemporalDetector, kind: str = 'visible', target_distance: float = 10.0,
                 camera_height: float = 0.0) -> None:
        self.detector, self._kind = detector, kind
        self._target_distance, self._camera_height = target_distance, camera_height
        self.shown: NDArray[np.uint8] | None = None
        self.detected: tuple[Detections, list[int]] = Detections(), []
        self.unchanged = 0.0
        # When the newest image was new, the image, and where the camera looked then.
        self._last: tuple[float, NDArray, CameraPose | None] = 0.0, np.empty(0), None
        self._newest = self._next_estimate = -math.inf  # capture time of the newest image, and of the next estimate
        self._depth: tuple[float, NDArray] | None = None  # time in s, image
        self._gain = AutomaticGain(kind != 'visible')
        self.mount(lambda frame, time: None)
        self._attitudes: Timeline[Quaternion] = Timeline(KEEP_S)  # from the body to the world
        self._bearing = (-math.inf, Bearing())  # when it was measured

    def on_image(self, message: Image | CompressedImage, arrival: float) -> tuple[Detection2DArray | None, Visibility | None]:
        """The detections in an image, and the visibility when an estimate is due; both carry the image's header.

        An image in which nothing was detected gives an empty message only where all of the view has been searched within the
        last seconds, and every reported track was looked for in this image: then the absence of detections says something.
        Otherwise it gives None. So does an image that has been the same for more than FROZEN_S, and one that a newer one has
        overtaken: to go back in time would end all tracks.

        Parameters:
            message: raw or compressed image; its stamp is the time of capture.
            arrival (s): time of arrival on the node's clock. Not used: results depend on the time of capture.

        Raises ValueError for an image that cannot be decoded or is too large, or is none of the camera, or is that of before
        although the camera has turned: nothing that it shows, or does not show, is so now.
        """
        time, header = to_seconds(message.header.stamp), header_of(message)
        if 0.0 < self._newest - time < OVERTAKEN_S:
            return None, None
        self._newest = time
        counts = image_from_message(message, self._most_pixels)
        camera = self._camera_of(counts.shape[1], counts.shape[0])
        pose = self._pose(header.frame_id, time, camera)
        self._compare(counts, time, pose)
        if self.unchanged > FROZEN_S:
            return None, None
        image = self.shown = self._gain.apply(counts, time)
        image = 255 - image if self._kind == 'black_hot' else image
        detections, tracks = self.detected = self.detector.detect(image, time, pose, self._bearing_cue(pose, time))
        complete = len(detections) or self.detector.searched(time)
        return (detections_message(header, detections, tracks) if complete else None,
                self._visibility(header, image, time, camera, pose))

    def on_odometry(self, message: Odometry) -> None:
        """Use the rig's attitude, so that its rotation breaks no track. Raises ValueError for an impossible one."""
        time = to_seconds(message.header.stamp)
        attitude = checked_orientation(attitude_of(message.pose.pose.orientation), 'attitude')
        if time < self._attitudes.newest - OVERTAKEN_S:
            self._attitudes.clear()
        if time >= self._attitudes.newest:
            self._attitudes.add(time, attitude)

    def mount(self, rotation_of: RotationOf, camera: PinholeCamera | None = None) -> None:
        """How the camera is mounted, and which it is where no CameraInfo tells; images may be of another size then.

        Parameters:
            rotation_of: rotation (3, 3) to the rig's body from the frame of a name at a time (s), None where it is not known;
                may raise ValueError.
            camera: intrinsics; None until `on_camera_info`.
        """
        self._rotation_of, self._camera, self._told = rotation_of, camera, False

    def on_bearing(self, message: Bearing) -> None:
        """Look for the target where the fusion has it. Raises ValueError for a bearing that is none."""
        values = (message.azimuth, message.elevation, message.azimuth_world, message.elevation_world)
        known = all(math.isfinite(value) for value in values) and message.azimuth_variance >= 0.0
        if not (known or message.state == Bearing.STATE_NONE):
            raise ValueError('a bearing without direction, or of negative variance')
        self._bearing = (to_seconds(message.measured), message)

    def _compare(self, image: NDArray, time: float, pose: CameraPose | None) -> None:
        since, last, before = self._last
        if not np.array_equal(image, last):
            since, before = time, pose
        self._last = since, image, before or pose
        self.unchanged = time - since
        angle = 0.0 if before is None or pose is None else angle_between(before, pose)
        if angle > TURNED:
            raise ValueError(f'the camera is frozen or covered: its image is the same to the bit after it turned by '
                             f'{math.degrees(angle):.0f} deg')

    @property
    def _most_pixels(self) -> int:
        """Pixels from which an image is not decoded: twice those of its camera, where a CameraInfo told them."""
        return 2 * self._camera.width * self._camera.height if self._told and self._camera else MOST_PIXELS

    def _camera_of(self, width: int, height: int) -> PinholeCamera | None:
        """The camera of images of this size. Raises ValueError for another than that of a CameraInfo: bearings rest on it."""
        camera = self._camera
        if camera is not None and self._told and (camera.width, camera.height) != (width, height):
            raise ValueError(f'images are {width} x {height} pixels, and by camera/camera_info, its binning and its region of '
                             f'interest {camera.width} x {camera.height}')
        return None if camera is None else camera.scaled(width, height)

    def _pose(self, frame: str, time: float, camera: PinholeCamera | None) -> CameraPose | None:
        to_body = None
        with suppress(ValueError):  # not yet known
            to_body = self._rotation_of(frame, time)
        if camera is None or to_body is None:
            return None
        if not self._attitudes.oldest - LATEST_S <= time <= self._attitudes.newest + LATEST_S:
            return CameraPose(camera, to_body)
        return CameraPose(camera, to_body, quat2mat(between(*self._attitudes.around(time))) @ to_body)

    def _bearing_cue(self, pose: CameraPose | None, time: float) -> BearingCue | None:
        """Where the bearing is in the image, None where it is outside or old; that in the world does not turn with the rig."""
        measured, message = self._bearing
        if pose is None or message.state == Bearing.STATE_NONE or not abs(time - measured) <= BEARING_AGE_S:
            return None
        in_world = pose.to_world is not None and message.attitude_known
        azimuth, elevation = ((message.azimuth_world, message.elevation_world) if in_world else
                              (message.azimuth, message.elevation))
        known = 0.0 <= message.elevation_variance < math.inf
        rotation = pose.to_world if pose.to_world is not None and in_world else pose.to_body
        pixel = pixel_of(angles_to_direction(azimuth, elevation if known else 0.0), rotation, pose.camera)
        sigma = np.sqrt([message.azimuth_variance, message.elevation_variance if known else math.inf])
        return None if pixel is None else BearingCue(pixel, sigma * (pose.camera.fx, pose.camera.fy))

    def _visibility(self, header: Header, image: NDArray, time: float, camera: PinholeCamera | None,
                    pose: CameraPose | None) -> Visibility | None:
        """The visibility in an image, None when no estimate is due; how far light reaches says nothing about heat."""
        if self._kind != 'visible' or self._next_estimate - PERIOD_S <= time < self._next_estimate:
            return None
        self._next_estimate = time + PERIOD_S
        left = visibilities.estimate(image, self._distance(image, time, camera, pose), self._target_distance)
        return Visibility(header=header, visibility=FOUND * left.share * left.sharp, range=left.range,
                          unsearched=1.0 - self.detector.planner.share)

    def _distance(self, image: NDArray, time: float, camera: PinholeCamera | None, pose: CameraPose | None) -> NDArray | None:
        """Distance (h, w; m) of what an image shows, None where nothing tells; without a pose the camera looks level."""
        if self._depth is not None and abs(self._depth[0] - time) <= LATEST_S:    # an older one is of another scene
            depth = self._depth[1]
            return depth if depth.shape == image.shape[:2] else None
        if camera is None or not self._camera_height > 0.0:
            return None
        level = FLU_TO_OPTICAL.T if pose is None else pose.to_body if pose.to_world is None else pose.to_world
        return visibilities.ground_distances(camera, self._camera_height, level)

    def on_depth(self, message: Image) -> None:
        """Use a depth image (16UC1 in mm or 32FC1 in m) that is aligned to the colour image as scale for visibility.

        Raises ValueError for an image that cannot be read, or of another type.
        """
        depth = image_from_message(message, self._most_pixels)
        if depth.ndim != 2 or depth.dtype == np.uint8:
            raise ValueError(f'encoding {message.encoding!r} of a depth image, expected 16UC1 (mm) or 32FC1 (m)')
        metres = depth.astype(np.float32) * np.float32(1e-3 if depth.dtype == np.uint16 else 1.0)
        self._depth = to_seconds(message.header.stamp), metres

    def on_camera_info(self, message: CameraInfo) -> None:
        """Use the intrinsics, also for visibility over flat ground. Raises ValueError for impossible ones."""
        self._camera, self._told = PinholeCamera.from_camera_info(message), True

    def reset(self) -> None:
        """Discard tracks and earlier images."""
        self.detector.reset()
        self.unchanged, self._last = 0.0, (0.0, np.empty(0), None)
        self._newest = self._next_estimate = -math.inf
        self._depth = None


def make_detection_stage(parameters: Any) -> DetectionStage:
    """A stage with the settings of detector_node. Raises ModelError or ValueError.

    Parameters:
        parameters: generated struct of detector_node, from the node or from `av_common.parameters.node_parameters`.
    """
    p = parameters
    detector = make_detector(p)
    near = detector.model.near
    planner = RegionPlanner(detector.model.longest, near, p.regions or REGIONS, 0.0 if p.regions else p.look_time
                            ) if near and p.search == 'adaptive' else None
    temporal = TemporalDetector(detector, temporal_fusion=p.temporal_fusion, planner=planner)
    return DetectionStage(temporal, p.camera_kind, p.visibility_distance, p.camera_height)


def make_detector(parameters: Any, keep: tuple[str, ...] = (DRONE,)) -> Detector:
    """The detector of one image from the parameters of detector_node: the shipped one, of a file, or of another package.

    Parameters:
        parameters: those of detector_node; empty names in lists are ignored, and spaces around names.
        keep: classes to report, after `keep_classes` were renamed to drone; empty for all.

    Raises ModelError or ValueError.
    """
    p, name = parameters, parameters.model or 'shipped'
    drones, names = ([text.strip() for text in given if text.strip()] for given in (p.keep_classes, p.class_names))
    settings = DetectorSettings(p.score_threshold, keep, dict.fromkeys(drones, DRONE), tuple(names), p.input_size,
                                tuple(p.providers), p.threads)
    if is_model_file(name):
        return Detector(name, settings)
    if name == 'shipped':
        return Detector(shipped_model(p.camera_kind), settings)
    return ForeignDetector(DETECTORS.load(name)(p), settings, DRONE)
