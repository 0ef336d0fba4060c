"""Sound at microphones by formulas, and the hearing stage that is fed with it."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from formula_rig import START, wrapped
from judged_rig import FormulaRig
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import resample
from std_msgs.msg import Header

from av_audio.stage import DoaStage, make_doa_stage
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import AudioFrame, DoaArray

RATE, BLOCK, SPEED = 48_000, 1600, 343.2        # Hz, samples, m/s at 20 degrees Celsius
BAND = (200.0, 4000.0)                          # Hz, in which signal-to-noise ratios are given
MARGIN = 2400                                   # samples of sound before and after
PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'pair')
SQUARE = MicrophoneArray([[x, y, 0.0] for x, y in ((0.06, 0.06), (0.06, -0.06), (-0.06, -0.06), (-0.06, 0.06))], 'square')
EIGHT = MicrophoneArray([[x, y, z] for x in (0.06, -0.06) for y in (0.06, -0.06) for z in (0.06, -0.06)], 'eight')

# From random numbers and a number of samples to the sound (n,) of a source.
Voice = Callable[[Generator, int], NDArray]


def band_noise(rng: Generator, count: int, slope: float = 0.0, band: tuple[float, float] = BAND) -> NDArray:
    """Gaussian noise in a band whose power falls as frequency to the power of `slope`."""
    frequencies = np.fft.rfftfreq(count, 1.0 / RATE)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    amplitudes = np.where(inside, np.maximum(frequencies, 1.0) ** (-0.5 * slope), 0.0)
    sound = np.fft.irfft(amplitudes * (rng.normal(size=(2, inside.size)).T @ [1.0, 1j]), count)
    return sound / sound.std()


def rotors(rng: Generator, count: int) -> NDArray:
    """Four rotors of two blades near 90 turns/s whose speeds wander by 0.5 %, with noise of the blades 10 dB below."""
    time, sound = np.arange(count) / RATE, 0.0
    for _ in range(4):
        turns = rng.uniform(170.0, 195.0)
        phase = 2.0 * np.pi * (turns * time + 0.005 * turns / 1.3 * np.sin(1.3 * time + rng.uniform(0.0, 6.0)))
        for k in range(1, 22):
            sound = sound + k**-0.6 * np.cos(k * phase + rng.uniform(0.0, 2.0 * np.pi))
    return sound / np.std(sound) + 0.3 * band_noise(rng, count, 1.0, (100.0, 6000.0))


def harmonics(rng: Generator, count: int, pitch: float, orders: int, wander: float = 0.02) -> NDArray:
    """Harmonics of a pitch (Hz) that wanders by a share of it, the n-th with 1 / n of the amplitude, and nothing between."""
    time = np.arange(count) / RATE
    phase = 2.0 * np.pi * pitch * (time + 0.5 * wander * np.sin(2.0 * time + rng.uniform(0.0, 6.0)))
    sound = sum(k**-1.0 * np.cos(k * phase + rng.uniform(0.0, 2.0 * np.pi)) for k in range(1, orders + 1))
    return sound / np.std(sound)


def comb(rng: Generator, count: int) -> NDArray:
    """An engine: harmonics of 40 Hz that wander by 2 %."""
    return harmonics(rng, count, 40.0, 59)


def wing_beat(rng: Generator, count: int) -> NDArray:
    """An insect: harmonics of 230 Hz that wander by 2 %."""
    return harmonics(rng, count, 230.0, 15)


def propeller(rng: Generator, count: int) -> NDArray:
    """One propeller of two blades, 105 turns/s within 0.1 %: harmonics, each 3 dB weaker, and noise of the blades."""
    time = np.arange(count) / RATE
    turns = 105.0 * time + 0.05 * np.sin(2.0 * time + rng.uniform(0.0, 6.0))
    tone = sum(10.0 ** (-0.15 * k) * np.cos(4.0 * np.pi * k * turns + rng.uniform(0.0, 2.0 * np.pi)) for k in range(1, 16))
    air = band_noise(rng, count, 0.5, (400.0, 7000.0)) * (1.0 + 0.5 * np.cos(4.0 * np.pi * turns))
    return tone / np.std(tone) + 0.4 * air / np.std(air)


def siren(rng: Generator, count: int) -> NDArray:
    """A tone with overtones between 600 and 1300 Hz, every 2 s."""
    time = np.arange(count) / RATE
    phase = np.cumsum(950.0 + 350.0 * np.sin(np.pi * time + rng.uniform(0.0, 6.0))) * 2.0 * np.pi / RATE
    return np.cos(phase) + 0.3 * np.cos(2.0 * phase) + 0.1 * np.cos(3.0 * phase)


def heard(sound: NDArray, microphones: MicrophoneArray, directions: NDArray) -> NDArray:
    """Sound (n, m) of a far source at the microphones, which hear it earlier the closer they are to it.

    Parameters:
        sound (n + 2 * MARGIN,): at the centre of the array.
        microphones: their positions are in the array's frame.
        directions (3,) or (n, 3): unit vectors to the source in the array's frame, one or at each sample.
    """
    fine = resample(sound, 4 * len(sound))
    spline = CubicSpline((np.arange(len(fine)) / 4.0 - MARGIN) / RATE, fine)
    time = np.arange(len(sound) - 2 * MARGIN) / RATE
    return spline(time[:, np.newaxis] + np.atleast_2d(directions) @ microphones.positions.T / SPEED)


def hum(rng: Generator, count: int) -> NDArray:
    """A rotor near 95 turns/s whose speed wanders by 1.5 %, with two blades and as much noise of the air."""
    time = np.arange(count) / RATE
    knots = np.linspace(0.0, time[-1], round(3.0 * time[-1]) + 2)
    turns = rng.uniform(80.0, 110.0) * np.cumsum(1.0 + 0.015 * np.interp(time, knots, rng.normal(size=len(knots)))) / RATE
    tone = sum(k**-0.8 * np.cos(4.0 * np.pi * k * turns + rng.uniform(0.0, 2.0 * np.pi)) for k in range(1, 30))
    air = band_noise(rng, count, 1.0, (100.0, 10_000.0)) * (1.0 + 0.5 * np.cos(4.0 * np.pi * turns))
    return tone / np.std(tone) + air


def rattle(rng: Generator, count: int) -> NDArray:
    """A wheel on gravel: 400 blows a second, each of 1 ms, and the whine of its gear."""
    blows = np.zeros(count)
    np.add.at(blows, rng.integers(0, count, count * 400 // RATE), rng.normal(size=count * 400 // RATE))
    stones = np.convolve(blows, np.exp(-np.arange(300) / 50.0) * np.cos(0.2 * np.arange(300)))[:count]
    gear = wing_beat(rng, count)
    return stones / stones.std() + 0.5 * gear


def flaps(rng: Generator, count: int) -> NDArray:
    """A loose sheet in the wind: six flaps a second, each of 15 ms, over a hiss that is 10 dB quieter."""
    blows, number = np.zeros(count), max(1, count * 6 // RATE)
    np.add.at(blows, rng.integers(0, count, number), rng.exponential(size=number))
    bursts = np.convolve(blows, np.exp(-np.arange(round(0.05 * RATE)) / (0.015 * RATE)))[:count] * rng.normal(size=count)
    return bursts / bursts.std() + 0.3 * rng.normal(size=count)


def rig_alone(voice: Voice, microphones: MicrophoneArray, seed: int, seconds: float, parts: int = 4) -> tuple[NDArray, NDArray]:
    """Two pieces (n, m) of the sound of a rig's rotors, wheels or sheets, at other times, with 1 % of noise of each microphone.

    Parameters:
        voice: of one of them; each is about as loud, and its level varies by 1 dB from second to second.
        microphones: they are amid the parts, which are 0.2 to 0.35 m away and below.
        seed: of the rig.
        seconds: of each piece.
        parts: at the first so many of four corners.
    """
    rng, count = np.random.default_rng([seed, 44]), round(2.0 * seconds * RATE)
    arm, turn, sound = rng.uniform(0.2, 0.35), rng.uniform(-0.1, 0.1), np.zeros((count, microphones.channels))
    time = np.arange(count) / RATE
    for corner in range(parts):
        angle = 0.5 * math.pi * corner + 0.25 * math.pi + turn
        place = np.array([arm * math.cos(angle), arm * math.sin(angle), -0.1])
        distances = np.linalg.norm(microphones.positions - place, axis=1)
        level = np.interp(time, np.arange(0.0, 2.0 * seconds + 2.0), rng.normal(size=round(2.0 * seconds) + 2))
        spline = CubicSpline((np.arange(count + 2 * MARGIN) - MARGIN) / RATE, voice(rng, count + 2 * MARGIN))
        sound += 10.0 ** (0.05 * (level + rng.normal()))[:, np.newaxis] * spline(
            time[:, np.newaxis] - distances / SPEED) / distances
    sound += 0.01 * sound.std() * rng.normal(size=sound.shape)
    sound = (0.05 / sound.std() * sound).astype(np.float32)
    return sound[:count // 2], sound[count // 2:]


def band_power(sound: NDArray) -> float:
    """Power (of the first channel) in BAND."""
    frequencies = np.fft.rfftfreq(len(sound), 1.0 / RATE)
    inside = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    return float(np.sum(np.abs(np.fft.rfft(sound[:, 0])[inside]) ** 2))


def with_noise(rng: Generator, sound: NDArray, ratio_db: float) -> NDArray:
    """Sound (n, m) with white noise of each microphone, by the ratio of powers in BAND; at -26 dB of full scale."""
    noise = rng.normal(size=sound.shape)
    mixed = sound + math.sqrt(band_power(sound) / band_power(noise) * 10.0 ** (-0.1 * ratio_db)) * noise
    return (0.05 / mixed.std() * mixed).astype(np.float32)


def hearing(microphones: MicrophoneArray, **parameters: Any) -> DoaStage:
    """The hearing stage with doa_node's parameters."""
    return make_doa_stage(node_parameters('av_audio', 'doa_node', overrides=parameters), microphones)


