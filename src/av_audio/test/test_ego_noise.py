"""A target under the rig's ego-noise, which is known from a recording of the rig alone."""

from __future__ import annotations

import json

import numpy as np
import pytest
import soundfile
from flying_rig import RING, FlyingRig
from known_sound import PAIR as WIDE_PAIR
from known_sound import RATE as FLYING_RATE

from av_audio import Localizer, LocalizerSettings, NoiseRecording
from av_audio.cli import localize
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray

RATE, SECONDS = 16_000, 8.0
PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), name='pair')
ROTORS = np.array([[0.2, 0.2, -0.3], [0.2, -0.2, -0.3], [-0.2, 0.2, -0.3], [-0.2, -0.2, -0.3]])
AZIMUTH = np.radians(50.0)
C = speed_of_sound(20.0)


def delayed(sound, seconds):
    """A sound (n,), periodic, as it arrives after each of some delays: (n, m)."""
    frequencies = np.fft.rfftfreq(len(sound), 1.0 / RATE)
    return np.fft.irfft(np.fft.rfft(sound)[:, None] * np.exp(-2j * np.pi * np.outer(frequencies, seconds)), len(sound), axis=0)


def rig_alone(rng):
    """Four independent rotors that hiss near the microphones (n, 2), of power 1, and the microphones' ego-noise."""
    sound = np.zeros((round(SECONDS * RATE), 2))
    for place in ROTORS:
        distances = np.linalg.norm(PAIR.positions - place, axis=1)
        sound += delayed(rng.normal(size=len(sound)), distances / C) / distances
    return sound / sound.std() + 0.05 * rng.normal(size=sound.shape)


def target(rng):
    """Something far away that hisses, of power 1."""
    return delayed(rng.normal(size=round(SECONDS * RATE)), -PAIR.positions @ angles_to_direction(AZIMUTH) / C)


def errors(sound, method='ml', recording=None):
    """Degrees between the target and the nearer of the mirror images, by window."""
    settings = LocalizerSettings(method=method, hop_s=0.25)
    estimates = Localizer(PAIR, RATE, settings, recording).process(sound, 0)
    azimuths = np.degrees([estimate.azimuth for estimate in estimates])
    return np.abs((azimuths - np.degrees(AZIMUTH) + 180.0) % 360.0 - 180.0).min(axis=1)


@pytest.fixture(scope='module')
def recording():
    """The rig alone, at another time."""
    return NoiseRecording(rig_alone(np.random.default_rng(1)).astype(np.float32), RATE)


@pytest.mark.parametrize('method', ['ml', 'phat', 'music', 'mvdr'])
def test_a_target_is_located_under_rotors_twice_as_strong(recording, method):
    """No method locates it without the recording, every method with it."""
    rng = np.random.default_rng(2)
    sound = rig_alone(rng) + np.sqrt(0.5) * target(rng)
    assert np.mean(errors(sound, method) < 8.0) < 0.2
    found = errors(sound, method, recording)
    assert np.mean(found < 8.0) > 0.9
    assert np.median(found) < 3.0


@pytest.mark.parametrize('gain_db', [-60.0, -10.0, 0.0, 10.0])
def test_the_level_may_differ_from_the_recording(recording, gain_db):
    """Positions and spectra of the noise must be as recorded, its level may differ; on the ground the rig is silent."""
    rng = np.random.default_rng(3)
    gain = 10.0 ** (gain_db / 20.0)
    sound = gain * rig_alone(rng) + max(gain, 0.1) * target(rng)
    found = errors(sound, recording=recording)
    assert np.mean(found < 8.0) > 0.95
    assert np.median(found) < 2.0


def test_a_loud_target_is_as_accurate_as_without_a_recording(recording):
    """Rotors 10 dB below it: only their noise is whitened, not a similar sound from elsewhere."""
    rng = np.random.default_rng(6)
    sound = np.sqrt(0.1) * rig_alone(rng) + target(rng)
    assert np.median(errors(sound, recording=recording)) < 1.1 * np.median(errors(sound))


@pytest.mark.parametrize('rounding', [0.0, 2.0**-12], ids=['exact', 'rounded'])
def test_bands_in_which_a_codec_left_nothing_count_for_nothing(rounding):
    """Above 3 kHz, in the recording and in flight: nothing deviates there, or only what rounding leaves."""
    rng = np.random.default_rng(2)
    known, heard = rig_alone(np.random.default_rng(1)), rig_alone(rng) + np.sqrt(0.5) * target(rng)
    passed = np.fft.rfftfreq(len(heard), 1.0 / RATE)[:, np.newaxis] < 3000.0
    known, heard = (np.fft.irfft(passed * np.fft.rfft(sound, axis=0), len(sound), axis=0) for sound in (known, heard))
    if rounding:
        known, heard = (rounding * np.round(sound / rounding) for sound in (known, heard))
    assert np.mean(errors(heard, recording=NoiseRecording(known.astype(np.float32), RATE)) < 8.0) > 0.9


