"""The stage that node, replay and experiments share, on message objects."""

import contextlib
from array import array
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from known_sound import RATE, flat, scene
from std_msgs.msg import Float32MultiArray, Header

from av_audio import DOA_METHODS, Direction, DoaStage, Localizer, LocalizerSettings, audio_frame, make_doa_stage
from av_audio.stage import localizer_settings
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds, to_stamp

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'pair')
BLOCK = 1600


def sound(seconds):
    """From 30 degrees."""
    samples = flat(np.random.default_rng(1), seconds, np.array([0.0, 0.1 / speed_of_sound(20.0)]))
    return (0.3 * samples / np.abs(samples).max()).astype(np.float32)


def frames(samples, first_sample=0, stamp=100.0, rate=RATE):
    """Blocks of samples whose first was captured at `stamp` (s)."""
    for start in range(0, len(samples), BLOCK):
        header = Header(stamp=to_stamp(stamp + start / rate), frame_id='microphones')
        yield audio_frame(samples[start:start + BLOCK], first_sample + start, rate, header)


def feed(stage, samples, **options):
    """All messages; frames arrive late, which must not matter."""
    return [message for frame in frames(samples, **options)
            for message in stage.on_audio(frame, to_seconds(frame.header.stamp) + 3.0)]


def test_directions_are_stamped_by_the_capture_of_the_window():
    messages = feed(DoaStage(PAIR), sound(1.0), first_sample=5000)
    assert [to_seconds(message.header.stamp) for message in messages] == pytest.approx(100.25 + 0.1 * np.arange(6), abs=1e-6)
    for message in messages:
        assert (message.header.frame_id, message.method, message.window) == ('microphones', 'ml', 0.5)
        strongest = [h.azimuth for h in message.hypotheses if h.ambiguity_group == 0]
        assert np.degrees(strongest) == pytest.approx([30.0, 150.0], abs=0.3)
        assert message.axis.y == 1.0


def test_it_is_the_localizer_on_the_same_samples():
    samples = sound(1.0)
    estimates = Localizer(PAIR, RATE, LocalizerSettings(method='phat')).process(samples, 0)
    messages = feed(DoaStage(PAIR, LocalizerSettings(method='phat')), samples)
    assert [m.hypotheses[0].azimuth for m in messages] == pytest.approx([e.azimuth[0] for e in estimates], rel=1e-6)


def test_a_method_that_fails_discards_its_window(monkeypatch):
    """Of the samples after the window some may be lost: what follows does not continue it."""
    begins, messages = [], []

    def failing_at_first(window):
        begins.append(window[0, 0])
        if len(begins) == 1:
            raise RuntimeError('no direction')
        return [Direction(0.0, 0.1)]

    monkeypatch.setattr(DOA_METHODS, 'check', lambda name: None)
    monkeypatch.setattr(DOA_METHODS, 'load', lambda name: lambda array, rate: failing_at_first)
    stage, samples = DoaStage(PAIR, LocalizerSettings(method='failing_at_first', window_s=0.51)), sound(1.2)
    for frame in frames(samples):
        with contextlib.suppress(RuntimeError):
            messages += stage.on_audio(frame, 0.0)
    assert begins[1] == samples[16 * BLOCK, 0]
    assert to_seconds(messages[0].header.stamp) == pytest.approx(100.0 + 16 * BLOCK / RATE + 0.255, abs=1e-6)


def test_messages_of_other_libraries_serve_as_well():
    """Replay decodes bags without rclpy: the same fields, samples as an array."""
    frame = next(frames(sound(0.6)))
    stamp = SimpleNamespace(sec=100, nanosec=0)
    other = SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id='ears'), sample_rate=RATE, channels=2,
                            first_sample=0, samples=np.tile(np.asarray(frame.samples, np.float32), 20))
    message = DoaStage(PAIR).on_audio(other, 0.0)[0]
    assert message.header.frame_id == 'ears' and to_seconds(message.header.stamp) == 100.25


@pytest.mark.parametrize('changes, words', [
    ({'channels': 1}, '1 channels, but the array pair has 2 microphones'),
    ({'sample_rate': 4000}, 'half of the sample rate'),
    ({'sample_rate': 2**32 - 1}, 'sample_rate is 4294967295 Hz, expected 1000 to 384000'),
    ({'sample_rate': 0}, 'sample_rate is 0'),
    ({'samples': array('f', bytes(4 * (2 * 10 * RATE + 2)))}, 'samples in a frame, expected at most')])
def test_frames_that_do_not_fit_are_refused(changes, words):
    stage, samples = DoaStage(PAIR), sound(0.6)
    bad = next(frames(samples))
    for name, value in changes.items():
        setattr(bad, name, value)
    with pytest.raises(ValueError, match=words):
        stage.on_audio(bad, 0.0)
    assert len(feed(stage, samples)) == 2


