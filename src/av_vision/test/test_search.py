"""The regions of each image follow the cues, cover the image in time, and are the same for the same images."""

import numpy as np
import pytest

from av_vision.search import FULL, SEARCHED_S, BearingCue, Cue, RegionPlanner

SHAPE = (512, 640)


def planner(regions=2):
    return RegionPlanner(1280, 320, regions)


def inside(region, centre):
    return region.x <= centre[0] <= region.x + region.width and region.y <= centre[1] <= region.y + region.height


@pytest.mark.parametrize('shape', [(512, 640), (480, 640), (1080, 1920), (416, 416), (120, 900)])
def test_the_first_image_is_searched_whole_and_then_every_part_in_turn(shape):
    plan = planner()
    assert plan.plan(shape, 0.0, []) == []
    searched, near = np.zeros(shape, bool), 0
    for k in range(1, 200):
        for region in plan.plan(shape, k / 15.0, []):
            near += region.kind == 'near'
            assert 0 <= region.x <= region.x + region.width <= shape[1]
            assert 0 <= region.y <= region.y + region.height <= shape[0]
            if region.kind == 'tile':
                searched[region.y:region.y + region.height, region.x:region.x + region.width] = True
    assert searched.all()
    assert near > 20


@pytest.mark.parametrize('shape', [SHAPE, (720, 1280), (1080, 1920)])
def test_whatever_is_small_is_whole_in_some_tile(shape):
    """Of less than what neighbouring tiles have in common: a fifth of their sides, which are 416 pixels of the input."""
    plan = planner()
    plan.plan(shape, 0.0, [])
    tiles = {region for k in range(1, 400) for region in plan.plan(shape, k / 15.0, []) if region.kind == 'tile'}
    size = 0.19 * 416 * min(max(shape) / 1280, 1.0)
    for centre in np.random.default_rng(0).uniform(size, np.array(shape[::-1]) - size, (500, 2)):
        assert any(tile.holds(centre, size) for tile in tiles)


def test_a_track_is_looked_at_in_nearly_every_image_and_the_rest_is_not_forgotten():
    plan, centre, age = planner(), np.array([400.0, 300.0]), 0.0
    plan.plan(SHAPE, 0.0, [])
    hits = 0
    for k in range(1, 151):
        age += 1.0 / 15.0
        regions = plan.plan(SHAPE, k / 15.0, [Cue(centre, 20.0, age)])
        if any(region.kind == 'track' and region.holds(centre, 20.0) for region in regions):
            hits, age = hits + 1, 0.0
    assert hits > 120
    assert plan.searched(10.0)


@pytest.mark.parametrize('pace', [15.0, 5.0])
@pytest.mark.parametrize('bearing', [None, BearingCue(np.array([400.0, 300.0]), np.array([8.0, 8.0]))])
def test_the_target_has_most_looks_where_there_is_time_for_one(pace, bearing):
    """One region of each image: three of four are the target's, or the bearing's; the rest still covers all in its turn."""
    plan, centre, bird, looked, other, near = planner(1), np.array([400.0, 300.0]), np.array([60.0, 60.0]), 0.0, 0.0, set()
    plan.plan(SHAPE, 0.0, [])
    hits = 0
    for k in range(1, 241):
        time = k / pace
        tracks = [] if bearing else [Cue(centre, 20.0, time - looked), Cue(bird, 20.0, time - other)]
        region, = plan.plan(SHAPE, time, tracks, bearing)
        if region.kind in ('track', 'bearing') and region.holds(centre, 20.0):
            hits, looked = hits + 1, time
        other = time if region.holds(bird, 20.0) else other
        near.add((region.kind, region.x, region.y))
    assert hits >= 0.7 * 240
    assert sum(kind == 'tile' for kind, *_ in near) == 12 and ('near', 0, 0) in near


