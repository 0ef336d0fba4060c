"""Geometry of a microphone array: delays of its pairs, and the directions that delays cannot distinguish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from av_common.angles import angles_to_direction
from av_common.config_reader import ConfigError, bounded, load

PLACED_M = 1e-3  # to which microphones are at their places, and from which on they are apart
# Share of the largest dimension up to which another one tells nothing: a usual error of 1 deg in the largest becomes one of
# more than half of the unit ball.
FLAT = 0.03
MOST_MICROPHONES = 256  # so that a file makes no more than 32,640 pairs
# The wavelength of a blade-pass frequency of 100 Hz, the lowest of drones: farther apart, microphones hear the same period
# again, whatever the direction.
WIDEST_GAP_M = 3.4
UNITS_M = {'millimetres': 1e-3, 'centimetres': 1e-2}
USUAL_SIZE_M = 0.15  # of arrays; the unit that brings positions closest to it was probably meant


COSINES = np.linspace(-1.0, 1.0, 129)  # of the angle to a line of microphones, at which `av_interfaces/DoaOdds` has odds


@dataclass(frozen=True)
class DelayCurve:
    """Effect of a body between two microphones on their delay.

    Parameters:
        cosine (k,): cosines of the angle between a direction and the array's axis, strictly increasing.
        measured (k,): c tau / d at these directions, strictly increasing; in the free field it is the cosine itself.
        sigma: standard deviation of what is measured about the curve, one number or (k,): front and back differ, most so
            beside an ear, and so do frequencies.

    Raises ValueError for anything else.
    """

    cosine: Sequence[float] | NDArray
    measured: Sequence[float] | NDArray
    sigma: float | tuple[float, ...] = bounded(0.0, low=0.0, high=1.0)

    def __post_init__(self) -> None:
        cosine, measured = (np.asarray(values, dtype=float) for values in (self.cosine, self.measured))
        if cosine.shape != measured.shape or cosine.ndim != 1 or cosine.size < 2:
            raise ValueError(f'delay_curve: cosine and measured must be lists of one length of at least 2, '
                             f'not {cosine.shape} and {measured.shape}')
        if not (np.all(np.diff(cosine) > 0.0) and np.all(np.diff(measured) > 0.0)):
            raise ValueError('delay_curve: cosine and measured must rise strictly and hold no NaN')
        sigma = np.asarray(self.sigma, dtype=float)
        if sigma.shape not in ((), cosine.shape):
            raise ValueError(f'delay_curve: sigma must be a number or a list of {cosine.size}, not {sigma.shape}')
        object.__setattr__(self, 'sigma', sigma)
        object.__setattr__(self, 'cosine', cosine)
        object.__setattr__(self, 'measured', measured)

    def true_cosine(self, measured: ArrayLike) -> NDArray:
        """Cosines of the directions at which `measured` is measured; beyond both ends the curve's end slopes count."""
        return _interpolate(np.asarray(measured, dtype=float), self.measured, self.cosine)

    def sigma_at(self, measured: ArrayLike) -> NDArray:
        """Standard deviation of the scatter about the curve where `measured` is measured; beyond both ends that of the end."""
        places = np.asarray(self.measured, dtype=float)
        return np.interp(np.asarray(measured, dtype=float), places, np.broadcast_to(self.sigma, places.shape))

    def measured_cosine(self, cosine: ArrayLike) -> NDArray:
        """Values measured at directions of these cosines: the inverse of `true_cosine`."""
        return _interpolate(np.asarray(cosine, dtype=float), self.cosine, self.measured)


