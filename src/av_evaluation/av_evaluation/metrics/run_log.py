"""What happened in a run, as columns that metrics and pictures read."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.angles import wrap


class Series:
    """Rows of numbers in order of arrival, read as columns by name. Flat storage: hours of a run fit in memory."""

    def __init__(self, *names: str) -> None:
        self._names = names
        self._flat = array('d')

    def add(self, *values: float) -> None:
        """Append one row; raises ValueError when a value is missing."""
        if len(values) != len(self._names):
            raise ValueError(f'{len(values)} values, expected {self._names}')
        self._flat.extend(values)

    def extend(self, *columns: ArrayLike) -> None:
        """Append rows, given as columns (n,)."""
        self._flat.frombytes(np.column_stack(columns).astype(np.float64).tobytes())

    def __len__(self) -> int:
        return len(self._flat) // len(self._names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """One column (n,)."""
        return self._table()[:, self._names.index(name)]

    def save(self, path: Path) -> None:
        """Write the rows as CSV with a header."""
        formats = ['%.6f' if name == 'time' else '%.9g' for name in self._names]
        np.savetxt(path, self._table(), formats, delimiter=',', header=','.join(self._names), comments='')

    def _table(self) -> NDArray[np.float64]:
        return np.array(self._flat).reshape(-1, len(self._names))


class RunLog:
    """Truth, what each sense said, and the bearing. Times in s, azimuths in rad in the body frame.

    `delay` is from the capture of what a message rests on to its arrival here: for sound from its window's end, for the bearing
    from its newest measurement.
    """

    def __init__(self) -> None:
        self.target = Series('time', 'x', 'y', 'z')
        self.rig = Series('time', 'x', 'y', 'z', 'yaw')
        self.sound = Series('time', 'azimuth', 'mirrored', 'confidence', 'delay')  # mirrored is nan where there is none
        self.sight = Series('time', 'azimuth', 'confidence', 'delay')  # azimuth is nan where nothing was detected
        self.fused = Series('time', 'azimuth', 'sigma', 'state', 'resolved', 'delay')
        self.notes: dict[str, str] = {}

    def save(self, folder: Path) -> None:
        """Write each series as `<name>.csv` into a folder, one column a quantity, for whoever wants to look closer."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, series in vars(self).items():
            if isinstance(series, Series):
                series.save(folder / f'{name}.csv')

    @property
    def has_truth(self) -> bool:
        """Whether errors can be told."""
        return len(self.target) > 1 and len(self.rig) > 1

    def true_azimuth(self, time: ArrayLike) -> NDArray[np.float64]:
        """Azimuth of the target in the rig's frame at times (n,), nan outside of the truth's span."""
        time = np.asarray(time, float)
        if not self.has_truth:
            return np.full(time.shape, math.nan)
        moment = {'left': math.nan, 'right': math.nan}
        east, north = (np.interp(time, self.target['time'], self.target[axis], **moment)
                       - np.interp(time, self.rig['time'], self.rig[axis], **moment) for axis in 'xy')
        yaw = np.interp(time, self.rig['time'], np.unwrap(self.rig['yaw']), **moment)
        return wrap(np.arctan2(north, east) - yaw)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last thing that happened."""
        times = np.concatenate([series['time'] for series in (self.target, self.sound, self.sight, self.fused)])
        return float(np.ptp(times)) if times.size else 0.0
