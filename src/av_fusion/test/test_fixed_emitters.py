"""Sources at fixed places that are no drones are learnt; a drone never is, and is followed in front of one."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_fusion.filter.fixed_emitters import FixedEmitters, FixedEmitterSettings
from av_fusion.measurement.measurements import Cone, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose, RigMotion

HOP, LEARN_S = 0.25, 30.0
FAN, DRONE = math.radians(130.0), math.radians(40.0)
HUM = 0.1  # probability of a drone of a generator


class Rig:
    """A pair of microphones whose directions, of a source in the world, are judged.

    Parameters:
        yaw: heading (rad) over time (s); None without odometry.
        settings: of the emitters.
    """

    def __init__(self, yaw: Callable[[float], float] | None = lambda t: 0.0, settings: FixedEmitterSettings | None = None,
                 seed: int = 1) -> None:
        self.motion, self._yaw = RigMotion(), yaw
        self.emitters = FixedEmitters(settings or FixedEmitterSettings(learn_after=LEARN_S), self.motion)
        self.sensors, self.random, self.time = SimulatedSensors(seed), np.random.default_rng(seed), 100.0

    def hear(self, duration: float, azimuth: Callable[[float], float], probability: Callable[[float], float],
             seen: bool = False) -> list[DoaMeasurement]:
        """What the emitters make of a source that is heard for `duration` s; azimuth (rad, world) and probability over time."""
        judged = []
        for _ in range(round(duration / HOP)):
            self.time += HOP
            heading = self._turn()
            sound = self.sensors.doa(self.time, float(wrap(azimuth(self.time) - heading)))
            judged += self.emitters.judge([sound._replace(drone_probability=probability(self.time))])
            if seen:
                self.emitters.see(self.sensors.camera(self.time, float(wrap(azimuth(self.time) - heading)),
                                                        detection_probability=1.0))
        return judged

    def _turn(self) -> float:
        if self._yaw is None:
            return 0.0
        yaw = self._yaw(self.time)
        self.motion.add(Pose.level(self.time, yaw, (self._yaw(self.time + 0.01) - yaw) / 0.01))
        return yaw

    def known_deg(self) -> list[float]:
        """Azimuths (deg) of the known emitters."""
        return sorted(math.degrees(azimuth) % 360.0 for azimuth, _ in self.emitters.known)


def test_a_steady_hum_is_learnt_after_the_set_time():
    rig = Rig()
    rig.hear(0.8 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.known_deg() == []
    rig.hear(0.8 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.known_deg() == pytest.approx([50.0, 130.0], abs=2.0)    # a pair at rest knows both images
    assert '130' in rig.emitters.diagnostics()['fixed emitters']


def test_a_turning_rig_learns_the_place_and_not_its_image():
    rig = Rig(lambda t: 0.6 * math.sin(0.3 * t))
    rig.hear(2.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.known_deg() == pytest.approx([130.0], abs=3.0)


def test_what_is_learnt_is_not_followed_where_its_sound_is_misjudged():
    rig = Rig()
    before = rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)[0]
    assert before.drone_probability == HUM
    judged = rig.hear(2.0, lambda t: FAN, lambda t: 0.6)
    assert max(one.target_probability for one in judged) < 0.5
    elsewhere = rig.hear(2.0, lambda t: math.radians(-20.0), lambda t: 0.6)
    assert min(one.target_probability for one in elsewhere) > 0.7


def test_a_bystander_of_the_last_seconds_is_known_where_the_rig_has_turned():
    """Its sound is judged by its direction in the array's frame, in which it may have taken the place of a drone."""
    rig = Rig(lambda t: 0.0 if t < 106.0 else 0.5)
    rig.hear(6.0, lambda t: FAN, lambda t: 0.02)
    assert max(one.target_probability for one in rig.hear(1.0, lambda t: FAN, lambda t: 0.4)) < 0.5
    assert min(one.target_probability for one in rig.hear(1.0, lambda t: math.radians(-20.0), lambda t: 0.4)) > 0.5
    assert rig.hear(2.0, lambda t: FAN, lambda t: 0.9)[-1].target_probability > 0.9    # it was a drone after all


def test_a_wide_direction_beside_that_of_a_bystander_is_not_the_bystanders():
    rig = Rig()
    rig.hear(6.0, lambda t: FAN, lambda t: 0.02)
    rig.time += HOP
    own, beside = (DoaMeasurement.of_cone(rig.time, Cone((0.0, 1.0, 0.0), math.sin(azimuth), sigma**2), 0.9)._replace(
        drone_probability=p) for azimuth, sigma, p in ((FAN, 0.02, 0.02), (FAN - 0.3, 0.3, 0.6)))
    assert rig.emitters.judge([beside, own])[0] == beside


@pytest.mark.parametrize('probability', [0.95, 0.6, 0.3, math.nan])
def test_a_hovering_drone_is_never_learnt(probability):
    """Nor one whose sound is doubtful, or is not judged."""
    rig = Rig()
    judged = rig.hear(20.0 * LEARN_S, lambda t: DRONE, lambda t: probability)
    assert rig.known_deg() == []
    assert all(one.drone_probability == probability or math.isnan(probability) for one in judged)