@pytest.mark.parametrize(('samples', 'rate', 'complaint'), [
    (np.zeros((48_000, 1)), RATE, r'my.wav has samples of shape \(48000, 1\), expected \(n, 2\)'),
    (np.zeros((48_000, 2)), 48_000, 'my.wav was recorded at 48000 Hz, expected 16000 Hz'),
    (np.zeros((1600, 2)), RATE, 'my.wav lasts 0.1 s, expected 2 s or more'),
    (np.full((48_000, 2), np.nan), RATE, 'my.wav has samples that are not finite'),
    (np.ones((48_000, 2)) * [1.0, 0.0], RATE, 'my.wav has a silent channel'),
    (np.sin(np.maximum(np.arange(80_000) - 40_000, 0))[:, None] * [1.0, 0.5], RATE, 'my.wav has the same sound in channels 0'),
])
def test_a_recording_that_does_not_fit_is_refused(samples, rate, complaint):
    """By name, and with what would be right."""
    with pytest.raises(ValueError, match=complaint):
        Localizer(PAIR, RATE, ego_noise=NoiseRecording(samples.astype(np.float32), rate, 'my.wav'))


def test_localize_takes_a_file_of_the_rig_alone(recording, tmp_path, capsys):
    """As in the guide: noise recorded while hovering is whitened in flight."""
    rng = np.random.default_rng(5)
    for name, sound in (('alone', recording.samples), ('flight', rig_alone(rng) + np.sqrt(0.5) * target(rng))):
        soundfile.write(tmp_path / f'{name}.wav', 0.1 * sound, RATE)
    (tmp_path / 'array.yaml').write_text('microphones: [[0, 0.1, 0], [0, -0.1, 0]]\n')
    localize.main([str(tmp_path / 'flight.wav'), '--array', str(tmp_path / 'array.yaml'), '--json',
                   '--ego-noise', str(tmp_path / 'alone.wav')])
    azimuths = [record['azimuth_deg'][0] for record in json.loads(capsys.readouterr().out)]
    assert np.median(azimuths) == pytest.approx(50.0, abs=3.0)
    with pytest.raises(SystemExit, match='sound file .*missing.wav does not exist'):
        localize.main([str(tmp_path / 'flight.wav'), '--array', str(tmp_path / 'array.yaml'), '--ego-noise', 'missing.wav'])


def flown(array, level_db, windows=24, recorded=(1.0,), throttle=1.0, method='ml', seed=11, rotors=FlyingRig):
    """Errors (n,) in degrees and confidences (n,) of three rigs that fly, with recordings of 6 s for each throttle."""
    rng, errors, confidences = np.random.default_rng(seed), [], []
    for _ in range(3):
        rig = rotors(array, rng)
        alone = np.concatenate([rig.alone(rng, 6.0, step)[0] for step in recorded]).astype(np.float32)
        settings = LocalizerSettings(hop_s=0.5, method=method)
        localizer = Localizer(array, FLYING_RATE, settings, NoiseRecording(alone, FLYING_RATE))
        for _ in range(windows // 3):
            azimuth = rng.uniform(-np.pi, np.pi)
            sound, _ = rig.hears(rng, rng.normal(size=FLYING_RATE // 2), azimuth, level_db, throttle=throttle)
            estimate, = localizer.process(sound, localizer.next_sample)
            errors.append(np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth)))))
            confidences.append(estimate.confidence[0])
    return np.array(errors), np.array(confidences)


@pytest.mark.parametrize('method', ['ml', 'phat', 'music', 'mvdr'])
@pytest.mark.parametrize(('array', 'level_db'), [(WIDE_PAIR, 10.0), (RING, 20.0)], ids=['pair', 'ring'])
def test_every_method_hears_over_rotors_that_jitter(array, level_db, method):
    """Of rotors whose recording is of another time, with wind, at the levels at which hearing is wanted."""
    errors, confidences = flown(array, level_db, method=method)
    assert np.mean(errors > 20.0) < 0.1
    assert np.median(errors[confidences > 0.9]) < 4.0
    assert np.mean(confidences > 0.9) > 0.3


@pytest.mark.parametrize(('array', 'level_db'), [(WIDE_PAIR, 32.0), (RING, 65.0)], ids=['pair', 'ring'])
def test_where_it_is_deaf_it_says_so(array, level_db):
    errors, confidences = flown(array, level_db)
    assert np.mean(errors > 20.0) > 0.4
    assert np.mean(confidences[errors > 20.0] > 0.9) < 0.1


