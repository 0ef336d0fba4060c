"""audio_node and doa_node in one process, on real topics."""

import itertools
import re
import time
from functools import cached_property

import numpy as np
import pytest
import rclpy
import soundfile
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from known_sound import RATE, flat, scene
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray, Header
from std_srvs.srv import Trigger

from av_audio.device_process import load_sounddevice
from av_audio.nodes.audio_node import AudioNode
from av_audio.nodes.doa_node import DoaNode
from av_common.acoustics import speed_of_sound
from av_common.qos import RESULT, STREAM
from av_common.stamps import to_seconds
from av_interfaces.msg import AudioFrame, DoaArray

pytestmark = pytest.mark.system
DELAY = 0.1 / speed_of_sound(20.0)  # from 30 degrees


class Rig:
    """Nodes under test, and a node that records what they publish.

    Nothing here depends on the speed of the machine: queues are deep, and every wait ends with an event. TIMEOUT_S only
    limits how long a failure takes.
    """

    TIMEOUT_S = 120.0

    def __init__(self):
        rclpy.init()
        self.executor = SingleThreadedExecutor()
        self.nodes = []
        self.recorder = rclpy.create_node('recorder')
        self.executor.add_node(self.recorder)
        self.received = {}
        for name, (kind, qos) in {'audio/frames': (AudioFrame, STREAM), 'doa': (DoaArray, RESULT),
                                  '/diagnostics': (DiagnosticArray, RESULT)}.items():
            self.received[name] = []
            deep = QoSProfile(depth=2000, reliability=qos.reliability)
            self.recorder.create_subscription(kind, name, self.received[name].append, deep)

    @cached_property
    def frames(self):
        """Where frames are sent from; beside an audio_node it would be a second publisher, and refused."""
        return self.recorder.create_publisher(AudioFrame, 'audio/frames', STREAM)

    def add(self, kind, **parameters):
        node = kind(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])
        self.nodes.append(node)
        self.executor.add_node(node)
        self.spin(lambda: node.is_active or node._problem)
        return node

    def spin(self, until):
        end = time.monotonic() + self.TIMEOUT_S
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert until()

    def publish(self, node, message):
        """Send a frame to a doa_node, and wait until that has processed it."""
        self.spin(lambda: self.frames.get_subscription_count() >= 2)  # the recorder's and the node's
        published = time.monotonic()
        self.frames.publish(message)
        self.spin(lambda: node._frames.age < time.monotonic() - published)

    def wait_for_status(self, words, level):
        """Wait until a diagnostic status of this level contains these words."""
        self.spin(lambda: any(words in status.message and status.level == level
                              for message in self.received['/diagnostics'] for status in message.status))

    def wait_for_end_of_status(self, node, words):
        """Wait until a newer diagnostic status of a node does not contain these words."""
        begin = len(self.received['/diagnostics'])
        self.spin(lambda: any(node.get_name() in status.name and words not in status.message
                              for message in self.received['/diagnostics'][begin:] for status in message.status))

    def close(self):
        for node in self.nodes:
            node.close()
            node.destroy_node()
        self.recorder.destroy_node()
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
    """Windows begin with a frame, the hop is three of them; a machine that stalls may lose frames before doa_node."""
    soundfile.write(tmp_path / 'sound.wav', sound(2.0), RATE)
    rig.add(DoaNode, array_file=array_file, hop=0.1)
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.spin(lambda: len(rig.received['doa']) >= 5)
    first_frame = rig.received['audio/frames'][0]
    begin = to_seconds(first_frame.header.stamp) - first_frame.first_sample / RATE
    for message in rig.received['doa']:
        assert [np.degrees(one.azimuth) for one in message.hypotheses] == pytest.approx([30.0, 150.0], abs=0.3)
        assert message.header.frame_id == 'microphones'
        frames = (to_seconds(message.header.stamp) - begin - 0.25) * RATE / 1600
        assert frames == pytest.approx(round(frames), abs=1e-3)
    frames = rig.received['audio/frames']
    assert [b.first_sample - a.first_sample for a, b in itertools.pairwise(frames)] == [1600] * (len(frames) - 1)


