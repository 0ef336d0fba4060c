"""The microphones: whether all channels are alive, and in the order of the array file."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags, welch

from av_audio.device_process import COMMON_RATES
from av_audio.health import ChannelHealth
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray
from av_view.doctor.finding import Finding

AREA = 'microphones'
RATE_TOLERANCE = 1e-3  # ten times that of a poor crystal, 100 ppm
QUIET_DBFS, LOUD_DBFS = -75.0, -6.0
SPECTRUM = 4096  # samples
EDGE_DB = 30.0  # least step at half of the given rate: resamplers stop by 60 dB, microphones fall by less
CLAP_S = 0.02  # around the loudest moment
CLAP_DB = 15.0  # above the rest of the recording
CLAPS_APART_S = 0.4  # those of a step are slower
MOST_PERMUTED = 7  # microphones, whose orders are all tried
MISFIT = 0.25  # of the array's aperture, up to which arrivals fit an order
TIE = 0.1  # of the aperture, by which another order must fit better
DIRECTIONS = {'ahead': 0.0, 'left': 90.0, 'behind': 180.0, 'right': -90.0}


def judge_silence(waited_s: float, load: float, cores: int) -> Finding:
    """Judge a device of which nothing has come.

    Parameters:
        waited_s (s): for how long.
        load: processes that want to run, mean of a minute.
        cores: number of processor cores.
    """
    if load > cores:
        return Finding(AREA, 'unknown', f'no samples within {waited_s:.0f} s, while {load:.1f} processes want to run on '
                       f'{cores} cores', 'end what is not needed (top), and look again')
    return Finding(AREA, 'error', f'the device gives no samples within {waited_s:.0f} s', 'unplug it and plug it in again')


def resampled_from(samples: NDArray, rate: float) -> float | None:
    """The rate (Hz), or a usual one above it, from which a sound server has made a recording; None without signs of it.

    A converter's own noise fills the band; a resampler leaves nothing above half of the rate that it was given.

    Parameters:
        samples (n, channels): as captured.
        rate (Hz): of the samples.
    """
    if len(samples) < SPECTRUM:
        return None
    frequencies, power = welch(samples, rate, nperseg=SPECTRUM, axis=0)
    level = power.mean(axis=1)
    for given in (one for one in reversed(COMMON_RATES) if one < 0.8 * rate):
        edge = 0.5 * given
        below = np.median(level[(frequencies > 0.6 * edge) & (frequencies < 0.85 * edge)])
        full = np.median(level[(frequencies > 0.1 * edge) & (frequencies < 0.5 * edge)])
        # A quarter may be the transition of the resampler.
        above = level[(frequencies > 1.08 * edge) & (frequencies < min(1.4 * edge, 0.49 * rate))]
        step = 10.0 ** (-0.1 * EDGE_DB)
        if below > step * full and np.quantile(above, 0.75) < step * below:
            return float(given)
    return None


def judge_sound(samples: NDArray, rate: float, delivered: float, array: MicrophoneArray | None = None) -> list[Finding]:
    """Judge a recording of the surroundings.

    Parameters:
        samples (n, channels): as captured, full scale is 1.
        rate (Hz): the rate that was asked for.
        delivered (Hz): the rate at which samples came.
        array: the microphones of the channels; None where they are not known.
    """
    health = ChannelHealth(samples.shape[1], rate, array)
    health.update(samples)
    with np.errstate(divide='ignore'):
        levels = 20.0 * np.log10(samples.std(axis=0))
    found = [Finding(AREA, 'error' if fault.is_severe else 'warning', fault.text, fault.mend) for fault in health.faults]
    if abs(delivered / rate - 1.0) > RATE_TOLERANCE:
        found.append(Finding(AREA, 'error', f'{delivered:.0f} samples a second come instead of {rate:.0f}',
                             'set sample_rate of audio_node to what the device supports; connect it without a hub'))
    given = resampled_from(samples, rate)
    if given is not None:
        found.append(Finding(AREA, 'warning', f'{rate:.0f} Hz are made from {given:.0f} Hz or less: a sound server resamples',
                             f'set sample_rate of audio_node to {given:.0f}, or device to the hardware (hw:...)'))
    if QUIET_DBFS > levels.max() > -np.inf:
        found.append(Finding(AREA, 'warning', f'it is quiet: {levels.max():.0f} dB of full scale', 'raise the gain: alsamixer'))
    if levels.max() > LOUD_DBFS:
        found.append(Finding(AREA, 'warning', f'the level is {levels.max():.0f} dB of full scale: a near drone will clip',
                             'lower the gain: alsamixer'))
    if not found:
        listed = ', '.join(f'{level:.0f}' for level in levels)
        found.append(Finding(AREA, 'ok', f'{samples.shape[1]} channels are alive at {rate:.0f} Hz, levels {listed} dBFS'))
    return found


def judge_clap(samples: NDArray, rate: float, array: MicrophoneArray, azimuth: float) -> Finding:
    """Judge the order of the channels by a clap from a known direction.

    Parameters:
        samples (n, channels): a recording with one clap.
        rate (Hz): of the samples.
        array: the array that the channels should be of.
        azimuth (rad): of the clap, counter-clockwise from ahead in the array's frame.
    """
    heard = claps(samples, rate)
    if not heard:
        return Finding(AREA, 'unknown', 'no clap was heard', 'clap louder or closer: --clap left')
    return judge_order(heard[0], rate, array, azimuth)


def judge_order(clap: NDArray, rate: float, array: MicrophoneArray, azimuth: float) -> Finding:
    """Judge the order of the channels by the samples around one clap; arguments as for `judge_clap`."""
    arrivals = _arrivals(clap, rate)
    expected = -(array.positions @ angles_to_direction(np.array([azimuth]), np.zeros(1))[0]) / speed_of_sound(20.0)
    aperture = array.aperture / speed_of_sound(20.0)
    where = f'{math.degrees(azimuth):.0f} degrees'
    if np.ptp(expected) < 2.0 * MISFIT * aperture:
        return Finding(AREA, 'unknown', f'a clap from {where} reaches all microphones at once', 'clap along the array')
    straight = tuple(range(array.channels))
    orders = permutations(straight) if array.channels <= MOST_PERMUTED else [straight]
    misfit, order = min((_misfit(arrivals[list(one)], expected), one) for one in orders)
    if misfit > MISFIT * aperture:
        return Finding(AREA, 'error', f'the clap from {where} fits no order of the channels of {array.name}',
                       'is it the right array file, in metres, and does no wall reflect? Clap again from 2 m')
    if _misfit(arrivals, expected) <= misfit + TIE * aperture:
        return Finding(AREA, 'ok', f'the channels are in the order of {array.name}, by a clap from {where}')
    return Finding(AREA, 'error', f'the channels are not in the order of {array.name}: the clap from {where} fits the order '
                   f'{list(order)}', f'set channels of audio_node to {list(order)} of those chosen now, or turn the array')


def claps(samples: NDArray, rate: float) -> list[NDArray]:
    """The samples around the beginning of each sound that is much louder than the rest, the loudest first.

    Parameters:
        samples (n, channels): a recording.
        rate (Hz): of the samples.
    """
    length = max(int(CLAP_S * rate), 8)
    if len(samples) < 2 * length:
        return []
    power = np.concatenate([[0.0], np.cumsum(np.square(samples, dtype=float).sum(axis=1))])
    smooth = (power[length:] - power[:-length]) / length  # from each sample on
    least, apart, found = np.median(smooth) * 10.0 ** (0.1 * CLAP_DB), int(CLAPS_APART_S * rate), []
    while smooth[peak := int(smooth.argmax())] > least:
        middle = peak + length // 2
        found.append(samples[max(middle - length, 0):middle + length])
        smooth[max(peak - apart, 0):peak + apart] = 0.0
    return found


def _arrivals(clap: NDArray, rate: float) -> NDArray:
    """Time (channels,) in s at which each channel hears the clap, relative to the first; by interpolated cross-correlation."""
    lags = correlation_lags(len(clap), len(clap))
    times = [0.0]
    for channel in clap.T[1:]:
        likeness = correlate(channel, clap[:, 0])
        best = int(np.clip(likeness.argmax(), 1, len(likeness) - 2))
        before, at, after = likeness[best - 1:best + 2]
        bend = before - 2.0 * at + after
        times.append((lags[best] + (0.5 * (before - after) / bend if bend else 0.0)) / rate)
    return np.array(times)


def _misfit(arrivals: NDArray, expected: NDArray) -> float:
    """Root mean square difference in s, whenever the clap began."""
    return float(np.std(arrivals - expected))
