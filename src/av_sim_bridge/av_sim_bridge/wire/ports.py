"""UDP ports of the streams: RFlySim's numbers, and their offset for a second rig."""

from dataclasses import dataclass

TIME_SYNC_GROUP = '224.0.0.10'
RIG, FIRST_TARGET = 1, 2    # numbers of the vehicles


@dataclass(frozen=True)
class Ports:
    """UDP ports of one rig and its target.

    RFlySim numbers vehicles from 1. The true state of vehicle n has port 30101 + 2(n - 1), its IMU 31000 + n - 1, the
    image of sensor s 9999 + s; sensor 1 is the depth of sensor 0, sensor 2 the rig's second camera. The ports of commands to
    the simulated rig, `control`, and of its gimbal's orientation, `gimbal`, are specific to this project.
    """

    audio: int = 28003
    image: int = 9999
    rig_truth: int = 30101
    target_truth: int = 30103
    imu: int = 31000
    time_sync: int = 20005
    control: int = 30100
    gimbal: int = 28005
    depth: int = 10000
    second_image: int = 10001

    def shifted(self, offset: int) -> 'Ports':
        """The ports plus `offset`, for another rig on the same machine."""
        return Ports(**{name: port + offset for name, port in vars(self).items()})