def test_a_recording_of_several_throttles_serves_each_of_them():
    """Flown at a throttle that was recorded among others: as good as with a recording of this throttle alone."""
    one, _ = flown(RING, 25.0, recorded=(0.8,), throttle=0.8)
    several, _ = flown(RING, 25.0, recorded=(1.0, 0.8, 1.2), throttle=0.8)
    assert np.mean(several > 20.0) <= np.mean(one > 20.0) + 0.05
    assert np.median(several) < 2.0


def test_a_recording_without_other_noise_leaves_the_confidence():
    """Few rotors, and more microphones than rotors: what whitening adds to the covariance is added to what judges it, too."""
    _, confidences = flown(RING, 10.0)
    assert np.mean(confidences > 0.9) > 0.9


class HissingRig(FlyingRig):
    """Propellers as recorded on a bench: lines have a tenth of the power, and the level of each rotor varies by 1 dB."""

    def alone(self, rng, seconds, throttle=1.0):
        self.hiss = np.full(4, 3.0)
        parts = []
        for _ in range(max(1, round(seconds))):
            self.gains = 10.0 ** (rng.normal(size=4) / 20.0)
            parts.append(super().alone(rng, min(seconds, 1.0), throttle))
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def test_rotors_that_hiss_and_vary_leave_the_confidence():
    """What whitening leaves of them raises all bands a little, and a target raises them far more."""
    errors, confidences = flown(RING, 15.0, rotors=HissingRig)
    assert np.max(errors) < 5.0
    assert np.mean(confidences > 0.9) > 0.9


def test_the_varying_rig_alone_is_no_source():
    _, confidences = flown(RING, 70.0, rotors=HissingRig)
    assert np.mean(confidences > 0.9) < 0.1


@pytest.mark.parametrize('method', ['ml', 'music', 'mvdr'])
def test_silence_in_a_recording_is_no_throttle(recording, method):
    """As of an editor: its covariance of 0 would whiten everything, to confidences that are no numbers."""
    padded = recording._replace(samples=np.concatenate([np.zeros((3 * RATE, 2), np.float32), recording.samples]))
    rng = np.random.default_rng(2)
    assert np.mean(errors(rig_alone(rng) + np.sqrt(0.5) * target(rng), method, padded) < 8.0) > 0.9
    noise = 0.1 * rng.normal(size=(RATE, 2))
    estimates = Localizer(PAIR, RATE, LocalizerSettings(method=method), padded).process(noise, 0)
    assert all(np.isfinite(estimate.confidence).all() for estimate in estimates)
    with pytest.raises(ValueError, match='not silent'):
        padded.windows(10 * len(padded.samples))


def test_a_knock_in_a_recording_costs_no_confidence():
    """It is no throttle, and its peak is none of the rig."""
    rng = np.random.default_rng(13)
    rig = FlyingRig(WIDE_PAIR, rng)
    alone = rig.alone(rng, 10.0)[0]
    knocked = alone.copy()
    blow = rng.normal(size=FLYING_RATE) * np.exp(-np.arange(FLYING_RATE) / 800.0)
    knocked[2 * FLYING_RATE:3 * FLYING_RATE] += 20.0 * alone.std() * blow[:, None] * [1.0, 0.6]
    localizers = [Localizer(WIDE_PAIR, FLYING_RATE, LocalizerSettings(hop_s=0.5), NoiseRecording(
        each.astype(np.float32), FLYING_RATE)) for each in (alone, knocked)]
    sounds = [rig.hears(rng, rng.normal(size=FLYING_RATE // 2), rng.uniform(-np.pi, np.pi), 12.0)[0] for _ in range(20)]
    plain, disturbed = (np.mean([one.process(sound, one.next_sample + FLYING_RATE)[0].confidence[0] > 0.9
                                 for sound in sounds]) for one in localizers)
    assert disturbed >= plain - 0.1 > 0.5


@pytest.mark.parametrize(('array', 'rigs'), [(WIDE_PAIR, 3), (RING, 1)], ids=['pair', 'ring'])
def test_a_rig_alone_hears_hardly_anything(array, rigs):
    """What whitening leaves of own noise has its own places: neither the highest peak there nor the next one is a source."""
    rng, strongest, further = np.random.default_rng(12), [], []
    for _ in range(rigs):
        rig = FlyingRig(array, rng)
        recording = NoiseRecording(rig.alone(rng, 10.0)[0].astype(np.float32), FLYING_RATE)
        estimates = Localizer(array, FLYING_RATE, LocalizerSettings(hop_s=0.5), recording).process(rig.alone(rng, 15.0)[0], 0)
        strongest += [max(estimate.confidence) for estimate in estimates]
        further += [max(one.confidence) for estimate in estimates for one in estimate.further]
    assert np.mean(np.array(strongest) > 0.3) < 0.15
    assert np.sum(np.array(further) > 0.3) < 0.15 * len(strongest)


