"""Messages and bags for the tests, made by rosbags alone, independent of the code under test."""

from __future__ import annotations

import math
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from ament_index_python.packages import get_package_share_directory
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TYPES = get_typestore(Stores.ROS2_HUMBLE)
for _folder, _package in ((Path(__file__).parents[2] / 'av_interfaces' / 'msg', 'av_interfaces'),
                          (Path(get_package_share_directory('vision_msgs'), 'msg'), 'vision_msgs')):
    TYPES.register({name: fields for file in sorted(_folder.glob('*.msg'))
                    for name, fields in get_types_from_msg(file.read_text(), f'{_package}/msg/{file.stem}').items()})
for _name, _text in (
        ('AudioData', 'uint8[] data'),
        ('AudioDataStamped', 'std_msgs/Header header\naudio_common_msgs/AudioData audio'),
        ('AudioInfo', 'uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\nstring coding_format')):
    TYPES.register(get_types_from_msg(_text, f'audio_common_msgs/msg/{_name}'))

ODOMETRY = 'nav_msgs/msg/Odometry'
SECOND = 10**9
EPOCH = 1_700_000_000.0
RATE, SPACING, SOUND_SPEED = 16_000, 0.2, 343.2
CAMERA = {'width': 640, 'height': 480, 'focal': 457.0}


def make(kind, *values):
    return TYPES.types[kind](*values)


def cdr(message):
    return bytes(TYPES.serialize_cdr(message, message.__msgtype__))


def stamp(time):
    return make('builtin_interfaces/msg/Time', *divmod(round(time * 1e9), 10**9))


def header(time, frame='base_link'):
    return make('std_msgs/msg/Header', stamp(time), frame)


def vector(x=0.0, y=0.0, z=0.0):
    return make('geometry_msgs/msg/Vector3', float(x), float(y), float(z))


