"""Several sources, by formulas: names that stay, drones that cross, and what is heard and is none."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from figures import at_least, at_most
from formula_rig import Source, never, unit, wrapped
from judged_rig import FormulaRig, angle_between, rms

from av_interfaces.msg import Bearing

NEAR = 8.0          # deg, from a track to the source that it is of


def direction(track):
    """Unit vector (3,) of a track in the body."""
    return unit(math.degrees(track.azimuth), math.degrees(track.elevation))


def named(rig, moment, source):
    """Names of the tracks close to a source."""
    truth = rig.body(moment.t, source)
    return [track.id for track in moment.targets.tracks if angle_between(direction(track), truth) < NEAR]


def majority(rig, source, after, until):
    """The name that a source has most often in a time (s), 0 for none."""
    found = [name for moment in rig.between(after, until) for name in named(rig, moment, source)]
    return max(set(found), key=found.count) if found else 0


def drone(azimuth, elevation, rate=0.0, judged=0.95, **options):
    return Source.at(azimuth, elevation, rate, drone_probability=lambda t: judged, **options)


@pytest.mark.parametrize(('array', 'sight'), [('eight', never), ('square', never), ('eight', lambda t: True)],
                         ids=['eight, heard', 'square, heard', 'eight, heard and seen'])
def test_two_drones_have_two_names_that_stay(contract, array, sight):
    """70 deg apart, both heard in every window."""
    kept, named_both, errors = [], [], []
    for seed in range(3):
        rig = FormulaRig([drone(-25.0, 25.0, 2.0), drone(50.0, 30.0, -2.0)], array=array, sight=sight, seed=seed).run(9.0)
        names = [[majority(rig, source, after, after + 2.0) for after in (2.0, 7.0)] for source in (0, 1)]
        kept.append(all(first == last > 0 for first, last in names) and names[0] != names[1])
        named_both += [all(named(rig, moment, source) for source in (0, 1)) for moment in rig.between(2.0)]
        errors += [min(angle_between(direction(track), rig.body(moment.t, source)) for track in moment.targets.tracks)
                   for moment in rig.following(2.0) for source in (0, 1)]
    contract(at_least('names kept', float(np.mean(kept)), 1.0),
             at_least('both named', float(np.mean(named_both)), 0.98),
             at_most('error, RMS', rms(errors), 3.0, 'deg'))


@pytest.mark.parametrize('confidence', [0.3, 0.45])
def test_a_quiet_drone_is_found_beside_a_loud_one(contract, confidence):
    """Half of what is reported so is a source: ten windows that agree are one."""
    quiet = drone(35.0, 12.0, 3.0, confidence=confidence, heard=lambda t: t > 3.0)
    rig = FormulaRig([quiet, drone(-60.0, 12.0)], array='eight', sight=never).run(9.0)
    contract(at_least('named', float(np.mean([bool(named(rig, moment, 0)) for moment in rig.between(5.0)])), 0.95))


@pytest.mark.parametrize(('case', 'options', 'voices'), [
    ('heard, of different voices', {'sight': never}, (110.0, 190.0)),
    ('heard and seen, alike', {}, (math.nan, math.nan))])
def test_drones_that_cross_keep_their_names(contract, case, options, voices):
    """At +-6 deg/s, 14 deg apart in height or not at all: by their voices, or by their way through an image."""
    kept = []
    for seed in range(6):
        drones = [drone(side * 24.0, 12.0, -side * 6.0, fundamental=voice)
                  for side, voice in zip((1.0, -1.0), voices, strict=True)]
        rig = FormulaRig(drones, array='eight', seed=seed, **options).run(8.0)
        names = [[majority(rig, source, after, after + 1.0) for after in (1.5, 7.0)] for source in (0, 1)]
        kept.append(all(before == after > 0 for before, after in names))
    contract(at_least(f'{case}: names kept', float(np.mean(kept)), 0.8))


def test_names_are_not_used_again():
    """A drone ends, another begins elsewhere 8 s later."""
    rig = FormulaRig([drone(-30.0, 20.0, heard=lambda t: t < 4.0), drone(60.0, 20.0, heard=lambda t: t > 12.0)], array='eight',
                     sight=never).run(16.0)
    first, second = majority(rig, 0, 2.0, 4.0), majority(rig, 1, 14.0, 16.0)
    assert 0 < first < second


def test_a_second_drone_does_not_move_the_bearing_of_the_first(contract):
    """It appears, confirmed by sound and sight: the one that is followed stays, with no larger steps than without it."""
    def largest_step(rig):
        azimuths = [math.degrees(moment.bearing.azimuth) for moment in rig.following(2.0)]
        return float(np.max(np.abs(np.diff(azimuths))))

    added, changed = [], []
    for seed in range(3):
        first, second = drone(-10.0, 8.0, 1.0), drone(22.0, 8.0, heard=lambda t: t > 4.0, seen=lambda t: t > 4.0)
        rig = FormulaRig([first, second], array='eight', seed=seed).run(8.0)
        added.append(largest_step(rig) - largest_step(FormulaRig([first], array='eight', seed=seed).run(8.0)))
        changed.append(len({moment.targets.selected for moment in rig.following(2.0)}) > 1)
    contract(at_most('what it adds to the largest step of the bearing', max(added), 1.0, 'deg'),
             at_most('another is followed', float(np.mean(changed)), 0.0))


@pytest.mark.parametrize('array', ['pair', 'eight'])
def test_a_sound_that_is_no_drones_is_not_followed(contract, array):
    """Heard in every window, each of which says 0.02: nothing moves on it."""
    rig = FormulaRig([drone(47.0, 10.0, judged=0.02, confidence=0.95)], array=array, sight=never).run(12.0)
    contract(at_most('followed', rig.followed(1.0), 0.02))


@pytest.mark.parametrize('array', ['pair', 'eight'])
def test_what_is_heard_and_not_followed_is_said(contract, array):
    """`fusion/state` names where it is heard and with which probability it is a drone's."""
    rig = FormulaRig([drone(47.0, 10.0, judged=0.04, confidence=0.95)], array=array, sight=never).run(6.0)
    said = []
    for moment in rig.between(3.0):
        numbers = [float(number) for number in re.findall(r'[-+]?\d+(?:\.\d+)?', moment.state.reason)]
        shares = [float(number) for number in re.findall(r'\b[01]\.\d+', moment.state.reason)]
        places = (47.0, 133.0) if array == 'pair' else (47.0,)
        said.append(any(abs(wrapped(number - place)) < 5.0 for number in numbers for place in places)
                    and any(share < 0.3 for share in shares))
    contract(at_least('said', float(np.mean(said)), 0.95))