def test_frames_that_do_not_fit_are_reported_and_survived(rig, array_file):
    node = rig.add(DoaNode, array_file=array_file)
    samples = sound(1.0)
    rig.publish(node, frame(samples[:1600, :1], channels=1))
    rig.wait_for_status('1 channels, but the array pair has 2 microphones', DiagnosticStatus.WARN)
    rig.publish(node, frame(samples[:1600], rate=4000))
    rig.wait_for_status('half of the sample rate', DiagnosticStatus.WARN)
    rig.publish(node, frame(samples[:1600].ravel()[:-1]))
    rig.wait_for_status('not a multiple of 2 channels', DiagnosticStatus.WARN)
    rig.publish(node, frame(np.full((1600, 2), np.nan), 5000 - 1600, stamp=200.0 - 1600 / RATE))
    for k in range(15):
        rig.publish(node, frame(samples[k * 1600:(k + 1) * 1600], 5000 + k * 1600, stamp=200.0 + k * 1600 / RATE))
    rig.spin(lambda: rig.received['doa'])
    assert node.is_active
    assert to_seconds(rig.received['doa'][0].header.stamp) == pytest.approx(200.25, abs=1e-6)


def test_parameters_change_while_running(rig, tmp_path, array_file):
    soundfile.write(tmp_path / 'sound.wav', sound(2.0), RATE)
    node = rig.add(DoaNode, array_file=array_file, hop=0.1)
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.spin(lambda: rig.received['doa'])
    node.set_parameters([Parameter('temperature', value=-20.0), Parameter('method', value='phat')])
    rig.spin(lambda: rig.received['doa'][-1].method == 'phat')
    # in slower sound the same delay is a shorter path
    assert np.degrees(rig.received['doa'][-1].hypotheses[0].azimuth) == pytest.approx(27.7, abs=0.3)


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('band_low', 1e9, 'band_low is 1e+09 Hz, expected more than 0 and less than band_high'),
    ('elevation_min_deg', 90.0, 'elevation_min_deg is 90, expected'), ('window', float('nan'), 'window'),
    ('band_high', float('inf'), 'band_high'), ('array_file', 'x' * 10_000_000, ''), ('method', 'magic', 'method')])
def test_parameters_that_do_not_fit_each_other_are_refused_at_the_start_and_later(rig, array_file, name, value, words):
    """The answer names parameter, value and what is expected; the former value stays."""
    node = rig.add(DoaNode, array_file=array_file)
    before = node.get_parameter(name).value
    refused, = node.set_parameters([Parameter(name, value=value)])
    assert not refused.successful and refused.reason and words in refused.reason
    assert node.get_parameter(name).value == before and getattr(node.settings, name) == before
    if name != 'array_file':
        with pytest.raises((ValueError, ParameterException), match=re.escape(words)):
            DoaNode(parameter_overrides=[Parameter(name, value=value)])


def test_a_band_beyond_half_of_the_sample_rate_is_refused_while_it_runs(rig, array_file, tmp_path):
    """The rate is that of the frames; before the first of them nobody knows it."""
    soundfile.write(tmp_path / 'sound.wav', sound(2.0), RATE)
    node = rig.add(DoaNode, array_file=array_file)
    assert node.set_parameters([Parameter('band_high', value=0.6 * RATE)])[0].successful
    assert node.set_parameters([Parameter('band_high', value=4000.0)])[0].successful
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.spin(lambda: rig.received['doa'])
    refused, = node.set_parameters([Parameter('band_high', value=0.6 * RATE)])
    assert not refused.successful and 'half of the sample rate' in refused.reason
    assert node.set_parameters([Parameter('band_high', value=0.5 * RATE)])[0].successful    # as of 8 kHz with the default band


