"""Faults of the channels of a microphone array, detected in their samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from av_audio.spacing import CLEARER, LONGEST_S, PEAK_SIGMAS, WINDOW_S, delay_curve
from av_common.acoustics import BODY_STRETCH, speed_of_sound
from av_common.microphone_array import MicrophoneArray

DEAD_DBFS = -100.0    # noise of 16 bits has -101
OFFSET, STEADIER = 0.05, 5.0    # of full scale; than the means of an eighth of a window, which wind moves
# A source at 1.5 apertures is 6 dB louder at one microphone; sensitivities differ by 3 dB each in data sheets.
QUIET_DB = 6.0 + 2.0 * 3.0
# Samples within 0.5 % of the extreme: of a sine 1.4 times as many as in the 1 % below them, of noise fewer.
TOP, LEAST_SPIKE, CLIPPED_SHARE = 0.005, 4.0, 1e-3
COPY_SHARE, COPY_RESIDUAL = 1e-3, 4.0 * 2.0**-30 / 12.0    # of the power; twice the quantisation of 16 bits in each
OCTAVES_HZ = 125.0 * 2.0 ** np.arange(6)    # lower edges
LEAST_BINS = 8    # of an octave, for a coherence
INCOHERENT = 1e-3    # probability that noise alone is as coherent in an octave
# Cumulative sums of log-likelihood ratios (Page, 1954): on average a million windows, 70 h, pass until one is false (Lorden,
# 1971). Of nine windows that can tell, eight tell the truth.
ALARM = math.log(1e6)
VOTE = math.log(9.0)
# What a window adds to the evidence, and what one without it takes. Facts need no vote.
STEPS = {**dict.fromkeys(('dead', 'copy', 'offset'), (ALARM / 3.0, -ALARM)), 'clips': (ALARM, -0.5),
         **dict.fromkeys(('quiet', 'deaf', 'inverted', 'late', 'apart', 'exchanged'), (VOTE, -VOTE))}
# Directions are wrong by them, or there are none.
SEVERE = ('dead', 'copy', 'deaf', 'inverted', 'late', 'apart', 'exchanged')
DIFFUSE_M = 0.69    # half a wavelength at 250 Hz, the end of the first octave: so close, sound from everywhere is coherent
# Of exchanged channels: share of the array's radius by which positions and wavefronts are off, and radii of the nearest source.
TOLERANCE = 0.05
NEAREST = 1.5
OUTLIER = 3.0  # standard deviations
GAIN_MEND = 'look at its plug and gain: alsamixer'

# By kind and channels, what is wrong in words.
Found = dict[tuple[str, tuple[int, ...]], str]


class ChannelFault(NamedTuple):
    """What is wrong with some channels.

    Parameters:
        text: what is wrong, with the numbers of the channels, from 0 on.
        mend: what to do about it.
        is_severe: directions are wrong by it, or there are none.
    """

    text: str
    mend: str
    is_severe: bool

    def __str__(self) -> str:
        return f'{self.text}: {self.mend}'


class ChannelHealth:
    """Detects channels that are dead, copies, inverted, late, exchanged or quieter, that clip or have a constant offset.

    Microphones that are close to each other hear the same: with one sign, within the delays that their distance permits, and
    equally loud but for the source's distance. Neighbouring channels are compared window by window; see `STEPS` and `ALARM`.

    Attributes:
        levels_dbfs (m,): levels in the newest window without their offset, -inf for silence.

    Parameters:
        channels: their number, m.
        sample_rate (Hz): sample rate.
        array: the microphones; None where they are not known: signs and delays are not judged then.
    """

    def __init__(self, channels: int, sample_rate: float, array: MicrophoneArray | None = None) -> None:
        self._channels, self._window = channels, round(WINDOW_S * sample_rate)
        neighbours = [(k, (k + 1) % channels) for k in range(channels)]
        self._pairs = neighbours if channels > 2 else neighbours[:channels - 1]
        distances = [0.0 if array is None else float(np.linalg.norm(array.positions[i] - array.positions[j]))
                     for i, j in self._pairs]
        self._permitted = BODY_STRETCH * np.array(distances) / speed_of_sound(20.0) + 1.0 / sample_rate
        self._order = None if array is None else ChannelOrder(array, sample_rate)
        self._hear_alike = 0.0 < max(distances, default=0.0) < DIFFUSE_M
        self._taper, self._frequencies = np.hanning(self._window), fft.rfftfreq(self._window, 1.0 / sample_rate)
        edges = np.searchsorted(self._frequencies, (OCTAVES_HZ, 2.0 * OCTAVES_HZ)).T
        self._octaves = [slice(begin, end) for begin, end in edges.tolist() if end - begin >= LEAST_BINS]
        self._evidence: dict[tuple[str, tuple[int, ...]], float] = {}
        self._told: Found = {}
        self.clear()

    def clear(self) -> None:
        """Discard the samples of an unfinished window."""
        self._waiting: list[NDArray] = []
        self._count = 0
        self.levels_dbfs = np.full(self._channels, -np.inf)

    def update(self, samples: NDArray) -> None:
        """Take the next samples (n, m), full scale 1."""
        self._waiting.append(samples)
        self._count += len(samples)
        if self._count >= self._window:
            waiting = np.concatenate(self._waiting).astype(float)
            whole = len(waiting) // self._window * self._window
            for window in np.split(waiting[:whole], whole // self._window):
                self._judge(np.ascontiguousarray(window.T))
            self._waiting, self._count = [waiting[whole:]], len(waiting) - whole

    @property
    def faults(self) -> list[ChannelFault]:
        """What is wrong, by the windows until now."""
        return [ChannelFault(text, _mend(kind), kind in SEVERE) for (kind, _), text in self._told.items()]

    @property
    def usable(self) -> list[int]:
        """Channels without a severe fault: of the others, samples and positions do not belong together."""
        wrong = {k for kind, channels in self._told if kind in SEVERE for k in channels}
        return [k for k in range(self._channels) if k not in wrong]

    def _judge(self, window: NDArray) -> None:
        """Take the samples (m, n) of a window."""
        if not np.isfinite(window).all():
            return
        offsets = window.mean(axis=1)
        sound = window - offsets[:, None]
        power = np.einsum('mn,mn->m', sound, sound) / self._window
        with np.errstate(divide='ignore'):
            self.levels_dbfs = 10.0 * np.log10(power)
        dead = self.levels_dbfs < DEAD_DBFS
        if dead.all():
            return
        found: Found = {('dead', (k,)): f'channel {k} is dead' for k in np.flatnonzero(dead)}
        steady = np.abs(offsets) > np.maximum(OFFSET, STEADIER * _wander(window))
        found |= {('offset', (k,)): f'channel {k} has a constant offset of {offsets[k]:+.2f} of full scale'
                  for k in np.flatnonzero(steady)}
        found |= {('clips', (k,)): f'channel {k} clips in {100.0 * share:.1f} % of the samples'
                  for k in range(self._channels) if (share := _clipped(window[k])) > CLIPPED_SHARE}
        found |= {('copy', same): f'channels {", ".join(map(str, same))} are identical: one microphone, not an array'
                  for same in copies(sound)}
        open_kinds = {'dead', 'offset', 'clips', 'copy'}
        if not dead.any() and not any(kind == 'copy' for kind, _ in found) and len(self._pairs):
            compared, kinds = self._compare(sound)
            found, open_kinds = found | compared, open_kinds | kinds
        self._weigh(found, open_kinds)

    def _weigh(self, found: Found, kinds: set[str]) -> None:
        """Add up evidence: for what a window has found, and against all else of the kinds that it can tell."""
        for fault in {*self._evidence, *found}:
            kind = fault[0]
            if kind not in kinds:
                continue
            step = STEPS[kind][fault not in found]
            self._evidence[fault] = min(max(self._evidence.get(fault, 0.0) + step, 0.0), 1.5 * ALARM)
            if fault in found and self._evidence[fault] >= ALARM - 1e-9:
                self._told[fault] = found[fault]
            elif self._evidence[fault] == 0.0:
                self._told.pop(fault, None)
                del self._evidence[fault]

    def _compare(self, sound: NDArray) -> tuple[Found, set[str]]:
        """What neighbouring channels of a window (m, n) say about each other, and the kinds of faults that it can tell."""
        spectra, frequencies = fft.rfft((sound * self._taper).astype(np.float32)), self._frequencies
        signs, peaks, late, ratios, deaf = [], [], [], [], []
        for (i, j), permitted in zip(self._pairs, self._permitted, strict=True):
            cross = spectra[i] * spectra[j].conj()
            lags, curve, sigma = delay_curve(cross, frequencies, self._window, LONGEST_S + permitted)
            inside, peak = np.abs(lags) <= permitted, int(np.argmax(np.abs(curve)))
            peaks.append(lags[peak] if abs(curve[peak]) > PEAK_SIGMAS * sigma else math.nan)
            heights = curve[inside].max(), -curve[inside].min(), np.abs(curve[~inside]).max(initial=0.0)
            best = int(np.argmax(heights))
            clear = heights[best] > max(PEAK_SIGMAS * sigma, CLEARER * max(np.delete(heights, best)))
            signs.append((1, -1, 0)[best] if clear else 0)
            delay = float(lags[np.argmax(np.where(inside == (best < 2), np.abs(curve), 0.0))])
            late.append(delay if clear and best == 2 else 0.0)
            ratio, is_deaf = self._ratio(spectra[i], spectra[j], delay)
            ratios.append(ratio)
            deaf.append(is_deaf)
        found, kinds = self._levels(ratios, deaf)
        if self._order is None:
            return found, kinds
        exchanged = self._order.exchanged(np.array(peaks))
        if exchanged and not self._is_one_wave(spectra, peaks):
            exchanged = None
        if exchanged is not None:
            kinds.add('exchanged')
        if exchanged:    # which explains delays that are too long
            pairs = ' or '.join(f'{i} and {j}' for i, j in exchanged)
            found['exchanged', tuple(sum(exchanged, ()))] = f'channels {pairs} are exchanged'
        elif all(sign or delay for sign, delay in zip(signs, late, strict=True)):
            kinds |= {'inverted', 'late', 'apart'}
            found |= self._delays(signs, late)
        return found, kinds

    def _is_one_wave(self, spectra: NDArray, delays: list[float]) -> bool:
        """Whether delays (m,) in s between neighbours add up to those of second neighbours, as those of one source do.

        Of several near sources, such as own rotors, neighbours here and there hear another one best.
        """
        count, tolerance = self._channels, OUTLIER * 0.5 * math.sqrt(3.0) / (self._frequencies[1] * self._window)
        for k in range(count):
            after, cross = (k + 1) % count, spectra[k] * spectra[(k + 2) % count].conj()
            longest = LONGEST_S + self._permitted[k] + self._permitted[after]
            lags, curve, sigma = delay_curve(cross, self._frequencies, self._window, longest)
            peak = int(np.argmax(np.abs(curve)))
            is_clear = abs(curve[peak]) > PEAK_SIGMAS * sigma
            if not is_clear or abs(delays[k] + delays[after] - lags[peak]) > tolerance:
                return False
        return True

    def _delays(self, signs: list[int], late: list[float]) -> Found:
        """Signs by which a minority differs, and delays that no direction has.

        Parameters:
            signs: of neighbours' products, 0 where the delay is impossible.
            late (s): impossible delays of the first neighbour against the second, else 0.
        """
        later = [j if delay < 0.0 else i for (i, j), delay in zip(self._pairs, late, strict=True) if delay]
        if len(later) > 2 or len(set(later)) > 1:
            longest = 1e3 * np.max(np.abs(late))
            return {('apart', tuple(range(self._channels))):
                    f'delays of up to {longest:.1f} ms between neighbours are longer than their distances permit'}
        found: Found = {}
        if later:  # than one neighbour or both: by other directions their delay is permitted
            found['late', (later[0],)] = f'channel {later[0]} is late by {1e3 * np.sum(np.abs(late)) / len(later):.1f} ms'
        elif self._channels == 2 and signs[0] < 0:
            found['inverted', (0, 1)] = 'channel 0 or 1 is inverted'
        polarity = np.cumprod([1, *signs])
        if polarity[-1] == 1 and (polarity < 0).any():
            wrong = -1 if np.sum(polarity[:-1] < 0) <= self._channels // 2 else 1
            found |= {('inverted', (int(k),)): f'channel {k} is inverted' for k in np.flatnonzero(polarity[:-1] == wrong)}
        return found

    def _ratio(self, first: NDArray, second: NDArray, delay: float) -> tuple[tuple[float, float], int]:
        """Bounds (dB) of the level of what is heard, and which hears nothing; see `_levels`.

        Noise of the second microphone alone makes |S_12| / S_22 too small, of the first alone S_11 / |S_12| too large.

        Parameters:
            first, second (k,): spectra.
            delay (s): of the first against the second.
        """
        least, largest, apart = math.inf, -math.inf, []
        for octave in self._octaves:
            angles = 2.0 * np.pi * delay * self._frequencies[octave]
            turned = second[octave] * (np.cos(angles) - 1j * np.sin(angles))
            shared = abs(np.vdot(turned, first[octave]))
            one, other = (float(np.vdot(part[octave], part[octave]).real) for part in (first, second))
            if not 0.0 < min(one, other) <= max(one, other) < math.inf:
                continue
            apart.append(10.0 * math.log10(one / other))
            if shared**2 / (one * other) > 1.0 - INCOHERENT ** (1.0 / (0.5 * len(turned) - 1.0)):
                least, largest = min(least, 20.0 * math.log10(shared / other)), max(largest, 20.0 * math.log10(one / shared))
        if math.isfinite(least):
            return (least, largest), 0
        side = 0 if not apart else 1 if max(apart) < -2.0 * QUIET_DB else -1 if min(apart) > 2.0 * QUIET_DB else 0
        return (math.nan, math.nan), side

    def _levels(self, ratios: list[tuple[float, float]], deaf: list[int]) -> tuple[Found, set[str]]:
        """Channels that are quieter than a neighbour, or have nothing in common with those that hear the same.

        Parameters:
            ratios (dB): least and largest level of the first neighbour against the second; NaN where not known.
            deaf: 1 where the first neighbour hears nothing of what the second hears, -1 for the reverse, else 0.
        """
        found: Found = {}
        for (i, j), (least, largest), side in zip(self._pairs, ratios, deaf, strict=True):
            if side:
                found['dead', (i if side > 0 else j,)] = f'channel {i if side > 0 else j} hears nothing of what others hear'
            elif largest < -QUIET_DB or least > QUIET_DB:
                quiet, by = (i, -largest) if largest < 0.0 else (j, least)
                found['quiet', (quiet,)] = f'channel {quiet} is {by:.0f} dB quieter than channel {i + j - quiet}'
        apart = [k for k, (least, _) in enumerate(ratios) if math.isnan(least)]  # pairs that have nothing in common
        if len(apart) == len(ratios):
            return found, set()
        if self._hear_alike and not any(deaf):
            found |= {('deaf', (k,)): f'channel {k} hears nothing of what others hear' for k in range(self._channels)
                      if apart == sorted({k, (k - 1) % self._channels})}
        return found, {'quiet', 'deaf'}


class ChannelOrder:
    """Hypotheses of two exchanged channels, each of which a plane wave fits, or does not.

    A plane wave arrives at times that are linear in the positions. Of m microphones that span r dimensions, m - 1 - r
    combinations of delays are 0, by each hypothesis others. Exchanges that are symmetries of the array, such as of opposite
    corners of a square, only mirror directions; they are no hypotheses, and of several that differ by such a symmetry none is
    better.

    Parameters:
        array: the microphones.
        sample_rate (Hz): sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: float) -> None:
        centred, speed = array.positions - array.positions.mean(axis=0), speed_of_sound(20.0)
        self._squares = np.sum(centred**2, axis=1) / speed**2
        self._bend = 0.5 / (NEAREST * math.sqrt(float(self._squares.max())))
        shape, widths, _ = np.linalg.svd(centred, full_matrices=False)
        self._shape = shape[:, :array.rank]
        self._crossing = widths[:array.rank] / speed
        self._sigma = math.hypot(0.5 / sample_rate, TOLERANCE * float(self._crossing[0]) / math.sqrt(array.channels))
        self._closure = OUTLIER * 0.5 * math.sqrt(array.channels) / sample_rate
        degrees = array.channels - 1 - array.rank    # of freedom of what is left: chi-square's mean, half its variance
        self._most = degrees + OUTLIER * math.sqrt(2.0 * degrees) if degrees > 0 else 0.0
        self._first, self._second = np.triu_indices(array.channels, 1)
        probes = np.random.default_rng(1).normal(size=(4, array.channels))
        explained = [np.sum(self._explained(probe) ** 2, axis=1) for probe in probes]
        self._classes = np.unique(np.round(explained, 6), axis=1, return_inverse=True)[1].reshape(-1)

    def exchanged(self, delays: NDArray) -> list[tuple[int, int]] | None:
        """Pairs of channels of which one is exchanged; empty where the order is as described, None where that is not known.

        Parameters:
            delays (m,) (s): of each channel against the next, of the last against the first; NaN where not known.
        """
        if not self._most or not abs(delays.sum()) <= self._closure:
            return None
        times = -np.concatenate([[0.0], np.cumsum(delays - delays.mean())[:-1]])
        times -= times.mean()
        explained = self._explained(times)
        left = (times @ times - np.sum(explained**2, axis=1)) / self._sigma**2
        left[np.linalg.norm(explained / self._crossing, axis=1) > BODY_STRETCH] = math.inf
        if self._left_by_near(times, times @ self._shape) <= self._most * self._sigma**2:
            return []
        best = int(np.argmin(left))
        same = self._classes == self._classes[best]
        if left[best] > self._most or (left[~same] < left[best] + 2.0 * VOTE).any():
            return None
        return [(int(self._first[k]), int(self._second[k])) for k in np.flatnonzero(same[1:])]

    def _left_by_near(self, times: NDArray, explained: NDArray) -> float:
        """Square (s^2) of arrival times (m,) that no wave of a source at any distance explains, by the described order.

        A source at R is later by (p^2 - (p u)^2) / (2 R c) at p than a plane wave from u.
        """
        plane = self._shape @ explained
        bent = self._squares - plane**2
        bent -= bent.mean() + self._shape @ (bent @ self._shape)
        left = times - plane
        share = float(bent @ left) / max(float(bent @ bent), 1e-300)
        return float(np.sum((left - min(max(share, 0.0), self._bend) * bent) ** 2))

    def _explained(self, times: NDArray) -> NDArray:
        """Parts (1 + p, r) of arrival times (m,) that a plane wave explains, by the described order and by each exchange."""
        change = (times[self._second] - times[self._first])[:, None] * (self._shape[self._first] - self._shape[self._second])
        return np.asarray(times @ self._shape + np.concatenate([np.zeros((1, change.shape[1])), change]))


