"""Inputs with two sources: what of them continues the track, and that it proves nothing."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from av_common.track import Source, State, Target, Targets, Track
from av_fusion.filter.gating import Agreement
from av_fusion.measurement.input_gate import InputGate
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import IDENTITY, Rows, Vector, direction, turned_back
from av_fusion.tracker_protocol import Tracker

DOA, DETECTIONS, ODOMETRY = 'doa', 'detections', 'odometry'
SENSORS = {DOA: Source.SOUND, DETECTIONS: Source.SIGHT}
UNEXPECTED = 2  # measurements in a row that are not explained by a track show that it is false
KEPT = 2000  # measurements of an input of which a copy is recognised
KEPT_POSES = 200  # more than arrive until two sources are noticed and the tracker has returned to its former state
DIGITS = 9  # of a unit vector, beyond which turning it back from the body differs
REASON = 'an input has two sources: the track is continued, and counts as a prediction'


class Copies:
    """Recognises measurements that equal former ones: true ones have noise, and never repeat to the last digit."""

    def __init__(self) -> None:
        self._former: dict[tuple[Vector, ...], None] = {}  # in order of their newest occurrence; a set has no order

    def among(self, measured: Iterable[Sequence[Hypothesis | Detection]], sensor: Rows = IDENTITY) -> list[bool]:
        """Note the measurements of one message; returns which of them a former message had.

        Parameters:
            measured: the directions of each measurement, in the body frame.
            sensor: rotation of the sensor, in whose frame they are compared, on the body.
        """
        found = []
        for directions in measured:
            seen = [turned_back(sensor, direction(one.azimuth, one.elevation)) for one in directions]
            found.append(tuple([(round(x, DIGITS), round(y, DIGITS), round(z, DIGITS)) for x, y, z in seen]))
        copies = [one in self._former for one in found]
        for one in found:
            self._former.pop(one, None)
            self._former[one] = None
        while len(self._former) > KEPT:
            del self._former[next(iter(self._former))]
        return copies


class ContestedInputs:
    """Chooses the measurements that a tracker gets, and states which sensors support its tracks.

    Of an input with two sources those are used that lie in the gate of a track, agree with each other, and are no copies of
    former ones. A track that is continued in this way counts as a prediction. It ends where it does not explain what the one
    source that is left measures.

    Parameters:
        gate: knows which inputs have two sources.
    """

    def __init__(self, gate: InputGate) -> None:
        self._gate = gate
        self._agreements = {DOA: Agreement(), DETECTIONS: Agreement()}
        self._copies = {DOA: Copies(), DETECTIONS: Copies()}
        self._to_verify = 0  # measurements in a row that must contradict the continued tracks to end them
        self._poses: deque[Pose] = deque(maxlen=KEPT_POSES)

    def resume(self, tracker: Tracker) -> None:
        """Give a tracker that returned to a former state the poses since then that continue each other.

        Without them a false pose could be taken for the next one, as more motion is possible in a longer time.
        """
        for pose in self._poses:
            if tracker.motion.continues(pose):
                tracker.add_pose(pose)

    def use_pose(self, tracker: Tracker, pose: Pose, arrival: float) -> bool:
        """Whether a pose that arrived at `arrival` (s) can be given to the tracker."""
        usable = not self._is_contested(ODOMETRY, arrival) or tracker.motion.continues(pose)
        if usable:
            self._gate.use(ODOMETRY, pose.time, arrival)
            self._poses.append(pose)
        return usable

    def use_doas(self, tracker: Tracker, measurements: list[DoaMeasurement], stamp: float, arrival: float
                 ) -> list[DoaMeasurement] | None:
        """The directions of arrival of a window for the tracker; None for a window that tells nothing.

        Parameters:
            tracker: the tracker.
            measurements: of the window.
            stamp, arrival (s): times of its capture and arrival.
        """
        copied = self._copies[DOA].among(measurement.hypotheses for measurement in measurements)
        if self._is_contested(DOA, arrival):
            measurements = tracker.expected_doas([one for one, copy in zip(measurements, copied, strict=True) if not copy])
            directions = [hypothesis for measurement in measurements for hypothesis in measurement.hypotheses]
            if not directions or not self._agreements[DOA].add(stamp, directions):
                return None
            self._to_verify = UNEXPECTED
        elif self._to_verify and measurements:
            self._verify(tracker, bool(tracker.expected_doas(measurements)))
        self._gate.use(DOA, stamp, arrival)
        return measurements

    def use_image(self, tracker: Tracker, measurement: CameraMeasurement, arrival: float) -> CameraMeasurement | None:
        """The image for the tracker; None for one that tells nothing. See `use_doas`."""
        copied = self._copies[DETECTIONS].among(([one] for one in measurement.detections), measurement.view)
        if self._is_contested(DETECTIONS, arrival):
            expected = tracker.expected_image(measurement._replace(detections=tuple(
                [one for one, copy in zip(measurement.detections, copied, strict=True) if not copy])))
            if expected is None or not self._agreements[DETECTIONS].add(expected.time, expected.detections):
                return None
            measurement, self._to_verify = expected, UNEXPECTED
        elif self._to_verify and measurement.detections:
            self._verify(tracker, tracker.expected_image(measurement) is not None)
        self._gate.use(DETECTIONS, measurement.time, arrival)
        return measurement

    def supported(self, track: Track, targets: Targets, now: float) -> tuple[Track, Targets]:
        """Track and targets at `now` (s), supported only by sensors whose newest measurements were certainly theirs."""
        doubtful = Source.NOTHING
        for name, source in SENSORS.items():
            doubtful |= source if self._gate.is_doubtful(name, now) else Source.NOTHING
        if not doubtful:
            return track, targets
        heard, seen = self._gate.trusted(DOA), self._gate.trusted(DETECTIONS)
        return _without_support(track, doubtful, max(heard, seen)), targets._replace(
            targets=tuple([_target(target, doubtful, heard, seen) for target in targets.targets]))

    def _is_contested(self, name: str, now: float) -> bool:
        return self._gate.sources.is_contested(name, now)

    def _verify(self, tracker: Tracker, expected: bool) -> None:
        self._to_verify = 0 if expected else self._to_verify - 1
        if not expected and not self._to_verify:
            tracker.reset()


def _without_support(track: Track, doubtful: Source, trusted: float) -> Track:
    """The track without the sensors that are doubtful; `trusted` (s) is the newest stamp of what was measured before."""
    source, state, reason = track.source & ~doubtful, track.state, track.reason
    if ((state == State.VISUAL_ACTIVE and doubtful & Source.SIGHT)
            or (state == State.ACOUSTIC_ACTIVE and doubtful & Source.SOUND)):
        state = (State.VISUAL_ACTIVE if source & Source.SIGHT else State.ACOUSTIC_ACTIVE if source & Source.SOUND
                 else State.COASTING)
        reason = REASON
    return track._replace(state=state, reason=reason, source=source, measured=min(track.measured, max(trusted, 0.0)))


def _target(target: Target, doubtful: Source, heard: float, seen: float) -> Target:
    return target._replace(track=_without_support(target.track, doubtful, max(heard, seen)), heard=min(target.heard, heard),
                           seen=min(target.seen, seen))