@pytest.mark.parametrize('count', [2, 3])
def test_where_there_is_time_for_one_all_reported_tracks_have_their_turn(count):
    """Else that of the highest score has all looks, and the others count as gone."""
    plan, looked, hits = planner(1), np.zeros(count), np.zeros(count)
    plan.plan(SHAPE, 0.0, [])
    for k in range(1, 121):
        time = 0.1 * k
        cues = [Cue(np.array([100.0 + 180.0 * n, 250.0]), 20.0, time - looked[n], True) for n in range(count)]
        region, = plan.plan(SHAPE, time, cues)
        seen = [region.kind == 'track' and region.holds(cue.centre, 20.0) for cue in cues]
        hits, looked = hits + seen, np.where(seen, time, looked)
    assert hits.min() > 0.8 * hits.max() and hits.sum() > 0.7 * 120


def test_a_large_object_gets_a_large_region():
    plan = planner()
    plan.plan(SHAPE, 0.0, [])
    region, = (one for one in plan.plan(SHAPE, 0.1, [Cue(np.array([300.0, 250.0]), 120.0, 0.1)]) if one.kind == 'track')
    assert region.width >= 240
    assert region.holds(np.array([300.0, 250.0]), 120.0)


@pytest.mark.parametrize(('sigma', 'least'), [((4.0, 4.0), 160), ((40.0, 10.0), 300)])
def test_the_bearings_sigma_gives_the_size_of_its_region(sigma, least):
    plan = planner()
    plan.plan(SHAPE, 0.0, [])
    cue = BearingCue(np.array([320.0, 200.0]), np.array(sigma))
    kinds = {region.kind: region for k in range(1, 5) for region in plan.plan(SHAPE, 0.1 * k, [], cue)}
    assert kinds['bearing'].width >= least
    assert inside(kinds['bearing'], cue.centre)


def test_a_bearing_of_unknown_elevation_is_searched_for_along_its_column():
    plan, column = planner(), 560.0
    plan.plan(SHAPE, 0.0, [])
    cue = BearingCue(np.array([column, 256.0]), np.array([6.0, np.inf]))
    tiles = [region for k in range(1, 16) for region in plan.plan(SHAPE, k / 15.0, [], cue) if region.kind == 'tile']
    rows = [region for region in tiles if region.x <= column <= region.x + region.width]
    assert len(rows) > 0.6 * len(tiles)
    assert {row.y for row in rows} == {0, 152, 304}


def test_absence_tells_something_only_while_all_has_been_searched():
    plan = planner()
    plan.plan(SHAPE, 0.0, [])
    assert plan.searched(SEARCHED_S)
    assert not plan.searched(SEARCHED_S + 0.1)
    for k in range(1, 46):
        plan.plan(SHAPE, 5.0 + k / 15.0, [])
    assert plan.searched(5.0 + 45 / 15.0)


def test_the_whole_image_is_searched_after_a_jump_back_a_new_size_and_where_there_is_time():
    plan = planner()
    plan.plan(SHAPE, 5.0, [])
    assert plan.plan(SHAPE, 5.1, [])
    assert plan.plan(SHAPE, 1.0, []) == []
    assert plan.plan((480, 640), 1.1, []) == []
    plan.regions = FULL
    assert plan.plan((480, 640), 1.2, []) == []


def test_the_same_images_give_the_same_regions():
    def run():
        plan = planner(3)
        return [plan.plan(SHAPE, k / 15.0, [Cue(np.array([100.0, 90.0]), 12.0, 0.1)]) for k in range(60)]

    assert run() == run()


def test_the_pace_follows_the_processor():
    plan = RegionPlanner(1280, 320, 2, look_time=0.06)
    plan.plan(SHAPE, 0.0, [])
    plan.took(0.22)
    assert plan.regions == 3
    for each, regions in ((0.05, 1), (0.002, FULL)):
        for _ in range(100):
            plan.took(each * (len(plan.plan(SHAPE, 0.1, [])) or FULL))
        assert plan.regions == regions
    fixed = planner(3)
    fixed.took(10.0)
    assert fixed.regions == 3