def test_a_drone_that_is_mostly_taken_for_something_else_is_never_learnt():
    """For five seconds of each half minute it sounds like what it is."""
    rig = Rig()
    rig.hear(600.0, lambda t: DRONE, lambda t: 0.8 if t % LEARN_S < 5.0 else 0.1)
    assert rig.known_deg() == []


def test_a_drone_that_was_seen_is_never_learnt():
    """A quiet one, that sounds like nothing at all, is in the picture for a second of each half minute."""
    rig = Rig()
    for _ in range(20):
        rig.hear(LEARN_S - 1.0, lambda t: 0.2, lambda t: 0.1)
        rig.hear(1.0, lambda t: 0.2, lambda t: 0.1, seen=True)
    assert rig.known_deg() == []


def test_a_source_that_moves_is_not_learnt():
    """A car that passes slowly, a drone that wanders as it hovers 10 m away, and noise from anywhere."""
    slow = Rig()
    slow.hear(5.0 * LEARN_S, lambda t: 0.4 + math.radians(0.3) * (t - 100.0), lambda t: HUM)
    assert slow.known_deg() == []
    wandering = Rig()
    wandering.hear(5.0 * LEARN_S, lambda t: 0.4 + 0.1 * math.sin(0.5 * t), lambda t: HUM)
    assert wandering.known_deg() == []
    noise = Rig()
    noise.hear(5.0 * LEARN_S, lambda t: noise.random.uniform(-math.pi, math.pi), lambda t: HUM)
    assert noise.known_deg() == []


def test_a_drone_in_front_of_an_emitter_is_followed():
    """At once where it clearly sounds like one or is seen; within seconds where it is more likely one than not."""
    rig = Rig(lambda t: FAN)
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.hear(HOP, lambda t: FAN, lambda t: 0.95)[0].target_probability > 0.5
    rig.hear(HOP, lambda t: FAN, lambda t: 0.6, seen=True)
    assert rig.hear(HOP, lambda t: FAN, lambda t: 0.6)[0].target_probability > 0.7
    hovering = rig.hear(15.0, lambda t: FAN, lambda t: 0.6)
    assert hovering[-1].drone_probability == 0.6
    assert rig.known_deg() == []


def test_a_drone_that_flies_through_does_not_undo_what_was_learnt():
    rig = Rig()
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    middle = rig.time + 6.0
    passing = rig.hear(12.0, lambda t: FAN + math.radians(10.0) * (t - middle), lambda t: 0.9)
    assert min(one.target_probability for one in passing) > 0.5
    assert 130.0 in [round(azimuth, -1) for azimuth in rig.known_deg()]


def test_emitters_are_forgotten():
    """By request, after long silence, and when the rig has gone elsewhere."""
    rig = Rig()
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.emitters.forget() == 2
    assert rig.known_deg() == []
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    rig.hear(8.0 * LEARN_S, lambda t: DRONE, lambda t: 0.9)
    assert rig.known_deg() == []
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    for _ in range(50):
        rig.time += HOP
        rig.motion.add(Pose(rig.time, velocity=(2.0, 0.0, 0.0)))
        rig.emitters.judge([rig.sensors.doa(rig.time, DRONE)._replace(drone_probability=0.9)])
    assert rig.known_deg() == []


def test_a_rig_without_odometry_learns_and_one_whose_odometry_stopped_waits():
    tripod = Rig(yaw=None)
    tripod.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert len(tripod.known_deg()) == 2
    lost = Rig()
    lost.hear(1.0, lambda t: FAN, lambda t: HUM)
    lost._yaw = None
    lost.hear(3.0 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert lost.known_deg() == []


def test_a_corrected_heading_turns_what_was_learnt():
    rig = Rig()
    rig.hear(1.5 * LEARN_S, lambda t: FAN, lambda t: HUM)
    a = math.radians(30.0)
    rig.emitters.turn_world(((math.cos(a), -math.sin(a), 0.0), (math.sin(a), math.cos(a), 0.0), (0.0, 0.0, 1.0)))
    assert rig.known_deg() == pytest.approx([80.0, 160.0], abs=2.0)


def test_arrays_that_measure_directions_learn_one_place():
    emitters = FixedEmitters(FixedEmitterSettings(learn_after=LEARN_S), RigMotion())
    random = np.random.default_rng(2)
    for step in range(round(1.5 * LEARN_S / HOP)):
        azimuth, elevation = (float(mean + random.normal(0.0, 0.02)) for mean in (FAN, 0.1))
        emitters.judge([DoaMeasurement(100.0 + HOP * step, (Hypothesis(azimuth, 4e-4, elevation, 4e-4),), 0.9,
                                       drone_probability=HUM)])
    assert [math.degrees(azimuth) for azimuth, _ in emitters.known] == pytest.approx([130.0], abs=2.0)


def test_nothing_is_learnt_where_it_is_disabled():
    rig = Rig(settings=FixedEmitterSettings(enabled=False, learn_after=LEARN_S))
    rig.hear(3.0 * LEARN_S, lambda t: FAN, lambda t: HUM)
    assert rig.known_deg() == []
    assert rig.emitters.diagnostics() == {}