def frames(sound: NDArray, first: int = 0, begin: float = 0.0, rate: int = RATE) -> Iterator[AudioFrame]:
    """The messages of a sound (n, m) whose first sample was captured `begin` s after the start."""
    for at in range(0, len(sound), BLOCK):
        block = np.ascontiguousarray(sound[at:at + BLOCK], np.float32)
        yield AudioFrame(header=Header(stamp=to_stamp(START + begin + at / rate), frame_id='microphones'), sample_rate=rate,
                         channels=block.shape[1], first_sample=first + at, samples=array('f', block.tobytes()))


def directions_of(stage: DoaStage, sound: NDArray, **options: Any) -> list[DoaArray]:
    """All messages of a sound (n, m); each block arrives when it is complete."""
    return [message for frame in frames(sound, **options)
            for message in stage.on_audio(frame, to_seconds(frame.header.stamp) + BLOCK / RATE)]


def strongest(message: DoaArray, truth_deg: float) -> tuple[float, float, float] | None:
    """Error (deg), sigma (deg) and confidence of the strongest source's image that is nearest to the truth; None without."""
    images = [image for image in message.hypotheses if image.ambiguity_group == 0]
    if not images:
        return None
    best = min(images, key=lambda image: abs(wrapped(math.degrees(image.azimuth) - truth_deg)))
    return (wrapped(math.degrees(best.azimuth) - truth_deg), math.degrees(math.sqrt(best.azimuth_variance)), best.confidence)


def listen(microphones: MicrophoneArray, sound: NDArray, rig: FormulaRig, rate: int = RATE, **parameters: Any) -> FormulaRig:
    """Hear a sound (n, m) and fuse what is heard, on a rig whose own sensors are silent; returns the rig.

    Parameters:
        microphones: the array.
        sound: of its channels, from the start of the rig on.
        rig: gives the attitude and takes the directions as they come.
        rate (Hz): of the samples.
        parameters: of doa_node that differ from the defaults.
    """
    stage, waiting = hearing(microphones, **parameters), frames(sound, rate=rate)
    frame = next(waiting, None)
    for _ in rig.steps(len(sound) / rate):
        while frame is not None and to_seconds(frame.header.stamp) - START + BLOCK / rate <= rig.now + 1e-9:
            for message in stage.on_audio(frame, START + rig.now):
                rig.give('doa', message, rig.now)
            frame = next(waiting, None)
    return rig
