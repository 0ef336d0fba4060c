"""JPDA of Stone Soup on the same reports, for comparison; needs the package `stonesoup`.

It gets what a user of Stone Soup would know of the rigs: their positions, the share of time for which they measure a drone,
the density of false tracks, and the speed of sound. Reports are used in the order of capture, as independent measurements that
are equivalent to them (`Tracklets`): their errors are correlated otherwise. Tracks begin where two directions meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stonesoup.base import Property
from stonesoup.dataassociator.neighbour import GlobalNearestNeighbour
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.base import Initiator
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.nonlinear import CartesianToElevationBearing
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, OrnsteinUhlenbeck
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.angle import Bearing, Elevation
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.types.track import Track
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from av_evaluation.experiments.stone_soup_jpda import jpda_updates, moment
from av_evaluation.network.figures import Estimate
from av_network.apparent_direction import ApparentDirections, apparent_directions
from av_network.meeting import MOST_APART, meetings
from av_network.motion_model import axes_shares, velocity_covariance
from av_network.observation import Observation
from av_network.report import Report
from av_network.report_queue import ReportQueue
from av_network.settings import NetworkSettings, RigSettings
from av_network.tracklets import Tracklets

PLACES, SPEEDS = [0, 2, 4], [1, 3, 5]  # of position and velocity in the state
WIDE_M = 300.0  # standard deviation of a position before the first direction
RECENT_S = 0.6  # for which a direction can meet that of another rig

MOTION = NetworkSettings(velocity_memory=6.0, speed_sigma=6.0)  # the best of what was measured


@dataclass(frozen=True)
class StoneSoupTuning:
    """What the tracker is told; by default the sensing of `five_drones`.

    Of the motion, three settings were compared, of the rest nothing was searched.

    Parameters:
        motion: of which the spectral density of the acceleration, the prior speed and the memory of velocities count.
        detected: probability that a rig's report holds a target.
        clutter (1/sr): density of a rig's directions that belong to no track.
        points: directions until a track counts, those of the first pair excluded.
        lost_sigma (m): root mean square error of a position from which a track ends.
    """

    motion: NetworkSettings = MOTION
    detected: float = 0.5
    clutter: float = 0.05
    points: int = 6
    lost_sigma: float = 7.0


class _Apparent(CartesianToElevationBearing):
    """Elevation and bearing of a target where it was when it emitted what a rig receives."""

    speed: float = Property(default=math.inf, doc='m/s, of sound; inf for light')

    def _function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        found = self._apparent(state)
        return StateVectors(np.stack([found.elevation, found.azimuth]))

    def jacobian(self, state: Any, **kwargs: Any) -> NDArray[np.float64]:
        found, H = self._apparent(state), np.zeros((2, 6))
        scale = np.array([1.0, 1.0 / max(math.cos(found.elevation[0]), 1e-3)])[:, None]
        H[:, PLACES], H[:, SPEEDS] = found.by_position[0, ::-1] * scale, found.by_velocity[0, ::-1] * scale
        return H

    def _apparent(self, state: Any) -> ApparentDirections:
        vectors = np.array(state.state_vector, float).T
        count, origin = len(vectors), np.array(self.translation_offset, float).ravel()
        return apparent_directions(vectors[:, PLACES], vectors[:, SPEEDS], origin, np.zeros(count), np.full(count, self.speed))


class _Reports:
    """Reports as detections of Stone Soup, in the order of capture."""

    def __init__(self, rigs: Sequence[RigSettings], wait: float) -> None:
        self._names = {rig.name: index for index, rig in enumerate(rigs)}
        self._queue, settings = ReportQueue(wait), NetworkSettings()
        self._tracklets, self._sound = Tracklets(settings.rig_manoeuvre, settings.rig_rate_sigma), settings.sound_speed

    def put(self, report: Report) -> None:
        self._queue.put(report, report.time)

    def ready(self, now: float) -> list[tuple[datetime, set[Any]]]:
        return [(moment(report.time), {self._detection(report, Observation(
            self._names[report.rig], report.position, report.time, *each)) for each in self._tracklets.fresh(report)})
            for report in self._queue.ready(now)]

    def _detection(self, report: Report, one: Observation) -> Any:
        azimuth, elevation = one.angles
        level = max(math.cos(elevation), 0.1)
        noise = np.diag([one.covariance[1, 1], one.covariance[0, 0] / level**2])
        model = _Apparent(6, PLACES, noise, translation_offset=StateVector(report.position),
                          speed=self._sound if one.sighting.by_sound else math.inf)
        return Detection(StateVector([Elevation(elevation), Bearing(azimuth)]), timestamp=moment(report.time),
                         measurement_model=model, metadata={'observation': one})


class _Triangulation(Initiator):
    """Tracks where a direction meets one of another rig; the prior is wide, and both directions update it."""

    predictor: Any = Property(doc='of states')
    updater: Any = Property(doc='of states')
    motion: NetworkSettings = Property(doc='of targets')
    most_sigma: float = Property(doc='m, of a position with which a track begins')

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._recent: dict[tuple[int, int], Any] = {}

    def initiate(self, detections: set[Any], timestamp: datetime, **_: Any) -> set[Any]:
        self._recent = {key: each for key, each in self._recent.items()
                        if (timestamp - each.timestamp).total_seconds() < RECENT_S}
        found = {Track([state]) for one in detections for state in self._states(one, timestamp)}
        self._recent |= {one.metadata['observation'].key: one for one in detections}
        return found

    def _states(self, one: Any, timestamp: datetime) -> list[Any]:
        direction = one.metadata['observation']
        others = [each for key, each in self._recent.items() if key[0] != direction.rig]
        if not others:
            return []
        none = np.zeros(max(each.metadata['observation'].rig for each in [one, *others]) + 1)
        met = meetings(direction, [each.metadata['observation'] for each in others], none, none,
                       self.motion.most_distance, self.motion.speed_sigma * RECENT_S)
        states = [self._state(place, other, one, timestamp)
                  for place, apart, other in zip(met.places, met.apart, others, strict=True) if apart < MOST_APART]
        return [state for state in states if position_sigma(state) < self.most_sigma]

    def _state(self, place: NDArray[np.float64], first: Any, second: Any, timestamp: datetime) -> Any:
        mean, covariance = np.zeros((6, 1)), np.diag([WIDE_M**2, 0.0] * 3)
        mean[PLACES, 0], covariance[np.ix_(SPEEDS, SPEEDS)] = place, velocity_covariance(self.motion)
        begun = GaussianStatePrediction(StateVector(mean), covariance, timestamp=first.timestamp)
        state = self.updater.update(SingleHypothesis(begun, first))
        return self.updater.update(SingleHypothesis(self.predictor.predict(state, timestamp=timestamp), second))


class StoneSoupJpda:
    """JPDA (by loopy belief propagation) with extended Kalman filters; a `NetworkPeer`.

    Parameters:
        rigs: the rigs.
        tuning: see `StoneSoupTuning`.
        wait (s): see `ReportQueue`.
    """

    def __init__(self, rigs: Sequence[RigSettings], tuning: StoneSoupTuning | None = None, wait: float = 0.5) -> None:
        tuning = tuning or StoneSoupTuning()
        self._reports, self._tracks, self._ids = _Reports(rigs, wait), set[Any](), dict[str, int]()
        self._predictor, self._updater = _motion(tuning), ExtendedKalmanUpdater()
        self._associator = JPDAwithLBP(PDAHypothesiser(self._predictor, self._updater, tuning.clutter, tuning.detected,
                                                       prob_gate=0.999))
        self._deleter = CovarianceBasedDeleter(tuning.lost_sigma**2, mapping=PLACES)
        nearest = GlobalNearestNeighbour(DistanceHypothesiser(self._predictor, self._updater, Mahalanobis(),
                                                              missed_distance=3.0))
        pairs = _Triangulation(self._predictor, self._updater, tuning.motion, 2.0 * tuning.lost_sigma)
        self._initiator = MultiMeasurementInitiator(None, CovarianceBasedDeleter(4.0 * tuning.lost_sigma**2, mapping=PLACES),
                                                    nearest, self._updater, min_points=tuning.points + 1, initiator=pairs)

    def take(self, report: Report, now: float) -> None:
        """See `NetworkPeer`."""
        self._reports.put(report)

    def estimates(self, now: float) -> list[Estimate]:
        """See `NetworkPeer`."""
        for time, detections in self._reports.ready(now):
            self._step(detections, time)
        return [_estimate(self._ids.setdefault(track.id, len(self._ids) + 1),
                          self._predictor.predict(track.state, timestamp=moment(now))) for track in self._tracks]

    def _step(self, detections: set[Any], time: datetime) -> None:
        used, associations = set[Any](), self._associator.associate(self._tracks, detections, time)
        for track, update in jpda_updates(associations, self._updater, time, used):
            track.states = [update]
        self._tracks -= self._deleter.delete_tracks(self._tracks)
        self._tracks |= self._initiator.initiate(detections - used, time)


def position_sigma(state: Any) -> float:
    """Root mean square error (m) of a state's position by its covariance."""
    return math.sqrt(float(np.trace(state.covar[np.ix_(PLACES, PLACES)])))


def _motion(tuning: StoneSoupTuning) -> Any:
    motion = tuning.motion
    return KalmanPredictor(CombinedLinearGaussianTransitionModel([
        OrnsteinUhlenbeck(motion.manoeuvre * share, 1.0 / motion.velocity_memory) for share in axes_shares(motion)]))


def _estimate(identifier: int, state: Any) -> Estimate:
    order = [*PLACES, *SPEEDS]
    return Estimate(identifier, np.array(state.state_vector, float).ravel()[order],
                    np.array(state.covar, float)[np.ix_(order, order)])
