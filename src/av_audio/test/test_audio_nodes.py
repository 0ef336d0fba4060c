"""audio_node and doa_node in one process, on real topics."""

import importlib.util
import itertools
import time

import numpy as np
import pytest
import rclpy
import soundfile
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import Header

from av_audio.benchmark.signals import RATE, flat
from av_audio.nodes.audio_common_node import AudioCommonNode
from av_audio.nodes.audio_node import AudioNode
from av_audio.nodes.doa_node import DoaNode
from av_common.acoustics import speed_of_sound
from av_common.qos import RESULT, STREAM
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame, DoaArray

pytestmark = pytest.mark.system
DELAY = 0.1 / speed_of_sound(20.0)  # from 30 degrees


class Rig:
    """Nodes under test and a listener that keeps what it hears."""

    def __init__(self):
        rclpy.init()
        self.executor = SingleThreadedExecutor()
        self.nodes = []
        self.listener = rclpy.create_node('listener')
        self.executor.add_node(self.listener)
        self.heard = {}
        for name, (kind, qos) in {'audio/frames': (AudioFrame, STREAM), 'doa': (DoaArray, RESULT),
                                  '/diagnostics': (DiagnosticArray, 10)}.items():
            self.heard[name] = []
            self.listener.create_subscription(kind, name, self.heard[name].append, qos)
        self.frames = self.listener.create_publisher(AudioFrame, 'audio/frames', STREAM)

    def add(self, kind, **parameters):
        node = kind(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])
        self.nodes.append(node)
        self.executor.add_node(node)
        self.spin(lambda: node.is_active or node._problem)
        return node

    def spin(self, until, seconds=20.0):
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert until()

    def says(self, words, level):
        """Wait until a diagnostic status of this level contains these words."""
        self.spin(lambda: any(words in status.message and status.level == level
                              for message in self.heard['/diagnostics'] for status in message.status))

    def close(self):
        for node in self.nodes:
            node.close()
            node.destroy_node()
        self.listener.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


@pytest.fixture
def array_file(tmp_path):
    path = tmp_path / 'pair.yaml'
    path.write_text('microphones: [[0, 0.1, 0], [0, -0.1, 0]]')
    return str(path)


def sound(seconds):
    samples = flat(np.random.default_rng(1), seconds, np.array([0.0, DELAY]))
    return (0.3 * samples / np.abs(samples).max()).astype(np.float32)


def frame(samples, first_sample=0, rate=RATE, channels=2, stamp=100.0):
    header = Header(stamp=Time(sec=int(stamp), nanosec=round(1e9 * (stamp % 1.0))), frame_id='microphones')
    return AudioFrame(header=header, sample_rate=rate, channels=channels, first_sample=first_sample,
                      samples=samples.ravel().tolist())


def test_a_file_becomes_directions_with_capture_stamps(rig, tmp_path, array_file):
    soundfile.write(tmp_path / 'sound.wav', sound(2.0), RATE)
    rig.add(DoaNode, array_file=array_file, hop=0.1)
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.spin(lambda: len(rig.heard['doa']) >= 5)
    first_frame = rig.heard['audio/frames'][0]
    begin = to_seconds(first_frame.header.stamp) - first_frame.first_sample / RATE
    for message in rig.heard['doa']:
        assert [np.degrees(one.azimuth) for one in message.hypotheses] == pytest.approx([30.0, 150.0], abs=0.3)
        assert message.header.frame_id == 'microphones'
        windows = (to_seconds(message.header.stamp) - begin - 0.25) / 0.1
        assert windows == pytest.approx(round(windows), abs=1e-3)
    frames = rig.heard['audio/frames']
    assert [b.first_sample - a.first_sample for a, b in itertools.pairwise(frames)] == [1600] * (len(frames) - 1)


def test_frames_that_do_not_fit_are_reported_and_survived(rig, array_file):
    node = rig.add(DoaNode, array_file=array_file)
    samples = sound(1.0)
    rig.spin(lambda: rig.frames.get_subscription_count() >= 2)
    rig.frames.publish(frame(samples[:1600, :1], channels=1))
    rig.says('1 channels, but the array pair has 2 microphones', DiagnosticStatus.ERROR)
    rig.frames.publish(frame(samples[:1600], rate=4000))
    rig.says('half of the sample rate', DiagnosticStatus.ERROR)
    rig.frames.publish(frame(samples[:1600].ravel()[:-1]))
    rig.says('not a multiple of 2 channels', DiagnosticStatus.ERROR)
    rig.frames.publish(frame(np.full((1600, 2), np.nan)))
    for k in range(20):
        rig.frames.publish(frame(samples[k * 1600:(k + 1) * 1600], 5000 + k * 1600, stamp=200.0 + k * 1600 / RATE))
        rig.executor.spin_once(timeout_sec=0.05)
    rig.spin(lambda: rig.heard['doa'])
    assert node.is_active
    assert to_seconds(rig.heard['doa'][0].header.stamp) == pytest.approx(200.25, abs=1e-6)


def test_parameters_change_while_running(rig, tmp_path, array_file):
    soundfile.write(tmp_path / 'sound.wav', sound(2.0), RATE)
    node = rig.add(DoaNode, array_file=array_file, hop=0.1)
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.spin(lambda: rig.heard['doa'])
    node.set_parameters([Parameter('temperature', value=-20.0), Parameter('method', value='phat')])
    rig.spin(lambda: rig.heard['doa'][-1].method == 'phat')
    # in slower sound the same delay is a shorter path
    assert np.degrees(rig.heard['doa'][-1].hypotheses[0].azimuth) == pytest.approx(27.7, abs=0.3)


def test_missing_input_is_said(rig, array_file, tmp_path):
    rig.add(DoaNode, array_file=array_file)
    rig.says('no audio frames', DiagnosticStatus.WARN)
    rig.add(AudioNode, file=str(tmp_path / 'missing.wav'))
    rig.says('missing.wav does not exist', DiagnosticStatus.ERROR)


def test_without_an_array_file_it_says_so(rig):
    rig.add(DoaNode)
    rig.says('array_file is empty', DiagnosticStatus.ERROR)


def test_faults_of_the_channels_are_reported(rig, tmp_path):
    soundfile.write(tmp_path / 'mono.wav', sound(1.0)[:, [0, 0]], RATE)
    rig.add(AudioNode, file=str(tmp_path / 'mono.wav'), loop=True)
    rig.says('channels 0, 1 are identical', DiagnosticStatus.WARN)


@pytest.mark.skipif(importlib.util.find_spec('audio_common_msgs') is not None, reason='audio_common_msgs is installed')
def test_the_adapter_names_the_package_it_needs(rig):
    rig.add(AudioCommonNode)
    rig.says('audio_common_msgs is not installed', DiagnosticStatus.ERROR)