@pytest.mark.parametrize(('parameters', 'words'), [
    ({'channels': [0, 0]}, 'each microphone needs a separate channel'), ({'channels': [0, -1]}, 'not [-1]')])
def test_audio_parameters_that_contradict_each_other_are_refused_at_the_start(rig, parameters, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        AudioNode(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])


def test_changed_elevations_are_applied(rig, array_file):
    """At once."""
    node = rig.add(DoaNode, array_file=array_file)
    assert node.set_parameters([Parameter('elevation_min_deg', value=-30.0)])[0].successful
    assert node._stage.settings.elevation_deg == (-30.0, 90.0)


def test_channels_are_taken_in_the_order_given(rig, tmp_path):
    samples = np.zeros((RATE, 4), np.float32) + np.array([0.0, 0.1, 0.2, 0.3], np.float32)
    soundfile.write(tmp_path / 'four.wav', samples, RATE, subtype='FLOAT')
    node = rig.add(AudioNode, file=str(tmp_path / 'four.wav'), channels=[2, 0], loop=True)
    rig.spin(lambda: rig.received['audio/frames'])
    assert rig.received['audio/frames'][0].samples[:2] == pytest.approx([0.2, 0.0])
    refused, = node.set_parameters([Parameter('channels', value=[0, 1])])
    assert not refused.successful and 'channels takes effect when the node is configured' in refused.reason
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert node.set_parameters([Parameter('channels', value=[0, 1])])[0].successful


def test_all_channels_are_the_default(rig, tmp_path):
    soundfile.write(tmp_path / 'three.wav', np.zeros((RATE, 3)), RATE)
    rig.add(AudioNode, file=str(tmp_path / 'three.wav'), loop=True)
    rig.spin(lambda: rig.received['audio/frames'])
    assert rig.received['audio/frames'][0].channels == 3


def test_ego_rotors_are_notched_at_the_speeds_of_a_topic(rig, array_file):
    """Rotors 15 dB louder than the target mislead until the motors' speeds are known."""
    samples, blade_pass = scene(np.random.default_rng(3), np.radians(10.0), 15.0)
    node = rig.add(DoaNode, array_file=array_file, ego_rotor_blades=3)
    rig.wait_for_status('no motor speeds', DiagnosticStatus.WARN)
    speeds = rig.recorder.create_publisher(Float32MultiArray, 'motor_speeds', STREAM)
    rig.spin(lambda: speeds.get_subscription_count() >= 1)
    azimuths = []
    for attempt in range(2):
        begin = len(rig.received['doa'])
        for k, first in enumerate(range(0, len(samples), 1600)):
            rig.publish(node, frame(samples[first:first + 1600], attempt * len(samples) + first,
                                    stamp=100.0 + attempt * len(samples) / RATE + k / 30.0))
        rig.spin(lambda begin=begin: len(rig.received['doa']) > begin)
        azimuths.append(np.degrees(rig.received['doa'][-1].hypotheses[0].azimuth))
        turns = 2.0 * np.pi * blade_pass / 3.0  # rad/s; one motor turns the other way, one stands, one has no sensor
        speeds.publish(Float32MultiArray(data=[-turns[0], *turns[1:], 0.0, float('nan')]))
        rig.spin(lambda: len(node._stage.blade_pass_hz))
    assert abs(azimuths[0] - 10.0) > 10.0
    assert azimuths[1] == pytest.approx(10.0, abs=3.0)
    rig.wait_for_status('rotors turn and ego_noise names no recording', DiagnosticStatus.WARN)
    node.trigger_deactivate()
    assert not len(node._stage.blade_pass_hz)


