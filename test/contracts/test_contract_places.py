"""Hearing and fusing in rooms of pyroomacoustics, which share no code with the suite, and between measured ears."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most, within
from formula_rig import START, Source, never, unit
from formula_sound import PAIR, RATE, SPEED, band_noise, directions_of, frames, hearing, listen, rotors, strongest, with_noise
from judged_rig import FormulaRig, rms
from real_recordings import moving_drone, needs_data
from scipy.signal import fftconvolve

from av_common.microphone_array import DelayCurve, MicrophoneArray
from av_common.stamps import to_seconds

ROOMS, T60_S, DISTANCE_M, RATIO_DB = 24, 0.4, 3.0, 10.0
LINE = MicrophoneArray([[0.0, y, 0.0] for y in (0.1, 0.06, 0.0, -0.02, -0.1)], 'line')
EARS_M = 0.0875                                     # radius of a head, to which Woodworth's formula belongs


class Room:
    """Sound (n, m) of microphones in a shoebox room of random size, at a random place and heading.

    Parameters:
        seed: of everything.
        seconds: of sound, after 0.6 s in which the room fills.
        microphones: the array.
    """

    def __init__(self, seed: int, seconds: float = 1.5, microphones: MicrophoneArray = PAIR) -> None:
        pyroomacoustics = pytest.importorskip('pyroomacoustics')
        rng = np.random.default_rng([6, seed])
        while True:
            size = rng.uniform([5.0, 4.5, 2.6], [9.0, 7.0, 3.6])
            place = rng.uniform([1.0, 1.0, 1.2], [size[0] - 1.0, size[1] - 1.0, 1.6])
            self.azimuth, yaw = np.degrees(rng.uniform(-np.pi, np.pi, 2))
            source = place + DISTANCE_M * unit(self.azimuth + yaw, rng.uniform(0.0, 6.0))
            if (source > 0.4).all() and (source < size - 0.4).all():
                break
        absorption, order = pyroomacoustics.inverse_sabine(T60_S, size)
        box = pyroomacoustics.ShoeBox(size, fs=RATE, materials=pyroomacoustics.Material(absorption), max_order=min(order, 14))
        box.set_sound_speed(SPEED)
        box.add_source(source)
        c, s = unit(yaw)[:2]
        box.add_microphone_array((place + microphones.positions @ [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]).T)
        box.compute_rir()
        count, fills = round((seconds + 0.6) * RATE), round(0.6 * RATE)
        dry = (rotors, band_noise)[seed % 2](rng, count)
        self.sound = with_noise(rng, np.stack([fftconvolve(dry, each[0])[fills:count] for each in box.rir], axis=1), RATIO_DB)

    @property
    def cosine(self) -> float:
        """True cosine to the axis of microphones on the y axis, of a level source."""
        return math.sin(math.radians(self.azimuth))


def phat(window) -> float:
    """Cosine of the maximum of the generalised cross-correlation with phase transform (Knapp and Carter, 1976)."""
    count = 2 * len(window)
    left, right = np.fft.rfft(window, count, axis=0).T
    cross = left * np.conj(right)
    correlation = np.fft.irfft(cross / np.maximum(np.abs(cross), 1e-12), 8 * count)
    most = 0.2 / SPEED * RATE * 8
    lags = np.arange(-math.floor(most), math.floor(most) + 1)
    return -float(lags[np.argmax(correlation[lags])]) / most


def apart(cosine: float, truth: float) -> float:
    """Angle (deg) between cones of two cosines."""
    return abs(math.degrees(math.asin(min(max(cosine, -1.0), 1.0)) - math.asin(truth)))


@pytest.fixture(scope='module')
def windows():
    """Of all rooms: error (deg), error over sigma, and confidence by the stage; error of GCC-PHAT of the same samples."""
    rows = []
    for seed in range(ROOMS):
        room = Room(seed)
        for message in directions_of(hearing(PAIR, hop=0.5), room.sound):
            first = round((to_seconds(message.header.stamp) - START - 0.25) * RATE)
            strong = message.hypotheses[0] if message.hypotheses else None
            error, sigmas, confidence = (90.0, 0.0, 0.0) if strong is None else (
                apart(strong.cosine, room.cosine), abs(strong.cosine - room.cosine) / math.sqrt(strong.cosine_variance),
                strong.confidence)
            rows.append((error, sigmas, confidence, apart(phat(room.sound[first:first + RATE // 2]), room.cosine)))
    return np.array(rows)


def test_in_rooms_directions_are_no_worse_than_those_of_phat(contract, windows):
    """The same samples, whole band."""
    error, _, _, plain = windows.T
    contract(at_most('median over that of GCC-PHAT', float(np.median(error) / np.median(plain)), 1.0),
             at_most('beyond 20 deg, above the share of GCC-PHAT', float(np.mean(error > 20.0) - np.mean(plain > 20.0)), 0.0))


def test_in_rooms_the_sigma_of_what_passes_is_honest(contract, windows):
    """1.64 sigma are 90 % of a Gaussian's errors; a reflection that is taken for the source spoils it."""
    _, sigmas, confidence, _ = windows.T
    contract(at_least('within 1.64 sigma', float(np.mean(sigmas[confidence > 0.3] < 1.64)), 0.8))