def _wander(window: NDArray) -> NDArray:
    """Standard deviations (m,) of the means of a window's eighths."""
    return np.asarray(np.std([part.mean(axis=1) for part in np.array_split(window, 8, axis=1)], axis=0))


def _clipped(samples: NDArray) -> float:
    """Share of the samples (n,) at a level that they reach often and never exceed."""
    low, middle, high = samples.min(), samples.mean(), samples.max()
    if high <= low:
        return 0.0
    ends = (high - samples, TOP * (high - middle)), (samples - low, TOP * (middle - low))
    spikes = sum(_spike(beyond, width) for beyond, width in ends)
    if spikes:
        step = float(np.diff(np.unique(samples)).min())    # of the converter, which is coarse in quiet sound
        spikes = sum(_spike(beyond, max(width, 0.5 * step)) for beyond, width in ends)
    return spikes / len(samples)


def _spike(beyond: NDArray, width: float) -> int:
    """Samples within a width of an end, from which they are `beyond` (n,) away; 0 where these are no more than of any sound.

    Sound gets rarer towards its extremes: of what is within three widths, a third at most is within one. Of 17 or more, so many
    are by chance once in 1e8 windows.
    """
    top, near = (int(np.count_nonzero(beyond <= part * width)) for part in (1.0, 3.0))
    return top if top > LEAST_SPIKE * (near - top + LEAST_SPIKE) else 0