@dataclass(frozen=True)
class MicrophoneArray:
    """A rigid array of microphones.

    The wave of a far source at the unit vector u reaches a pair (i, j) with the delay (arrival at j minus arrival at i)
    tau = (r_i - r_j) . u / c. Delays depend only on the part of u inside the array's span: `basis` (3, rank) spans it,
    and q = basis^T u is what an estimator can find.

    Parameters:
        positions (m, 3) (m): microphones in the order of the channels; x forward, y left, z up.
        name: the array's name.
        delay_curve: effect of a body between the microphones of a pair; None in the free field.

    Raises ValueError for an unusable geometry.
    """

    positions: NDArray
    name: str = 'array'
    delay_curve: DelayCurve | None = field(default=None)

    def __post_init__(self) -> None:
        positions = np.asarray(self.positions, dtype=float)
        if positions.ndim != 2 or positions.shape[1] != 3 or len(positions) < 2:
            raise ValueError(f'microphones: expected at least two positions [x, y, z] in metres, '
                             f'got shape {positions.shape}')
        if not np.all(np.isfinite(positions)):
            raise ValueError('microphones: positions must be finite numbers in metres')
        _check_gap(positions)
        object.__setattr__(self, 'positions', positions)
        for i, j in combinations(range(len(positions)), 2):
            if np.linalg.norm(positions[i] - positions[j]) < PLACED_M:
                raise ValueError(f'microphones: {i} and {j} are at the same place {positions[i].tolist()}, expected at least '
                                 f'{PLACED_M:g} m between them')
        if self.rank == 1 and np.linalg.norm(self.basis[:2, 0]) < 0.1:
            raise ValueError('microphones: a vertical line cannot measure azimuth; turn it or add a microphone')
        if self.delay_curve is not None and len(positions) != 2:
            raise ValueError(f'delay_curve: belongs to two microphones, not to {len(positions)}')

    def part(self, channels: Sequence[int]) -> MicrophoneArray:
        """The array of some of the channels, in rising order. Raises ValueError where these measure no azimuth."""
        return self if len(channels) == self.channels else MicrophoneArray(self.positions[list(channels)], self.name)

    @classmethod
    def load(cls, path: str | Path) -> MicrophoneArray:
        """Read an array file. Raises OSError, or ValueError with the name of the file and the reason."""
        try:
            content = load(_ArrayFile, path)
            return cls(content.microphones, content.name or Path(path).stem, content.delay_curve)
        except ConfigError as error:
            raise ValueError(f'array file {error}') from error
        except ValueError as error:
            raise ValueError(f'array file {path}: {error}') from error

    def save(self, path: str | Path, comment: str = '') -> None:
        """Write an array file that `load` reads; `comment` becomes lines of comment at its top.

        Parameters:
            path: the file to write.
            comment: text for lines of comment at its top.
        """
        content = {'name': self.name, 'microphones': np.round(self.positions, 6).tolist()}
        if self.delay_curve is not None:
            content['delay_curve'] = {'cosine': np.round(self.delay_curve.cosine, 6).tolist(),
                                      'measured': np.round(self.delay_curve.measured, 6).tolist(),
                                      'sigma': np.round(self.delay_curve.sigma, 6).tolist()}
        lines = ''.join(f'# {line}\n' for line in comment.splitlines())
        Path(path).expanduser().write_text(lines + yaml.safe_dump(content, sort_keys=False, default_flow_style=None),
                                           encoding='utf-8')

    @property
    def channels(self) -> int:
        """Number of microphones."""
        return len(self.positions)

    @cached_property
    def pairs(self) -> NDArray:
        """Indices (p, 2) of all pairs of microphones, the smaller one first."""
        return np.array(list(combinations(range(self.channels), 2)))

    @cached_property
    def baselines(self) -> NDArray:
        """r_i - r_j of all pairs (p, 3) in m."""
        return self.positions[self.pairs[:, 0]] - self.positions[self.pairs[:, 1]]

    @cached_property
    def aperture(self) -> float:
        """Largest distance between two microphones in m."""
        return float(np.max(np.linalg.norm(self.baselines, axis=1)))

    @cached_property
    def basis(self) -> NDArray:
        """Orthonormal axes (3, rank) of the line, plane or space that the microphones span, as far as that tells directions.

        The line points from the last to the first microphone, so that q rises with the delay; a horizontal plane gets
        x and y.
        """
        if self.channels == 2:
            return (self.baselines[0] / np.linalg.norm(self.baselines[0]))[:, None]
        _, _, axes = np.linalg.svd(self.positions - self.positions.mean(axis=0))
        spread = np.ptp(self.positions @ axes.T, axis=0)
        rank = int(np.sum(spread > max(PLACED_M, FLAT * float(spread[0]))))
        if rank == 1:
            axis = axes[0] * np.sign(axes[0] @ (self.positions[0] - self.positions[-1]))
            return axis[:, None]
        if rank == 2 and abs(axes[2, 2]) > 1.0 - 1e-9:
            return np.eye(3)[:, :2]
        return np.eye(3) if rank == 3 else axes[:2].T

    @property
    def rank(self) -> int:
        """Dimension of the span: 1 for a line, 2 for a plane, 3 for microphones in space."""
        return self.basis.shape[1]

    def delays(self, directions: ArrayLike, speed_of_sound: float) -> NDArray:
        """Delays (n, p) in s of all pairs, with the effect of the delay curve.

        Parameters:
            directions (n, 3): unit vectors towards far sources.
            speed_of_sound (m/s): see `av_common.acoustics`.
        """
        projections = np.atleast_2d(np.asarray(directions, dtype=float)) @ self.baselines.T
        if self.delay_curve is not None:
            projections = self.aperture * self.delay_curve.measured_cosine(projections / self.aperture)
        return projections / speed_of_sound

    def hypotheses(self, q: ArrayLike) -> NDArray:
        """Unit vectors (..., k, 3) whose projection on the basis is q (..., rank): the mirror images of one source.

        A line yields the two horizontal directions on its cone (forward first where it points to the left), a plane
        the directions on both of its sides (upper first), microphones in space just one. q outside of the unit ball
        is moved onto it.
        """
        projected = np.asarray(q, dtype=float)
        projected = projected / np.maximum(1.0, np.linalg.norm(projected, axis=-1, keepdims=True))
        if self.rank == 1:
            axis = self.basis[:, 0]
            spread = np.arccos(np.clip(projected / np.hypot(axis[0], axis[1]), -1.0, 1.0))
            return angles_to_direction(np.arctan2(axis[1], axis[0]) + spread * [-1.0, 1.0])
        inside = projected @ self.basis.T
        if self.rank == 3:
            return (inside / np.maximum(np.linalg.norm(inside, axis=-1, keepdims=True), 1e-12))[..., None, :]
        normal = np.cross(self.basis[:, 0], self.basis[:, 1])
        normal = normal * (1.0 if normal[2] >= 0.0 else -1.0)
        height = np.sqrt(np.maximum(0.0, 1.0 - np.sum(projected**2, axis=-1, keepdims=True))) * normal
        return np.stack([inside + height, inside - height], axis=-2)