def test_in_rooms_the_sigma_of_a_line_is_honest(contract):
    """Five microphones average noise, and not what reflects their source from elsewhere."""
    sigmas = []
    for seed in range(ROOMS):
        room = Room(seed, 1.5, LINE)
        heard = [message.hypotheses[0] for message in directions_of(hearing(LINE, hop=0.5), room.sound)]
        sigmas += [abs(strong.cosine - room.cosine) / math.sqrt(strong.cosine_variance) for strong in heard
                   if strong.confidence > 0.3]
    contract(at_least('within 1.64 sigma', float(np.mean(np.array(sigmas) < 1.64)), 0.8),
             at_least('that pass', len(sigmas) / (3 * ROOMS), 0.5))


def test_in_rooms_reflections_are_no_further_sources(contract):
    """One source before eight microphones, which resolve more of its reflections than a pair."""
    ring = MicrophoneArray([[0.1 * math.cos(a), 0.1 * math.sin(a), 0.0] for a in np.arange(8) * math.pi / 4.0], 'ring')
    heard = [message for seed in range(ROOMS // 2)
             for message in directions_of(hearing(ring, hop=0.5), Room(seed, 1.0, ring).sound)]
    more = [any(image.ambiguity_group > 0 and image.confidence > 0.3 for image in message.hypotheses) for message in heard]
    contract(at_most('with a further source', float(np.mean(more)), 0.1))


@pytest.mark.xfail(strict=False, reason='13 % of what passes')
def test_in_rooms_what_is_wrong_does_not_pass(contract, windows):
    """A wrong window is one beyond 20 deg: at most 3 % of those that pass may be."""
    error, _, confidence, _ = windows.T
    contract(at_most('beyond 20 deg, of what passes', float(np.mean(error[confidence > 0.3] > 20.0)), 0.03))


def test_in_rooms_a_confidence_is_no_less_than_it_says(contract, windows):
    """Of what passes any confidence, as many are wrong as the confidences state, or fewer."""
    error, _, confidence, _ = windows.T
    for least in (0.3, 0.5, 0.7, 0.9):
        passed = confidence >= least
        contract(at_most(f'beyond 20 deg, of what passes {least:g}, less what is stated',
                         float(np.mean(error[passed] > 20.0) - np.mean(1.0 - confidence[passed])), 0.0))


def test_in_rooms_fusing_is_no_worse_than_a_window(contract, windows):
    """A source and a rig at rest for 4 s: the bearing, mirror images folded, is at least as good as the median window.

    Half of the sources are noise, which is no drone: what they are is not judged here.
    """
    errors, normalised = [], []
    for seed in range(ROOMS // 2):
        room = Room(seed, 3.5)
        rig = listen(PAIR, room.sound, FormulaRig([Source.at(room.azimuth, 3.0)], sound=never, sight=never), drone_model='none')
        errors += list(np.abs(rig.errors(2.0, folded=True)))
        normalised += list(rig.normalised(2.0, 0.5, folded=True))
    contract(at_most('median', float(np.median(errors)), float(np.median(windows[:, 0])), 'deg'),
             at_least('within 2 sigma', float(np.mean(np.array(normalised) < 4.0)), 0.8))


@needs_data
@pytest.mark.parametrize('head', ['by the formula', 'free field'])
def test_a_recorded_drone_between_measured_ears(contract, tmp_path, head):
    """It moves from -60 to 60 deg at 12.5 deg/s. The path around a sphere (Woodworth, 1938) is a (angle + sin angle).

    Without it two free microphones 0.2 m apart stand for the head, which is right within 3 deg.
    """
    soundfile = pytest.importorskip('soundfile')
    azimuths = np.arange(-60.0, 61.0, 10.0)
    moving_drone(tmp_path / 'drone.wav', azimuths, 0.8)
    sound, rate = soundfile.read(tmp_path / 'drone.wav')
    lateral = np.radians(np.linspace(-90.0, 90.0, 37))
    ears = PAIR if head == 'free field' else MicrophoneArray(
        [[0.0, EARS_M, 0.0], [0.0, -EARS_M, 0.0]], 'ears', DelayCurve(np.sin(lateral), 0.5 * (lateral + np.sin(lateral)), 0.05))

    def truth(t):
        return float(np.interp(t, 0.8 * np.arange(len(azimuths)), azimuths))
    stage = hearing(ears)
    errors = [strongest(message, truth(to_seconds(message.header.stamp) - START))[0] for frame in frames(sound, rate=rate)
              for message in stage.on_audio(frame, to_seconds(frame.header.stamp))]
    assert not stage.faults
    rig = listen(ears, sound, FormulaRig([Source(lambda t: unit(truth(t)))], sound=never, sight=never), rate)
    fused = np.abs(rig.errors(1.5, folded=True))
    most = 1.5 if head == 'by the formula' else 3.0
    contract(at_most(f'{head}: windows, median', float(np.median(np.abs(errors))), most, 'deg'),
             at_most(f'{head}: bearing, median', float(np.median(fused)), 3.0, 'deg'),
             within(f'{head}: bearing, mean normalised square', float(rig.normalised(1.5, 0.5, folded=True).mean()), 0.05, 1.5),
             at_least(f'{head}: followed', rig.followed(1.5), 1.0))
    assert rms(fused) < 6.0