@pytest.mark.parametrize('array', ['pair', 'square', 'eight'])
def test_a_drone_beside_a_louder_bystander_is_followed(contract, array):
    """Both are heard in every window; the bystander is the first group, and sounds like none."""
    right = []
    for seed in range(3):
        rig = FormulaRig([drone(35.0, 20.0, 2.0, judged=0.9, confidence=0.7), drone(-50.0, 5.0, judged=0.03, confidence=0.95)],
                         array=array, sight=never, seed=seed).run(9.0)
        errors = dict(zip([moment.t for moment in rig.following(3.0)], rig.errors(3.0, folded=array == 'pair'), strict=True))
        right += [abs(errors.get(moment.t, 180.0)) < 10.0 for moment in rig.between(3.0)]
    contract(at_least('the drone is followed', float(np.mean(right)), 0.97))


def test_a_drone_that_falls_silent_is_not_replaced_by_a_siren(contract):
    """It is followed for 5 s, then only the siren is heard."""
    siren = []
    for seed in range(3):
        rig = FormulaRig([drone(35.0, 15.0, heard=lambda t: t < 5.0), drone(-50.0, 5.0, judged=0.02)], array='eight',
                         sight=never, seed=seed).run(12.0)
        siren += [moment.bearing.state != Bearing.STATE_NONE and abs(math.degrees(moment.bearing.azimuth) + 50.0) < 15.0
                  for moment in rig.between(5.0)]
    contract(at_most('the siren is followed', float(np.mean(siren)), 0.02))


def test_a_reflection_does_not_draw_the_bearing_away(contract):
    """Louder than the sound itself and always at one place, where clear images show nothing; the camera shows the drone."""
    right = []
    for seed in range(2):
        rig = FormulaRig([Source.at(12.0, 6.0, 1.0, confidence=0.6), Source.at(-24.0, 6.0, confidence=0.9, seen=never)],
                         visibility=lambda t: 1.0, seed=seed).run(9.0)
        errors = dict(zip([moment.t for moment in rig.following(2.0)], rig.errors(2.0), strict=True))
        right += [abs(errors.get(moment.t, 180.0)) < 2.0 for moment in rig.between(2.0)]
    contract(at_least('within 2 deg', float(np.mean(right)), 0.98))


def test_a_bird_in_the_image_is_not_the_drone(contract):
    """It is silent, detected with 0.35, and crosses the drone; the drone is heard and detected with 0.9."""
    wrong, switched = [], []
    for seed in range(2):
        bird = Source.at(-28.0, 12.0, 8.0, heard=never, score=0.35)
        rig = FormulaRig([drone(5.0, 8.0), bird], array='eight', seed=seed).run(8.0)
        wrong += [abs(error) > 3.0 for error in rig.errors(2.0)]
        switched.append(len({moment.targets.selected for moment in rig.following(2.0)}) - 1)
    contract(at_most('off by more than 3 deg', float(np.mean(wrong)), 0.0), at_most('others followed', max(switched), 0))


def test_judgements_that_waver_are_put_together(contract):
    """A drone judged between 0.3 and 0.95, and an engine between 0.05 and 0.6: their means tell them apart."""
    right, random = [], np.random.default_rng(9)
    for seed in range(3):
        rig = FormulaRig([Source.at(35.0, 15.0, drone_probability=lambda t: random.uniform(0.3, 0.95)),
                          Source.at(-50.0, 5.0, drone_probability=lambda t: random.uniform(0.05, 0.6))],
                         array='eight', sight=never, seed=seed).run(10.0)
        right += [moment.bearing.state != Bearing.STATE_NONE and abs(math.degrees(moment.bearing.azimuth) - 35.0) < 10.0
                  for moment in rig.between(5.0)]
    contract(at_least('the drone is followed', float(np.mean(right)), 0.95))
