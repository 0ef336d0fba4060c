"""From the sensors' messages to commands, by formulas: what moves, how fast, and what must stand still."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most
from formula_rig import Source, azimuth_of, never, unit
from judged_rig import rms
from vehicle import Vehicle

from av_common.rig import GimbalMount
from av_interfaces.msg import PointingCommand

STANDS_S = 0.3      # from the arrival of the newest measurement, as the message and the pointing package promise
STILL = 1e-6        # rad/s


def rates(commands):
    return np.abs([command.yaw_rate for command in commands])


@pytest.mark.parametrize(('azimuth', 'rate'), [(28.0, 3.0), (-30.0, 0.0)])
def test_the_body_turns_to_what_is_seen_and_stays_on_it(contract, azimuth, rate):
    """30 deg at 45 deg/s take a second, dead time and lag half of one."""
    vehicle = Vehicle([Source.at(azimuth, 5.0, rate)]).run(8.0)
    off = [abs(azimuth_of(vehicle.rig.body(t))) for t in np.arange(4.0, 8.0, 0.1)]
    contract(at_most('off the axis after 4 s, most', max(off), 3.0, 'deg'),
             at_most('off the axis, mean', float(np.mean(off)), 1.0, 'deg'))


@pytest.mark.parametrize('array', ['pair', 'square'])
def test_a_body_that_follows_by_sound_does_not_take_the_target_for_its_own(contract, array):
    """To and fro by 50 deg at up to 25 deg/s: it moves less on the body than in the world."""
    vehicle = Vehicle([Source(lambda t: unit(50.0 * math.sin(0.5 * t), 8.0))], sight=never, array=array).run(25.0)
    contract(at_least('followed', vehicle.rig.followed(3.0), 1.0))


@pytest.mark.parametrize('array', ['pair', 'square'])
@pytest.mark.parametrize('azimuth', [60.0, -140.0, 20.0])
def test_a_body_does_not_turn_after_its_own_sound_for_ever(contract, array, azimuth):
    """A direction that is fixed to the body, which the body never reaches."""
    vehicles: list[Vehicle] = []
    own = Source(lambda t: vehicles[0].attitude(t).apply(unit(azimuth, -5.0)) if vehicles else unit(azimuth, -5.0))
    vehicles.append(Vehicle([own], sight=never, array=array))
    yaw = np.degrees(vehicles[0].run(20.0).yaw)
    contract(at_most('turned', float(np.abs(yaw).max()), 180.0, 'deg'),
             at_most('turned in the last 10 s', float(np.ptp(yaw[len(yaw) // 2:])), 5.0, 'deg'))


@pytest.mark.parametrize('seed', range(3))
def test_the_body_searches_then_turns_to_what_is_heard_behind(contract, seed):
    """Sound alone at 150 deg: a turn that tells the side, at most at the search rate, then half a turn at 45 deg/s."""
    vehicle = Vehicle([Source.at(150.0, 5.0)], sight=never, seed=seed).run(11.0)
    modes = [command.mode for _, command in vehicle.commands]
    searching = [command for _, command in vehicle.commands if command.mode == PointingCommand.MODE_SEARCH]
    off = [azimuth_of(vehicle.rig.body(t)) for t in np.arange(8.0, 11.0, 0.1)]
    assert modes.index(PointingCommand.MODE_SEARCH) < modes.index(PointingCommand.MODE_TRACK)
    contract(at_most('search rate, most', float(np.degrees(rates(searching).max())), 40.0 + 1e-3, 'deg/s'),
             at_most('off the axis in the end, RMS', rms(off), 3.0, 'deg'))


@pytest.mark.parametrize('meanwhile', ['nothing', 'images without visibility', 'clear images'])
def test_nothing_turns_on_a_bearing_that_is_stale(contract, meanwhile):
    """A target at 25 deg/s, followed; from 4 s on it is neither heard nor seen. Bearings go on, as predictions."""
    def until(t):
        return t < 4.0
    target = Source.at(0.0, 5.0, 25.0, heard=until, seen=until)
    images = {'nothing': until}.get(meanwhile, lambda t: True)
    vehicle = Vehicle([target], array='eight', sight=images, sound=until,
                      visibility=None if 'without' in meanwhile else lambda t: 1.0).run(7.0)
    before, after = vehicle.between(3.0, 4.0), vehicle.between(4.0 + 0.3 + STANDS_S + 0.02)
    contract(at_least('rate before, mean', float(np.degrees(rates(before).mean())), 10.0, 'deg/s'),
             at_most('rate after, most', float(np.degrees(rates(after).max())), 0.0, 'deg/s'))


def test_nothing_turns_without_odometry(contract):
    """The poses end at 4 s, the target is still heard and seen."""
    vehicle = Vehicle([Source.at(0.0, 5.0, 25.0)], array='eight', odometry=lambda t: t < 4.0).run(7.0)
    contract(at_most('rate after, most', float(np.degrees(rates(vehicle.between(4.0 + STANDS_S + 0.02)).max())), 0.0, 'deg/s'))


@pytest.mark.xfail(strict=False, reason='turns for 0.3 of the time')
def test_nothing_turns_on_what_is_contradicted(contract):
    """From 4 s on each window hears something else somewhere else, and clear images do not show the target.

    No direction is heard twice but by chance, so that no turn can be of use.
    """
    target = Source.at(25.0, 5.0, heard=lambda t: t < 4.0, seen=lambda t: t < 4.0)
    share = []
    for seed in range(3):
        vehicle = Vehicle([target], visibility=lambda t: 1.0, seed=seed).run(4.0)
        vehicle.rig.sound_clutter = 1.0
        vehicle.run(6.0)
        share.append(float(np.mean(rates(vehicle.between(5.0)) > STILL)))
    contract(at_most('share of the time that it turns', float(np.mean(share)), 0.05))


@pytest.mark.parametrize('azimuth', [130.0, -120.0])
def test_a_gimbal_looks_before_the_body_turns(contract, azimuth):
    """Heard on one of two sides, clear air: the camera turns to one, then to the other, at up to 120 deg/s, and sees it."""
    vehicle = Vehicle([Source.at(azimuth, 8.0)], gimbal=GimbalMount(stabilized=False, pan_limits_deg=(-150.0, 150.0)),
                      visibility=lambda t: 0.95).run(8.0)
    seen = next((m.t for m in vehicle.rig.following() if m.bearing.source & m.bearing.SOURCE_SIGHT), math.inf)
    searched = [command for t, command in vehicle.commands if command.mode == PointingCommand.MODE_SEARCH and t < seen]
    assert any(command.mode == PointingCommand.MODE_LOOK for command in vehicle.between(0.0, seen))
    contract(at_most('time until it is seen', seen, 5.0, 's'),
             at_most('share of the time before in which the body turns', len(searched) / len(vehicle.between(0.0, seen)), 0.1),
             at_most('error after 6 s, RMS', rms(vehicle.rig.errors(6.0)), 0.5, 'deg'),
             at_least('resolved after it', float(np.mean([m.bearing.resolved for m in vehicle.rig.between(seen + 0.5)])), 1.0))


def test_an_open_side_turns_nothing_where_no_rotation_is_asked_for(contract):
    """Rotations are switched off: the body waits, since either side may be the wrong one."""
    vehicle = Vehicle([Source.at(150.0, 5.0)], sight=never, parameters={'rotation': False}).run(6.0)
    contract(at_most('rate, most', float(np.degrees(rates(vehicle.between(0.0)).max())), 0.0, 'deg/s'))


def test_one_publisher_that_is_out_of_order_stops_nothing(contract):
    """A pose 45 ms late once a second, a target at 20 deg/s: the body follows without a break."""
    def network(kind, captured, arrival):
        return (arrival + 0.045 if kind == 'odometry' and round(captured * 50) % 50 == 25 else arrival,)
    vehicle = Vehicle([Source.at(0.0, 5.0, 20.0)], array='eight', network=network).run(10.0)
    late = rates(vehicle.between(4.0))
    off = [abs(azimuth_of(vehicle.rig.body(t))) for t in np.arange(4.0, 10.0, 0.1)]
    contract(at_most('share of the time that it stands', float(np.mean(late < math.radians(2.0))), 0.0),
             at_most('off the axis, most', max(off), 6.0, 'deg'))


@pytest.mark.parametrize('array', ['pair', 'eight'])
def test_targets_that_jump_never_break_a_limit(array):
    """Anywhere within a second, with clutter and gaps: each command is checked against the one before (see `Vehicle`)."""
    random = np.random.default_rng(12)
    places = [unit(random.uniform(-180.0, 180.0), random.uniform(0.0, 40.0)) for _ in range(20)]
    vehicle = Vehicle([Source(lambda t: places[int(t / 0.9)])], array=array, sound_clutter=0.3, sight_clutter=0.2,
                      network=lambda kind, captured, arrival: (arrival,) if random.random() > 0.2 else ()).run(12.0)
    assert len(vehicle.commands) > 500 and any(rates(vehicle.between(0.0)) > 0.1)


def test_a_node_that_is_not_enabled_moves_nothing():
    vehicle = Vehicle([Source.at(25.0, 5.0)], pointing={'enabled': False}).run(4.0)
    assert not any(command.move_body or command.move_gimbal for _, command in vehicle.commands)
    assert all(command.yaw_rate == 0.0 for _, command in vehicle.commands)


@pytest.mark.parametrize('gimbal', [None, GimbalMount(stabilized=False, pan_limits_deg=(-150.0, 150.0))])
@pytest.mark.parametrize('contested', ['doa', 'detections', 'odometry', 'camera/camera_info', 'visibility'])
def test_nothing_moves_while_an_input_of_the_bearing_is_contested(contested, gimbal):
    """From 4 s to 7 s one input has two publishers; by the others the target is measured on, moving, and the forger's, too."""
    vehicle = Vehicle([Source.at(0.0, 5.0, 25.0), Source.at(-60.0, 5.0, heard=lambda t: t > 4.0, seen=lambda t: t > 4.0)],
                      array='eight', visibility=lambda t: 1.0, gimbal=gimbal).run(4.0)
    vehicle.rig.stage.refuse_contested({contested: ['/genuine', '/forger']})
    vehicle.run(3.0)
    vehicle.rig.stage.refuse_contested({})
    vehicle.run(4.0)
    before, during, after = vehicle.between(3.0, 4.0), vehicle.between(4.0 + STANDS_S + 0.02, 7.0), vehicle.between(7.5)
    axes = ('yaw_rate', 'pan_rate', 'tilt_rate')
    assert any(abs(getattr(command, axis)) > 0.1 for command in before for axis in axes)
    assert len(during) > 100 and not any(getattr(command, axis) for command in during for axis in axes)
    assert any(abs(getattr(command, axis)) > 0.1 for command in after for axis in axes)