def copies(sound: NDArray) -> list[tuple[int, ...]]:
    """Groups of channels of a sound (m, n) without offset that are one times a number each, but for the rounding of samples."""
    shared = sound @ sound.T / sound.shape[1]
    power = shared.diagonal()
    groups, left = [], np.flatnonzero(power >= 10.0 ** (0.1 * DEAD_DBFS)).tolist()
    while left:
        first = left[0]
        same = [k for k in left if power[k] - shared[first, k] ** 2 / power[first]
                <= min(COPY_SHARE * power[k], COPY_RESIDUAL * (1.0 + power[k] / power[first]) + 1e-8 * power[k])]
        groups += [tuple(same)] if len(same) > 1 else []
        left = [k for k in left if k not in same and k != first]
    return groups


def _mend(kind: str) -> str:
    """What to do about a kind of fault."""
    return {'copy': 'choose other channels of audio_node; `ros2 run av_view doctor --only devices` shows what there is',
            'clips': 'lower the gain: alsamixer', 'inverted': 'exchange the two wires of its balanced plug, or turn its sign',
            'exchanged': 'exchange them, by `channels` of audio_node or their positions in the array file',
            'late': 'all channels must come from one device with one clock, without effects, and positions be in metres',
            'apart': 'positions in the array file are in metres; are they too small?'}.get(kind, GAIN_MEND)
