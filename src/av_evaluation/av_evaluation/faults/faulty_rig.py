"""A rig whose description is wrong, on drawn measurements: they do not fit what the stage is told of the sensors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from std_msgs.msg import Header

from av_common.angles import wrap
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.experiments.measurement_simulation import LEFT, MeasurementSimulation, Scan
from av_fusion.consistency.monitor import ConsistencyMonitor
from av_fusion.measurement.measurements import Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.settings import make_tracker
from av_fusion.stage import FusionOutput, FusionStage
from av_interfaces.msg import Bearing

SIGHT_SCANS, SOUND_SCANS = 1, 3  # from capture, or the centre of a window, to arrival, at ten scans a second


@dataclass
class Faults:
    """What is wrong. Defaults are a rig as described.

    Parameters:
        swapped: the microphones are exchanged.
        camera_yaw_deg: the camera is turned by this to the left of what is said.
        mirrored, upside_down: the image.
        rolled_deg: the camera is turned by this about its axis, clockwise as seen from behind it.
        late: s by which images are stamped after their capture.
        yaw_sign: -1 for odometry that turns the wrong way.
        delay: added to each cosine, by a channel that is late.
        spacing, focal: true over described distance of the microphones, and focal length.
        frozen: orientations in the odometry are the first one, while its rates go on.
        stuck: orientations in the odometry are the first one, and its rates 0.
    """

    swapped: bool = False
    camera_yaw_deg: float = 0.0
    mirrored: bool = False
    upside_down: bool = False
    rolled_deg: float = 0.0
    late: float = 0.0
    yaw_sign: int = 1
    delay: float = 0.0
    spacing: float = 1.0
    focal: float = 1.0
    frozen: bool = False
    stuck: bool = False


class FaultyRig:
    """A fusion stage fed with the measurements of a level rig, with its faults.

    Attributes:
        monitor: says what is wrong.

    Parameters:
        simulation: draws the measurements, ten scans a second.
        faults: what is wrong.
    """

    def __init__(self, simulation: MeasurementSimulation, faults: Faults) -> None:
        self._simulation, self._faults = simulation, faults
        tracker = make_tracker(node_parameters('av_fusion', 'fusion_node'))
        self.monitor = ConsistencyMonitor(tracker.motion)
        # In the place of messages and a `MeasurementConverter`: what is drawn is measured already.
        converter: Any = SimpleNamespace(doa=lambda message, *_: message.measured,
                                         detections=lambda message, *_: message.measured)
        self._stage = FusionStage(tracker, converter, consistency=self.monitor)
        self._bearings: list[Bearing] = []

    def steps(self) -> Iterator[float]:
        """Go through the scenario; gives the time (s) after each step."""
        scans = list(self._simulation.scans())
        seen = max(SIGHT_SCANS, math.ceil(10.0 * self._faults.late))
        for k, scan in enumerate(scans):
            self._stage.tracker.add_pose(self._pose(scan.time))
            if k >= seen:
                self._note(self._stage.on_detections(self._image(scans[k - seen]), scan.time))
            if k >= SOUND_SCANS:
                self._note(self._stage.on_doa(self._sound(scans[k - SOUND_SCANS]), scan.time))
            yield scan.time

    def lies(self, after: float, until: float, in_world: bool = False) -> float:
        """Share of a time (s) with bearings that are resolved, sure to 10 deg, and off by more than 10 deg and 3 sigma."""
        bearings = [bearing for bearing in self._bearings if after <= to_seconds(bearing.header.stamp) < until]
        wrong = 0
        for bearing in bearings:
            time = to_seconds(bearing.header.stamp)
            x, y, _ = self._simulation.truth(time)[0]
            azimuth, variance = ((bearing.azimuth_world - self._simulation.yaw(time), bearing.covariance_world[0]) if in_world
                                 else (bearing.azimuth, bearing.azimuth_variance))
            sure = bearing.state != Bearing.STATE_NONE and bearing.resolved and variance < math.radians(10.0) ** 2
            wrong += sure and abs(wrap(azimuth - math.atan2(y, x))) > max(math.radians(10.0), 3.0 * math.sqrt(variance))
        return wrong / max(len(bearings), 1)

    def _note(self, output: FusionOutput | None) -> None:
        if output is not None:
            self._bearings.append(output.bearing)

    def _pose(self, time: float) -> Pose:
        yaw, wrong = self._simulation.yaw, self._faults
        rate = 0.0 if wrong.stuck else wrong.yaw_sign * (yaw(time + 1e-3) - yaw(time)) / 1e-3
        return Pose.level(time, yaw(0.0) if wrong.frozen or wrong.stuck else wrong.yaw_sign * yaw(time), rate)

    def _sound(self, scan: Scan) -> Any:
        """The directions of a window, of a pair with the faults of its microphones."""
        wrong, measured = self._faults, list[DoaMeasurement]()
        for doa in scan.doas:
            if doa.cone is not None:
                cosine = (-1.0 if wrong.swapped else 1.0) * wrong.spacing * doa.cone.cosine + wrong.delay
                cone = Cone(LEFT, min(max(cosine, -1.0), 1.0), doa.cone.variance)
                doa = DoaMeasurement.of_cone(doa.time, cone, doa.confidence, doa.window)
            measured.append(doa)
        return SimpleNamespace(header=Header(stamp=to_stamp(scan.time)), measured=tuple(measured))

    def _image(self, scan: Scan) -> Any:
        """The detections of an image, with the faults of the camera, whose description is turned."""
        wrong, time = self._faults, scan.time + self._faults.late
        c, s = math.cos(math.radians(wrong.camera_yaw_deg)), math.sin(math.radians(wrong.camera_yaw_deg))
        image = scan.image._replace(time=time, detections=tuple(map(self._displaced, scan.image.detections)),
                                    view=((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
        return SimpleNamespace(header=Header(stamp=to_stamp(time)), measured=image)

    def _displaced(self, found: Detection) -> Detection:
        """Where a detection is by what is told of the camera; the image has the tangents of its angles."""
        wrong = self._faults
        y, z = math.tan(found.azimuth), math.tan(found.elevation) / math.cos(found.azimuth)  # to the left, and up
        roll = math.radians(wrong.rolled_deg + 180.0 * wrong.upside_down)
        y, z = math.cos(roll) * y + math.sin(roll) * z, math.cos(roll) * z - math.sin(roll) * y
        azimuth = math.atan((-wrong.focal if wrong.mirrored else wrong.focal) * y)
        return found._replace(azimuth=float(wrap(azimuth - math.radians(wrong.camera_yaw_deg))),
                              elevation=math.atan(wrong.focal * z * math.cos(azimuth)))
