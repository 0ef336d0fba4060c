"""What a DOA message holds for a line, a plane and a space of microphones, and samples there and back."""

import math

import numpy as np
import pytest
from known_sound import RATE, flat
from std_msgs.msg import Header

from av_audio import DoaStage, LocalizerSettings, audio_frame, samples_of
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import DelayCurve, MicrophoneArray
from av_interfaces.msg import AudioFrame

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
SQUARE = MicrophoneArray([[0.03, 0.03, 0.0], [-0.03, 0.03, 0.0], [-0.03, -0.03, 0.0], [0.03, -0.03, 0.0]])
PYRAMID = MicrophoneArray([[0.05, 0.0, 0.0], [-0.03, 0.04, 0.0], [-0.03, -0.04, 0.0], [0.0, 0.0, 0.06]])


def message_of(array, azimuth_deg, elevation_deg=0.0, noise=0.01):
    """The message of half a second from one direction, with every elevation allowed."""
    rng = np.random.default_rng(1)
    direction = angles_to_direction(np.radians(azimuth_deg), np.radians(elevation_deg))
    sound = flat(rng, 0.5, -array.positions @ direction / speed_of_sound(20.0))
    sound = 0.1 * sound / sound.std() + 0.1 * noise * rng.normal(size=sound.shape)
    stage = DoaStage(array, LocalizerSettings(elevation_deg=(-90.0, 90.0)))
    message, = stage.on_audio(audio_frame(sound, 0, RATE, Header()), 0.0)
    return message


def vector(message):
    return np.array([message.x, message.y, message.z])


@pytest.mark.parametrize('azimuth', [-70.0, 0.0, 35.0, 85.0])
def test_a_pair_measures_a_cone_about_its_axis(azimuth):
    message = message_of(PAIR, azimuth)
    np.testing.assert_allclose(vector(message.axis), [0.0, 1.0, 0.0])
    assert len(message.hypotheses) == 2
    for hypothesis in message.hypotheses:
        assert hypothesis.cosine == pytest.approx(np.sin(np.radians(azimuth)), abs=5e-3)
        assert 0.0 < hypothesis.cosine_variance < 1e-4
    assert message.hypotheses[0].cosine == message.hypotheses[1].cosine


@pytest.mark.parametrize('azimuth', [90.0, -90.0])
def test_the_cosine_at_end_fire_is_that_of_the_estimated_angle(azimuth):
    """It agrees with the direction beside it, lies within -1..1, and its variance does not vanish."""
    message = message_of(PAIR, azimuth, noise=1.0)
    broadside = message_of(PAIR, 0.0, noise=1.0)
    for hypothesis in message.hypotheses:
        assert hypothesis.cosine == pytest.approx(vector(hypothesis.direction) @ vector(message.axis), abs=1e-6)
        assert hypothesis.end_fire and 0.9 < abs(hypothesis.cosine) <= 1.0
        assert 1e-3 * broadside.hypotheses[0].cosine_variance < hypothesis.cosine_variance
        assert hypothesis.azimuth_variance > 5.0 * broadside.hypotheses[0].azimuth_variance


def test_the_cone_of_a_calibrated_pair_has_its_delay_curve_undone():
    bent = MicrophoneArray(PAIR.positions, 'bent', DelayCurve([-1.0, 0.0, 1.0], [-0.8, 0.0, 0.8]))
    message = message_of(bent, np.degrees(np.arcsin(0.8 * np.sin(np.radians(40.0)))))
    assert message.hypotheses[0].cosine == pytest.approx(np.sin(np.radians(40.0)), abs=2e-3)
    straight = message_of(PAIR, 30.0).hypotheses[0].cosine_variance
    assert message.hypotheses[0].cosine_variance == pytest.approx(straight / 0.8**2, rel=0.3)


def test_an_inclined_line_has_its_axis_in_space():
    """The cosine is that to the true axis, though the hypotheses are horizontal."""
    axis = np.array([0.0, math.cos(0.3), math.sin(0.3)])
    inclined = MicrophoneArray(np.array([0.1, 0.0, -0.1])[:, None] * axis)
    message = message_of(inclined, 50.0)
    np.testing.assert_allclose(vector(message.axis), axis, atol=1e-6)
    for hypothesis in message.hypotheses:
        assert hypothesis.cosine == pytest.approx(vector(hypothesis.direction) @ axis, abs=2e-3)
        assert hypothesis.cosine == pytest.approx(angles_to_direction(np.radians(50.0), 0.0) @ axis, abs=5e-3)


def test_two_images_of_a_plane_are_no_cone():
    """One on each side of the plane: axis zero and cosines NaN, or fusion would take all directions between for possible."""
    message = message_of(SQUARE, 30.0, 40.0)
    assert np.degrees([h.elevation for h in message.hypotheses]) == pytest.approx([40.0, -40.0], abs=1.0)
    assert vector(message.axis).tolist() == [0.0, 0.0, 0.0]
    assert all(math.isnan(h.cosine) and math.isnan(h.cosine_variance) for h in message.hypotheses)


def test_a_vertical_plane_has_a_front_and_a_back_image_and_no_cone():
    """They look like the two images of a pair: horizontal, mirrored at the y axis."""
    upright = MicrophoneArray([[0.0, 0.05, 0.05], [0.0, -0.05, 0.05], [0.0, -0.05, -0.05], [0.0, 0.05, -0.05]])
    message = message_of(upright, 30.0)
    assert np.degrees([h.azimuth for h in message.hypotheses]) == pytest.approx([30.0, 150.0], abs=1.0) or np.degrees(
        [h.azimuth for h in message.hypotheses]) == pytest.approx([150.0, 30.0], abs=1.0)
    assert vector(message.axis).tolist() == [0.0, 0.0, 0.0]
    assert all(math.isnan(h.cosine) and math.isnan(h.cosine_variance) for h in message.hypotheses)


def test_microphones_in_space_have_one_direction_and_no_axis():
    message = message_of(PYRAMID, -110.0, 50.0)
    (hypothesis,) = message.hypotheses
    assert np.degrees([hypothesis.azimuth, hypothesis.elevation]) == pytest.approx([-110.0, 50.0], abs=0.5)
    assert vector(message.axis).tolist() == [0.0, 0.0, 0.0] and math.isnan(hypothesis.cosine)


@pytest.mark.parametrize('offset', [0.0, 0.3])
def test_silence_has_no_hypotheses(offset):
    message, = DoaStage(PAIR).on_audio(audio_frame(np.full((RATE // 2, 2), offset), 0, RATE, Header()), 0.0)
    assert message.hypotheses == [] and message.level < -100.0


def test_samples_there_and_back():
    samples = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)).astype(np.float32)
    frame = audio_frame(samples, 7, RATE, Header(frame_id='microphones'))
    assert (frame.channels, frame.first_sample, frame.sample_rate, frame.header.frame_id) == (3, 7, RATE, 'microphones')
    np.testing.assert_array_equal(samples_of(frame), samples)


@pytest.mark.parametrize('frame, words', [
    (AudioFrame(channels=0, samples=[0.0]), 'without channels'),
    (AudioFrame(channels=2, samples=[0.0, 0.0, 0.0]), '3 samples are not a multiple of 2 channels')])
def test_frames_that_contradict_themselves_are_refused(frame, words):
    with pytest.raises(ValueError, match=words):
        samples_of(frame)
