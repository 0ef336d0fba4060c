"""Log of a run: truth, measurements and estimates as columns of numbers."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from av_bags.retrying_file import RetryingFile, unnamed_file
from av_bags.topics import TRUE_TARGET
from av_common.frames import attitude_of, is_orientation
from av_common.stamps import to_seconds
from av_common.track import State, Track
from av_evaluation.metrics.tracks import TrackFigures
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_doas
from av_fusion.measurement.rig_motion import Pose

ROWS_IN_MEMORY = 1000   # of a log with a folder
LARGEST_OFFSET_S = 60.0    # of a stamp from its arrival: the figures take memory by the log's span of time

Event = Pose | list[DoaMeasurement] | CameraMeasurement | float


class Series:
    """A table of numbers that grows by rows and is read by columns; 8 bytes for each number.

    Parameters:
        names: of the columns.
        folder: for a file without a name that holds all but the newest rows; None, or one that cannot be written, to keep all
            in memory.
    """

    def __init__(self, *names: str, folder: Path | None = None) -> None:
        self._names = names
        self._flat = array('d')     # the newest rows
        self._file: RetryingFile | None = None
        if folder is not None:
            with suppress(OSError):
                self._file = unnamed_file(folder)

    def add(self, *values: float) -> None:
        """Append one row, a value for each column. Raises ValueError for another number of values."""
        if len(values) != len(self._names):
            raise ValueError(f'{len(values)} values, expected {self._names}')
        self._flat.extend(values)
        if self._file is not None and len(self._flat) >= 2 * ROWS_IN_MEMORY * len(self._names):
            self._move(self._file)

    def newest(self) -> Series:
        """A series of the rows in memory, which are the newest ROWS_IN_MEMORY at least, or all without a folder."""
        found = Series(*self._names)
        found._flat = self._flat
        return found

    def __len__(self) -> int:
        stored = self._file.tell() // self._flat.itemsize if self._file is not None else 0
        return (stored + len(self._flat)) // len(self._names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """One column (n,)."""
        return self._table()[:, self._names.index(name)]

    def save(self, path: Path) -> None:
        """Write the rows as CSV with a header; times to the microsecond."""
        formats = ['%.6f' if name == 'time' else '%.9g' for name in self._names]
        np.savetxt(path, self._table(), formats, delimiter=',', header=','.join(self._names), comments='')

    def _table(self) -> NDArray[np.float64]:
        stored = self._file.content() if self._file is not None else b''
        return np.concatenate([np.frombuffer(stored), np.array(self._flat)]).reshape(-1, len(self._names))

    def _move(self, file: RetryingFile) -> None:
        """Move all but the newest rows to the file. While the disk refuses them, they stay in memory."""
        newest = -ROWS_IN_MEMORY * len(self._names)
        file.write(self._flat[:newest].tobytes())
        del self._flat[:newest]
        with suppress(OSError):
            file.commit()


class RunLog:
    """Truth, measurements and estimated bearing of a run. Times in s, positions in m, azimuths in rad in the body frame.

    It is written by hand, or as the observer of a `FusionStage`; what is stamped by another clock then raises ValueError. A
    delay is the time from capture to arrival, for sound from the centre of its window. That of a bearing is from the capture
    of its newest measurement. Delays are in the time of the arrivals: computing takes none.

    Attributes:
        target: true positions of the target in the world.
        rig: true positions of the rig in the world, and attitudes (w, x, y, z) from its body to the world.
        sound: azimuths of the first and second hypothesis of each window; `mirrored` is nan without a second one.
        sight: azimuth of the best detection of each image, nan with score 0 where there is none.
        fused: estimated bearings with standard deviation, `State`, and whether front and back are resolved.
        notes: on the origin of the data, by topic.
        tracks: how well all targets are tracked, of simulated runs with several; None for others.
        doa: most confident direction of arrival of each window by other estimators, in runs that are kept for them.
        events: poses, windows of sound, camera measurements, and times (s) at which the track was asked for, of such runs.
        left_out (s): time between segments of a bag, which is left out of the times of what is observed.

    Parameters:
        folder: for temporary files, so that the log's memory does not grow with the run; None to keep all in memory.
        keeps_events: whether `events` gets what the tracker is given, for other trackers.
    """

    def __init__(self, folder: Path | None = None, keeps_events: bool = False) -> None:
        self.target = Series('time', 'x', 'y', 'z', folder=folder)
        self.rig = Series('time', 'x', 'y', 'z', 'qw', 'qx', 'qy', 'qz', folder=folder)
        self.sound = Series('time', 'azimuth', 'mirrored', 'confidence', 'delay', folder=folder)
        self.sight = Series('time', 'azimuth', 'score', 'delay', folder=folder)
        self.fused = Series('time', 'azimuth', 'sigma', 'state', 'resolved', 'delay', folder=folder)
        self.notes: dict[str, str] = {}
        self.tracks: TrackFigures | None = None
        self.doa: dict[str, list[DoaMeasurement]] = {}
        self.events: list[Event] = []
        self.left_out = 0.0
        self._keeps_events = keeps_events

    def on_pose(self, pose: Pose) -> None:
        """Keep a pose."""
        self._keep(pose._replace(time=pose.time - self.left_out))

    def on_doa(self, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """Log the most confident measurement of a window."""
        logged = [doa._replace(time=self._time(doa.time, arrival)) for doa in measurements]
        self._keep(usable_doas(logged))
        for doa in logged[:1]:
            azimuths = [hypothesis.azimuth for hypothesis in doa.hypotheses]
            self.sound.add(doa.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan, doa.confidence,
                           arrival - self.left_out - doa.time)

    def on_other(self, method: str, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """Log the most confident measurement of a window by another method."""
        self.doa.setdefault(method, []).extend(
            doa._replace(time=self._time(doa.time, arrival)) for doa in measurements[:1])

    def on_camera(self, measurement: CameraMeasurement, message: Any, arrival: float) -> None:
        """Log the best detection. Detections whose names begin with 'oracle' are the simulator's."""
        measurement = measurement._replace(time=self._time(measurement.time, arrival))
        self._keep(measurement)
        best = measurement.best
        self.sight.add(measurement.time, best.azimuth if best else math.nan, best.score if best else 0.0,
                       arrival - self.left_out - measurement.time)
        if any(detection.id.startswith('oracle') for detection in message.detections):
            self.notes['detections'] = "the simulator's visual oracle (no detector ran)"

    def on_track(self, track: Track, time: float) -> None:
        """Log the track at `time` (s)."""
        self._keep(time - self.left_out)
        known = track.state != State.NONE
        self.fused.add(self._time(track.time, time), track.azimuth, math.sqrt(track.azimuth_variance), track.state,
                       track.resolved, time - track.measured if known else math.nan)

    def on_truth(self, name: str, odometry: Any, arrival: float) -> None:
        """Log a true pose.

        Parameters:
            name: of its topic: TRUE_TARGET or TRUE_RIG of `av_bags.topics`.
            odometry: the message.
            arrival (s): its time.

        Raises ValueError for a pose that is none, too.
        """
        time, position = self._time(to_seconds(odometry.header.stamp), arrival), odometry.pose.pose.position
        place, attitude = (position.x, position.y, position.z), attitude_of(odometry.pose.pose.orientation)
        if not all(map(math.isfinite, place)):
            raise ValueError(f'the position is {place}, expected finite numbers')
        if name == TRUE_TARGET:
            self.target.add(time, *place)
        elif is_orientation(attitude):
            self.rig.add(time, *place, *attitude)
        else:
            raise ValueError(f'the orientation (w, x, y, z) is {attitude}, expected a unit quaternion')

    def _time(self, stamp: float, arrival: float) -> float:
        """Time (s) in the log of what is stamped `stamp` (s)."""
        if not abs(stamp - arrival) <= LARGEST_OFFSET_S:
            raise ValueError(f'stamp is more than {LARGEST_OFFSET_S:g} s off the clock')
        return stamp - self.left_out

    def _keep(self, event: Event) -> None:
        if self._keeps_events:
            self.events.append(event)

    def newest(self) -> RunLog:
        """A log of the rows in memory, which takes the same time however long the run is."""
        log = RunLog()
        for name, series in vars(self).items():
            if isinstance(series, Series):
                setattr(log, name, series.newest())
        return log

    def save(self, folder: Path) -> None:
        """Write each series as `<name>.csv` into a folder, which is made where it does not exist."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, series in vars(self).items():
            if isinstance(series, Series):
                series.save(folder / f'{name}.csv')

    @property
    def has_truth(self) -> bool:
        """Whether errors can be computed."""
        return len(self.target) > 1 and len(self.rig) > 1

    def true_azimuth(self, time: ArrayLike) -> NDArray[np.float64]:
        """True azimuth (n, rad) of the target in the body's tilting frame at times (n, s), nan outside of the truth's span."""
        time = np.asarray(time, float)
        if not self.has_truth:
            return np.full(time.shape, math.nan)
        outside = {'left': math.nan, 'right': math.nan}
        away = np.stack([np.interp(time, self.target['time'], self.target[axis], **outside)
                         - np.interp(time, self.rig['time'], self.rig[axis], **outside) for axis in 'xyz'], axis=-1)
        forward, left = np.einsum('...i,...ij->j...', away, self._rotations(time))[:2]
        return np.arctan2(left, forward)

    def heading(self, time: ArrayLike) -> NDArray[np.float64]:
        """True yaw (n, rad) of the rig at times (n, s), 0 without truth."""
        time = np.asarray(time, float)
        if not len(self.rig):
            return np.zeros(time.shape)
        forward = self._rotations(time)[..., 0]
        return np.arctan2(forward[..., 1], forward[..., 0])

    def _rotations(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """True rotations (n, 3, 3) from the body to the world at times (n, s); outside of their span those of its ends."""
        times, first = np.unique(self.rig['time'], return_index=True)
        attitudes = Rotation.from_quat(np.stack([self.rig[name] for name in ('qx', 'qy', 'qz', 'qw')], axis=1)[first])
        if len(times) == 1:
            return np.broadcast_to(attitudes.as_matrix()[0], (*time.shape, 3, 3))
        within = Slerp(times, attitudes)(np.clip(time, times[0], times[-1]).ravel())
        return within.as_matrix().reshape(*time.shape, 3, 3)
