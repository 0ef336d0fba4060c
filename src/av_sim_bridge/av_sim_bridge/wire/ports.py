"""Where each stream goes: RFlySim's addresses, and how they move for a second rig."""

from dataclasses import dataclass

TIME_SYNC_GROUP = '224.0.0.10'


@dataclass(frozen=True)
class Ports:
    """UDP ports of one rig and its target.

    RFlySim numbers vehicles from 1: truth of vehicle n goes to 30101 + 2(n - 1), its IMU to 31000 + n - 1,
    the image of sensor s to 9999 + s. Commands to the simulated rig go to `control`, which is this project's own.
    """

    audio: int = 28003
    image: int = 9999
    rig_truth: int = 30101
    target_truth: int = 30103
    imu: int = 31000
    time_sync: int = 20005
    control: int = 30100

    @property
    def depth(self) -> int:
        """Where depth goes, as the image of the next sensor."""
        return self.image + 1

    def shifted(self, offset: int) -> 'Ports':
        """The same ports moved by `offset`, for another rig on the same machine."""
        return Ports(**{name: port + offset for name, port in vars(self).items()})
