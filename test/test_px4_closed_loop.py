"""Simulated sound and images, fusion, pointing, guard and the fake autopilot in one process: deterministic."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fake_autopilot import HOLD, OFFBOARD, FakeAutopilot
from gimbal_bench import Bench

from av_common.rig import load_rig
from av_common.track import State, Track
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.tracker import MultiTargetTracker
from av_pointing.controller import Ages, Mode, PointingController
from av_px4.commands import pitch_yaw
from av_px4.gimbal import Gimbal, GimbalInputs
from av_px4.guard import BodyGuard, Inputs
from av_px4.handover import VehicleStatus
from av_px4.odometry import pose_from_px4
from av_sim_bridge.vehicle import VehicleState
from av_simulator import Circle, find_config, load_scenario

DT = 1.0 / 30.0


class Flight:
    """Stands where OfflineRun has its pointing controller: between track and vehicle as px4_node does it."""

    def __init__(self, heading_deg, mode):
        self.autopilot = FakeAutopilot(heading=math.radians(heading_deg), nav_state=mode)
        self.controller, self.guard, self.gimbal = PointingController(), BodyGuard(offboard=True), Gimbal()
        self.controller.limit_body(self.guard.max_rate)
        for k in range(10):    # the pilot hands over later
            self.guard.step(0.1 * k - 1.0, Inputs(VehicleStatus(HOLD, True, False), 0.0, 0.0, 0.0, 0.0, enabled=True,
                                                   place_known=True))
        self.world, self.rows = None, []

    def on_attitude(self, time, attitude):
        self.controller.on_attitude(time, attitude)

    def step(self, now, track, ages, cue=None):
        autopilot, command = self.autopilot, self.controller.step(now, track, ages, cue)
        status = VehicleStatus(autopilot.nav_state, autopilot.armed, autopilot.failsafe)
        wanted = GimbalInputs(command.move_gimbal, command.pan, command.tilt, command.pan_rate, True, status.nav_state)
        for out in self.gimbal.step(now, wanted):
            self.gimbal.acknowledge(now, out.command, autopilot.command(out.command, out.params, (1, 191), (1, 1)))
        decision = self.guard.step(now, Inputs(status, 0.0, 0.0, 0.0, 0.0, ages.measurement, command.yaw_rate,
                                               command.move_body, None, True))
        if decision.heartbeat:
            autopilot.heartbeat()
        if decision.setpoint:
            autopilot.setpoint(autopilot.position, math.nan, -decision.yaw_rate)
        autopilot.advance(DT)
        pose = self.pose()
        self.world.dynamics.follow(VehicleState(now, pose.position, attitude_wxyz=pose.attitude_wxyz))
        self.rows.append((now, track.azimuth, -autopilot.gimbal[1], pose.yaw, command.mode == Mode.TRACK, track.resolved))
        return command

    def pose(self):
        autopilot = self.autopilot
        half = autopilot.estimated_heading / 2
        return pose_from_px4(autopilot.position, (math.cos(half), 0.0, 0.0, math.sin(half)), (0.0,) * 3, (0.0,) * 3)


def fly(scenario, seconds, heading_deg, mode, kind=Flight):
    """The flight and its rows: time, bearing, pan of the gimbal (rad, left), yaw, followed, front and back resolved."""
    flight = kind(heading_deg, mode)
    run = OfflineRun(scenario, load_rig(find_config('rig')), MultiTargetTracker(), pointing=flight)
    flight.world = run.world
    log = run.run(seconds)
    return flight, np.array(flight.rows), log


def test_the_gimbal_follows_what_is_heard_and_seen_at_20_deg_a_second():
    """The vehicle holds its heading while the drone passes in front and leaves the field of view: at most 2 deg of error."""
    scenario = load_scenario(find_config('circle', 'scenarios'))
    path = Circle((0.0, 0.0, 3.5), 9.0, 18.0, -50.0)
    scenario = replace(scenario, targets=(replace(scenario.targets[0], trajectory=path),))
    flight, rows, _ = fly(scenario, 6.5, 90.0, HOLD)
    # later, on the microphones' axis, sound alone cannot resolve front and back, and the bearing itself jumps
    followed = rows[(np.cumsum(rows[:, 4]) > 30) & (np.abs(rows[:, 1]) < math.radians(80.0))]
    errors = np.degrees(np.abs(followed[:, 1] - followed[:, 2]))
    print(f'gimbal from the bearing: median {np.median(errors):.2f}, 95 % {np.percentile(errors, 95):.2f}, '
          f'most {errors.max():.2f} deg over {np.degrees(np.ptp(followed[:, 1])):.0f} deg')
    assert np.ptp(followed[:, 1]) > math.radians(90.0) and errors.max() < 2.0
    assert flight.autopilot.setpoints == 0


@pytest.mark.parametrize('heading_deg', [120.0, -150.0])
def test_the_body_turns_until_front_is_told_from_back(heading_deg):
    """Sound only, in OFFBOARD, from any side: front and back are resolved correctly, and the vehicle faces the drone."""
    scenario = load_scenario(find_config('behind_in_fog', 'scenarios'))
    flight, rows, log = fly(scenario, 10.0, heading_deg, OFFBOARD)
    assert rows[-1, 5] and flight.autopilot.setpoints_in_foreign_modes == 0
    assert flight.autopilot.largest_rate <= math.radians(45.0) + 1e-9
    truth = math.atan2(log.target['y'][-1], log.target['x'][-1])
    assert abs(math.remainder(rows[-1, 3] - truth, 2.0 * math.pi)) < math.radians(15.0)


class LateFlight(Flight):
    """Bearings reach pointing 0.3 s after fusion made them."""

    waiting = ()

    def step(self, now, track, ages, cue=None):
        self.waiting = (*self.waiting, (now, track, ages))
        due = [item for item in self.waiting if item[0] <= now - 0.3]
        self.waiting = (*due[-1:], *self.waiting[len(due):])
        if not due:
            return super().step(now, track._replace(state=State.NONE), Ages(), cue)
        made, track, ages = due[-1]
        late = now - made
        return super().step(now, track, ages._replace(bearing=ages.bearing + late, late=ages.late + late,
                                                      captured=ages.captured + late), cue)


def test_the_body_follows_a_drone_at_15_deg_a_second_with_late_bearings():
    """In OFFBOARD, heard and seen: 4 deg rms and 12 at most, from where the drone was in fact."""
    scenario = load_scenario(find_config('circle', 'scenarios'))
    path = Circle((0.0, 0.0, 3.5), 9.0, -24.0, 50.0)
    scenario = replace(scenario, targets=(replace(scenario.targets[0], trajectory=path),))
    flight, rows, log = fly(scenario, 16.0, 90.0, OFFBOARD, LateFlight)
    truth = np.interp(rows[:, 0], log.target['time'], np.unwrap(np.arctan2(log.target['y'], log.target['x'])))
    error = np.degrees(np.angle(np.exp(1j * (truth - rows[:, 3]))))[rows[:, 0] > 6.0]
    print(f'body from the drone: {np.sqrt(np.mean(error**2)):.2f} deg rms, most {np.abs(error).max():.2f}')
    assert np.sqrt(np.mean(error**2)) < 4.0 and np.abs(error).max() < 12.0 and flight.autopilot.setpoints > 0


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_follows_a_target_at_20_deg_a_second_within_2_deg(sign):
    """From the bearing, stamped as it arrives, through the pointing controller to where the gimbal looks."""
    controller, bench, errors = PointingController(), Bench(), []
    rate = sign * math.radians(20.0)
    for k in range(500):
        time = 0.02 * k
        azimuth = -sign * math.radians(100.0) + rate * time
        command = controller.step(time, Track(
            time=time, state=State.VISUAL_ACTIVE, azimuth=azimuth, elevation=0.2, azimuth_variance=1e-4,
            elevation_variance=1e-4, azimuth_world=azimuth, azimuth_world_rate=rate, resolved=True), Ages(0.0, 0.0, 0.0))
        bench.time = time
        bench.deliver(bench.client.step(time, GimbalInputs(True, command.pan, command.tilt, command.pan_rate, True, HOLD, 1)))
        bench.autopilot.advance(0.02)
        errors.append(abs(math.degrees(azimuth + 0.02 * rate) - bench.looks[0]))
    assert max(errors[150:]) < 2.0
    assert pitch_yaw(azimuth, 0.0, True).params[1] * sign < 0.0
