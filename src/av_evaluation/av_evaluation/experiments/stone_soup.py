"""JPDA of Stone Soup on the same measurements, for comparison; needs the package `stonesoup`.

The state is the unit vector to a target and its rate, so that no angle wraps and everything is linear and Gaussian. It is
given what a user of Stone Soup would know of the sensors: the densities of clutter, the detection probabilities, the field of
view. The noise of overlapping windows is multiplied by the number of windows that share a sample, as in the rig's filter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stonesoup.dataassociator.neighbour import GlobalNearestNeighbour
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import KalmanUpdater

from av_evaluation.experiments.measurement_simulation import Scan, SensorModel
from av_fusion.measurement.measurements import Detection as Seen
from av_fusion.measurement.measurements import Hypothesis
from av_fusion.measurement.vectors import direction, tangents

RADIAL = 0.02  # standard deviation of the length of a measured unit vector
SKY = 2.0 * math.pi * 0.6  # sr, in which false directions are expected
UNKNOWN_ELEVATION = 0.15, 0.2  # rad, mean and standard deviation, where a pair of microphones measures none
PLACES = [0, 2, 4]  # of the vector in the state
START = datetime(2026, 1, 1)
USED = 0.1  # probability of an association from which a detection begins no track
# Tuning by the lowest mean GOSPA over `crossing` and `swarm_5` (seed 101), one value after the other. Searched were noise
# 0.0001 to 0.1, the sigma of rates 0.1 to 0.3, the probability of hearing 0.6 to 0.95, the lost sigma 8 to 20 deg.
NOISE = 0.0001  # 1/s^3, density of the acceleration of each coordinate
RATE_SIGMA = 0.1  # 1/s, prior, of the rate of each coordinate
HEARD, SEEN = 0.6, 0.8  # detection probabilities
POINTS = 3  # measurements until a track counts
LEAST_SCORE = 0.5  # of detections that are used
LOST_SIGMA = math.radians(9.0)  # at which a track ends


class _Sensors:
    """Measurements of a scan as detections of Stone Soup."""

    def __init__(self, model: SensorModel) -> None:
        self.model = model
        self._overlap = max(model.window * model.sound_rate, 1.0)
        length = math.sqrt(math.tau) * RADIAL
        self.sound_clutter = max(model.sound_clutter, 0.05) / (SKY * length)
        view = 4.0 * model.half_view * math.sin(model.half_height)
        self.sight_clutter = max(model.sight_clutter, 0.01) / (view * length)

    def heard(self, scan: Scan) -> set[Any]:
        return {self._detection(hypothesis, scan.time, self._overlap) for doa in scan.doas or ()
                for hypothesis in doa.hypotheses}

    def seen(self, scan: Scan) -> set[Any]:
        found = scan.image.detections if scan.image is not None else ()
        return {self._detection(detection, scan.time, 3.0) for detection in found if detection.score >= LEAST_SCORE}

    def in_view(self, state: Any) -> bool:
        x, y, z = (float(state.mean[place, 0]) for place in PLACES)
        return (abs(math.atan2(y, x)) < self.model.half_view
                and abs(math.atan2(z, math.hypot(x, y))) < self.model.half_height)

    @staticmethod
    def _detection(measured: Hypothesis | Seen, time: float, overlap: float) -> Any:
        known = math.isfinite(measured.elevation_variance)
        elevation, spread = ((measured.elevation, overlap * measured.elevation_variance) if known
                             else (UNKNOWN_ELEVATION[0], UNKNOWN_ELEVATION[1] ** 2))
        vector = np.array(direction(measured.azimuth, elevation))
        across, up = (np.array(axis) for axis in tangents(measured.azimuth, elevation))
        noise = (overlap * measured.across_variance * np.outer(across, across) + spread * np.outer(up, up)
                 + RADIAL**2 * np.outer(vector, vector))
        return Detection(StateVector(vector), timestamp=moment(time),
                         measurement_model=LinearGaussian(6, PLACES, noise))


def _motion() -> Any:
    return KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(NOISE)] * 3))


class StoneSoupJpda:
    """JPDA (by loopy belief propagation) with initiation from several measurements; a `Peer`.

    Parameters:
        model: of the sensors.
    """

    def __init__(self, model: SensorModel) -> None:
        self._sensors, self._tracks = _Sensors(model), set[Any]()
        predictor, self._updater = _motion(), KalmanUpdater()
        self._sound, self._sight = (
            JPDAwithLBP(PDAHypothesiser(predictor, self._updater, clutter, detected, prob_gate=0.999))
            for clutter, detected in ((self._sensors.sound_clutter, HEARD), (self._sensors.sight_clutter, SEEN)))
        self._deleter = CovarianceBasedDeleter(2.0 * LOST_SIGMA**2, mapping=PLACES)
        nearest = GlobalNearestNeighbour(DistanceHypothesiser(predictor, self._updater, Mahalanobis(), missed_distance=3.0))
        prior = GaussianState([0.0] * 6, np.diag([1.0, RATE_SIGMA**2] * 3))
        self._initiator = MultiMeasurementInitiator(prior, self._deleter, nearest, self._updater, min_points=POINTS)

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """See `Peer`."""
        if scan.doas is not None:
            self._step(self._sound, self._tracks, self._sensors.heard(scan), scan.time)
        if scan.image is not None:
            self._step(self._sight, {track for track in self._tracks if self._sensors.in_view(track.state)},
                       self._sensors.seen(scan), scan.time)
        return {id(track): _vector(track.state) for track in self._tracks}

    def identity(self) -> float:
        """See `Peer`."""
        return math.nan

    def _step(self, associator: Any, tracks: set[Any], detections: set[Any], time: float) -> None:
        now, used = moment(time), set[Any]()
        for track, update in jpda_updates(associator.associate(tracks, detections, now), self._updater, now, used):
            track.append(update)
        self._tracks -= self._deleter.delete_tracks(self._tracks)
        self._tracks |= self._initiator.initiate(detections - used, now)


def _vector(state: Any) -> NDArray[np.float64]:
    vector = np.array([float(state.mean[place, 0]) for place in PLACES])
    return np.asarray(vector / np.linalg.norm(vector))


def moment(time: float) -> datetime:
    """A time (s) as Stone Soup has it."""
    return START + timedelta(seconds=time)


def jpda_updates(associations: dict[Any, Any], updater: Any, time: datetime, used: set[Any]) -> Iterator[tuple[Any, Any]]:
    """Tracks with their updates: the hypotheses of each reduced to one Gaussian.

    Parameters:
        associations: hypotheses by track, of a probabilistic data associator.
        updater: of states.
        time: of the detections.
        used: gets the detections that stem from a track.
    """
    for track, hypotheses in associations.items():
        states, weights = [], []
        for hypothesis in hypotheses:
            states.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
            weights.append(hypothesis.probability)
            if hypothesis and hypothesis.probability > USED:
                used.add(hypothesis.measurement)
        mean, covariance = gm_reduce_single(StateVectors([state.state_vector for state in states]),
                                            np.stack([state.covar for state in states], axis=2), np.array(weights, float))
        yield track, GaussianStateUpdate(mean, covariance, hypotheses, time)
