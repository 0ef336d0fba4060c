"""A component of the posterior: a Gaussian of the target's direction on the sphere, its rates, and its inverse range."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import remainder, tau
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.vectors import ZERO, Rows, Vector, combined, dot, tangents, turned, turned_back
from av_fusion.measurement.vectors import angles as angles_of
from av_fusion.measurement.vectors import direction as direction_of
from av_fusion.tracks.evidence import LONGEST_S, Evidence
from av_fusion.tracks.motion import CLIMB_S, Elevation, MotionModel
from av_fusion.tracks.past_state import NOW, Deviation, Lag, PastState, Row, share_within
from av_fusion.tracks.settings import FilterSettings

PASSING_S = 1.0  # correlation time of the acceleration of a target that passes by
RANGE_S = 30.0  # time constant with which the range is forgotten
LEAST_INVERSE_RANGE, LARGEST_INVERSE_RANGE = 1e-3, 1.0  # 1/m
LARGEST_AZIMUTH_VARIANCE = math.pi**2 / 3.0  # of an azimuth that is not known at all
ASSOCIATED = 0.5  # probability from which a measurement counts as associated with a component
SIZE = 5  # of the state: directions across and up (rad), their rates (rad/s), inverse range (1/m)
_IDENTITY = np.identity(SIZE)
NOT_HIDDEN = (0.0, -math.inf)  # at no time
SOUND = ''  # no camera's name
LEAST = 1e-6  # probability of anything, so that what is measured is possible by any settings, and a target can be given up


class BodyDirection(NamedTuple):
    """A direction in the body frame, with the variances of azimuth and elevation; angles in rad."""

    azimuth: float
    elevation: float
    azimuth_variance: float
    elevation_variance: float

    @property
    def front_share(self) -> float:
        """Probability that the azimuth is within 90 degrees."""
        return share_within(0.5 * math.pi, self.azimuth, self.azimuth_variance)


@dataclass(eq=False, slots=True)
class GaussianComponent:
    """A density of direction, rates and inverse range, with its weight in the mixture: a Gaussian for each mode of motion.

    The mean is a direction in the world. Deviations are in the plane that touches the sphere there, across (to larger azimuth)
    and up. A change of the mean moves along a great circle and turns covariance and rates with the axes of that plane, so that
    nothing is singular at the zenith: there the axes are any two.

    Parameters:
        weight: probability of the component.
        azimuth, elevation (rad): mean direction in the world.
        modes (k,): probabilities of the modes of motion.
        offsets (k, 5): mean of the state (across, up, rate across, rate up, inverse range) in each mode, from that of all.
        covariances (k, 5, 5): of the state in each mode.
        across_rate, up_rate (rad/s): rates of the direction that are the target's own, without the rig's translation.
        inverse_range (1/m): of the target.
        elevation_measured: whether a measurement has updated the elevation, or the motion model alone.
        on_rig: whether the source is fixed to the body, as the rig's own rotors are; rates are then relative to that.
        usual: distribution to which the elevation returns.
        hidden: by sensor, the probability that the target is hidden from it, and the time (s) for which that is valid: fog, or
            something near, hides it from a camera, louder sources from the microphones.
        newest_doa, newest_sighting (s): capture times of the newest direction of arrival, and of the newest image with a
            detection, that is associated with the component: more probably than not it stems from this target.
        evidence: what was associated since the last report to other rigs.
    """

    weight: float
    azimuth: float
    elevation: float
    modes: NDArray[np.float64] = field(repr=False)
    offsets: NDArray[np.float64] = field(repr=False)
    covariances: NDArray[np.float64] = field(repr=False)
    across_rate: float = 0.0
    up_rate: float = 0.0
    inverse_range: float = 0.03
    elevation_measured: bool = False
    on_rig: bool = False
    usual: Elevation = field(default=Elevation(0.0, 1.0, 1.0), repr=False)
    hidden: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    newest_doa: float = -math.inf
    newest_sighting: float = -math.inf
    evidence: deque[Evidence] = field(default_factory=deque, repr=False)

    @classmethod
    def born(cls, share: float, azimuth: float, elevation: float, covariance: tuple[float, float, float],
             settings: FilterSettings, usual: Elevation | None = None) -> GaussianComponent:
        """A component at a measured direction.

        Parameters:
            share: its weight.
            azimuth, elevation (rad): the direction in the world.
            covariance (rad^2): variance across, covariance, and variance up.
            settings: of targets.
            usual: distribution to which the elevation returns, where that was not measured; None where it was.
        """
        model, rate_variance, level = settings.model, settings.rate_sigma**2, math.cos(elevation) ** 2
        up_rate_variance = level * float(model.shares @ model.climb_rates**2) + (1.0 - level) * rate_variance
        hh, hv, vv = covariance
        state = np.diag((hh, vv, rate_variance, up_rate_variance, model.usual_inverse_range**2))
        state[0, 1] = state[1, 0] = hv
        return cls(share, azimuth, elevation, model.shares, np.zeros((len(model.shares), SIZE)),
                   np.array([state] * len(model.shares)), inverse_range=model.usual_inverse_range,
                   elevation_measured=usual is None, usual=usual or model.elevations[0])

    @property
    def measured(self) -> float:
        """Capture time (s) of the newest measurement that is associated with the component."""
        return max(self.newest_doa, self.newest_sighting)

    @property
    def direction(self) -> Vector:
        """Unit vector of the mean in the world."""
        return direction_of(self.azimuth, self.elevation)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance (5, 5) of the state, whatever the mode."""
        within = (self.modes @ self.covariances.reshape(len(self.modes), -1)).reshape(SIZE, SIZE)
        return within + (self.modes * self.offsets.T) @ self.offsets

    def rates(self, velocity: Vector) -> tuple[float, float]:
        """Rates (rad/s) across and up as seen from a rig that moves at `velocity` (m/s, world)."""
        across, up = tangents(self.azimuth, self.elevation)
        return (self.across_rate - self.inverse_range * dot(velocity, across),
                self.up_rate - self.inverse_range * dot(velocity, up))

    def predict(self, dt: float, model: MotionModel, moving: bool, moved: Vector, turn: Rows) -> None:
        """Predict by `dt` s: white angular acceleration, of a density that depends on the mode.

        Close to the horizon targets fly level: there the elevation returns to its usual value, and the rate up decays. What
        is left of this at an elevation e has the weight cos(e)^2, so that both axes are alike at the zenith. A target that
        passes by at constant speed accelerates on the sphere by up to its squared rate.

        Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 6.2.2-12.

        Parameters:
            dt (s): duration of the prediction; with a negative one the state is extrapolated back without process noise.
            model: motion of targets.
            moving: whether the target accelerates at all.
            moved (m), turn: displacement and rotation of the rig meanwhile, in the world. What is on the rig turns with it.
        """
        level, late = math.cos(self.elevation) ** 2, max(dt, 0.0)
        kept = math.exp(-0.5 * level * late * model.elevation_density / self.usual.variance)
        held = math.exp(-level * late / CLIMB_S)
        forgotten = math.exp(-late / RANGE_S)
        step = _IDENTITY.copy()
        step[0, 2], step[1, 3], step[1, 1], step[3, 3] = dt, 0.5 * dt * (1.0 + held), kept, held
        step[4, 4], s = forgotten, self.inverse_range
        across = dt * self.across_rate
        up = 0.5 * dt * (1.0 + held) * self.up_rate + (kept - 1.0) * (self.elevation - self.usual.mean)
        if moved != ZERO and not self.on_rig:
            left, above = tangents(self.azimuth, self.elevation)
            beside, below, nearer = dot(moved, left), dot(moved, above), dot(moved, self.direction)
            step[0, 4], step[1, 4], step[4, 4] = -beside, -below, forgotten * (1.0 + 2.0 * s * nearer)
            across, up, s = across - s * beside, up - s * below, s + s * s * nearer
        if late > 0.0:
            self._mix(model.transitions(dt))
        self.offsets, self.covariances = self.offsets @ step.T, step @ self.covariances @ step.T
        self.inverse_range = _bounded(model.usual_inverse_range + forgotten * (s - model.usual_inverse_range))
        self.up_rate *= held
        if late > 0.0:
            self._add_noise(dt, model, moving, level, kept, forgotten)
        self.azimuth = remainder(self.azimuth + math.cos(self.elevation) * across, tau)  # level flight, as far as it is level
        self.move((1.0 - level) * across, up)
        if self.on_rig:
            self.turn_world(turn)

    def _mix(self, transitions: NDArray[np.float64]) -> None:
        """Change modes with the probabilities (k, k): the interaction of Blom and Bar-Shalom, 1988.

        The interacting multiple model algorithm for systems with Markovian switching coefficients, IEEE Transactions on
        Automatic Control 33(8).
        """
        joint = self.modes[:, None] * transitions
        self.modes = self.modes @ transitions
        given = (joint / self.modes).T  # (to, from)
        squares = (self.covariances + self.offsets[:, :, None] * self.offsets[:, None, :]).reshape(len(given), -1)
        self.offsets = given @ self.offsets
        self.covariances = (given @ squares).reshape(-1, SIZE, SIZE) - self.offsets[:, :, None] * self.offsets[:, None, :]

    def _add_noise(self, dt: float, model: MotionModel, moving: bool, level: float, kept: float, forgotten: float) -> None:
        passing = min(self.across_rate**2 + self.up_rate**2, 0.5)
        q = float(moving) * model.accelerations + PASSING_S * passing**2
        climb = math.sin(self.elevation) * passing
        q_up = (1.0 - level) * q + level * 2.0 * model.climb_rates**2 / CLIMB_S + PASSING_S * climb**2
        white = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        self.covariances[:, 0:4:2, 0:4:2] += q[:, None, None] * white
        self.covariances[:, 1:4:2, 1:4:2] += q_up[:, None, None] * white
        self.covariances[:, 1, 1] += 0.5 * (1.0 - kept * kept) * self.usual.variance
        self.covariances[:, 4, 4] += (1.0 - forgotten**2) * model.usual_inverse_range**2

    def at(self, lag: Lag = NOW) -> PastState:
        """The direction at the time of a measurement that is earlier by a lag."""
        seconds, moved = lag.seconds, ZERO if self.on_rig else lag.moved
        across, up = -seconds * self.across_rate, -seconds * self.up_rate
        jacobian = np.zeros((2, SIZE))
        jacobian[0, 0] = jacobian[1, 1] = 1.0
        jacobian[0, 2] = jacobian[1, 3] = -seconds
        if moved != ZERO:
            beside, below = [dot(moved, axis) for axis in tangents(self.azimuth, self.elevation)]
            jacobian[0, 4], jacobian[1, 4] = beside, below
            across, up = across + self.inverse_range * beside, up + self.inverse_range * below
        gains, offsets = self.covariances @ jacobian.T, self.offsets @ jacobian.T
        spreads = jacobian @ gains
        (hh, hv), (_, vv) = ((self.modes @ spreads.reshape(-1, 4)).reshape(2, 2) + (self.modes * offsets.T) @ offsets).tolist()
        level = math.cos(self.elevation)
        azimuth = self.azimuth + level * across
        left, above = tangents(azimuth, self.elevation)
        past = PastState(direction_of(azimuth, self.elevation), left, above, hh, hv, vv, self.modes, offsets, spreads, gains,
                         lag)
        past = past.shifted((1.0 - level * level) * across, up)
        return past.turned(lag.turn) if self.on_rig else past

    def update(self, time: float, seen: bool, past: PastState, deviations: Sequence[Deviation], shares: NDArray[np.float64],
               fraction: float, keep_elevation: bool = False) -> None:
        """Update by alternative values of one quantity, by probabilistic data association (Bar-Shalom and Tse, 1975).

        Where the elevation is kept, it and the rate up keep their means, and their uncertainty is accounted for:
        Schmidt-Kalman filter (Schmidt, Advances in Control Systems 3, 1966, pp. 293-340). A cone about a level axis says
        nothing about the elevation close to the horizon, and in linear approximation ever more once the mean has left it. Such
        a mean would climb instead of turning back.

        What values say by themselves is kept as evidence, if one of them probably belongs to this component. That of images is
        weakened by the effective sample fraction: their errors are alike, so that together they say less than the filter,
        which moves on, makes of each.

        Parameters:
            time (s): capture time.
            seen: whether by the camera.
            past: the component at that time.
            deviations: the values, compared with it.
            shares (k, m): probability of each in each mode that it belongs to this component; they sum to at most one.
            fraction: effective sample fraction.
            keep_elevation: whether the elevation is kept, as far as it is level.
        """
        row = deviations[int((self.modes @ shares).argmax())].row  # those of directions far away differ
        innovations, noises = np.array([one.innovations for one in deviations]).T, np.array([one.noise for one in deviations])
        curved = np.array([np.maximum(one.totals - past.variances(one.row) - one.noise, 0.0) for one in deviations]).T
        independent = curved + noises / fraction
        self._accept(time, seen, past, row, _moments(*[self.modes @ each for each in (innovations, independent, shares)]))
        share, mean, square, variance = _moments(innovations, curved + noises if seen else independent, shares)
        total = past.variances(row) + variance
        cross = past.gains @ np.array(row)
        gain = cross / total[:, None]
        if keep_elevation:
            gain[:, [1, 3]] *= math.sin(self.elevation) ** 2  # overhead both axes are alike
        both = gain[:, :, None] * cross[:, None, :] * share[:, None, None]
        spread = (share * total + square - mean**2)[:, None, None]
        self.covariances = (self.covariances - both - both.transpose(0, 2, 1)
                            + gain[:, :, None] * gain[:, None, :] * spread)
        self.offsets = self.offsets + gain * mean[:, None]
        self.recentre()

    def _accept(self, time: float, seen: bool, past: PastState, row: Row, moments: NDArray[np.float64]) -> None:
        share, mean, square, variance = moments.tolist()
        length = math.hypot(*row)
        if share < ASSOCIATED or length < 1e-6:
            return
        normal = combined(row[0] / length, past.left, row[1] / length, past.above)
        variance = (variance + square / share - (mean / share) ** 2) / share / length**2
        self.evidence.append(Evidence(time, seen, past.direction, normal, mean / share / length, variance))
        while self.evidence[0].time < time - LONGEST_S:
            self.evidence.popleft()

    def update_moments(self, past: PastState, row: Row, shifts: NDArray[np.float64], changes: NDArray[np.float64]) -> None:
        """Update by new moments of one quantity.

        Parameters:
            past: the component at the time for which they hold.
            row: derivatives of the quantity with respect to the direction across and up at that time.
            shifts (k,), changes (k,): of its mean and its variance in each mode.
        """
        gain = past.gains @ np.array(row) / np.maximum(past.variances(row), 1e-12)[:, None]
        self.covariances = self.covariances + gain[:, :, None] * gain[:, None, :] * changes[:, None, None]
        self.offsets = self.offsets + gain * shifts[:, None]
        self.recentre()

    def weigh_modes(self, likelihoods: NDArray[np.float64]) -> None:
        """Weigh the modes by likelihoods (k,) of a measurement."""
        weights = self.modes * likelihoods
        self.modes = weights / np.add.reduce(weights)

    def recentre(self) -> None:
        """Move the mean to that of all modes."""
        change = self.modes @ self.offsets
        self.offsets = self.offsets - change
        across, up, across_rate, up_rate, inverse_range = change.tolist()
        self.across_rate += across_rate
        self.up_rate += up_rate
        self.inverse_range = _bounded(self.inverse_range + inverse_range)
        self.move(across, up)

    def move(self, across: float, up: float) -> None:
        """Move the mean along a great circle; covariance and rates turn with the axes of the plane."""
        length = math.hypot(across, up)
        if length < 1e-12:
            return
        cos_length, sin_length = math.cos(length), math.sin(length)
        level, climb, east, north = math.cos(self.elevation), math.sin(self.elevation), across / length, up / length
        x, y = level * cos_length - climb * sin_length * north, east * sin_length
        course = math.atan2(level * cos_length * north - climb * sin_length, level * east)
        self.elevation = math.atan2(climb * cos_length + level * sin_length * north, math.hypot(x, y))
        self.azimuth = remainder(self.azimuth + math.atan2(y, x), tau)
        self._turn_axes(course - math.atan2(north, east))

    def _turn_axes(self, angle: float) -> None:
        """Turn covariance and rates by `angle` (rad) from the axis across towards the axis up."""
        c, s = math.cos(angle), math.sin(angle)
        self.across_rate, self.up_rate = c * self.across_rate - s * self.up_rate, s * self.across_rate + c * self.up_rate
        turn = np.array([[c, -s, 0, 0, 0], [s, c, 0, 0, 0], [0, 0, c, -s, 0], [0, 0, s, c, 0], [0, 0, 0, 0, 1.0]])
        self.offsets, self.covariances = self.offsets @ turn.T, turn @ self.covariances @ turn.T

    def turn_world(self, rows: Rows) -> None:
        """Turn the component with the world, where the rig's attitude was corrected."""
        self.evidence.clear()
        left = turned(rows, tangents(self.azimuth, self.elevation)[0])
        self.azimuth, self.elevation = angles_of(turned(rows, self.direction))
        across, up = tangents(self.azimuth, self.elevation)
        self._turn_axes(math.atan2(dot(left, up), dot(left, across)))

    def in_body(self, attitude: Rows) -> BodyDirection:
        """The direction in the body frame."""
        azimuth, elevation = angles_of(turned_back(attitude, self.direction))
        across, up = tangents(self.azimuth, self.elevation)
        (hh, hv), (_, vv) = self.covariance[:2, :2].tolist()
        variances = []
        for axis in tangents(azimuth, elevation):
            along = turned(attitude, axis)
            h, v = dot(along, across), dot(along, up)
            variances.append(h * h * hh + 2.0 * h * v * hv + v * v * vv)
        level = max(math.cos(elevation) ** 2, 1e-9)
        return BodyDirection(azimuth, elevation, min(variances[0] / level, max(LARGEST_AZIMUTH_VARIANCE, variances[0])),
                             variances[1])

    def p_hidden(self, sensor: str, time: float, usual: float, lasts: float, is_known: bool = False) -> float:
        """Probability that the target is hidden from a sensor at a time: a two-state Markov chain.

        What hides a target changes slowly: a hundred images without it are hardly more evidence than one. A target that was
        perceived was not hidden then.

        Parameters:
            sensor: name of the camera; SOUND for the microphones.
            time (s): capture time of a scan.
            usual: long-run probability.
            lasts (s): correlation time.
            is_known: whether the long-run probability is known, and bounds what this scan tells, or assumed.
        """
        hidden, newest = self.hidden.get(sensor, NOT_HIDDEN)
        kept = math.exp(min(newest - time, 0.0) / lasts)
        return max(usual + kept * (hidden - usual) if hidden > usual or not is_known else usual, LEAST)

    def note_hidden(self, sensor: str, time: float, hidden: float) -> None:
        """Note the probability that the target was hidden from a sensor (see `p_hidden`) at a time (s)."""
        self.hidden = {**self.hidden, sensor: (hidden, max(time, self.hidden.get(sensor, NOT_HIDDEN)[1]))}


def _bounded(inverse_range: float) -> float:
    return min(max(inverse_range, LEAST_INVERSE_RANGE), LARGEST_INVERSE_RANGE)


def _moments(innovations: NDArray[np.float64], variances: NDArray[np.float64], shares: NDArray[np.float64]
             ) -> NDArray[np.float64]:
    """Sum of the shares (..., m), mean and mean square of the innovations by them, and variance of a value, (4, ...).

    The variance is 1 where no value has a share, or one below 0 by rounding: a total is never 0 / 0, nor negative.
    """
    weighted = shares * innovations
    share, mean, square, information = np.add.reduce((shares, weighted, weighted * innovations, shares / variances), axis=-1)
    return np.array((share, mean, square, np.maximum(share, 1e-300) / np.maximum(information, 1e-300)))