def test_a_recording_of_the_rig_alone_that_does_not_fit_is_reported(rig, tmp_path, array_file):
    """When the file is missing, and when its rate is not that of the stream."""
    rig.add(DoaNode, array_file=array_file, ego_noise=str(tmp_path / 'alone.wav'))
    rig.wait_for_status('alone.wav does not exist', DiagnosticStatus.ERROR)
    soundfile.write(tmp_path / 'alone.wav', sound(3.0), RATE // 2)
    soundfile.write(tmp_path / 'sound.wav', sound(1.0), RATE)
    rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    rig.add(DoaNode, array_file=array_file, ego_noise=str(tmp_path / 'alone.wav'))
    rig.wait_for_status(f'alone.wav was recorded at {RATE // 2} Hz', DiagnosticStatus.WARN)


def test_ego_noise_is_learned_in_flight_and_forgotten(rig, array_file):
    """On request, from what is heard next."""
    node = rig.add(DoaNode, array_file=array_file)
    learn = rig.recorder.create_client(Trigger, 'doa_node/learn_ego_noise')
    rig.spin(learn.service_is_ready)
    answer = learn.call_async(Trigger.Request())
    rig.spin(answer.done)
    assert answer.result().success and '10 s' in answer.result().message
    alone = sound(11.0)
    for first in range(0, len(alone), 4800):
        rig.publish(node, frame(alone[first:first + 4800], first, stamp=100.0 + first / RATE))
    assert node._stage.ego_noise.known.name == 'noise learned in flight'
    node.trigger_deactivate()
    assert node._stage.ego_noise.known is None


def test_missing_input_is_reported(rig, array_file, tmp_path):
    rig.add(DoaNode, array_file=array_file)
    rig.wait_for_status('no audio frames', DiagnosticStatus.WARN)
    rig.add(AudioNode, file=str(tmp_path / 'missing.wav'))
    rig.wait_for_status('missing.wav does not exist', DiagnosticStatus.ERROR)


def test_an_absent_device_is_reported_and_retried(rig):
    try:
        load_sounddevice()
    except ImportError as error:
        pytest.skip(str(error))
    rig.add(AudioNode, source='device', device='no such thing')
    rig.wait_for_status("device='no such thing' matches 0 capture devices", DiagnosticStatus.ERROR)


def test_a_missing_array_file_is_reported(rig):
    rig.add(DoaNode)
    rig.wait_for_status('array_file is empty', DiagnosticStatus.ERROR)


def test_lost_samples_are_reported_while_they_are_recent(rig, tmp_path, monkeypatch):
    monkeypatch.setattr('av_audio.nodes.audio_node.RECENT_S', 0.5)
    soundfile.write(tmp_path / 'sound.wav', sound(1.0), RATE)
    node = rig.add(AudioNode, file=str(tmp_path / 'sound.wav'), loop=True)
    node._buffer.overwritten += 5
    rig.wait_for_status('samples lost', DiagnosticStatus.WARN)
    rig.wait_for_end_of_status(node, 'samples lost')


def test_lost_phases_are_reported_while_they_are_recent(rig, array_file, monkeypatch):
    monkeypatch.setattr('av_audio.nodes.doa_node.RECENT_S', 3.0)
    node = rig.add(DoaNode, array_file=array_file)
    for k in range(16):
        rig.publish(node, frame(sound(1.0)[k * 1600:(k + 1) * 1600, [0, 0]], k * 1600, stamp=100.0 + k * 1600 / RATE))
    rig.wait_for_status('a lossy code has removed the phases', DiagnosticStatus.WARN)
    rig.wait_for_end_of_status(node, 'a lossy code has removed the phases')
    assert node._stage.without_phases


def test_faults_of_the_channels_are_reported(rig, tmp_path, array_file):
    soundfile.write(tmp_path / 'mono.wav', sound(1.0)[:, [0, 0]], RATE)
    rig.add(AudioNode, file=str(tmp_path / 'mono.wav'), loop=True)
    rig.add(DoaNode, array_file=array_file)
    rig.wait_for_status('channels 0, 1 are identical', DiagnosticStatus.ERROR)
