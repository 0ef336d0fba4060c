"""Sounds that are judged not to be a drone's are not followed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors
from test_geometry import message
from test_tracker import errors_deg, run

from av_common.angles import angles_to_direction, wrap
from av_common.track import Source
from av_fusion.measurement.geometry import doa_in_body
from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.tracker import MultiTargetTracker

DRONE, BYSTANDER = math.radians(40.0), math.radians(-60.0)


class JudgedSensors(SimulatedSensors):
    """Directions with a probability of a drone; every few of them stem from a bystander."""

    def __init__(self, drone_probability: float = 0.95, bystander_probability: float = 0.01, period: int = 0,
                 bystander: float = BYSTANDER) -> None:
        super().__init__(3)
        self._probabilities, self._period, self._bystander, self._count = (
            (drone_probability, bystander_probability), period, bystander, 0)

    def doa(self, time: float, azimuth: float, confidence: float = 0.9) -> DoaMeasurement:
        self._count += 1
        from_bystander = bool(self._period) and self._count % self._period != 0
        found = super().doa(time, self._bystander if from_bystander else azimuth, confidence)
        return found._replace(drone_probability=self._probabilities[from_bystander])


def test_an_unknown_probability_changes_nothing():
    expected = run(MultiTargetTracker(), SimulatedSensors(3), lambda t: DRONE, 0.0, 3.0)[1]
    tracks = run(MultiTargetTracker(), JudgedSensors(math.nan), lambda t: DRONE, 0.0, 3.0)[1]
    assert [(track.azimuth, track.azimuth_variance) for track in tracks] == pytest.approx(
        [(track.azimuth, track.azimuth_variance) for track in expected], nan_ok=True)


@pytest.mark.parametrize('value', [math.nan, 0.0, -1.0, 2.0, math.inf])
def test_no_probability_is_unknown(value):
    """Also the 0 of a sender that does not know the field: no judgement is that sure."""
    sent = message(angles_to_direction([0.2, math.pi - 0.2]), (0.0, 1.0, 0.0))
    for hypothesis in sent.hypotheses:
        hypothesis.drone_probability = value
    (found,) = doa_in_body(sent, np.eye(3))
    assert math.isnan(found.drone_probability)


def test_a_bystander_alone_is_not_followed_and_the_reason_says_so():
    tracks = run(MultiTargetTracker(), JudgedSensors(0.01), lambda t: BYSTANDER, 0.0, 20.0)[1]
    assert all(track.source == Source.NOTHING for track in tracks)
    assert 'judged not a drone (0.' in tracks[-1].reason


def test_a_drone_is_followed_beside_a_bystander_that_is_heard_more_often():
    """Four of five directions are those of the bystander, which the camera has not shown either."""
    tracks = run(MultiTargetTracker(), JudgedSensors(0.9, 0.02, period=5), lambda t: DRONE + 0.01 * t, 0.0, 20.0)
    errors = [min(abs(wrap(track.azimuth - truth)), abs(wrap(math.pi - track.azimuth - truth)))  # front and back are open
              for track, truth in zip(tracks[1][300:], tracks[2][300:], strict=True)]
    assert max(errors) < math.radians(10.0)


@pytest.mark.parametrize('bystander', [BYSTANDER, DRONE - math.radians(15.0)])
def test_the_track_stays_when_a_bystander_takes_over(bystander):
    """The drone is not heard for 2 s, but a siren is, far from it or close."""
    tracker = MultiTargetTracker()
    sensors = JudgedSensors(0.95)
    _, tracks, truths = run(tracker, sensors, lambda t: DRONE, lambda t: 0.4 * math.sin(t), 6.0)
    assert abs(errors_deg(tracks, truths, -1)[0]) < 5.0
    for step in range(20):
        tracker.add_doas([sensors.doa(106.0 + 0.1 * step, bystander)._replace(drone_probability=0.01)])
        track = tracker.estimate(106.0 + 0.1 * step)
        if track.source != Source.NOTHING:
            assert abs(wrap(track.azimuth - truths[-1])) < math.radians(10.0)


def hear_both(bystander, drone, start, seconds, tracker=None):
    """Drone and bystander in each window, with probabilities by the time (s) since `start`; tracker and tracks."""
    tracker, sensors, tracks = tracker or MultiTargetTracker(), SimulatedSensors(5), []
    for step in range(round(10 * seconds)):
        time, yaw = start + 0.1 * step, 0.5 * math.sin(step / 10.0)
        tracker.add_pose(Pose.level(time, yaw))
        tracker.add_doas([sensors.doa(time, azimuth - yaw)._replace(drone_probability=probability(0.1 * step))
                          for azimuth, probability in ((BYSTANDER, bystander), (DRONE, drone))])
        tracks.append(tracker.estimate(time))
    return tracker, tracks


def test_a_first_wrong_judgement_does_not_stay():
    """An alarm sounds like a drone for 0.3 s after its first second, then like none; the drone beside it wavers about 0.6."""
    _, tracks = hear_both(lambda t: math.nan if t < 0.7 else 0.4 if t < 1.0 else 0.02,
                          lambda t: math.nan if t < 0.7 else 0.5 if t < 1.0 else 0.6 + 0.3 * math.sin(3.0 * t), 100.0, 20.0)
    azimuths = [track.azimuth_world for track in tracks if track.source != Source.NOTHING]
    assert not any(abs(wrap(azimuth - BYSTANDER)) < math.radians(10.0) for azimuth in azimuths)
    assert len(azimuths) > 150
    assert max(abs(wrap(azimuth - DRONE)) for azimuth in azimuths[-100:]) < math.radians(10.0)


def test_two_sounds_that_are_not_judged_wait_for_a_judgement():
    """Either may be the bystander. Where nothing ever judges, one of them is followed after a second."""
    for judged in (math.nan, 0.9):
        _, tracks = hear_both(lambda t: math.nan, lambda t, p=judged: p, 100.0, 3.0)
        followed = [track.source != Source.NOTHING for track in tracks]
        assert any(followed[:9]) == (judged > 0.5)
        assert all(followed[12:])


def test_a_direction_has_the_kind_of_what_was_heard_at_its_place():
    """A talker whose newest window is not judged, or is judged wrongly, is still the talker."""
    for probability in (math.nan, 0.5):
        tracker, _ = hear_both(lambda t: 0.02, lambda t: 0.9, 100.0, 6.0)
        later, tracks = hear_both(lambda t, p=probability: p, lambda t: math.nan, 106.0, 0.5, tracker)
        assert all(abs(wrap(track.azimuth_world - DRONE)) < math.radians(5.0) for track in tracks)
        assert sorted(track.kind.drone > 0.5 for track in later.filter.tracks if track.existence > 0.5) == [False, True]
