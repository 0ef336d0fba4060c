"""Directions from the covariances of narrow bands: MUSIC and MVDR, and all methods where the rig's own noise is whitened."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from av_audio.drift import is_positive
from av_audio.ego_noise import BAND_HZ, MIN_DURATION_S, SHARES, EgoNoise, covariance, in_time, level_weights, throttles
from av_audio.ego_peaks import EgoPeaks, EgoValues
from av_audio.spectra import ALIKE_HZ, TINY
from av_audio.steered_response import MARGIN, OPTIMISM, Peak, direction_grid, with_other_lobes
from av_common.microphone_array import PLACED_M, MicrophoneArray

# Of the trace, added to a covariance before it is inverted: the coherence that a source loses at 4.5 kHz between microphones
# 0.2 m apart when it moves by 2 degrees within a window. With less, bands have peaks narrower than the errors of the model.
LOADING = 0.03
GRID_POINTS_PER_PERIOD = 4.0  # of the highest band: neighbours differ by 90 deg of phase between the outermost microphones
REFINEMENTS = 5  # of a maximum on the grid, by the best of its neighbours, each with half of the step


class Method(NamedTuple):
    """A function of direction for each band.

    Parameters:
        matrices: from covariances (b, m, m) with a trace of m to those whose quadratic form is taken.
        value: from quadratic forms (b, g) with unit steering vectors and powers (b, 1) of the bands to what is summed.
        even: whether the snapshots of a band have equal weights.
    """

    matrices: Callable[[NDArray], NDArray]
    value: Callable[[NDArray, NDArray], NDArray]
    even: bool = False


def _same(covariances: NDArray) -> NDArray:
    return covariances


def _strongest(covariances: NDArray) -> NDArray:
    vectors = np.linalg.eigh(covariances)[1][..., -1:]
    return vectors @ vectors.conj().swapaxes(-1, -2)


def _inverse(covariances: NDArray) -> NDArray:
    microphones = covariances.shape[-1]
    return np.linalg.inv(covariances + LOADING * microphones * np.eye(microphones, dtype=covariances.dtype))


BAND_METHODS: dict[str, Method] = {
    # Of noise of known shape the likelihood believes too much in the few bands that a recording does not fit. Capon's form
    # bounds what a band counts; in own tests both were within their spread.
    'ml': Method(_inverse, lambda form, power: 1.0 / form),
    'phat': Method(_same, lambda form, power: form, even=True),  # Knapp and Carter, 1976
    'plain': Method(_same, lambda form, power: power / power.mean() * form),
    'music': Method(_strongest, lambda form, power: form),  # Schmidt, 1986
    'mvdr': Method(_inverse, lambda form, power: 1.0 / form),  # Capon, 1969
}


class _Window(NamedTuple):
    """What is searched in a window.

    Parameters:
        matrices (b, m, m): of the method.
        power (b, 1): of the bands.
        vectors (b, m, m), gains (b, m): that whiten, one after the other; see `EgoNoise`.
        values (b, g): on the grid, by what those of the rig alone are like.
    """

    matrices: NDArray
    power: NDArray
    vectors: NDArray
    gains: NDArray
    values: NDArray


class BandSearch:
    """Finds the maxima of a method's sum over bands. Motion within a window is not modelled.

    Its curvature and the scatter of the bands' gradients give the covariance of a maximum (sandwich estimate; White, 1982), and
    the scale by which the sum becomes a logarithm of a likelihood (Pauli, Racugno and Ventura, 2011).

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the bins.
        weights (k,): of the bins.
        speed_of_sound (m/s): speed of sound.
        method: one of BAND_METHODS.
        recording: spectra (m, k) of windows of the rig alone, by which spectra are whitened; empty whitens nothing.

    Raises ValueError when there are fewer frequencies than one band needs.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, weights: NDArray, speed_of_sound: float, method: str,
                 recording: Iterable[NDArray] = ()) -> None:
        self._array, self._method = array, BAND_METHODS[method]
        spacing = float(frequencies[1] - frequencies[0])
        self._bins = max(array.channels, round(BAND_HZ / spacing))
        self._count = len(frequencies) // self._bins
        if not self._count:
            raise ValueError(f'{len(frequencies)} frequency bins, expected at least {self._bins}: the band is too narrow, or '
                             'the window too short')
        centres = frequencies[:self._count * self._bins].reshape(self._count, -1).mean(axis=1, keepdims=True)
        # Bands overlap by half. Their taper, half a sine (Harris, 1978), keeps lines and bursts apart from their neighbours.
        within = np.arange(2 * self._bins) + 0.5
        self._taper = (math.sqrt(2.0) * np.sin(np.pi * within / len(within))).astype(np.float32)
        self._starts = np.arange(0, self._count, round(ALIKE_HZ / BAND_HZ))
        self._weights = weights[:self._count * self._bins].reshape(self._count, -1).mean(axis=1)[:, None]
        # phase per unit of q (b, m, rank): nearer microphones are ahead
        self._phase = 2.0 * np.pi * centres[..., None] * (array.positions @ array.basis) / speed_of_sound
        self._step = speed_of_sound / (GRID_POINTS_PER_PERIOD * float(centres[-1, 0]) * array.aperture)
        self._apart = 2.0 * self._step  # peaks that are closer are at one place
        self.grid = direction_grid(array.rank, 1.0 / self._step)
        self._cell = (2.0 * MARGIN, np.pi * MARGIN**2, 4.0 * np.pi)[array.rank - 1] / len(self.grid)
        self._tree = cKDTree(self.grid)
        _, neighbours = self._tree.query(self.grid, min(len(self.grid), 3 ** min(array.rank, 2)))
        self._neighbours = neighbours[:, 1:]
        self._placed = (0.5 * PLACED_M / array.aperture) ** 2  # the tolerance is two standard deviations
        # Windows, which overlap by half: what passes sooner, as a knock or motors that start, is no throttle.
        self._least = 2.0 * MIN_DURATION_S * spacing
        self._listen([self._bands(spectra) for spectra in recording])

    def _listen(self, windows: list[NDArray]) -> None:
        """Learn the rig's own noise from windows (b, m, n), and what it leaves after whitening by other windows."""
        self._noise: EgoNoise | None = None
        self._alone: list[EgoPeaks] = []  # the highest in each window, and the next
        self._usual = EgoValues(*(np.broadcast_to(np.float32(value), (self._count, len(self.grid))) for value in (0.0, 1.0)))
        self._use(np.broadcast_to(np.eye(self._array.channels), (1, self._count, *2 * (self._array.channels,))))
        if not windows:
            return
        throttle = throttles(np.array([np.mean(np.abs(bands) ** 2) for bands in windows]))
        lasts = np.bincount(throttle)[throttle] >= self._least
        if lasts.any():
            throttle, windows = throttle[lasts], [windows[k] for k in np.flatnonzero(lasts)]
        of_one = [throttle == one for one in np.unique(throttle)]
        late = np.any([these & (np.cumsum(these) > 0.5 * np.sum(these)) for these in of_one], axis=0)  # half of each throttle
        if np.sum(~late) > 1:
            halves = [[windows[k] for k in np.flatnonzero(half)] for half in (~late, late)]
            left = [self._left(EgoNoise(known), half) for known, half in zip(halves[::-1], halves, strict=True)]
            usual = [EgoValues.of(values, self._starts) for values in left]
            found = [self._two_highest(other.standard(each)) for other, values in zip(usual[::-1], left, strict=True)
                     for each in values]
            for peaks in zip(*found, strict=True):
                heights, places = zip(*peaks, strict=True)
                self._alone.append(EgoPeaks.of(heights, self.grid[list(places)], self.grid, self._apart))
            self._usual = usual[0].beside(usual[1])
        self._noise = EgoNoise(windows)
        self._use(self._noise.vectors)

    def _left(self, noise: EgoNoise, windows: Sequence[NDArray]) -> NDArray:
        """Values (w, b, g) that whitening by this own noise leaves of windows (b, m, n)."""
        self._noise = noise
        self._use(noise.vectors)
        return np.stack([self._window(bands).values.astype(np.float32) for bands in windows])

    def _use(self, vectors: NDArray) -> None:
        self._vectors = vectors
        self._steering = [self._steered(self.grid, each) for each in vectors]

    def peaks(self, spectra: NDArray, most: int) -> list[Peak]:
        """The highest peak for spectra (m, k), then further sources: each band has the sound of one of them.

        Parameters:
            spectra (m, k): spectra of the window.
            most: largest number of peaks.
        """
        window = self._window(self._bands(spectra))
        found = [self._judged(self._peak(window, np.full(self._count, -np.inf), np.ones(len(self.grid), bool)), 0)]
        while len(found) < most and found[0].significance > 0.0:
            explained = np.max([self._at(window, peak.q[None], self._nearest(peak.q))[:, 0] for peak in found], axis=0)
            tops = self._tops(window.values, explained, [peak.q for peak in found])
            peak = self._judged(self._peak(window, explained, tops), 1) if tops.any() else None
            if peak is None or peak.source_probability < 0.5:
                break
            found.append(peak)
        return found

    def _judged(self, peak: Peak, order: int) -> Peak:
        """A peak with its probability to stem from a source, where peaks of the rig alone of this order are known.

        The significance would not tell: rotors of which one becomes louder raise all bands a little, so that these agree as if
        by a source.
        """
        return replace(peak, over_alone=self._alone[order].is_source(peak.height, peak.q)) if self._alone else peak

    def _tops(self, values: NDArray, explained: NDArray, found: list[NDArray]) -> NDArray:
        """Points (g,) of the grid at which there may be a further source: tops of what adds to those `found` (rank,).

        Parameters:
            values (b, g): on the grid.
            explained (b,): values that bands have at these.
            found: where they are.
        """
        gain = _gain(values, explained).sum(axis=0)
        return (gain >= gain[self._neighbours].max(axis=1)) & np.all(
            [np.linalg.norm(self.grid - q, axis=1) > self._apart for q in found], axis=0)

    def _two_highest(self, values: NDArray) -> list[tuple[float, int]]:
        """Height of the highest peak of values (b, g) and its place on the grid, and of the next: what adds to the highest."""
        first = int(np.argmax(values.sum(axis=0)))
        gain = _gain(values, values[:, first])
        tops = self._tops(values, values[:, first], [self.grid[first]])
        second = int(np.argmax(np.where(tops, gain.sum(axis=0), -np.inf)))
        return [(float(_rise(part)[:, place].sum()), place) for part, place in ((values, first), (gain, second))]

    def _bands(self, spectra: NDArray) -> NDArray:
        """Spectra (b, m, n) of n bins in each band, from spectra (m, k)."""
        count, before = self._count * self._bins, self._bins // 2
        padded = np.pad(spectra[:, :count], ((0, 0), (before, self._bins - before)))
        return self._taper * sliding_window_view(padded, 2 * self._bins, axis=1)[:, ::self._bins].transpose(1, 0, 2)

    def _nearest(self, q: NDArray) -> int:
        """The point of the grid that is nearest to q (rank,)."""
        return int(self._tree.query(q)[1])

    def _window(self, bands: NDArray) -> _Window:
        """What is searched in the spectra (b, m, n) of a window."""
        throttle, gains = 0, np.ones((self._count, self._array.channels))
        if self._noise is not None:
            throttle, gains = self._noise.likeliest(covariance(bands))
        vectors = self._vectors[throttle]
        white = gains[..., None] * (vectors.conj().swapaxes(-1, -2) @ bands)
        if self._noise is None:
            covariances = covariance(white)
        else:
            snapshots = in_time(white)
            weights = level_weights(snapshots, 0.0 if self._method.even else self._noise.freedom)
            # What the recording is not known to, of the window's power: where that is all there is, it is no source.
            unknown = SHARES[0] * np.mean(np.abs(bands) ** 2, axis=(1, 2)) * weights.mean(axis=(1, 2))
            covariances = covariance(np.sqrt(weights) * snapshots) + (unknown[:, None] * gains**2)[..., None] * np.eye(
                self._array.channels)
        power = np.maximum(np.einsum('bii->b', covariances).real / self._array.channels, TINY)
        matrices = self._method.matrices(covariances / power[:, None, None]).astype(np.complex64)
        window = _Window(matrices, power[:, None], vectors, gains.astype(np.float32), np.zeros(0))
        return window._replace(values=self._usual.standard(self._values(window, self._steering[throttle])))

    def _steered(self, points: NDArray, vectors: NDArray) -> NDArray:
        """Steering vectors (b, m, g) of points (g, rank) by the components that `vectors` (b, m, m) are."""
        angles = (self._phase @ points.T).astype(np.float32)
        return (vectors.conj().swapaxes(-1, -2) @ (np.cos(angles) + 1j * np.sin(angles))).astype(np.complex64)

    def _values(self, window: _Window, steering: NDArray) -> NDArray:
        white = window.gains[..., None] * steering
        form = np.sum((white.conj() * (window.matrices @ white)).real, axis=1)
        return self._weights * self._method.value(form / np.sum(np.abs(white) ** 2, axis=1), window.power)

    def _at(self, window: _Window, points: NDArray, near: int) -> NDArray:
        """Values (b, g) at points (g, rank), by what those of the rig alone are like at a point of the grid.

        Parameters:
            window: the window.
            points (g, rank): where.
            near: number of that point, which is close to all of them.
        """
        return self._usual.near(near).standard(self._values(window, self._steered(points, window.vectors)))

    def _peak(self, window: _Window, explained: NDArray, tops: NDArray) -> Peak:
        """The highest peak of what other sources do not explain.

        Parameters:
            window: the window.
            explained (b,): values that bands have at other sources.
            tops (g,): points of the grid at which it may be.
        """
        values = _gain(window.values, explained)
        total = values.sum(axis=0)
        best = int(np.argmax(np.where(tops, total, -np.inf)))
        q, step = self.grid[best], self._step
        for _ in range(REFINEMENTS):  # Newton's steps would leave a peak that is narrower than they are
            points = _stencil(q, _tangent(q), step)
            q = points[int(np.argmax(_gain(self._at(window, points, best), explained).sum(axis=0)))]
            step *= 0.5
        axes = _tangent(q)
        slopes, curvature = _derivatives(_gain(self._at(window, _stencil(q, axes, step), best), explained), len(axes), step)
        rise = _rise(values)[:, best]
        significance = _significance(rise)
        if significance <= 0.0 or not is_positive(curvature):  # of a flat sum the curvature is that of rounding errors
            unknown = np.full((len(q), len(q)), np.inf)
            return Peak(q, unknown, np.zeros_like(unknown), 0.0, 0.0)
        q = _on_sphere((q + np.clip(np.linalg.solve(curvature, slopes.sum(axis=1)), -step, step) @ axes)[None])[0]
        inverse = np.linalg.inv(curvature)
        gradients = np.add.reduceat(slopes, self._starts, axis=1)
        spread = inverse @ (gradients @ gradients.T) @ inverse * (1.0 + (OPTIMISM / significance) ** 2) ** 2
        scale = len(axes) / max(float(np.trace(spread @ curvature)), TINY)
        # where a parabola of this curvature falls to the mean of the curve, the lobe ends
        lobe = math.sqrt(2.0 * max(float(total[best] - total.mean()), 0.0) * len(axes) / float(np.trace(curvature)))
        outside = np.linalg.norm(self.grid - q, axis=1) > max(lobe, self._step)
        weights = self._cell * np.exp(np.minimum(scale * (total - total[best]), 0.0)) * outside
        covariance, share = with_other_lobes(q, axes.T @ (spread + self._placed * np.eye(len(axes))) @ axes, self.grid, weights)
        return Peak(q, covariance, np.zeros((len(q), len(q))), significance, share, float(rise.sum()))


