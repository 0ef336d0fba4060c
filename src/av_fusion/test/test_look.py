"""Looks of a camera on a gimbal: where they go, in which order, and when there are none."""

import math

import numpy as np
import pytest

from av_common.angles import angles_to_direction, wrap
from av_common.gimbal_geometry import gimbal_to_body
from av_common.rig import GimbalMount, Mount
from av_fusion.disambiguation.look import BUDGET_S, REST_S, LookPlanner, in_view
from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import rows_of
from av_fusion.tracks.component import GaussianComponent

HALF_VIEW, HALF_HEIGHT = math.radians(35.0), math.radians(27.0)
GIMBAL = GimbalMount(pan_limits_deg=(-150.0, 150.0), tilt_limits_deg=(-45.0, 60.0))


def deg(*angles):
    return tuple(math.radians(angle) for angle in angles)


def place(azimuth, weight=0.5, elevation=10.0, sigma=3.0, elevation_sigma=10.0):
    """A possible direction of a target that stands still."""
    covariance = np.diag([*np.square(deg(sigma, elevation_sigma)), 0.0, 0.0, 0.0])
    return GaussianComponent(weight, *deg(azimuth, elevation), np.ones(1), np.zeros((1, 5)), covariance[None])


def image(time, camera):
    """An image by a camera that is turned on the body by a matrix."""
    return CameraMeasurement(time, (), HALF_VIEW, HALF_HEIGHT, view=rows_of(camera))


class Search:
    """A gimbal that obeys, images at 10 Hz, and what the camera sees."""

    def __init__(self, *places, gimbal=GIMBAL, target=None, stuck=False, visible=0.8):
        self.planner, self.places, self.gimbal = LookPlanner(gimbal), list(places), gimbal
        self.target = None if target is None else angles_to_direction(*deg(*target))
        self.pan, self.tilt, self.time, self.stuck = 0.0, 0.0, 100.0, stuck
        self.looks, self.seen, self.visible = [], None, visible

    def run(self, seconds):
        step, rate = 0.02, math.radians(self.gimbal.max_rate_deg)
        for k in range(round(seconds / step)):
            self.time += step
            if k % 5 == 0:
                self._see(gimbal_to_body(self.gimbal, self.pan, self.tilt))
            look = self.planner.plan(self.time, self.places, self.visible, RigMotion())
            if self.seen is not None:
                break
            self.looks.append(None if look is None else tuple(np.degrees(look)))
            if look is not None and not self.stuck:
                self.pan += np.clip(look[0] - self.pan, -rate * step, rate * step)
                self.tilt += np.clip(look[1] - self.tilt, -rate * step, rate * step)
        return self

    def _see(self, camera):
        if self.target is not None and in_view(self.target[None], camera, HALF_VIEW, HALF_HEIGHT)[0]:
            self.seen = self.time
        self.planner.on_image(self.time, image(self.time, camera), RigMotion(), False)

    @property
    def directions(self):
        """Azimuths of the looks in their order, without repetitions."""
        found = []
        for look in self.looks:
            if look is not None and (not found or abs(wrap(math.radians(look[0] - found[-1]))) > 0.5):
                found.append(look[0])
        return found


def test_the_more_probable_of_two_images_is_looked_at_first_then_the_other():
    search = Search(place(100.0, 0.4), place(-100.0, 0.6)).run(5.0)
    assert np.sign(search.directions)[:2].tolist() == [-1.0, 1.0]
    assert search.directions[:2] == pytest.approx([-100.0, 100.0], abs=35.0)


def test_of_equal_images_the_nearer_is_looked_at_first():
    search = Search(place(60.0), place(-120.0)).run(5.0)
    assert search.directions[0] == pytest.approx(60.0, abs=30.0)
    assert search.directions[1] == pytest.approx(-120.0, abs=30.0)


def test_one_look_has_both_images_in_view_where_they_are_close():
    search = Search(place(75.0), place(105.0)).run(0.3)
    assert search.directions == pytest.approx([90.0], abs=12.0)


def test_a_target_behind_is_seen_before_the_body_could_turn_to_it():
    search = Search(place(30.0), place(150.0), target=(150.0, 12.0)).run(6.0)
    assert search.seen - 100.0 < 3.0


def test_elevations_are_searched_one_after_the_other():
    """A linear array does not tell the elevation: what is not in view at the horizon may be above."""
    search = Search(place(90.0, 1.0, elevation_sigma=25.0), target=(90.0, 45.0)).run(6.0)
    assert search.seen is not None
    tilts = [look[1] for look in search.looks if look is not None]
    assert tilts[0] < 25.0 < max(tilts)


def test_looks_end_when_they_tell_nothing_more_and_rest():
    search = Search(place(60.0), place(-120.0)).run(BUDGET_S + 1.0)
    assert search.looks[0] is not None
    assert search.looks[-1] is None
    ended = search.time
    search.places = [place(60.0), place(-120.0)]
    search.looks.clear()
    search.run(1.0)
    assert set(search.looks) == {None}
    search.run(REST_S)
    assert any(look is not None for look in search.looks)
    assert search.time < ended + 2.0 * REST_S


@pytest.mark.parametrize(('places', 'visible'), [
    ((place(60.0), place(-120.0)), 0.05),  # dense fog
    ((place(180.0, 1.0, sigma=1.0, elevation=89.0, elevation_sigma=1.0),), 0.8)])  # above the limits of tilt
def test_no_look_is_requested_that_can_tell_nothing(places, visible):
    assert set(Search(*places, visible=visible).run(1.0).looks) == {None}


def test_without_a_camera_there_is_no_look():
    planner = LookPlanner(GIMBAL)
    assert planner.plan(100.0, [place(60.0), place(-120.0)], 0.8, RigMotion()) is None


def test_a_gimbal_that_does_not_turn_keeps_the_body_waiting_no_longer_than_looks_last():
    search = Search(place(90.0), place(-90.0), stuck=True).run(BUDGET_S + 1.0)
    assert search.looks[0] is not None
    assert search.looks[-1] is None


def test_a_look_stays_within_the_limits():
    narrow = GimbalMount(pan_limits_deg=(-30.0, 30.0), tilt_limits_deg=(-10.0, 10.0))
    search = Search(place(60.0, elevation=20.0), place(-170.0), gimbal=narrow).run(1.0)
    looks = np.array([look for look in search.looks if look is not None])
    assert len(looks)
    assert np.abs(looks[:, 0]).max() <= 30.0 + 1e-6
    assert np.abs(looks[:, 1]).max() <= 10.0 + 1e-6


def test_a_mount_that_is_turned_has_its_limits_turned():
    """Behind a mount that faces backwards is what is ahead of the rig."""
    planner = LookPlanner(GimbalMount(mount=Mount(rpy_deg=(0.0, 0.0, 180.0)), pan_limits_deg=(-60.0, 60.0)))
    planner.on_image(100.0, image(100.0, np.diag([-1.0, -1.0, 1.0])), RigMotion(), False)
    look = planner.plan(100.1, [place(20.0), place(160.0)], 0.8, RigMotion())
    assert math.degrees(look[0]) == pytest.approx(160.0, abs=25.0)


def test_looks_begin_anew_after_the_target_was_seen_and_with_another_clock():
    search = Search(place(60.0), place(-120.0)).run(BUDGET_S + 1.0)
    search.planner.cancel()
    search.places = [place(60.0), place(-120.0)]
    search.looks.clear()
    assert search.run(0.5).looks[-1] is not None
    search.time -= 90.0
    search.looks.clear()
    assert search.run(0.5).looks[-1] is not None
