"""Names what is wrong with the description of a rig: each of its cameras against its sound, and its heading."""

from __future__ import annotations

from collections.abc import Sequence

from av_common.rig import CAMERAS
from av_fusion.consistency.camera_monitor import GAP_S, Belief, CameraMonitor
from av_fusion.consistency.events import Fault
from av_fusion.consistency.heading import HeadingWatch
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion


class ConsistencyMonitor:
    """Compares sound with what each camera sees, and the heading with the rig's turns.

    What no measurement of the rig can show is a heading that is off by a constant, and its drift while one target moves. A
    heading that is frozen shows in commanded turns and in the odometry's own rates.

    Attributes:
        fault: what is known to be wrong, None without; it stays until the description fits again.
        belief: what is published.
        left_out: cameras that are certainly not as described, while another one confirms the sound: bearings do without them.

    Parameters:
        motion: attitude of the rig.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
        cameras: names of the cameras.
    """

    def __init__(self, motion: RigMotion, sound_delay: float = 0.0, sight_delay: float = 0.0,
                 cameras: Sequence[str] = CAMERAS[:1]) -> None:
        self._cameras = {camera: CameraMonitor(motion, camera, sound_delay, sight_delay) for camera in cameras}
        self._heading = HeadingWatch(motion)
        self.fault: Fault | None = None
        self.belief = Belief()
        self.left_out: frozenset[str] = frozenset()

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Take the directions of one window, those that may be a drone's."""
        for monitor in self._cameras.values():
            monitor.add_doas(measurements)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Take an image in which something is seen."""
        self._cameras[measurement.camera].add_camera(measurement)

    def add_command(self, time: float, yaw_rate: float) -> None:
        """Note that the body is told to turn by a rate (rad/s) from `time` (s) on."""
        self._heading.command(time, yaw_rate)

    def advance(self, now: float) -> Fault | None:
        """Use what is known at `now` (s); returns the fault that is known."""
        found = {camera: fault for camera, monitor in self._cameras.items() if (fault := monitor.advance(now)) is not None}
        certain = {camera: fault for camera, fault in found.items() if fault.is_certain}
        others = [monitor for camera, monitor in self._cameras.items() if camera not in certain]
        confirmed = any(monitor.is_confirmed for monitor in others)  # once is enough, while it has no certain fault itself
        self.left_out = frozenset(certain) if confirmed else self.left_out & certain.keys() if others else frozenset()
        self.fault, stops = self._heading.check(now), bool(certain.keys() - self.left_out)
        if certain or (found and self.fault is None):
            self.fault = _together(list((certain or found).values()), stops)
        monitors = [monitor for camera, monitor in self._cameras.items() if camera not in self.left_out]
        # A bearing rests on the cameras that see the target; while none does it is off by as much as when one did.
        seeing = [monitor.belief for monitor in monitors if now - monitor.seen <= GAP_S]
        believed = seeing or [monitor.belief for monitor in monitors]
        self.belief = believed[0] if len(believed) == 1 else Belief(*map(max, zip(*believed, strict=True)))
        if self._heading.in_world > 0.0:
            self.belief = self.belief._replace(in_world=self.belief.in_world + self._heading.in_world)
        return self.fault


def _together(faults: Sequence[Fault], stops: bool) -> Fault:
    """What several cameras tell, as one fault; `stops` where nothing should move by the bearing."""
    text, mend = ('; and '.join(dict.fromkeys(words)) for words in zip(*[(one.text, one.mend) for one in faults], strict=True))
    return Fault(text, mend, max(fault.probability for fault in faults), stops)
