"""The methods of the paper's comparison and ours, on identical data: bearings of each as a series in the rig's frame.

Each method is judged by what it says at the instant it can say it: a direction of arrival at the end of its window, not at the
centre. The baselines of hearing alone know no hemisphere: they are given the true one, as the paper did by hand. What is
fused is given nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_fusion.bayes import BayesSettings, BayesTracker
from av_fusion.evaluation.recording import Recording
from av_fusion.evaluation.run_log import RunLog, Series
from av_fusion.gated import GatedSettings, GatedTracker
from av_fusion.machine import MachineSettings
from av_fusion.measurements import Look, Sound, State
from av_fusion.mode import Mode

BASELINES = {'gcc_phat': 'phat', 'music': 'music', 'mvdr': 'mvdr'}
METHODS = ('fused', 'gated', 'kalman', 'moving_average', *BASELINES, 'sight')
AVERAGED = 5  # windows, half a second
MEDIAN = 5  # samples of the median filter that every method gets


def bearings(method: str, recording: Recording, log: RunLog, tau: float = 0.5) -> tuple[NDArray, NDArray]:
    """Times (n,) and body azimuths (n,) in rad of one method, median-filtered in the world frame.

    Raises KeyError for a baseline that the run did not record, ValueError for an unknown method.
    """
    machine = MachineSettings(tau=tau)
    if method == 'fused':
        time, world = _following(recording.feed(BayesTracker(BayesSettings(machine=machine))), log)
    elif method == 'gated':
        time, world = _following(recording.feed(GatedTracker(replace(GatedSettings(), machine=machine))), log)
    elif method in BASELINES:
        time, world = _unmirrored(recording.sounds[BASELINES[method]], log)
    elif method == 'moving_average':
        time, world = _averaged(*_unmirrored(recording.sounds['phat'], log))
    elif method == 'kalman':
        time, world = _kalman(recording, log, tau)
    elif method == 'sight':
        seen = log.sight['confidence'] >= tau
        time = log.sight['time'][seen]
        world = wrap(log.sight['azimuth'][seen] + _yaw(time, log))
    else:
        raise ValueError(f'method {method!r}, expected one of {", ".join(METHODS)}')
    return time, wrap(_median(world) - _yaw(time, log))


def _following(series: Series, log: RunLog) -> tuple[NDArray, NDArray]:
    """Times and world azimuths where there is a target."""
    known = series['state'] != State.NONE
    time = series['time'][known]
    return time, wrap(series['azimuth'][known] + _yaw(time, log))


def _unmirrored(sounds: list[Sound], log: RunLog) -> tuple[NDArray, NDArray]:
    """Ends of the windows, and of each sound the image nearer to the truth, in the world frame."""
    time = np.array([sound.time for sound in sounds])
    azimuth = np.array([min((h.azimuth for h in sound.hypotheses), key=lambda a, t=true: abs(wrap(a - t)))
                        for sound, true in zip(sounds, log.true_azimuth(time), strict=True)])
    return time + np.array([0.5 * sound.window for sound in sounds]), wrap(azimuth + _yaw(time, log))


def _averaged(time: NDArray, world: NDArray) -> tuple[NDArray, NDArray]:
    """Moving average on the circle of the newest windows."""
    sums = np.cumsum(np.concatenate([np.zeros(AVERAGED), np.exp(1j * world)]))
    return time, np.angle(sums[AVERAGED:] - sums[:-AVERAGED])


def _kalman(recording: Recording, log: RunLog, tau: float) -> tuple[NDArray, NDArray]:
    """A Kalman filter of azimuth and rate over GCC-PHAT and confident detections, with fixed noise, each taken as of now."""
    events = [(time, azimuth, math.radians(4.0) ** 2)
              for time, azimuth in zip(*_unmirrored(recording.sounds['phat'], log), strict=True)]
    for look in (event for event in recording.events if isinstance(event, Look)):
        if look.best is not None and look.best.confidence >= tau:
            events.append((look.time, float(look.best.azimuth + _yaw(look.time, log)), math.radians(1.0) ** 2))
    events.sort()
    mode, filtered, now = Mode(1.0, events[0][1], 0.1, 0.0, 0.1), [], events[0][0]
    for time, azimuth, variance in events:
        mode.predict(float(time - now), 0.02, 0.0)
        mode.update(0.0, [mode.innovation(float(azimuth), 0.0)], [variance], [1.0])
        filtered.append(mode.azimuth)
        now = time
    return np.array([event[0] for event in events]), np.array(filtered)


def _yaw(time: NDArray | float, log: RunLog) -> NDArray:
    return np.interp(time, log.rig['time'], np.unwrap(log.rig['yaw']))


def _median(azimuth: NDArray) -> NDArray:
    """Running median on the circle over the newest MEDIAN samples, about the middle one."""
    if len(azimuth) < MEDIAN:
        return azimuth
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(azimuth, MEDIAN // 2, mode='edge'), MEDIAN)
    centre = azimuth[:, None]
    return wrap(azimuth + np.median(wrap(windows - centre), axis=1))
