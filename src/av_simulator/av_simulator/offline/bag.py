"""Recording of a simulation to a bag with the rig's topics."""

from __future__ import annotations

from pathlib import Path

from rclpy.serialization import serialize_message
from tf2_msgs.msg import TFMessage

from av_audio.messages import audio_frame
from av_bags.topics import FRAMES, GIMBAL, KINDS, absolute
from av_bags.writer import DEFAULT_QOS, LATCHED, BagWriter
from av_common.frames import BASE_FRAME
from av_common.rig_messages import gimbal_message, static_transforms
from av_common.stamps import to_stamp
from av_sim_bridge import messages
from av_simulator.run import Step
from av_simulator.world import World
from av_vision.messages import camera_info_message, image_message

EPOCH = 1_700_000_000.0    # s, stamp of the scenario's start; it is constant, so that the same run gives the same bag
WORLD_FRAME = 'map'
_TOPICS = ('audio/frames', 'camera/image_raw', 'camera/camera_info', 'detections', 'odometry', 'truth/rig', 'truth/target',
           FRAMES)


class BagRecorder:
    """Writes the steps of a world to a rosbag2 (mcap).

    Parameters:
        folder: folder of the bag; must not exist.
        world: the simulated world, for the rig's description and the sample rate.
    """

    def __init__(self, folder: Path, world: World):
        self._rig, self._rate = world.rig, world.sample_rate
        self._writer = BagWriter(folder)
        for topic in (*_TOPICS, *((GIMBAL,) if world.rig.gimbal else ())):
            self._writer.add_topic(absolute(topic), KINDS[topic][0], LATCHED if topic == FRAMES else DEFAULT_QOS)
        self._write('tf_static', EPOCH, TFMessage(transforms=static_transforms(self._rig, to_stamp(EPOCH))))

    def write(self, step: Step) -> None:
        """Append one step."""
        header = messages.make_header(EPOCH + step.begin, self._rig.array.frame)
        self._write('audio/frames', EPOCH + step.end,
                    audio_frame(step.sound, round(step.begin * self._rate), self._rate, header))
        for sample in step.truth:
            header = messages.make_header(EPOCH + sample.time, WORLD_FRAME)
            rig = messages.odometry_message(header, BASE_FRAME, sample.rig)
            self._write('odometry', EPOCH + sample.time, rig)
            self._write('truth/rig', EPOCH + sample.time, rig)
            if self._rig.gimbal is not None and (measured := sample.gimbal) is not None:
                time = EPOCH + sample.time
                self._write('gimbal/state', time, gimbal_message(self._rig.gimbal.frame, time, measured.orientation_wxyz,
                                                                 measured.variance, measured=True))
            self._write('truth/target', EPOCH + sample.time,
                        messages.odometry_message(header, 'target', sample.targets[0]))
        for view, image in step.images:
            header = messages.make_header(EPOCH + view.time, self._rig.camera.optical_frame)
            self._write('camera/image_raw', EPOCH + view.time, image_message(header, image.bgr))
            self._write('camera/camera_info', EPOCH + view.time,
                        camera_info_message(header, self._rig.camera.model))
            self._write('detections', EPOCH + view.time, messages.oracle_detections_message(header, image.boxes))

    def close(self) -> None:
        """Finish the bag."""
        self._writer.close()

    def _write(self, topic: str, time: float, message: object) -> None:
        self._writer.write(absolute(topic), round(time * 1e9), serialize_message(message))
