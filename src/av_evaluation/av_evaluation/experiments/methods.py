"""Methods of the publication's comparison, ours, and those of other packages: the bearings of each on identical measurements.

A direction of arrival is evaluated at its stamp, the centre of its window; its delay counts as latency. A tracker is evaluated
at the time of its estimate. Methods that cannot resolve front and back are given the true hemisphere, as in the
publication. Other trackers use no truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_audio.methods import DOA_METHODS
from av_common.angles import wrap
from av_common.parameters import node_parameters
from av_common.track import State
from av_evaluation.metrics.metrics import TAU
from av_evaluation.metrics.run_log import Event, RunLog, Series
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, Hypothesis, usable_doas
from av_fusion.measurement.rig_motion import Pose
from av_fusion.settings import TRACKERS, Tracker, make_tracker

OWN_METHOD = 'ml'  # the rig's own estimator of directions
METHODS = ('fused', 'sound', 'sight', 'gated', 'kalman', 'moving_average', 'gcc_phat', 'music', 'mvdr')
# Names in the publication's table of estimators and trackers that are called otherwise elsewhere.
ESTIMATORS = {'gcc_phat': 'phat', 'sound': OWN_METHOD, 'kalman': 'phat', 'moving_average': 'phat'}
OWN_TRACKERS = {'fused': 'bayes'}
MEDIAN = 5  # bearings of the median filter of every method


class UnavailableError(ValueError):
    """The run lacks the measurements that a method needs."""


def known_methods() -> list[str]:
    """METHODS, and those of other packages: their estimators of directions and their trackers."""
    others = [name for name in (*DOA_METHODS.names, *TRACKERS.names) if name not in ('plain', 'ml', 'phat', 'bayes')]
    return list(dict.fromkeys((*METHODS, *others)))


def check_methods(methods: tuple[str, ...]) -> None:
    """Raises ValueError for an unknown method, with those that are installed."""
    for method in methods:
        if method not in known_methods():
            raise ValueError(f'method {method!r}, expected one of {", ".join(known_methods())}; others are found as entry '
                             f'points {DOA_METHODS.group} and {TRACKERS.group} of installed packages')


def code_of(methods: tuple[str, ...]) -> list[str]:
    """Digests of the code of those methods that other packages offer."""
    return [group.code(name) for name in methods if name not in METHODS for group in (DOA_METHODS, TRACKERS)]


def is_tracker(method: str) -> bool:
    """Whether a method takes measurements of sound and sight, and gives one bearing."""
    return OWN_TRACKERS.get(method, method) in TRACKERS.names


def is_folded(method: str) -> bool:
    """Whether a method leaves it to others to tell front from back, so that it is given the true hemisphere."""
    if is_tracker(method):
        return bool(getattr(TRACKERS.load(OWN_TRACKERS.get(method, method)), 'FOLDED', False))
    return method != 'sight'


def estimators_of(methods: tuple[str, ...]) -> tuple[str, ...]:
    """Estimators of directions that methods need beside the rig's own."""
    names = [ESTIMATORS.get(method, method) for method in methods]
    return tuple(dict.fromkeys(name for name in names if name in DOA_METHODS.names and name != OWN_METHOD))


def bearings(method: str, log: RunLog, filtered: bool = True) -> tuple[NDArray, NDArray]:
    """Times (n, s) and azimuths (n, rad, body frame) of one method.

    They are empty where the target was not detected. Raises UnavailableError where the run lacks the measurements that the
    method needs, ValueError for an unknown method.

    Parameters:
        method: one of `known_methods`.
        log: truth, measurements and bearings of the run.
        filtered: whether they pass a median filter in the world frame.
    """
    check_methods((method,))
    observed = False
    if is_tracker(method):
        series = track(method, log)
        known = series['state'] != State.NONE
        time = series['time'][known]
        world = wrap(series['azimuth'][known] + log.heading(time))
        observed = len(series) > 0
        if method == 'moving_average':  # of directions of arrival, which are evaluated at their stamps
            time, first = np.unique(time - series['delay'][known], return_index=True)
            world = world[first]
    elif method == 'sight':
        detected = log.sight['score'] >= TAU
        time = log.sight['time'][detected]
        world = wrap(log.sight['azimuth'][detected] + log.heading(time))
        observed = len(log.sight) > 0
    else:
        time, world = _nearest(log.sound if method == 'sound' else _columns(_directions(method, log)), log)
    if not time.size and not observed:
        raise UnavailableError(f'{method}: no measurements')
    return time, wrap((_median(world) if filtered else world) - log.heading(time))


