"""Methods of the publication's comparison and ours: the bearings of each on identical measurements.

A direction of arrival is evaluated at its stamp, the centre of its window; its delay counts as latency. A tracker is evaluated
at the time of its estimate. Methods of sound alone cannot resolve front and back: they are given the true hemisphere, as in the
publication, or the hypothesis of the published controller (`unaided.py`). Trackers use no truth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import State
from av_evaluation.experiments.unaided import chosen_hypotheses
from av_evaluation.metrics.run_log import RunLog, Series
from av_evaluation.runs.measurement_record import OWN_METHOD, MeasurementRecord
from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.state_machine import MachineSettings
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.multi_target.settings import MultiTargetSettings
from av_fusion.multi_target.tracker import MultiTargetTracker

BASELINES = {'gcc_phat': 'phat', 'music': 'music', 'mvdr': 'mvdr'}
TRACKERS = ('fused', 'gated')
METHODS = ('fused', 'sound', 'sight', 'gated', 'kalman', 'moving_average', *BASELINES)
FOLDED = ('sound', 'moving_average', 'kalman', *BASELINES)  # methods that are given the true hemisphere
KALMAN_DENSITY = 0.02  # rad^2/s^3, of the white angular acceleration
AVERAGED = 5  # windows of the moving average, half a second
MEDIAN = 5  # bearings of the median filter of every method


class UnavailableError(ValueError):
    """The run lacks the measurements that a method needs."""


def bearings(method: str, record: MeasurementRecord, log: RunLog, tau: float = 0.5, aided: bool = True
             ) -> tuple[NDArray, NDArray]:
    """Times (n, s) and azimuths (n, rad, body frame) of one method, median-filtered in the world frame.

    They are empty where the target was not detected. Raises UnavailableError where the run lacks the measurements that the
    method needs, ValueError for an unknown method.

    Parameters:
        method: one of METHODS.
        record: measurements of the run.
        log: truth, measurements and bearings of the run.
        tau: score from which a detection counts.
        aided: whether methods of FOLDED are given the true hemisphere.
    """
    observed = False
    if method not in METHODS:
        raise ValueError(f'method {method!r}, expected one of {", ".join(METHODS)}')
    if method in TRACKERS:
        series = track(method, record, log, tau)
        time, world = _tracked(series, log)
        observed = len(series) > 0
    elif method == 'sight':
        detected = log.sight['score'] >= tau
        time = log.sight['time'][detected]
        world = wrap(log.sight['azimuth'][detected] + log.heading(time))
        observed = len(log.sight) > 0
    elif method == 'kalman':
        time, world = _kalman(record, log, tau, aided)
    else:
        measurements = _doa_measurements(method, record)
        time, world = _nearest(measurements, log) if aided else chosen_hypotheses(measurements, record, tau)
        if method == 'moving_average':
            time, world = _averaged(time, world)
    if not time.size and not observed:
        raise UnavailableError(f'{method}: no measurements')
    return time, wrap(_median(world) - log.heading(time))


def track(method: str, record: MeasurementRecord, log: RunLog, tau: float = 0.5) -> Series:
    """Bearings of a tracker, as a series like `RunLog.fused`. Raises UnavailableError for a run of bearings alone.

    Parameters:
        method: `fused` for the filter, `gated` for the published controller.
        record: measurements of the run.
        log: of the run.
        tau: gate on the score of detections.
    """
    machine = MachineSettings(tau=tau)
    if method == 'fused' and tau == MachineSettings().tau:
        return log.fused
    if not any(isinstance(event, DoaMeasurement | CameraMeasurement) for event in record.events):
        raise UnavailableError(f'{method}: only bearings were recorded, without measurements')
    if method == 'gated':
        return record.replay(GatedTracker(GatedSettings(machine=machine)))
    return record.replay(MultiTargetTracker(MultiTargetSettings(BayesSettings(machine=machine))))


def _doa_measurements(method: str, record: MeasurementRecord) -> list[DoaMeasurement]:
    """Directions of arrival that a method uses; a bag without sound holds those of the rig's own estimator only."""
    own = record.doa.get(OWN_METHOD, [])
    if method == 'sound':
        return own
    if method in BASELINES:
        return record.doa.get(BASELINES[method], [])
    return record.doa.get(BASELINES['gcc_phat'], own)


def _tracked(series: Series, log: RunLog) -> tuple[NDArray, NDArray]:
    """Times (n, s) and world azimuths (n, rad) with a track."""
    known = series['state'] != State.NONE
    time = series['time'][known]
    return time, wrap(series['azimuth'][known] + log.heading(time))


def _nearest(measurements: list[DoaMeasurement], log: RunLog) -> tuple[NDArray, NDArray]:
    """Stamps (n, s), and of each measurement the world azimuth (n, rad) of the hypothesis nearest to the truth."""
    measurements = [measurement for measurement in measurements if measurement.hypotheses]
    time = np.array([measurement.time for measurement in measurements])
    azimuth = np.zeros(len(time))
    for k, (measurement, true) in enumerate(zip(measurements, log.true_azimuth(time), strict=True)):
        azimuths = [hypothesis.azimuth for hypothesis in measurement.hypotheses]
        azimuth[k] = azimuths[int(np.argmin(np.abs(wrap(np.array(azimuths) - true))))]
    return time, wrap(azimuth + log.heading(time))


def _averaged(time: NDArray, world: NDArray) -> tuple[NDArray, NDArray]:
    """Circular mean of the newest AVERAGED azimuths at each time."""
    sums = np.cumsum(np.concatenate([np.zeros(AVERAGED), np.exp(1j * world)]))
    return time, np.angle(sums[AVERAGED:] - sums[:-AVERAGED])


def _kalman(record: MeasurementRecord, log: RunLog, tau: float, aided: bool) -> tuple[NDArray, NDArray]:
    """A Kalman filter of azimuth and rate over GCC-PHAT and detections from `tau`, with fixed noise.

    Measurements count at their arrival, without compensation of delays.
    """
    measurements = _doa_measurements('kalman', record)
    delay = 0.5 * measurements[0].window if measurements and aided else 0.0
    doa = _nearest(measurements, log) if aided else chosen_hypotheses(measurements, record, tau)
    events = [(time + delay, azimuth, math.radians(4.0) ** 2) for time, azimuth in zip(*doa, strict=True)]
    for camera in (event for event in record.events if isinstance(event, CameraMeasurement)):
        if camera.best is not None and camera.best.score >= tau:
            events.append((camera.time, float(camera.best.azimuth + log.heading(camera.time)), math.radians(1.0) ** 2))
    if not events:
        return np.zeros(0), np.zeros(0)
    events.sort()
    return np.array([event[0] for event in events]), _filtered(events)


def _filtered(events: list[tuple[float, float, float]]) -> NDArray:
    """Azimuths (n, rad) of a Kalman filter, given times (s), azimuths (rad) and variances (rad^2) of measurements."""
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


def _median(azimuth: NDArray) -> NDArray:
    """Circular median of the MEDIAN azimuths around each one."""
    if len(azimuth) < MEDIAN:
        return azimuth
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(azimuth, MEDIAN // 2, mode='edge'), MEDIAN)
    centre = azimuth[:, None]
    return wrap(azimuth + np.median(wrap(windows - centre), axis=1))
