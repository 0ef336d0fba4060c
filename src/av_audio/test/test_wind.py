"""Wind is told from sound by its coherence, and from noise of circuits by its spectrum."""

import math

import numpy as np
import pytest
from flying_rig import RING, coloured, propagated
from known_sound import PAIR, RATE, rotors
from std_msgs.msg import Header

from av_audio import DoaStage, Localizer, LocalizerSettings, audio_frame
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

SECONDS = 5
COUNT = SECONDS * RATE
FAR = MicrophoneArray([[0.0, 2.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])


def level(sound, array=PAIR):
    stage, first = DoaStage(array, LocalizerSettings(hop_s=float(SECONDS))), 0
    for block in np.array_split(sound.astype(np.float32), 50):
        stage.on_audio(audio_frame(block, first, RATE, Header()), 0.0)
        first += len(block)
    return stage.wind_dbfs


def gusts(rng, channels):
    """Turbulence that each microphone has for itself, in bursts."""
    swell = 1.0 + 0.8 * np.sin(2.0 * np.pi * 0.7 * np.arange(COUNT) / RATE)
    noise = coloured(rng, (COUNT, channels), 7.0 / 6.0, 2.0)
    return 0.05 * noise / noise.std() * swell[:, None] ** 2


def from_a_side(sound, azimuth):
    return propagated(sound, -PAIR.positions @ angles_to_direction(azimuth) / speed_of_sound(20.0))


@pytest.mark.parametrize('array', [PAIR, RING, FAR], ids=['pair', 'ring', 'one far away'])
def test_gusts_are_wind_also_over_a_drone(array):
    rng = np.random.default_rng(1)
    drone = rotors(rng, SECONDS, np.zeros(array.channels))
    assert -60.0 < level(gusts(rng, array.channels), array) < -20.0
    assert level(gusts(rng, array.channels) + 0.01 * drone / drone.std(), array) > -60.0


@pytest.mark.parametrize('slope', [0.0, 0.5], ids=['white', 'flicker'])
def test_noise_of_circuits_is_no_wind(slope):
    assert level(0.01 * coloured(np.random.default_rng(2), (COUNT, 2), slope, 20.0)) == -math.inf


@pytest.mark.parametrize('slope', [0.0, 1.0])
def test_sound_is_no_wind_however_low(slope):
    """A rumble from a side, and rumbles from all sides, with noise of the microphones 30 dB below."""
    rng = np.random.default_rng(3)
    rumble = coloured(rng, (COUNT, 1), slope, 30.0)[:, 0]
    everywhere = sum(from_a_side(coloured(rng, (COUNT, 1), slope, 30.0)[:, 0], azimuth) for azimuth in range(7))
    for sound in (from_a_side(rumble, 0.7), everywhere):
        sound = 0.05 * sound / sound.std()
        assert level(sound + 0.05 * 10.0**-1.5 * rng.normal(size=sound.shape)) == -math.inf


def test_a_drone_is_heard_in_wind_and_wind_alone_is_nowhere():
    """The drone has a tenth of the wind's power; gusts alone pass as often as any noise of the microphones at most."""
    rng, settings, alone = np.random.default_rng(4), LocalizerSettings(hop_s=0.25), []
    wind, drone = gusts(rng, 2), rotors(rng, SECONDS, -PAIR.positions @ angles_to_direction(0.5) / speed_of_sound(20.0))
    both = wind + math.sqrt(0.1) * wind.std() * drone / drone.std()
    heard = [np.degrees(abs(estimate.azimuth - 0.5).min()) for estimate in Localizer(PAIR, RATE, settings).process(both, 0)]
    assert np.median(heard) < 2.0 and np.mean(np.array(heard) > 10.0) < 0.1
    for seed in range(4):
        wind = gusts(np.random.default_rng([4, seed]), 2)
        alone += [estimate.confidence.max(initial=0.0) for estimate in Localizer(PAIR, RATE, settings).process(wind, 0)]
    assert np.mean(np.array(alone) > 0.3) <= 0.05


def test_nothing_is_said_at_once_and_of_silence():
    assert DoaStage(PAIR).wind_dbfs == -math.inf
    assert level(np.zeros((COUNT, 2))) == -math.inf
