"""Windows of sound whose direction is known, what methods find in them, how far that is off, and figures of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.localizer import Localizer
from av_common.acoustics import speed_of_sound
from av_common.angles import wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.metrics.metrics import INTERVAL, OUTLIER_DEG, rmse

C = speed_of_sound(20.0)  # m/s
CONFIDENCE_THRESHOLD = 0.9  # the default confidence above which an estimate is used


@dataclass(frozen=True)
class Figure:
    """A measured value with its bounds.

    Parameters:
        name: description of the value.
        value: the value.
        unit: its unit.
        at_most: upper bound, None without.
        at_least: lower bound, None without.
    """

    name: str
    value: float
    unit: str = ''
    at_most: float | None = None
    at_least: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the value is within its bounds."""
        return (self.at_most is None or self.value <= self.at_most) and (
            self.at_least is None or self.value >= self.at_least)

    def __str__(self) -> str:
        bounds = [f'>= {self.at_least:g}'] if self.at_least is not None else []
        bounds += [f'<= {self.at_most:g}'] if self.at_most is not None else []
        verdict = f'must be {" and ".join(bounds)}: {"ok" if self.holds else "MISSED"}' if bounds else ''
        return f'  {self.name:<66} {self.value:9.4g} {self.unit:<6} {verdict}'.rstrip()


class Window(NamedTuple):
    """Sound and where it comes from.

    Parameters:
        sound (n, m): samples.
        rate (Hz): sample rate.
        array: the microphones.
        azimuth (rad): of the source; of a pair that of either mirror image.
    """

    sound: NDArray
    rate: int
    array: MicrophoneArray
    azimuth: float


# Azimuths (k,) in rad of the strongest source's mirror images; sigma in rad and confidence, NaN and 0 where none is stated.
Found = tuple[NDArray, float, float]
Locate = Callable[[Window], Found]


class Trials(NamedTuple):
    """Results of a method in n windows.

    Parameters:
        error (n,) (deg): azimuth error of the closer mirror image; 180 where nothing is found.
        sigma (n,) (deg): estimated standard deviation.
        confidence (n,): confidence 0..1.
    """

    error: NDArray
    sigma: NDArray
    confidence: NDArray

    @classmethod
    def together(cls, parts: Iterable[Trials]) -> Trials:
        """The windows of several results."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    @property
    def passed(self) -> NDArray:
        """Which windows (n,) exceed the default confidence."""
        return self.confidence >= CONFIDENCE_THRESHOLD

    @property
    def far(self) -> NDArray:
        """Which windows (n,) are off by more than OUTLIER_DEG."""
        return self.error > OUTLIER_DEG

    @property
    def coverage(self) -> float:
        """Percentage of passed errors within INTERVAL, 90 by definition."""
        return share((self.error <= INTERVAL * self.sigma)[self.passed])


def compare(windows: Iterable[Window], methods: Mapping[str, Locate]) -> dict[str, Trials]:
    """Results of each method in the same windows.

    Parameters:
        windows: sound with its direction.
        methods: by name.
    """
    rows: dict[str, list[tuple[float, float, float]]] = {name: [] for name in methods}
    for window in windows:
        for name, locate in methods.items():
            found, sigma, confidence = locate(window)
            rows[name].append((error_deg(found, window.azimuth), float(np.degrees(sigma)), confidence))
    return {name: Trials(*np.array(results).T) for name, results in rows.items()}


def ours(localizer: Localizer) -> Locate:
    """A localizer as a method; windows are as long as its own."""
    def locate(window: Window) -> Found:
        estimate, = localizer.process(window.sound, localizer.next_sample)
        sigma = float(np.sqrt(estimate.azimuth_variance[0])) if len(estimate.azimuth) else np.nan
        return estimate.azimuth, sigma, float(np.max(estimate.confidence, initial=0.0))

    return locate


def error_deg(azimuths: NDArray, azimuth: float) -> float:
    """Error in deg of the azimuth (k,) that is closest to the true one (both in rad); 180 of none."""
    return float(np.degrees(np.min(np.abs(wrap(azimuths - azimuth)), initial=np.pi)))


def share(marked: NDArray) -> float:
    """Percentage of the values (n,) that are true; NaN of none."""
    return 100.0 * float(np.mean(marked)) if len(marked) else float('nan')


def error_figures(title: str, result: Trials, limits: Mapping[str, float]) -> Iterator[Figure]:
    """The figures of a method's errors, and of its confidence and sigma where it states them.

    Parameters:
        title: of the method and its windows.
        result: its errors.
        limits: upper bounds by the quantity.
    """
    figures = {'median error': (float(np.median(result.error)), 'deg'), 'RMSE': (rmse(result.error), 'deg'),
               'beyond 20 deg': (share(result.far), '%')}
    if result.confidence.any():
        astray = share(result.far[result.passed]) if result.passed.any() else 0.0
        figures |= {'above the default confidence': (share(result.passed), '%'), 'of those beyond 20 deg': (astray, '%'),
                    'of those within 1.64 sigma': (result.coverage, '%')}
    for quantity, (value, unit) in figures.items():
        yield Figure(f'{title}: {quantity}', value, unit, limits.get(quantity))