def _gain(values: NDArray, explained: NDArray) -> NDArray:
    """What values (b, g) add to those (b,) of other sources; the values themselves where there are none."""
    return np.maximum(values - explained[:, None], 0.0) if np.isfinite(explained).all() else values


def _rise(values: NDArray) -> NDArray:
    """Values (b, g) less their mean over the grid."""
    return values - values.mean(axis=1, keepdims=True)


def _significance(rise: NDArray) -> float:
    """Sum of the rises (b,) of bands over the standard deviation that independent bands give."""
    return float(rise.sum() / max(math.sqrt(float(rise @ rise)), TINY))


def _tangent(q: NDArray) -> NDArray:
    """Directions (d, rank) in which q (rank,) may move: all of them, or those on the unit sphere."""
    return np.eye(len(q)) if len(q) < 3 else np.linalg.svd(q[None])[2][1:]


def _stencil(q: NDArray, axes: NDArray, step: float) -> NDArray:
    """Points (3^d, rank) around q (rank,) at multiples -1, 0, 1 of a step along axes (d, rank)."""
    multiples = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * len(axes), indexing='ij'), axis=-1).reshape(-1, len(axes))
    return _on_sphere(q + step * multiples @ axes)


def _on_sphere(points: NDArray) -> NDArray:
    """Points (g, rank), on the unit sphere where the array is one in space."""
    return points / np.linalg.norm(points, axis=1, keepdims=True) if points.shape[1] == 3 else points


def _derivatives(values: NDArray, dimensions: int, step: float) -> tuple[NDArray, NDArray]:
    """Gradients (d, b) of each band and negative Hessian (d, d) of their sum, by differences of values (b, 3^d)."""
    cube = values.reshape(len(values), *[3] * dimensions)
    middle = [cube] if dimensions == 1 else [cube[:, :, 1], cube[:, 1, :]]
    gradients = np.stack([line[:, 2] - line[:, 0] for line in middle]) / (2.0 * step)
    hessian = np.diag([float(np.sum(line[:, 2] - 2.0 * line[:, 1] + line[:, 0])) for line in middle]) / step**2
    if dimensions == 2:
        corners = cube.sum(axis=0)
        hessian[0, 1] = hessian[1, 0] = (corners[2, 2] - corners[2, 0] - corners[0, 2] + corners[0, 0]) / (4.0 * step**2)
    return gradients, -hessian
