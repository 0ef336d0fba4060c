"""Messages that are late, lost, doubled, out of order or of another clock, by formulas: what is left of the bearing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from figures import at_least, at_most, within
from formula_rig import START, Source, never
from judged_rig import FormulaRig, rms

from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing

SETTLED = 2.0
MOVING = {'direction': Source.at(-12.0, 6.0, 3.0).direction}


def measured(moment):
    """Capture (s) of the newest measurement behind an output."""
    return to_seconds(moment.bearing.measured) - START


def names(rigs):
    """Most names that a target has in a run."""
    return max(len({moment.targets.selected for moment in rig.following(SETTLED)}) for rig in rigs)


def jitter(most, seed=0):
    """Every sound and image takes up to `most` (s) longer, each for itself: their order gets lost."""
    random = np.random.default_rng([7, seed])
    return lambda kind, captured, arrival: (arrival + (random.uniform(0.0, most) if kind in ('doa', 'detections') else 0.0),)


def constant(delay):
    return lambda kind, captured, arrival: (arrival + (delay if kind in ('doa', 'detections') else 0.0),)


@pytest.mark.parametrize('options', [{}, {'sight': never, 'array': 'eight'}], ids=['both', 'sound'])
def test_messages_out_of_order_are_as_good_as_late_ones(contract, options):
    """Up to 0.3 s of jitter against 0.3 s for all: the same information arrives, and none of it later."""
    errors, followed = {}, []
    for name, network in (('late', lambda seed: constant(0.3)), ('out of order', lambda seed: jitter(0.3, seed))):
        rigs = [FormulaRig([Source(**MOVING)], network=network(seed), seed=seed, **options).run(8.0) for seed in range(3)]
        errors[name] = rms(np.concatenate([rig.errors(SETTLED) for rig in rigs]))
        followed += [rig.followed(SETTLED) for rig in rigs]
    contract(at_most('error over that of late messages', errors['out of order'] / errors['late'], 1.1),
             at_least('followed', min(followed), 1.0))


def test_poses_that_come_out_of_order_cost_nothing(contract):
    """One publisher whose pose comes 45 ms late every second: never is it two sources, nor without a bearing."""
    def network(kind, captured, arrival):
        return (arrival + 0.045 if kind == 'odometry' and round(captured * 50) % 50 == 25 else arrival,)
    rigs = {name: FormulaRig([Source(**MOVING)], seed=2, **options).run(10.0)
            for name, options in (('in order', {}), ('out of order', {'network': network}))}
    late = rigs['out of order']
    contract(at_least('followed', late.followed(SETTLED), 1.0),
             at_least('attitude known', float(np.mean([moment.bearing.attitude_known for moment in late.between(1.0)])), 1.0),
             at_most('error over that in order', rms(late.errors(SETTLED)) / rms(rigs['in order'].errors(SETTLED)), 1.1))


def test_a_third_of_the_messages_may_be_lost(contract):
    random = np.random.default_rng(3)
    rigs = {share: [FormulaRig([Source(**MOVING)], seed=seed, network=lambda kind, captured, arrival, share=share: (
        (arrival,) if random.random() < share else ())).run(8.0) for seed in range(2)] for share in (1.0, 0.67)}
    errors = {share: rms(np.concatenate([rig.errors(SETTLED) for rig in some])) for share, some in rigs.items()}
    lossy = rigs[0.67]
    contract(at_most('error over that with all', errors[0.67] / errors[1.0], 1.5),
             at_least('followed', min(rig.followed(SETTLED) for rig in lossy), 1.0),
             at_most('names of the target', names(lossy), 1))


def test_a_message_that_comes_twice_counts_once(contract):
    """The same stamp again is no new information: neither the bearing nor its variance change."""
    errors, variances = [], []
    for seed in range(3):
        once, twice = (FormulaRig([Source(**MOVING)], seed=seed, network=network).run(6.0) for network in (
            lambda kind, captured, arrival: (arrival,), lambda kind, captured, arrival: (arrival, arrival)))
        errors.append(rms(twice.errors(SETTLED)) / rms(once.errors(SETTLED)))
        variances.append(np.mean([moment.bearing.azimuth_variance for moment in twice.following(SETTLED)])
                         / np.mean([moment.bearing.azimuth_variance for moment in once.following(SETTLED)]))
    contract(within('variance over that of single ones', float(np.mean(variances)), 0.95, 1.05),
             at_most('error over that of single ones', float(np.mean(errors)), 1.05))


def test_sound_that_is_late_counts_at_its_capture(contract):
    """0.8 s late, a target at 6 deg/s: taken for new, each window would be 6.6 deg behind."""
    rigs = [FormulaRig([Source.at(-20.0, 5.0, 6.0)], array='eight', sight=never, network=constant(0.5), seed=seed).run(9.0)
            for seed in range(2)]
    ages = [moment.t - measured(moment) for rig in rigs for moment in rig.following(SETTLED)]
    contract(at_most('error, mean', float(abs(np.mean(np.concatenate([rig.errors(3.0) for rig in rigs])))), 1.5, 'deg'),
             at_least('age of the newest measurement, least', min(ages), 0.8 - 1e-3, 's'),
             at_most('age of the newest measurement, greatest', max(ages), 0.9 + 1e-3, 's'))


def test_through_a_gap_the_bearing_stays_and_admits_more_and_more(contract):
    """Nothing for 1.5 s: the variance grows, `measured` stands still, the name stays, and the truth is within 3 sigma."""
    def silent(t):
        return not 4.0 < t < 5.5
    outside, rigs = [], []
    for seed in range(4):
        rig = FormulaRig([Source(**MOVING)], sound=silent, sight=silent, seed=seed).run(8.0)
        rigs.append(rig)
        gap = rig.between(4.3, 5.5)
        assert [moment.bearing.azimuth_variance for moment in gap] == sorted(m.bearing.azimuth_variance for m in gap)
        assert len({measured(moment) for moment in gap}) == 1
        outside += [abs(math.radians(error)) > 3.0 * math.sqrt(moment.bearing.azimuth_variance)
                    for moment, error in zip(gap, rig.errors(4.3, 5.5), strict=True)]
    contract(at_least('followed', min(rig.followed(SETTLED) for rig in rigs), 1.0),
             at_most('outside of 3 sigma in the gap', float(np.mean(outside)), 0.05),
             at_most('names of the target', names(rigs), 1),
             at_most('error half a second later, RMS', rms(np.concatenate([rig.errors(6.1) for rig in rigs])), 0.6, 'deg'))


def test_silence_ends_the_target(contract):
    """Coasting is said after the sensors' timeouts, and the target is given up after 3 s more."""
    rig = FormulaRig([Source(**MOVING)], sound=lambda t: t < 3.0, sight=lambda t: t < 3.0).run(9.0)
    said = {(moment.bearing.state, moment.bearing.source) for moment in rig.between(4.2, 5.5)}
    assert said == {(Bearing.STATE_COASTING, 0)}
    assert {'doa', 'detections'} <= set(rig.moments[-1].state.missing)
    contract(at_most('followed after 5 s of silence', rig.followed(8.0), 0.0))


