"""The stages on our simulator: its measurements without sound or images, and its sound of a drone behind a rig that obeys."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most, within
from formula_rig import BOX, CENTRE, FOCAL, START, Source, detection, never, unit, vector, wrapped
from formula_sound import RATE, frames, hearing
from judged_rig import FormulaRig, angle_between, rms
from scipy.spatial.transform import Rotation
from vision_msgs.msg import Detection2DArray

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_common.stamps import to_seconds, to_stamp
from av_evaluation.experiments.measurement_simulation import MeasurementSimulation
from av_interfaces.msg import Bearing, Doa, DoaArray
from av_pointing.stage import make_pointing_stage
from av_simulator import World, find_config, load_scenario
from av_vision.bearing import BOX_FRACTION, PIXEL_SIGMA


def directions(time, measurements) -> DoaArray:
    """The message of simulated directions, of a pair's cones or of the sphere."""
    cones = [measured.cone for measured in measurements if measured.cone is not None]
    message = DoaArray(window=0.5, method='simulation', axis=vector(np.array(cones[0].axis if cones else (0.0, 0.0, 0.0))))
    message.header.stamp, message.header.frame_id = to_stamp(START + time), 'microphones'
    for group, measured in enumerate(measurements):
        for image in measured.hypotheses:
            message.hypotheses.append(Doa(
                azimuth=image.azimuth, elevation=image.elevation, azimuth_variance=image.across_variance,
                elevation_variance=image.elevation_variance, confidence=measured.confidence, ambiguity_group=group,
                direction=vector(unit(math.degrees(image.azimuth), math.degrees(image.elevation))), drone_probability=math.nan,
                cosine=measured.cone.cosine if measured.cone else math.nan, fundamental=measured.fundamental,
                cosine_variance=measured.cone.variance if measured.cone else math.nan,
                fundamental_variance=measured.fundamental_variance))
    return message


def picture(time, image) -> Detection2DArray:
    """The message of simulated detections: boxes where a pinhole camera has their directions."""
    message = Detection2DArray()
    message.header.stamp, message.header.frame_id = to_stamp(START + time), 'camera'
    for found in image.detections:
        x, y, z = unit(math.degrees(found.azimuth), math.degrees(found.elevation))
        column, row = CENTRE - FOCAL / x * np.array([y, z])
        message.detections.append(detection(column, row, found.score))
        size = math.sqrt(max(found.score * FOCAL**2 * found.across_variance - PIXEL_SIGMA**2, 0.0)) / BOX_FRACTION
        message.detections[-1].bbox.size_x = message.detections[-1].bbox.size_y = max(size, 0.2 * BOX)
    return message


def simulated(name, seed, seconds, sight=True, **model):
    """A rig that has heard and seen a scenario's measurements, and the true directions by time."""
    truth: dict[float, np.ndarray] = {}
    rig = FormulaRig([Source(lambda t: truth[min(truth, key=lambda known: abs(known - t))][0])], sound=never, sight=never)
    for scan in MeasurementSimulation(load_scenario(find_config(name, 'scenarios')), seed, **model).scans():
        if scan.time > seconds:
            break
        truth[scan.time] = scan.truth
        rig.run(max(0.02 * round((scan.time + 0.1) / 0.02) - rig.now, 0.0))
        if sight:
            rig.give('detections', picture(scan.time, scan.image), rig.now)
        rig.give('doa', directions(scan.time, scan.doas), rig.now)
    return rig, truth


@pytest.mark.parametrize('pair', [True, False], ids=['pair', 'four'])
def test_simulated_measurements_give_a_bearing_with_its_sigma(contract, pair):
    """The first 20 s of `circle`, from the front to beyond end-fire, with clutter of both sensors.

    Near end-fire, 90 deg at 15 s, a pair's cosine hardly changes: its errors count up to 54 deg, its sigma everywhere.
    """
    errors, normalised = [], []
    for seed in range(2):
        rig, _ = simulated('circle', seed, 20.0, pair=pair)
        errors += list(rig.errors(2.0, 9.0 if pair else math.inf, folded=pair))
        normalised += list(rig.normalised(2.0, 0.5, folded=pair))
    contract(at_most('error, RMS', rms(errors), 3.0, 'deg'),
             at_most('error, median', float(np.median(np.abs(errors))), 1.5, 'deg'),
             within('mean normalised square', float(np.mean(normalised)), 0.1, 1.6),
             at_least('within 2.5 sigma', float(np.mean(np.array(normalised) < 6.25)), 0.93))


