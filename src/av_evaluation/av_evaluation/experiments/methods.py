"""The methods of the paper's comparison and ours, on identical data: bearings of each as a series in the rig's frame.

A direction of arrival is judged at its stamp, the centre of its window: how late it comes is its latency. A tracker says where
the target is now, and is judged so. Hearing alone knows no hemisphere: it is given the true one, as the paper did by hand, or
is left unaided (`unaided.py`). What is fused is given nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.experiments.unaided import chosen_images
from av_evaluation.metrics.run_log import RunLog, Series
from av_evaluation.runs.measurement_record import MeasurementRecord
from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.state_machine import MachineSettings
from av_fusion.filter.tracker import BayesTracker
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement

OWN = 'ml'  # the rig's own estimator
BASELINES = {'gcc_phat': 'phat', 'music': 'music', 'mvdr': 'mvdr'}
METHODS = ('fused', 'sound', 'sight', 'gated', 'kalman', 'moving_average', *BASELINES)
FOLDED = ('sound', 'moving_average', 'kalman', *BASELINES)  # those that are given the true hemisphere
KALMAN_DENSITY = 0.02  # rad^2/s^3, of the white angular acceleration
AVERAGED = 5  # windows, half a second
MEDIAN = 5  # samples of the median filter that every method gets


class UnavailableError(ValueError):
    """The run holds nothing that a method could work on."""


def bearings(method: str, record: MeasurementRecord, log: RunLog, tau: float = 0.5, aided: bool = True
             ) -> tuple[NDArray, NDArray]:
    """Times (n,) and body azimuths (n,) in rad of one method, median-filtered in the world frame.

    Those of FOLDED are `aided` by the truth. Empty where the target was looked for and not found. Raises UnavailableError
    where the run lacks what the method needs, ValueError for an unknown method.
    """
    looked = False
    if method not in METHODS:
        raise ValueError(f'method {method!r}, expected one of {", ".join(METHODS)}')
    if method in ('fused', 'gated'):
        series = track(method, record, log, tau)
        time, world = _following(series, log)
        looked = len(series) > 0
    elif method == 'sight':
        seen = log.sight['confidence'] >= tau
        time = log.sight['time'][seen]
        world = wrap(log.sight['azimuth'][seen] + _yaw(time, log))
        looked = len(log.sight) > 0
    elif method == 'kalman':
        time, world = _kalman(record, log, tau, aided)
    else:
        sounds = _sounds(method, record)
        time, world = _unmirrored(sounds, log) if aided else chosen_images(sounds, record, tau)
        if method == 'moving_average':
            time, world = _averaged(time, world)
    if not time.size and not looked:
        raise UnavailableError(f'{method}: nothing was reported')
    return time, wrap(_median(world) - _yaw(time, log))


def track(method: str, record: MeasurementRecord, log: RunLog, tau: float = 0.5) -> Series:
    """What the filter (`fused`) or the published machine (`gated`) says, as `RunLog.fused`. Raises UnavailableError."""
    machine = MachineSettings(tau=tau)
    if method == 'fused' and tau == MachineSettings().tau:
        return log.fused
    if not any(isinstance(event, DoaMeasurement | CameraMeasurement) for event in record.events):
        raise UnavailableError(f'{method}: only bearings were recorded, not what they rest on')
    return record.replay(BayesTracker(BayesSettings(machine=machine)) if method == 'fused'
                          else GatedTracker(GatedSettings(machine=machine)))


def _sounds(method: str, record: MeasurementRecord) -> list[DoaMeasurement]:
    """The sounds that a method of hearing works on; a bag without sound holds the rig's own directions only."""
    own = record.doa.get(OWN, [])
    if method == 'sound':
        return own
    if method in BASELINES:
        return record.doa.get(BASELINES[method], [])
    return record.doa.get(BASELINES['gcc_phat'], own)


def _following(series: Series, log: RunLog) -> tuple[NDArray, NDArray]:
    """Times and world azimuths where there is a target."""
    known = series['state'] != State.NONE
    time = series['time'][known]
    return time, wrap(series['azimuth'][known] + _yaw(time, log))


def _unmirrored(sounds: list[DoaMeasurement], log: RunLog) -> tuple[NDArray, NDArray]:
    """Stamps, and of each sound the image nearer to the truth, in the world frame."""
    sounds = [sound for sound in sounds if sound.hypotheses]
    if not sounds:
        return np.zeros(0), np.zeros(0)
    time = np.array([sound.time for sound in sounds])
    azimuth = np.array([min((h.azimuth for h in sound.hypotheses), key=lambda a, t=true: abs(wrap(a - t)))
                        for sound, true in zip(sounds, log.true_azimuth(time), strict=True)])
    return time, wrap(azimuth + _yaw(time, log))


def _averaged(time: NDArray, world: NDArray) -> tuple[NDArray, NDArray]:
    """Moving average on the circle of the newest windows."""
    sums = np.cumsum(np.concatenate([np.zeros(AVERAGED), np.exp(1j * world)]))
    return time, np.angle(sums[AVERAGED:] - sums[:-AVERAGED])


def _kalman(record: MeasurementRecord, log: RunLog, tau: float, aided: bool) -> tuple[NDArray, NDArray]:
    """A Kalman filter of azimuth and rate over GCC-PHAT and confident detections, with fixed noise, each taken as of now."""
    sounds = _sounds('kalman', record)
    late = 0.5 * sounds[0].window if sounds and aided else 0.0
    heard = _unmirrored(sounds, log) if aided else chosen_images(sounds, record, tau)
    events = [(time + late, azimuth, math.radians(4.0) ** 2) for time, azimuth in zip(*heard, strict=True)]
    for look in (event for event in record.events if isinstance(event, CameraMeasurement)):
        if look.best is not None and look.best.score >= tau:
            events.append((look.time, float(look.best.azimuth + _yaw(look.time, log)), math.radians(1.0) ** 2))
    if not events:
        return np.zeros(0), np.zeros(0)
    events.sort()
    return np.array([event[0] for event in events]), _filtered(events)


def _filtered(events: list[tuple[float, float, float]]) -> NDArray:
    """Azimuths (n,) of a Kalman filter of azimuth and rate, given times, azimuths and variances of measurements."""
    state, covariance, filtered, now = np.array([events[0][1], 0.0]), 0.1 * np.eye(2), [], events[0][0]
    for time, azimuth, variance in events:
        dt, now = time - now, time
        step = np.array([[1.0, dt], [0.0, 1.0]])
        noise = KALMAN_DENSITY * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        state, covariance = step @ state, step @ covariance @ step.T + noise
        gain = covariance[:, 0] / (covariance[0, 0] + variance)
        state = state + gain * wrap(azimuth - state[0])
        covariance = covariance - np.outer(gain, covariance[0])
        filtered.append(state[0])
    return wrap(np.array(filtered))


def _yaw(time: NDArray | float, log: RunLog) -> NDArray:
    return np.interp(time, log.rig['time'], np.unwrap(log.rig['yaw'])) if len(log.rig) else np.zeros(np.shape(time))


def _median(azimuth: NDArray) -> NDArray:
    """Running median on the circle over the MEDIAN samples about each one."""
    if len(azimuth) < MEDIAN:
        return azimuth
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(azimuth, MEDIAN // 2, mode='edge'), MEDIAN)
    centre = azimuth[:, None]
    return wrap(azimuth + np.median(wrap(windows - centre), axis=1))
