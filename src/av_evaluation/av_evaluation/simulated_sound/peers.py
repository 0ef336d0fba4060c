"""The fly-by rendered by other simulators. Each function returns samples (n, 2) and the processor time (s)."""

from __future__ import annotations

import contextlib
import io
import time

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from av_evaluation.simulated_sound.fly_by import PAIR, RATE, FlyBy

_BLOCK = RATE // 50  # pyroomacoustics has no motion: the source is stationary for 20 ms


def with_pyroomacoustics(fly_by: FlyBy, ground: bool = False) -> tuple[NDArray, float]:
    """Render with pyroomacoustics: each 20 ms of the tone are convolved with the response of the position in their middle.

    Parameters:
        fly_by: source and tone.
        ground: whether air absorption and a mirror source below z = 0 are added (cheaper than a room).
    """
    import pyroomacoustics as pra

    pra.constants.set('c', fly_by.medium.speed_of_sound)
    pra.constants.set('rir_hpf_enable', False)
    late = pra.constants.get('frac_delay_length') // 2
    samples, before = len(fly_by.times), RATE // 5
    received = np.zeros((samples + before + RATE, len(PAIR)))
    begin = time.process_time()
    for start in range(0, samples + before, _BLOCK):
        sent_at = (start - before + np.arange(_BLOCK)) / RATE
        place = fly_by.position(sent_at[[_BLOCK // 2]])[0]
        room = pra.AnechoicRoom(3, fs=RATE, air_absorption=ground)
        for image in [place, place * [1, 1, -1]][:1 + ground]:
            room.add_source(image)
        room.add_microphone_array(PAIR.T)
        room.compute_rir()
        tone = np.sin(2 * np.pi * fly_by.tone_hz * sent_at)
        for channel, responses in enumerate(room.rir):
            for response in responses:
                received[start:start + _BLOCK + len(response) - 1, channel] += oaconvolve(tone, response)
    return received[before + late:before + late + samples], time.process_time() - begin


def with_acoular(fly_by: FlyBy, upsampling: int = 16) -> tuple[NDArray, float]:
    """Render with acoular: a moving point source whose signal is upsampled and read at the nearest sample.

    Parameters:
        fly_by: source and tone.
        upsampling: factor of the upsampling.
    """
    import acoular

    samples = len(fly_by.times)
    points = {t: tuple(map(float, fly_by.position(np.array([t]))[0])) for t in np.linspace(-1.0, fly_by.seconds + 1.0, 61)}
    tone = acoular.SineGenerator(sample_freq=RATE, num_samples=samples, freq=fly_by.tone_hz)
    tone.amplitude = 1.0
    source = acoular.MovingPointSource(
        signal=tone, mics=acoular.MicGeom(pos_total=PAIR.T), env=acoular.Environment(c=fly_by.medium.speed_of_sound),
        trajectory=acoular.Trajectory(points=points), up=upsampling)
    begin = time.process_time()
    received = np.concatenate([block.copy() for block in source.result(_BLOCK)])
    return received, time.process_time() - begin


def with_pyroadacoustics(fly_by: FlyBy, ground: bool = True) -> tuple[NDArray, float]:
    """Render with pyroadacoustics: one source over a road, sample by sample; its motion starts with the sound.

    Parameters:
        fly_by: source and tone.
        ground: whether the reflection of the road and air absorption are included.
    """
    import pyroadacoustics

    scene = pyroadacoustics.Environment(fs=RATE, temperature=fly_by.medium.temperature_c,
                                        rel_humidity=round(fly_by.medium.humidity_percent))
    ends = fly_by.position(np.array([0.0, fly_by.seconds]))
    tone = np.sin(2 * np.pi * fly_by.tone_hz * fly_by.times)
    speed = np.array([np.linalg.norm(fly_by.velocity)])
    scene.add_source(position=ends[0], signal=tone, trajectory_points=ends, source_velocity=speed)
    scene.add_microphone_array(PAIR)
    scene.set_simulation_params('Sinc', ground, ground)
    begin = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        received = scene.simulate()
    return np.asarray(received).T, time.process_time() - begin