def test_a_frame_of_a_rate_that_is_refused_leaves_nothing_behind():
    """Channels were judged by it from then on: those of a source 8 degrees from ahead were said to be inverted."""
    stage, samples = DoaStage(PAIR), 0.1 * flat(np.random.default_rng(1), 3.0, np.array([0.0, 4 / RATE])).astype(np.float32)
    feed(stage, samples[:RATE])
    stray = next(frames(samples))
    stray.sample_rate = 4000
    with pytest.raises(ValueError, match='half of the sample rate'):
        stage.on_audio(stray, 0.0)
    messages = feed(stage, samples, first_sample=RATE, stamp=101.0)
    assert not stage.faults and all(message.hypotheses[0].confidence > 0.9 for message in messages)


def test_a_source_of_another_format_is_reported():
    stage, samples = DoaStage(PAIR), sound(1.0)
    feed(stage, samples)
    with pytest.raises(ValueError, match='1 channels'):
        feed(stage, samples[:, :1], stamp=200.0)


@pytest.mark.parametrize('stamp', [50.0, 102.0, 5000.0])
def test_a_source_that_starts_again_is_heard_again(stamp):
    stage = DoaStage(PAIR)
    feed(stage, sound(1.0))
    first = to_seconds(feed(stage, sound(2.0), stamp=stamp)[0].header.stamp)
    assert first == pytest.approx(stamp + 0.25, abs=1e-6)


def test_gaps_are_counted_as_restarts():
    stage = DoaStage(PAIR)
    feed(stage, sound(0.2))
    feed(stage, sound(0.6), first_sample=RATE, stamp=101.0)
    assert stage.restarts == 1 and stage.latest is not None


def test_new_settings_apply_from_the_next_frame():
    stage = DoaStage(PAIR)
    feed(stage, sound(0.6))
    stage.settings = LocalizerSettings(temperature_c=-20.0)
    message = feed(stage, sound(0.6), first_sample=RATE, stamp=101.0)[0]
    assert np.degrees(message.hypotheses[0].azimuth) == pytest.approx(27.7, abs=0.3)  # slower sound, the same delay


def test_motor_speeds_notch_the_rigs_own_rotors():
    """Rotors 15 dB louder than the target; of five motors one turns the other way, one stands, one has no sensor."""
    samples, blade_pass = scene(np.random.default_rng(3), np.radians(10.0), 15.0)
    speeds = 2.0 * np.pi * blade_pass / 3.0
    azimuths = []
    for blades in (0, 3):
        stage = DoaStage(PAIR, rotor_blades=blades)
        stage.on_motor_speeds(Float32MultiArray(data=[-speeds[0], *speeds[1:], 0.0, float('nan')]))
        azimuths.append(np.degrees(feed(stage, samples)[-1].hypotheses[0].azimuth))
    assert abs(azimuths[0] - 10.0) > 10.0
    assert azimuths[1] == pytest.approx(10.0, abs=3.0)


def test_motor_speeds_that_end_are_forgotten():
    """The node says then that nothing is notched; rotors turn at other speeds by now."""
    stage = DoaStage(PAIR, rotor_blades=2)
    stage.on_motor_speeds(Float32MultiArray(data=[500.0]))
    feed(stage, sound(0.9))
    assert len(stage.blade_pass_hz)
    feed(stage, sound(0.3), first_sample=round(0.9 * RATE), stamp=100.9)
    assert not len(stage.blade_pass_hz)


def test_a_message_of_a_million_motors_is_refused():
    with pytest.raises(ValueError, match='1000000 motors, expected at most 64'):
        DoaStage(PAIR, rotor_blades=2).on_motor_speeds(Float32MultiArray(data=array('f', bytes(4_000_000))))


def test_a_stage_is_made_of_the_parameters_of_doa_node(tmp_path):
    PAIR.save(tmp_path / 'pair.yaml')
    soundfile.write(tmp_path / 'alone.wav', sound(3.0), RATE)
    parameters = node_parameters('av_audio', 'doa_node', overrides={
        'array_file': str(tmp_path / 'pair.yaml'), 'window': 0.3, 'hop': 0.05, 'band_low': 300.0, 'band_high': 3000.0,
        'method': 'phat', 'temperature': 5.0, 'elevation_min_deg': -10.0, 'elevation_max_deg': 60.0,
        'ego_noise': str(tmp_path / 'alone.wav')})
    expected = LocalizerSettings(0.3, 0.05, (300.0, 3000.0), 'phat', 5.0, (-10.0, 60.0))
    assert localizer_settings(parameters) == expected
    assert make_doa_stage(parameters).settings == expected
    assert make_doa_stage(parameters, PAIR, method='ml').settings.method == 'ml'
    assert len(feed(make_doa_stage(parameters), sound(0.5))) == 5


def test_parameters_without_an_array_are_refused():
    with pytest.raises(ValueError, match='array_file is empty'):
        make_doa_stage(node_parameters('av_audio', 'doa_node'))
    with pytest.raises(OSError, match=r'alone\.wav does not exist'):
        make_doa_stage(node_parameters('av_audio', 'doa_node', overrides={'ego_noise': 'alone.wav'}), PAIR)
