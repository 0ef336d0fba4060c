"""From the sender's time to ROS time.

A datagram can be late but never early. The smallest difference between arrival and stamp is therefore the offset
between both clocks plus the least delay, and it may only rise as fast as the clocks can drift apart.
"""

from dataclasses import dataclass


@dataclass
class SenderClock:
    """ROS time = stamp + the smallest arrival - stamp seen, which may rise by `drift` seconds a second.

    The clock begins anew when every stamp of `restart` seconds lags behind by more than that: the sender was started
    again or was paused. One object serves all streams that carry the same clock, so that their stamps agree whatever
    the delay of each.
    """

    drift: float = 100e-6
    restart: float = 0.5
    restarts: int = 0
    _offset: float | None = None
    _updated: float = 0.0
    _in_time: float = 0.0    # when a stamp last did not lag behind

    @property
    def known(self) -> bool:
        """Whether anything has been observed yet."""
        return self._offset is not None

    def observe(self, stamp: float, arrival: float) -> None:
        """Take one arrival (ROS time, s) of a datagram stamped by the sender (s)."""
        offset = arrival - stamp
        lagging = self._offset is not None and offset > self._offset + self.restart
        if self._offset is None:
            self._offset = offset
        elif lagging and arrival - self._in_time > self.restart:
            self._offset = offset
            self.restarts += 1
            lagging = False
        else:
            self._offset = min(self._offset + self.drift * max(arrival - self._updated, 0.0), offset)
        if not lagging:
            self._in_time = arrival
        self._updated = max(self._updated, arrival)

    def to_ros(self, stamp: float) -> float:
        """ROS time in s of a sender's stamp. Raises RuntimeError before the first observation."""
        if self._offset is None:
            raise RuntimeError('the sender has not been heard yet')
        return stamp + self._offset


class SampleClock:
    """ROS time of a sample number, from the arrival of blocks of a stream without stamps."""

    def __init__(self, sample_rate: int, drift: float = 100e-6):
        self._rate = sample_rate
        self._clock = SenderClock(drift)

    def observe(self, end_sample: int, arrival: float) -> None:
        """Take the arrival (ROS time, s) of a block whose last sample is number end_sample - 1."""
        self._clock.observe(end_sample / self._rate, arrival)

    def to_ros(self, sample: int) -> float:
        """ROS time in s at which a sample was taken."""
        return self._clock.to_ros(sample / self._rate)