def attitude(yaw):
    return make('geometry_msgs/msg/Quaternion', 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def odometry(time, x=0.0, y=0.0, yaw=0.0, yaw_rate=0.0, frame='map', child='base_link'):
    pose = make('geometry_msgs/msg/Pose', make('geometry_msgs/msg/Point', float(x), float(y), 0.0), attitude(yaw))
    twist = make('geometry_msgs/msg/Twist', vector(), vector(z=yaw_rate))
    return make(ODOMETRY, header(time, frame), child, make('geometry_msgs/msg/PoseWithCovariance', pose, np.zeros(36)),
                make('geometry_msgs/msg/TwistWithCovariance', twist, np.zeros(36)))


def doa(time, azimuth, sigma=0.02, confidence=0.9, frame='microphones', window=0.5):
    """A sound and its mirror image about the y axis."""
    images = [make('av_interfaces/msg/Doa', vector(math.cos(a), math.sin(a)), a, 0.0, sigma**2, math.inf,
                   math.sin(a), (sigma * max(abs(math.cos(a)), 0.05))**2, confidence, 0, False, math.nan, math.nan, math.nan)
              for a in (azimuth, math.pi - azimuth)]
    return make('av_interfaces/msg/DoaArray', header(time, frame), window, 'test', -30.0, vector(y=1.0), images)


def detections(time, azimuth=None, score=0.9, frame='camera_optical_frame', label='drone', at=None):
    """A target of 30 pixels in the image of a level camera that looks ahead, or `at` another pixel, or no target."""
    found = []
    if azimuth is not None and abs(azimuth) < 0.6:
        column = 0.5 * (CAMERA['width'] - 1) - CAMERA['focal'] * math.tan(azimuth)
        nowhere = make('geometry_msgs/msg/PoseWithCovariance', make(
            'geometry_msgs/msg/Pose', make('geometry_msgs/msg/Point', 0.0, 0.0, 0.0), attitude(0.0)), np.zeros(36))
        hypothesis = make('vision_msgs/msg/ObjectHypothesis', label, score)
        result = make('vision_msgs/msg/ObjectHypothesisWithPose', hypothesis, nowhere)
        box = make('vision_msgs/msg/BoundingBox2D', make('vision_msgs/msg/Pose2D', make(
            'vision_msgs/msg/Point2D', *(at or (column, 239.5))), 0.0), 30.0, 30.0)
        found = [make('vision_msgs/msg/Detection2D', header(time, frame), [result], box, '1')]
    return make('vision_msgs/msg/Detection2DArray', header(time, frame), found)


def camera_info(time, binning=0, region=(0, 0, 0, 0), model='plumb_bob'):
    """Of an ideal lens; a region is left, top, height and width on the sensor."""
    f, cx, cy = CAMERA['focal'], 0.5 * (CAMERA['width'] - 1), 0.5 * (CAMERA['height'] - 1)
    roi = make('sensor_msgs/msg/RegionOfInterest', *region, False)
    return make('sensor_msgs/msg/CameraInfo', header(time, 'camera_optical_frame'), CAMERA['height'], CAMERA['width'],
                model, np.zeros(4 if model == 'equidistant' else 5), np.array([f, 0, cx, 0, f, cy, 0, 0, 1.0]),
                np.eye(3).ravel(), np.array([f, 0, cx, 0, 0, f, cy, 0, 0, 0, 1.0, 0]), binning, binning, roi)


def static_frames(time, aside=0.0):
    """A level camera that looks ahead, a thermal one that looks `aside` (rad), and microphones that are not turned."""
    def transform(parent, child, x, y, z, w):
        turned = make('geometry_msgs/msg/Transform', vector(), make('geometry_msgs/msg/Quaternion', x, y, z, w))
        return make('geometry_msgs/msg/TransformStamped', header(time, parent), child, turned)
    return make('tf2_msgs/msg/TFMessage', [
        transform('base_link', 'microphones', 0.0, 0.0, 0.0, 1.0), transform('base_link', 'camera_link', 0.0, 0.0, 0.0, 1.0),
        transform('base_link', 'thermal_link', 0.0, 0.0, math.sin(aside / 2), math.cos(aside / 2)),
        *(transform(f'{camera}_link', f'{camera}_optical_frame', -0.5, 0.5, -0.5, 0.5) for camera in ('camera', 'thermal'))])


def image(kind):
    """64 by 48 pixels of an encoding, or compressed as jpeg or png."""
    rows, columns = np.mgrid[0:48, 0:64]
    colour = np.stack([rows * 4, columns * 3, rows + columns], -1).astype(np.uint8)
    images = {'bgr8': colour, 'rgb8': colour[..., ::-1], 'mono8': colour[..., 0],
                'bgra8': np.dstack([colour, colour[..., :1]]), '16UC1': colour[..., 0].astype(np.uint16) * 200,
                'bayer_rggb8': colour[..., 0], 'yuv422_yuy2': colour[..., :2]}
    if kind in ('jpeg', 'png'):
        data = cv2.imencode(f'.{kind}', colour)[1].ravel()
        return make('sensor_msgs/msg/CompressedImage', header(EPOCH, 'camera_optical_frame'), kind, data)
    pixels = np.ascontiguousarray(images[kind])
    return make('sensor_msgs/msg/Image', header(EPOCH, 'camera_optical_frame'), 48, 64, kind, 0,
                     pixels.nbytes // 48, pixels.view(np.uint8).ravel())


def sound_of(azimuth, duration, seed=0):
    """White noise from a direction at microphones 0.2 m apart, left one first: (samples, 2) of full scale 1."""
    count = round(duration * RATE)
    spectrum = np.fft.rfft(np.random.default_rng(seed).normal(0.0, 0.1, count))
    delay = SPACING / SOUND_SPEED * math.sin(azimuth)
    turn = np.exp(-1j * np.pi * np.fft.rfftfreq(count, 1.0 / RATE) * delay)
    return np.stack([np.fft.irfft(spectrum / turn, count), np.fft.irfft(spectrum * turn, count)], 1).astype(np.float32)


def audio_frames(time, samples, block=800):
    """Messages of a sound that begins at `time`."""
    return [make('av_interfaces/msg/AudioFrame', header(time + k / RATE, 'microphones'), RATE, 2, k,
                 samples[k:k + block].ravel()) for k in range(0, len(samples), block)]


@contextmanager
def bag(path, storage=StoragePlugin.MCAP):
    """Yields a function that writes a message to a topic at a time in s."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {}

        def write(topic, time, message):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=TYPES)
            writer.write(connections[topic], round(time * SECOND), cdr(message))

        yield write


def flight(path, duration=20.0, storage=StoragePlugin.MCAP, prefix='', offset=0.0, leave_out=(), aside=None):
    """A target circles a standing rig in 40 s, from the front left. The camera detects it in front, the microphones always.

    With `aside` (rad) a second camera looks there, see `static_frames`.
    Stamps differ by `offset` s from the times of recording. Returns the path.
    """
    rng = np.random.default_rng(5)

    def azimuth_at(time):
        return 0.3 + 2 * math.pi / 40.0 * (time - EPOCH)

    with bag(path, storage) as writes:
        def write(topic, time, message):
            if topic not in leave_out:
                writes(topic if topic.startswith('/') else f'{prefix}/{topic}', time, message)

        write('/tf_static', EPOCH, static_frames(EPOCH + offset, aside or 0.0))
        for k in range(round(50 * duration)):
            time = EPOCH + k / 50.0
            truth, on_stamp = azimuth_at(time), time + offset
            write('odometry', time, odometry(on_stamp))
            write('truth/rig', time, odometry(on_stamp))
            write('truth/target', time, odometry(on_stamp, 10 * math.cos(truth), 10 * math.sin(truth), child='target'))
            if k % 5 == 0:
                measured = azimuth_at(time - 0.25) + rng.normal(0.0, 0.02)
                write('doa', time, doa(on_stamp - 0.25, measured))
            if k % 4 == 0:
                wrapped = math.remainder(truth, 2 * math.pi)
                write('camera/camera_info', time, camera_info(on_stamp))
                write('detections', time, detections(on_stamp, wrapped + rng.normal(0.0, 0.003)))
            if k % 4 == 2 and aside is not None:
                seen = math.remainder(truth - aside, 2 * math.pi) + rng.normal(0.0, 0.003)
                write('second_camera/camera_info', time, camera_info(on_stamp))
                write('second_camera/detections', time, detections(on_stamp, seen, frame='thermal_optical_frame'))
    return path