@pytest.mark.parametrize('meanwhile', ['images without visibility', 'clear images', 'images of fog', 'sound of elsewhere',
                                       'detections elsewhere'])
def test_what_does_not_show_the_target_does_not_keep_it_fresh(contract, meanwhile):
    """From 3 s on the target is neither heard nor seen: `measured` stands still, whatever else arrives."""
    def until(t):
        return t < 3.0
    here = Source(Source.at(10.0, 5.0).direction, heard=until, seen=until)
    elsewhere = Source(Source.at(-25.0, 5.0).direction, heard=lambda t: t >= 3.0 and meanwhile == 'sound of elsewhere',
                       seen=lambda t: t >= 3.0 and meanwhile == 'detections elsewhere')
    visibility = {'images without visibility': None,
                  'images of fog': lambda t: 1.0 if t < 3.0 else 0.0}.get(meanwhile, lambda t: 1.0)
    late = []
    for seed in range(2):
        rig = FormulaRig([here, elsewhere], visibility=visibility, seed=seed).run(6.0)
        for moment in rig.following(3.5):
            if abs(math.degrees(moment.bearing.azimuth) - 10.0) < 12.0:     # still this target
                late.append(measured(moment) - 3.0)
        late += [max(map(to_seconds, (track.last_heard, track.last_seen))) - START - 3.0 for moment in rig.between(3.5)
                 for track in moment.targets.tracks if abs(math.degrees(track.azimuth) - 10.0) < 12.0]    # followed or not
    contract(at_most(f'{meanwhile}: newest measurement after the last one', max(late), 0.02, 's'))


