"""The rig's noise is learned in flight, where it is no longer as recorded."""

import numpy as np
import pytest
from flying_rig import FlyingRig
from known_sound import PAIR, RATE
from std_msgs.msg import Header

from av_audio import DoaStage, LocalizerSettings, NoiseRecording, audio_frame
from av_common.angles import wrap

LEARNED_S = 10.0  # of sound that is listened to
SECONDS, OWN_DB = 2, 15.0  # of a block; of own noise over a target
AZIMUTHS = tuple(np.radians([-80.0, -50.0, -20.0, 10.0, 40.0, 70.0]))


def heard(stage, rng, rig, azimuths=AZIMUTHS):
    """Errors (n,) in degrees and confidences (n,) of targets over which rotors are 15 dB louder."""
    errors, confidences = [], []
    for azimuth in azimuths:
        stage.sent = getattr(stage, 'sent', 0) + RATE  # a gap: no window hears two targets
        sound, _ = rig.hears(rng, rng.normal(size=SECONDS * RATE), azimuth, OWN_DB, SECONDS)
        for message in send(stage, sound):
            first = [one for one in message.hypotheses if one.ambiguity_group == 0]
            errors.append(np.degrees(min(abs(wrap(one.azimuth - azimuth)) for one in first)))
            confidences.append(first[0].confidence)
    return np.array(errors), np.array(confidences)


def send(stage, sound, rate=RATE):
    """Directions in sound (n, m) that continues the stream."""
    first = getattr(stage, 'sent', 0)
    stage.sent = first + len(sound)
    return stage.on_audio(audio_frame(sound.astype(np.float32), first, rate, Header()), 0.0)


def learn(stage, sounds):
    stage.ego_noise.begin()
    for sound in sounds:
        assert stage.ego_noise.is_learning
        send(stage, sound)
    assert not stage.ego_noise.is_learning


@pytest.fixture(scope='module')
def changed():
    """A pair's stage with a recording, and its rig with a rotor that is 6 dB louder since."""
    rng = np.random.default_rng(50)
    rig = FlyingRig(PAIR, rng)
    recording = NoiseRecording((0.02 * rig.alone(rng, 8.0)[0]).astype(np.float32), RATE, 'alone.wav')
    rig.gains[0] = 2.0
    return DoaStage(PAIR, ego_noise=recording), rig


def test_a_louder_rotor_is_no_longer_a_direction(changed):
    """With the recording alone it is one, with confidence."""
    stage, rig = changed
    rng = np.random.default_rng(6)
    errors, confidences = heard(stage, rng, rig)
    assert np.mean((errors > 20.0) & (confidences > 0.9)) > 0.1
    learn(stage, [0.02 * rig.alone(rng, SECONDS)[0] for _ in range(round(LEARNED_S / SECONDS))])
    errors, confidences = heard(stage, rng, rig)
    assert np.mean(errors > 20.0) < 0.08 and np.mean(confidences > 0.9) > 0.8


def test_a_target_that_was_there_costs_confidence(changed):
    """In half of the time that was to be without one; it is never wrong with confidence for that."""
    stage, rig = changed
    rng, azimuth = np.random.default_rng(7), np.radians(-50.0)
    mixed = [rig.hears(rng, rng.normal(size=SECONDS * RATE), azimuth, OWN_DB, SECONDS)[0] for _ in range(3)]
    learn(stage, [*mixed, *(0.02 * rig.alone(rng, SECONDS)[0] for _ in range(2))])
    errors, confidences = heard(stage, rng, rig, [azimuth] * 3)
    assert not np.any((errors > 20.0) & (confidences > 0.9))
    stage.ego_noise.forget()
    assert stage.ego_noise.known.name == 'alone.wav'


def test_a_gap_begins_anew_and_unusable_sound_is_refused():
    stage, noise = DoaStage(PAIR, LocalizerSettings(hop_s=1.0)), np.random.default_rng(8).normal(size=(RATE, 2))
    send(stage, noise)
    assert not stage.ego_noise.known
    stage.ego_noise.begin()
    for _ in range(5):
        send(stage, noise)
    stage.sent += RATE
    for _ in range(9):
        send(stage, noise)
        assert stage.ego_noise.is_learning
    send(stage, noise)
    assert len(stage.ego_noise.known.samples) == LEARNED_S * RATE
    learn(stage, [noise * [1.0, 0.0]] * round(LEARNED_S))
    assert 'silent channel' in stage.ego_noise.refusal and stage.ego_noise.known.samples.any(axis=0).all()


def test_a_stream_of_another_rate_is_heard_and_not_whitened_by_what_was_learned():
    stage, noise = DoaStage(PAIR), np.random.default_rng(9).normal(size=(2 * RATE, 2))
    learn(stage, [noise] * 5)
    assert stage.ego_noise.known
    assert send(stage, noise, RATE // 2) and stage.ego_noise.known is None


def test_what_is_learned_is_of_one_rate():
    stage, noise = DoaStage(PAIR), np.random.default_rng(10).normal(size=(2 * RATE, 2))
    stage.ego_noise.begin()
    send(stage, noise)
    for _ in range(2):
        send(stage, noise, RATE // 2)
        assert stage.ego_noise.is_learning
    send(stage, noise, RATE // 2)
    assert len(stage.ego_noise.known.samples) == 6 * RATE and stage.ego_noise.known.sample_rate == RATE // 2


def test_samples_that_are_not_finite_begin_an_attempt_anew():
    stage, noise = DoaStage(PAIR), np.random.default_rng(11).normal(size=(2 * RATE, 2))
    learn(stage, [noise, noise * np.nan, *[noise] * 5])
    assert stage.ego_noise.known and not stage.ego_noise.refusal