def track(method: str, log: RunLog) -> Series:
    """Bearings of a tracker, as a series like `RunLog.fused`. Raises UnavailableError for a run of bearings alone.

    Parameters:
        method: `fused` for the filter, `gated` for the published controller, or another tracker.
        log: of the run.
    """
    if method == 'fused':
        return log.fused
    if not any(isinstance(event, list | CameraMeasurement) for event in log.events):
        raise UnavailableError(f'{method}: only bearings were recorded, without measurements')
    events = with_directions(log.events, _resolved(_directions(method, log), log)) if is_folded(method) else log.events
    return repeat(events, make_tracker(node_parameters(
        'av_fusion', 'fusion_node', overrides={'method': OWN_TRACKERS.get(method, method), 'tau': TAU})))


def _directions(method: str, log: RunLog) -> list[DoaMeasurement]:
    """Directions of arrival that a method uses; a bag without sound holds those of the rig's own estimator only."""
    own = [event[0] for event in log.events if isinstance(event, list) and event] if is_tracker(method) else []
    return log.doa.get(ESTIMATORS.get(method, method), own)


def _resolved(directions: list[DoaMeasurement], log: RunLog) -> list[DoaMeasurement]:
    """Directions with one hypothesis each, the one nearest to the truth, in the order in which their windows end."""
    directions = sorted((one for one in directions if one.hypotheses), key=lambda one: one.time + 0.5 * one.window)
    time, world = _nearest(_columns(directions), log)
    return [one._replace(hypotheses=(Hypothesis(float(azimuth), one.hypotheses[0].across_variance),), cone=None)
            for one, azimuth in zip(directions, wrap(world - log.heading(time)), strict=True)]


def _columns(measurements: list[DoaMeasurement]) -> Series:
    """Those that have a direction, as a series like `RunLog.sound`."""
    series = Series('time', 'azimuth', 'mirrored')
    for measurement in measurements:
        if measurement.hypotheses:
            series.add(measurement.time, *[*(one.azimuth for one in measurement.hypotheses), math.nan][:2])
    return series


def _nearest(series: Series, log: RunLog) -> tuple[NDArray, NDArray]:
    """Stamps (n, s), and of each direction the world azimuth (n, rad) of the hypothesis nearest to the truth."""
    time, azimuth, mirrored = series['time'], series['azimuth'], series['mirrored']
    true = log.true_azimuth(time)
    azimuth = np.where(np.abs(wrap(mirrored - true)) < np.abs(wrap(azimuth - true)), mirrored, azimuth)
    return time, wrap(azimuth + log.heading(time))


def _median(azimuth: NDArray) -> NDArray:
    """Circular median of the MEDIAN azimuths around each one."""
    if len(azimuth) < MEDIAN:
        return azimuth
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(azimuth, MEDIAN // 2, mode='edge'), MEDIAN)
    centre = azimuth[:, None]
    return wrap(azimuth + np.median(wrap(windows - centre), axis=1))


def repeat(events: Sequence[Event], tracker: Tracker) -> Series:
    """Give another tracker the events of a run; its bearings as a series like `RunLog.fused`."""
    series = RunLog().fused
    for event in events:
        if isinstance(event, CameraMeasurement):
            tracker.add_camera(event)
        elif isinstance(event, Pose):
            tracker.add_pose(event)
        elif isinstance(event, list):
            tracker.add_doas(event)
        else:
            track = tracker.estimate(event)
            series.add(event, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                       event - track.measured)
    return series


def with_directions(events: Sequence[Event], directions: Sequence[DoaMeasurement]) -> list[Event]:
    """Events with other directions of arrival in the place of the rig's own, each where its window ends."""
    waiting = sorted(usable_doas(directions), key=_end, reverse=True)
    found: list[Event] = []
    for event in events:
        if isinstance(event, list):
            continue
        while waiting and _end(waiting[-1]) <= (event if isinstance(event, float) else event.time):
            found.append([waiting.pop()])
        found.append(event)
    return [*found, *([one] for one in reversed(waiting))]


def _end(measurement: DoaMeasurement) -> float:
    """End (s) of a measurement's window."""
    return measurement.time + 0.5 * measurement.window