@pytest.mark.parametrize('wrong', [5.0, -5.0, 0.6])
def test_stamps_of_another_clock_are_not_used(contract, wrong):
    """Sound stamped by a clock that is far off, or ahead: what is not yet is not measured. Sight goes on."""
    rig, alone = (FormulaRig([Source.at(15.0, 5.0)], clock=lambda kind, t: wrong if kind == 'doa' else 0.0, array='eight',
                             sight=sight).run(5.0) for sight in (lambda t: True, never))
    contract(at_most('followed by sound', alone.followed(), 0.0),
             at_most('error by sight, RMS', rms(rig.errors(SETTLED)), 0.6, 'deg'))
    assert not any(moment.bearing.source & Bearing.SOURCE_SOUND for moment in rig.moments)


def test_one_stamp_of_the_future_keeps_nothing_out(contract):
    """A single wrong stamp of each sensor, 2 s ahead: the next message counts as before."""
    rig = FormulaRig([Source(**MOVING)], clock=lambda kind, t: 2.0 if abs(t - 4.0) < 0.05 else 0.0).run(7.0)
    contract(at_least('followed', rig.followed(SETTLED), 1.0), at_most('error, RMS', rms(rig.errors(4.5)), 0.5, 'deg'))
    assert rig.moments[-1].t - measured(rig.moments[-1]) < 0.3


@pytest.mark.parametrize('array', ['pair', 'eight'])
def test_asking_changes_nothing(contract, array):
    """Bearings in between, as often as somebody wants them, and posteriors that people watch: the same estimate."""
    rare, often = (FormulaRig([Source(**MOVING), Source.at(140.0, 8.0, seen=never)], array=array, seed=6, polls=polls,
                              parameters={'rate': rate}) for rate, polls in ((1.0, 1), (200.0, 3)))
    rare.run(6.0)
    for t in often.steps(6.0):
        often.stage.posterior(START + t)
    last, asked = ({round(moment.t, 3): moment.bearing for moment in rig.following()} for rig in (rare, often))
    pairs = [(bearing, asked[t]) for t, bearing in last.items()]
    apart = [abs(math.degrees(math.remainder(a.azimuth - b.azimuth, math.tau))) for a, b in pairs]
    ratio = [abs(math.log(a.azimuth_variance / b.azimuth_variance)) for a, b in pairs]
    contract(at_most('azimuths apart, most', max(apart), 1e-3, 'deg'), at_most('variances apart, most', max(ratio), 1e-3))


def test_the_same_messages_give_the_same_bearings():
    """Bit for bit: nothing depends on a clock of its own or on chance."""
    first, again = (FormulaRig([Source(**MOVING), Source.at(-140.0, 10.0)], array='square', sound_clutter=0.3,
                               sight_clutter=0.2, seed=8).run(4.0) for _ in range(2))
    assert str(first.moments) == str(again.moments)


def test_missing_inputs_are_named_until_they_come():
    rig = FormulaRig([Source.at(5.0)], sound=lambda t: t > 2.0, sight=lambda t: t > 3.0, odometry=lambda t: t > 1.0).run(5.0)
    named = {t: set(rig.between(t)[0].state.missing) for t in (0.5, 1.8, 2.9, 4.0)}
    assert named == {0.5: {'doa', 'detections', 'odometry'}, 1.8: {'doa', 'detections'}, 2.9: {'detections'}, 4.0: set()}
