"""From the sender's time to ROS time.

A datagram can be late but never early. The smallest difference between arrival and stamp is therefore the offset
between both clocks plus the least delay, and it may only rise as fast as the clocks can drift apart.
"""

from collections import deque
from dataclasses import dataclass, field


@dataclass
class SenderClock:
    """ROS time = stamp + the smallest arrival - stamp seen, which may rise by `drift` seconds a second.

    A stamp that is off by more than `restart` seconds is refused, until nothing else came for that long: then the
    sender was started again or was paused, and the clock begins anew. One object serves all streams that carry the same
    clock, so that their stamps agree whatever the delay of each.
    """

    drift: float = 100e-6
    restart: float = 0.5
    restarts: int = 0
    _offset: float | None = None
    _in_time: float = 0.0    # when a stamp was last accepted
    _lags: deque = field(default_factory=deque)    # arrival and lag over the last second

    @property
    def known(self) -> bool:
        """Whether anything has been observed yet."""
        return self._offset is not None

    def observe(self, stamp: float, arrival: float) -> bool:
        """Take one arrival (ROS time, s) of a datagram stamped by the sender (s); False where it is refused."""
        offset = arrival - stamp
        if self._offset is None:
            self._offset = offset
        elif abs(offset - self._offset) > self.restart:
            if arrival - self._in_time <= self.restart:
                return False
            self._offset = offset
            self.restarts += 1
        else:
            self._offset = min(self._offset + self.drift * max(arrival - self._in_time, 0.0), offset)
        self._in_time = max(self._in_time, arrival)
        self._lags.append((arrival, offset - self._offset))
        while self._lags[0][0] < arrival - 1.0:
            self._lags.popleft()
        return True

    @property
    def lateness(self) -> float:
        """Seconds by which even the quickest datagram of the last second was late: the sender does not keep up."""
        return min((lag for _, lag in tuple(self._lags)), default=0.0)

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