def test_simulated_drones_that_cross_in_fog_are_both_tracked(contract):
    """`crossing`: by their sound alone, which the array hears as one while they pass; both again afterwards."""
    def share(rig, truth, after, until):
        found = []
        for moment in rig.between(after, until):
            places = truth[min(truth, key=lambda known: abs(known - moment.t))]
            tracks = [unit(math.degrees(track.azimuth), math.degrees(track.elevation)) for track in moment.targets.tracks]
            found += [any(angle_between(track, place) < 8.0 for track in tracks) for place in places]
        return float(np.mean(found))
    heard = simulated('crossing', 0, 36.0, sight=False, sound_clutter=0.1)
    shares = [share(*heard, *part) for part in ((3.0, 12.0), (29.0, 36.0))]
    contract(at_least('tracked', min(shares), 0.85))


class HeardWorld:
    """The simulator's sound of a scenario, heard, fused and obeyed.

    Parameters:
        name: of the scenario.
        seed: of the world.
    """

    def __init__(self, name: str, seed: int) -> None:
        rig = load_rig(find_config('rig'))
        self.world = World(load_scenario(find_config(name, 'scenarios')), rig, seed, RATE)
        self.yaw, self.decided = [0.0], math.inf
        self.rig = FormulaRig([Source(self._direction)], attitude=self._attitude, sound=never, sight=never,
                              on_output=self._obey, on_pose=self._pose)
        self.hearing = hearing(rig.array.geometry, temperature=self.world.scenario.weather.temperature_c)
        self.pointing = make_pointing_stage(node_parameters('av_pointing', 'pointing_node', overrides={'enabled': True}))

    def run(self, seconds: float) -> HeardWorld:
        """Go on for `seconds`."""
        for t in self.rig.steps(seconds):
            first = round(t * RATE)
            sound = self.world.advance(960)
            forward = self.world.rig_state(self.world.time).rotation[:, 0]
            self.yaw.append(self.yaw[-1] + math.remainder(math.atan2(forward[1], forward[0]) - self.yaw[-1], math.tau))
            for frame in frames(sound, first, first / RATE):
                for message in self.hearing.on_audio(frame, START + t):
                    self.rig.give('doa', message, t)
        return self

    def _direction(self, t: float) -> np.ndarray:
        away = self.world.scenario.targets[0].trajectory(t)[0] - np.array(self.world.scenario.rig.trajectory(t)[0])
        return away / np.linalg.norm(away)

    def _attitude(self, t: float) -> Rotation:
        return Rotation.from_euler('z', np.interp(t, 0.02 * np.arange(len(self.yaw)), self.yaw))

    def _instant(self, t: float) -> Instant:
        return Instant(50.0 + t, START + t)

    def _pose(self, message, now: float) -> None:
        self.pointing.on_odometry(message, self._instant(now))

    def _obey(self, moment) -> None:
        if moment.bearing.state != Bearing.STATE_NONE and moment.bearing.resolved:
            self.decided = min(self.decided, moment.t)
        self.world.dynamics.command(self.pointing.on_bearing(moment.bearing, self._instant(moment.t)).yaw_rate, self.world.time)


def test_a_simulated_drone_behind_in_fog_is_turned_to(contract):
    """`behind_in_fog` by its sound: the side is told by a turn, then the rig faces it."""
    worlds = [HeardWorld('behind_in_fog', seed).run(10.0) for seed in range(2)]
    errors = np.concatenate([world.rig.errors(6.0) for world in worlds])
    facing = [abs(wrapped(math.degrees(moment.bearing.azimuth))) for world in worlds for moment in world.rig.following(8.0)]
    contract(at_most('time until it is told, longest', max(world.decided for world in worlds), 5.0, 's'),
             at_most('error, median', float(np.median(np.abs(errors))), 5.0, 'deg'),
             at_most('off the axis after 8 s, median', float(np.median(facing)), 8.0, 'deg'))
    assert all(to_seconds(world.rig.moments[-1].bearing.measured) > START + 9.0 for world in worlds)
