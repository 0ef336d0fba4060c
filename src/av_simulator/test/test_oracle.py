"""Lines of sight past solids whose shadows are known."""

from __future__ import annotations

import numpy as np
import pytest

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL
from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.oracle import Oracle, Solids
from av_simulator.rendering.render_process import make_renderer
from av_simulator.rendering.scenes import Field, Solid
from av_simulator.rendering.view import Drone, View

EYE = np.array([0.0, 0.0, 1.0])


def hides(solid, *points):
    return Solids([solid]).hide(EYE, np.array(points, float)).tolist()


@pytest.mark.parametrize(('shape', 'z', 'hidden'), [
    ('box', 0.95, True), ('box', -0.95, True), ('cylinder', 0.95, True), ('cylinder', 1.05, False),
    ('ellipsoid', 0.95, True), ('ellipsoid', 1.05, False), ('cone', 0.95, True), ('cone', 1.05, False)])
def test_a_solid_hides_up_to_its_top(shape, z, hidden):
    """Solids 10 m away, 1 m to all sides of (10, 0, 1); points right behind, seen along level rays."""
    solid = Solid(shape, (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
    level = Solids([solid]).hide(np.array([0.0, 0.0, 1.0 + z]), np.array([[20.0, 0.0, 1.0 + z]]))
    assert level.tolist() == [hidden]


def test_round_solids_have_round_sides():
    """At half height the cone is half as wide; the box' corner hides what the cylinder lets pass."""
    def past(shape, y, z=1.0):
        solid = Solid(shape, (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
        return Solids([solid]).hide(np.array([0.0, y, z]), np.array([[20.0, y, z]])).tolist()
    assert past('cone', 0.48) == [True] and past('cone', 0.52) == [False]
    assert past('cone', 0.9, 0.1) == [True] and past('ellipsoid', 0.9, 0.1) == [False]
    assert past('cylinder', 0.99) == [True] and past('cylinder', 1.01) == [False]
    turned = Solid('box', (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0), np.pi / 4)
    assert hides(turned, [20.0, 2.7, 1.0], [20.0, 2.9, 1.0]) == [True, False]


def test_nothing_hides_what_stands_before_it_or_elsewhere():
    solid = Solid('box', (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
    assert hides(solid, [8.9, 0.0, 1.0], [-20.0, 0.0, 1.0], [9.5, 0.0, 1.0], [20.0, 0.0, 1.0]) == [False, False, True, True]
    assert Solids([]).hide(EYE, np.zeros((2, 3))).tolist() == [False, False]


def test_a_thermal_camera_needs_no_light():
    """A drone 12 m ahead by night, seen by a camera of light and by one of heat."""
    camera = PinholeCamera.from_fov(320, 256, np.radians(50.0))
    drone = Drone(FIRST_TARGET, np.array([12.0, 0.0, 1.0]), np.eye(3), 0.5, 4, np.zeros(4))
    views = [View(0, 0.0, EYE, FLU_TO_OPTICAL.T, Atmosphere(0.0003), [drone], daylight, exposure=30.0 ** (daylight < 1.0))
             for daylight in (1.0, 0.002)]
    noon, light = (Oracle(camera, []).boxes(view)[0].score for view in views)
    heat = Oracle(camera, [], thermal=True).boxes(views[1])[0].score
    assert heat == pytest.approx(noon, rel=0.01) and light < 0.7 * noon
    flat = [make_renderer(camera, Field(), ((0.5, 4),), (), 1, 15.0, palette, 'flat').render(views[1]).boxes[0].score
            for palette in ('', 'white_hot')]
    assert flat == [light, heat]