@dataclass(frozen=True)
class _ArrayFile:
    """Content of an array file."""

    microphones: tuple[tuple[float, float, float], ...] = bounded(longest=MOST_MICROPHONES)
    name: str = ''
    delay_curve: DelayCurve | None = None


def _check_gap(positions: NDArray) -> None:
    """Raise ValueError where some microphones (m, 3) are farther from all others than an array can be, with the likely unit."""
    from scipy.sparse.csgraph import minimum_spanning_tree  # of SciPy only what loads an array needs
    distances = np.linalg.norm(positions[:, None] - positions, axis=2)
    gap = minimum_spanning_tree(distances).max()
    if gap > WIDEST_GAP_M:
        size = float(distances.max())
        unit = min(UNITS_M, key=lambda unit: abs(np.log(size * UNITS_M[unit] / USUAL_SIZE_M)))
        raise ValueError(f'microphones: {gap:g} m between neighbours, expected at most {WIDEST_GAP_M:g} m, as positions are '
                         f'in metres; these look like {unit} (an array of {size * UNITS_M[unit]:.3g} m)')


def _interpolate(x: NDArray, positions: ArrayLike, values: ArrayLike) -> NDArray:
    """Piecewise linear interpolation, extended beyond both ends by the end slopes."""
    xp, fp = np.asarray(positions, float), np.asarray(values, float)
    k = np.clip(np.searchsorted(xp, x) - 1, 0, len(xp) - 2)
    return fp[k] + (x - xp[k]) * (fp[k + 1] - fp[k]) / (xp[k + 1] - xp[k])
