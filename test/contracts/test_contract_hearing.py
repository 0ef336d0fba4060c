"""The hearing stage, and fusion of what it hears, by sound of formulas: directions, sigma, turns, gaps, no drones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most
from formula_rig import START, Source, never, unit, wrapped
from formula_sound import (
    BLOCK,
    EIGHT,
    MARGIN,
    PAIR,
    RATE,
    SQUARE,
    band_noise,
    band_power,
    comb,
    directions_of,
    flaps,
    frames,
    harmonics,
    heard,
    hearing,
    hum,
    listen,
    propeller,
    rattle,
    rig_alone,
    rotors,
    siren,
    strongest,
    wing_beat,
    with_noise,
)
from judged_rig import FormulaRig, rms
from real_recordings import CLIPS, needs_data
from scipy.signal import resample_poly
from scipy.spatial.transform import Rotation

from av_common.stamps import to_seconds

ARRAYS = {'pair': PAIR, 'square': SQUARE, 'eight': EIGHT}
PASSES = 0.3        # confidence from which fusion uses a direction: the default of its parameter
LOBE_DEG = 12.0     # of the pair at 4 kHz, wavelength over spacing; the others' apertures are alike


def quiet(sources, **options):
    """A rig whose own sensors say nothing."""
    return FormulaRig(sources, sound=never, sight=never, **options)


@pytest.mark.parametrize(('array', 'ratio_db', 'share'), [
    ('pair', 10.0, 0.1), ('square', 10.0, 0.1), ('eight', 10.0, 0.1), ('pair', 0.0, 0.2), ('square', 0.0, 0.2)])
def test_each_array_finds_a_direction_with_its_sigma(contract, array, ratio_db, share):
    """Rotors from anywhere, level: within a tenth of the main lobe at +10 dB, a fifth at 0 dB; and 95 % within 1.96 sigma."""
    found, microphones = [], ARRAYS[array]
    for seed in range(2 if array == 'eight' else 6):
        rng = np.random.default_rng([3, seed])
        azimuth = rng.uniform(-60.0, 60.0) if array == 'pair' else rng.uniform(-180.0, 180.0)
        sound = heard(rotors(rng, 2 * RATE + 2 * MARGIN), microphones, unit(azimuth, 0.0 if array == 'pair' else 10.0))
        found += [strongest(message, azimuth) for message in directions_of(hearing(microphones, hop=0.5),
                                                                           with_noise(rng, sound, ratio_db))]
    errors, sigmas, confidences = np.array(found).T
    contract(at_most('error, RMS', rms(errors), share * LOBE_DEG, 'deg'),
             at_least('within 1.96 sigma', float(np.mean(np.abs(errors) < 1.96 * sigmas)), 0.85),
             at_least('passing', float(np.mean(confidences > PASSES)), 0.95))


def test_noise_of_the_microphones_has_no_direction(contract):
    """Independent in each channel: nothing is there to be heard."""
    rng = np.random.default_rng(2)
    passing = [any(image.confidence > PASSES for image in message.hypotheses) for microphones in (PAIR, SQUARE)
               for message in directions_of(hearing(microphones, hop=0.25),
                                            (0.05 * rng.normal(size=(6 * RATE, microphones.channels))).astype(np.float32))]
    contract(at_most('passing', float(np.mean(passing)), 0.05))


@pytest.mark.parametrize('azimuth', [84.0, 90.0, -95.0])
def test_close_to_the_axis_of_a_pair_the_sigma_says_so(contract, azimuth):
    """The cosine is flat there: 3 deg off the axis it changes by a thousandth."""
    inside = []
    for seed in range(4):
        rng = np.random.default_rng([4, seed])
        sound = with_noise(rng, heard(rotors(rng, RATE + 2 * MARGIN), PAIR, unit(azimuth)), 5.0)
        for message in directions_of(hearing(PAIR, hop=0.25), sound):
            error, sigma, _ = strongest(message, azimuth)
            inside.append(abs(error) < 2.5 * sigma)
            image = message.hypotheses[0]
            assert image.end_fire and -1.0 <= image.cosine <= 1.0 and abs(message.axis.y) == 1.0
    contract(at_least('within 2.5 sigma', float(np.mean(inside)), 0.85))


@pytest.mark.parametrize(('array', 'azimuths', 'least'), [('pair', (-40.0, 20.0), 0.7), ('square', (-110.0, 20.0), 0.8)])
def test_two_sources_have_two_directions(contract, array, azimuths, least):
    """Equally loud, further apart than the main lobe."""
    found, microphones = [], ARRAYS[array]
    for seed in range(6):
        rng = np.random.default_rng([5, seed])
        parts = [heard(rotors(rng, RATE + 2 * MARGIN), microphones, unit(azimuth)) for azimuth in azimuths]
        sound = with_noise(rng, sum(part / part.std() for part in parts), 15.0)
        for message in directions_of(hearing(microphones, hop=0.25), sound):
            found += [any(abs(wrapped(math.degrees(image.azimuth) - azimuth)) < 8.0 for image in message.hypotheses)
                      for azimuth in azimuths]
    contract(at_least('found', float(np.mean(found)), least))


@pytest.mark.parametrize('fault', ['inverted', 'dead', 'a copy'])
def test_a_channel_at_fault_costs_only_itself(contract, fault):
    """Channel 1 of a square, or of a pair: within 2 s the others go on without it, and one alone has no direction."""
    passing, errors = [], []
    for microphones, azimuth in ((SQUARE, -110.0), (PAIR, -35.0)):
        rng = np.random.default_rng(15)
        sound = with_noise(rng, heard(rotors(rng, 6 * RATE + 2 * MARGIN), microphones, unit(azimuth)), 10.0)
        sound[:, 1] = {'inverted': -sound[:, 1], 'dead': 0.0 * sound[:, 1], 'a copy': sound[:, 0]}[fault]
        messages = directions_of(hearing(microphones, hop=0.25), sound)
        late = [strongest(message, azimuth) for message in messages if to_seconds(message.header.stamp) > START + 2.5]
        passing.append(float(np.mean([confidence > PASSES for _, _, confidence in late])))
        errors.append([error for error, _, _ in late])
    contract(at_most('error, RMS', rms(errors[0]), 0.1 * LOBE_DEG, 'deg'), at_least('passing', passing[0], 0.95),
             at_most('passing of a pair', passing[1], 0.0))


@pytest.mark.parametrize('array', ['pair', 'square', 'eight'])
@pytest.mark.parametrize('channels', [slice(None), slice(1)], ids=['all', 'one'])
def test_a_gain_that_is_too_high_hides_nothing(contract, array, channels):
    """20 dB over full scale at all microphones or at one. What cuts off by the level alone delays nothing (Van Vleck, 1966)."""
    found, microphones = [], ARRAYS[array]
    for seed in range(2):
        rng = np.random.default_rng([16, seed])
        azimuth = rng.uniform(-60.0, 60.0)
        sound = with_noise(rng, heard(rotors(rng, 2 * RATE + 2 * MARGIN), microphones, unit(azimuth, 0.0)), 10.0)
        sound[:, channels] *= 10.0 / sound.std()
        found += [strongest(message, azimuth) for message in directions_of(hearing(microphones, hop=0.25),
                                                                           np.clip(sound, -1.0, 1.0 - 2.0**-15))]
    errors, sigmas, confidences = np.array(found).T
    contract(at_most('error, RMS', rms(errors), 0.1 * LOBE_DEG, 'deg'),
             at_least('within 1.96 sigma', float(np.mean(np.abs(errors) < 1.96 * sigmas)), 0.85),
             at_least('passing', float(np.mean(confidences > PASSES)), 0.95))


def test_a_gap_is_not_bridged():
    """0.7 s of frames are lost: stamps stay those of the capture, and no window is made of both sides."""
    rng = np.random.default_rng(6)
    sound = with_noise(rng, heard(rotors(rng, 3 * RATE + 2 * MARGIN), PAIR, unit(30.0)), 15.0)
    stage, centres = hearing(PAIR), []
    for number, frame in enumerate(frames(sound)):
        if not 1.0 <= number * BLOCK / RATE < 1.7:
            messages = stage.on_audio(frame, to_seconds(frame.header.stamp) + 0.03)
            assert all(abs(strongest(message, 30.0)[0]) < 1.5 for message in messages)
            centres += [to_seconds(message.header.stamp) - START for message in messages]
    assert max(centre for centre in centres if centre < 1.5) <= 0.75 + 1e-3
    assert min(centre for centre in centres if centre > 1.0) >= 1.95 - 1e-3
    assert len(centres) > 10


@pytest.mark.parametrize(('rate', 'most'), [(80.0, 3.3), (120.0, 13.0)])
def test_a_turning_rig_hears_as_well_as_in_single_windows(contract, rate, most):
    """White noise at -5 dB, turning evenly: known from windows alone are 2.2 and 10.1 deg, here of 20 independent ones.

    A stage that is new for each window cannot know of the ones before.
    """
    rng, count = np.random.default_rng(5), 10 * RATE
    azimuth = 20.0 - rate * np.arange(count) / RATE
    towards = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0 * azimuth], axis=1)
    sound = with_noise(rng, heard(band_noise(rng, count + 2 * MARGIN), PAIR, towards), -5.0)

    def errors(messages):
        found = {}
        for message in messages:
            t = to_seconds(message.header.stamp) - START
            truth = math.asin(math.sin(math.radians(20.0 - rate * t)))
            found[round(t, 2)] = math.degrees(math.asin(message.hypotheses[0].cosine) - truth)
        return found
    stream = errors(directions_of(hearing(PAIR), sound))
    alone = errors([message for first in range(0, count - RATE // 2, RATE // 5) for message in directions_of(
        hearing(PAIR), sound[first:first + RATE // 2], begin=first / RATE)])
    same = rms([stream[t] for t in alone]) / rms(list(alone.values()))
    contract(at_most('error, RMS', rms(list(stream.values())), most, 'deg'),
             at_most('error over that of windows alone', same, 1.1))


def test_fusing_on_a_turning_rig_is_no_worse_than_its_windows(contract):
    """80 deg/s at 0 dB with odometry: a source at rest in the world stays there, though each window hears it elsewhere."""
    rng, count, rate = np.random.default_rng(7), 8 * RATE, 80.0
    azimuth = 20.0 - rate * np.arange(count) / RATE
    towards = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), np.full(count, 0.17)], axis=1)
    towards /= np.linalg.norm(towards, axis=1)[:, np.newaxis]
    sound = with_noise(rng, heard(rotors(rng, count + 2 * MARGIN), PAIR, towards), 0.0)
    rig = listen(PAIR, sound, quiet([Source.at(20.0, 10.0)],
                                    attitude=lambda t: Rotation.from_euler('z', rate * t, degrees=True)))
    world = [wrapped(math.degrees(moment.bearing.azimuth_world) - 20.0) for moment in rig.following(3.0)]
    contract(at_most('error in the world, RMS', rms(world), 4.0, 'deg'), at_least('followed', rig.followed(3.0), 0.98),
             at_least('resolved', float(np.mean([moment.bearing.resolved for moment in rig.between(3.0)])), 0.95))


@pytest.mark.parametrize('array', ['pair', 'square'])
def test_rotors_are_heard_and_followed(contract, array):
    """At rest in front, 10 deg up, +10 dB: from sound to bearing."""
    rng, microphones = np.random.default_rng(8), ARRAYS[array]
    sound = with_noise(rng, heard(rotors(rng, 5 * RATE + 2 * MARGIN), microphones, unit(25.0, 10.0)), 10.0)
    rig = listen(microphones, sound, quiet([Source.at(25.0, 10.0)]))
    contract(at_least('followed', rig.followed(1.5), 1.0),
             at_most('error, RMS', rms(rig.errors(1.5, folded=array == 'pair')), 0.1 * LOBE_DEG, 'deg'))


def white(rng, count):
    return rng.normal(size=count)


def brown(rng, count):
    return band_noise(rng, count, 2.0)


def followed(voice, ratio_db=10.0, seeds=1, seconds=5):
    """Mean share of the time in which a source 25 deg to the left is followed."""
    shares = []
    for seed in range(seeds):
        rng = np.random.default_rng([8, seed])
        sound = with_noise(rng, heard(voice(rng, seconds * RATE + 2 * MARGIN), PAIR, unit(25.0)), ratio_db)
        shares.append(listen(PAIR, sound, quiet([Source.at(25.0)])).followed(1.5))
    return float(np.mean(shares))


@pytest.mark.parametrize('voice', [comb, wing_beat, siren, white, brown])
def test_what_is_no_drone_is_not_followed(contract, voice):
    """A source with a direction, and nothing of a drone: below 5 % of the time."""
    contract(at_most(f'{voice.__name__}: followed', followed(voice), 0.05))


@pytest.mark.parametrize('wander', [0.0, 0.02])
@pytest.mark.parametrize('pitch', [100.0, 150.0, 320.0, 450.0])
def test_a_comb_is_not_followed(contract, pitch, wander):
    """A hum, a whistle: harmonics of one pitch (Hz) that is steady or wanders, and nothing between them."""
    def voice(rng, count):
        return harmonics(rng, count, pitch, int(7000.0 / pitch), wander)
    contract(at_most('followed', followed(voice), 0.05))


def test_one_steady_propeller_is_followed(contract):
    """An aeroplane: one comb as of an engine, but without half orders, steady, and with noise of the blades."""
    contract(at_least('followed', followed(propeller), 0.9))


@pytest.mark.parametrize('array', ['pair', 'square'])
@pytest.mark.parametrize('voice', [hum, rattle])
def test_a_rig_alone_claims_no_more_than_it_promises(contract, tmp_path, voice, array):
    """With its recording. A confidence c of equal odds is a likelihood ratio of c / (1 - c), whose mean without a source is 1.

    So it is 9 or more in at most a ninth of the windows (Markov), and the mean of c is at most a half (Jensen).
    """
    soundfile, found, microphones = pytest.importorskip('soundfile'), [], ARRAYS[array]
    for seed in range(3):
        recorded, flown = rig_alone(voice, microphones, seed, 8.0)
        soundfile.write(tmp_path / 'alone.wav', recorded, RATE, subtype='FLOAT')
        found += [max(image.confidence for image in message.hypotheses) for message in directions_of(
            hearing(microphones, hop=0.5, ego_noise=str(tmp_path / 'alone.wav')), flown)]
    contract(at_most('confidence from 0.9 on', float(np.mean(np.array(found) >= 0.9)), 1.0 / 9.0),
             at_most('mean confidence', float(np.mean(found)), 0.5))


def test_between_bursts_of_own_noise_a_drone_is_heard(contract, tmp_path):
    """With a recording of two loose sheets that are 8 dB louder in the mean: nine of ten directions are in the lobe."""
    soundfile, errors = pytest.importorskip('soundfile'), []
    for seed, azimuth in enumerate((50.0, -20.0, 5.0, -60.0)):
        recorded, flown = rig_alone(flaps, PAIR, seed, 8.0, parts=2)
        soundfile.write(tmp_path / 'alone.wav', recorded, RATE, subtype='FLOAT')
        drone = heard(rotors(np.random.default_rng(seed), len(flown) + 2 * MARGIN), PAIR, unit(azimuth))
        both = flown / math.sqrt(band_power(flown)) + 10.0**-0.4 * drone / math.sqrt(band_power(drone))
        stage = hearing(PAIR, hop=0.5, ego_noise=str(tmp_path / 'alone.wav'))
        found = [strongest(message, azimuth) for message in directions_of(stage, (0.05 * both / both.std()).astype(np.float32))]
        errors += [abs(best[0]) if best else 180.0 for best in found]
    contract(at_most('median error', float(np.median(errors)), 0.5 * LOBE_DEG, 'deg'),
             at_most('beyond a lobe', float(np.mean(np.array(errors) > LOBE_DEG)), 0.1))


@pytest.mark.xfail(strict=False, reason='followed for about 0.2 of the time')
@pytest.mark.parametrize('voice', [hum, rattle])
def test_a_rig_alone_is_not_followed(contract, tmp_path, voice):
    """With its recording, while it turns to and fro: as of what is no drone, below 5 % of the time."""
    soundfile, shares = pytest.importorskip('soundfile'), []
    for seed in range(3):
        recorded, flown = rig_alone(voice, PAIR, seed, 8.0)
        soundfile.write(tmp_path / 'alone.wav', recorded, RATE, subtype='FLOAT')
        rig = quiet([Source.at(25.0)], attitude=lambda t: Rotation.from_euler('z', 30.0 * math.sin(0.8 * t), degrees=True))
        shares.append(listen(PAIR, flown, rig, ego_noise=str(tmp_path / 'alone.wav')).followed(1.5))
    contract(at_most('followed', float(np.mean(shares)), 0.05))


SWAYS = {
    'swings': lambda t: Rotation.from_euler('z', 30.0 * math.sin(0.8 * t), degrees=True),
    'flies': lambda t: Rotation.from_euler('ZYX', [40.0 * math.sin(0.6 * t), 8.0 * math.sin(1.3 * t), 8.0 * math.sin(1.1 * t)],
                                           degrees=True)}


@pytest.mark.parametrize('array', ['pair', 'square'])
@pytest.mark.parametrize('sway', list(SWAYS))
def test_what_turns_with_the_rig_is_not_followed(contract, sway, array):
    """Certain directions at one place of the body, by formulas; those at one place of the world are followed."""
    attitude, own, others = SWAYS[sway], [], []
    for seed, place in enumerate((unit(60.0, -10.0), unit(15.0, 5.0), unit(140.0, -5.0))):
        rig = FormulaRig([Source(lambda t, place=place: attitude(t).apply(place))], sight=never, array=array,
                         attitude=attitude, seed=seed).run(12.0)
        own.append(rig.followed(6.0))
        others.append(FormulaRig([Source.at(50.0 * seed - 70.0, 9.0)], sight=never, array=array, attitude=attitude,
                                 seed=seed).run(12.0).followed(1.5))
        assert 'turns with the rig' in rig.moments[-1].state.reason
    contract(at_most('own sound followed', float(np.mean(own)), 0.05), at_least('others followed', min(others), 1.0))


@pytest.mark.parametrize('array', ['pair', 'square'])
def test_a_turning_rig_with_unknown_rotors_does_not_follow_them(contract, array):
    """Without a recording, alone and 8 dB over a target: from 6 s on for at most half of the time, as a wrong place is."""
    alone, over = [], []
    for seed in range(2):
        own = rig_alone(hum, ARRAYS[array], 20 + seed, 10.0)[1]
        beside = 35.0 - 30.0 * np.sin(0.8 * np.arange(len(own)) / RATE)
        voice = rotors(np.random.default_rng(seed), len(own) + 2 * MARGIN)
        target = heard(voice, ARRAYS[array], np.array([unit(azimuth) for azimuth in beside]))
        both = own / math.sqrt(band_power(own)) + 10.0**-0.4 * target / math.sqrt(band_power(target))
        for sound, found in ((own, alone), (0.05 * both / both.std(), over)):
            rig = listen(ARRAYS[array], sound.astype(np.float32), quiet([Source.at(35.0)], attitude=SWAYS['swings']))
            wrong = np.abs(rig.errors(6.0, folded=array == 'pair')) > 20.0
            found.append(rig.followed(6.0) * (1.0 if sound is own else float(np.mean([*wrong, False]))))
    contract(at_most('alone, followed', float(np.mean(alone)), 0.5),
             at_most('over a target, wrong', float(np.mean(over)), 0.5))


def recording(name):
    """A voice of a recorded clip."""
    soundfile = pytest.importorskip('soundfile')
    samples, rate = soundfile.read(CLIPS / 'audio' / f'{name}.flac', always_2d=True)
    common = math.gcd(rate, RATE)
    sound = resample_poly(samples[:, 0], RATE // common, rate // common)
    return lambda rng, count: np.resize(sound, count)


@needs_data
def test_recorded_drones_are_followed(contract):
    shares = [followed(recording(f'DRONE_{clip}'), 15.0, seconds=4) for clip in ('004', '022')]
    contract(at_least('followed', min(shares), 0.95))


@needs_data
@pytest.mark.parametrize('kind', ['BACKGROUND', 'HELICOPTER'])
def test_recordings_without_a_drone_are_not_followed(contract, kind):
    """From one direction, 15 dB above the noise."""
    shares = [followed(recording(f'{kind}_{clip}'), 15.0, seconds=4) for clip in ('004', '013', '016')]
    contract(at_most(f'{kind}: followed', float(np.mean(shares)), 0.05))
