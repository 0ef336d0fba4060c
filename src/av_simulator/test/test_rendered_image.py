"""Rendered images against geometry and Beer-Lambert: what is where, how far, how clear, and how much of it."""

import dataclasses

import numpy as np
import pytest

from av_common.rig import load_rig
from av_simulator import find_config, open_world
from av_simulator.rendering.atmosphere import Atmosphere, Cloud
from av_simulator.rendering.camera_effects import CameraEffects, motion_blurred
from av_simulator.rendering.flat_renderer import FlatRenderer
from av_simulator.rendering.scene_renderer import AIRLIGHT, SceneRenderer
from av_simulator.rendering.scenes import SCENES, Solid, Woodland
from av_simulator.rendering.view import LEAST, Drone, View, outline, score

CAMERA = load_rig(find_config('rig')).camera
EYE = np.array([0.0, 0.0, 1.5])
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])   # optical to ENU, looking east
DRONE = Drone(2, np.array([6.0, 1.0, 2.5]), np.eye(3), 0.6)
EMPTY = Woodland(trees=0)


def renderer(obstacles=(), drones=((0.6, 4),), scene=EMPTY, **options):
    try:
        return SceneRenderer(CAMERA.model, scene, list(drones), 1, list(obstacles), **options)
    except RuntimeError as error:
        pytest.skip(str(error))


def image(view, *args, **options):
    made = renderer(*args, **options)
    try:
        return made.render(view)
    finally:
        made.close()


def view(**changes):
    return View(**({'index': 1, 'time': 0.0, 'position': EYE, 'rotation': LEVEL, 'drones': [DRONE]} | changes))


def wall(distance):
    return Solid('box', (distance + 0.5, 0.0, 1.5), (0.5, 1.2, 1.2), (0.0, 0.0, 0.0))


@pytest.mark.parametrize('fog', [0.02, 0.1, 0.3])
@pytest.mark.parametrize('distance', [4.0, 8.0])
def test_fog_follows_beer_lambert_within_2_percent(fog, distance):
    """Transmission from the images alone: (fogged - airlight) / (clear - airlight) of a black wall, pixel by pixel."""
    made = renderer([wall(distance)])
    clear = made.render(view(drones=[])).bgr.astype(float)
    fogged = np.mean([made.render(view(drones=[], index=n, atmosphere=Atmosphere(fog))).bgr for n in range(12)], axis=0)
    made.close()
    centre = (slice(225, 255), slice(300, 340))
    measured = (fogged[centre] - AIRLIGHT).mean() / (clear[centre] - AIRLIGHT).mean()
    assert measured == pytest.approx(np.exp(-fog * distance), rel=0.02)


def test_depth_is_the_distance_along_the_axis():
    depth = image(view(drones=[]), [wall(7.0)]).depth
    assert depth[240, 320] == pytest.approx(7.0, abs=0.01)
    assert np.isinf(depth[5, 320])
    row = 400       # ground: rays of the camera model meet the plane z = 0
    rays = CAMERA.model.rays(np.column_stack([np.arange(640), np.full(640, row)]))
    expected = EYE[2] / rays[:, 1] * rays[:, 2]
    beside = np.abs(np.arange(640) - 320) > 200
    np.testing.assert_allclose(depth[row, beside], expected[beside], rtol=0.02)


@pytest.mark.parametrize('position', [(6.0, 1.0, 2.5), (5.0, -2.6, 1.2), (12.0, 5.0, 3.0)])
def test_boxes_lie_where_the_distorted_camera_projects_the_drone(position):
    drone = dataclasses.replace(DRONE, position=np.array(position))
    truth = image(view(drones=[drone])).truth[0]
    pixels = CAMERA.model.project((outline(drone) - EYE) @ LEVEL)
    assert truth.visible_fraction == 1.0
    assert truth.box[0] == pytest.approx(pixels[:, 0].min(), abs=0.12 * np.ptp(pixels[:, 0]) + 1.5)
    assert truth.box[2] == pytest.approx(pixels[:, 0].max(), abs=0.12 * np.ptp(pixels[:, 0]) + 1.5)
    centre = CAMERA.model.project([(drone.position - EYE) @ LEVEL])[0]
    assert (truth.box[0] + truth.box[2]) / 2 == pytest.approx(centre[0], abs=3.0)


def test_what_stands_before_a_drone_hides_that_share_of_it():
    # A post covers the drone from its middle to the left, seen from the eye.
    middle = np.array([3.0, 0.5, 2.0])
    post = Solid('box', (3.0, middle[1] + 0.3, 2.0), (0.02, 0.3, 1.0), (0.5, 0.5, 0.5))
    made = renderer([post])
    half, = made.render(view()).truth
    hidden, = made.render(view(drones=[dataclasses.replace(DRONE, position=np.array([6.0, 1.7, 2.5]))])).truth
    made.close()
    assert half.visible_fraction == pytest.approx(0.5, abs=0.1)
    assert hidden.visible_fraction == 0.0 and hidden.box is None


def test_segmentation_names_each_drone():
    drones = [DRONE, Drone(3, np.array([5.0, -1.0, 1.6]), np.eye(3), 0.6, 6, np.zeros(6))]
    made = image(view(drones=drones), drones=[(0.6, 4), (0.6, 6)], everything=True)
    assert set(np.unique(made.segmentation)) == {0, 2, 3}
    for truth in made.truth:
        columns = np.flatnonzero((made.segmentation == truth.target_id).any(axis=0))
        assert (truth.box[0], truth.box[2]) == (columns[0], columns[-1])


def test_every_drone_of_a_swarm_is_in_the_picture():
    """Ten side by side, as many as a scenario has; MuJoCo has six groups of what is drawn."""
    drones = [Drone(2 + k, EYE + np.array([9.0, 1.1 * (k - 4.5), 1.0]), np.eye(3), 0.6) for k in range(10)]
    made = image(view(drones=drones), drones=[(0.6, 4)] * 10, everything=True)
    for truth in made.truth:
        rows, columns = (np.flatnonzero((made.segmentation == truth.target_id).any(axis=axis)) for axis in (1, 0))
        assert truth.box == (columns[0], rows[0], columns[-1], rows[-1]) and truth.visible_fraction == 1.0
    assert len(open_world('swarm_10').view(0, 0.0).drones) == len(made.boxes) == 10


def test_the_oracle_reports_what_can_be_seen():
    assert [box.target_id for box in image(view()).boxes] == [2]
    assert image(view(atmosphere=Atmosphere(1.0))).boxes == []
    assert image(view(daylight=0.001)).boxes == []
    assert image(view(rotation=np.diag([-1.0, -1.0, 1.0]) @ LEVEL)).boxes == []


def test_the_same_view_gives_the_same_bytes():
    foggy = view(atmosphere=Atmosphere(0.1, 3.0, (Cloud(np.array([4.0, 0.0, 1.0]), 1.0, 0.5),)))
    scene = Woodland(trees=30)
    first, second = image(foggy, scene=scene), image(foggy, scene=scene)
    np.testing.assert_array_equal(first.bgr, second.bgr)
    assert (image(dataclasses.replace(foggy, index=2), scene=scene).bgr != first.bgr).any()


@pytest.mark.parametrize('kind', SCENES)
def test_every_scene_renders(kind):
    made = image(view(), scene=SCENES[kind](), everything=True)
    assert made.bgr.shape == (480, 640, 3)
    assert made.bgr.std() > 10
    assert made.thermal.shape == (480, 640)


def test_a_drone_is_warm_and_fog_veils_it():
    made = renderer(everything=True, air_c=10.0)
    clear, foggy = made.render(view()), made.render(view(atmosphere=Atmosphere(0.2)))
    made.close()
    warm = clear.segmentation == 2
    assert 10.0 < clear.thermal[warm].min() < 20.0 < clear.thermal[warm].max() < 40.0  # blades, motors
    distance = np.linalg.norm(DRONE.position - EYE)
    assert (foggy.thermal[warm] - 10.0).sum() == pytest.approx(
        np.exp(-0.7 * 0.2 * distance) * (clear.thermal[warm] - 10.0).sum(), rel=0.05)


@pytest.mark.parametrize('palette', ['white_hot', 'black_hot', 'raw'])
def test_a_thermal_camera_sees_the_drone_by_night(palette):
    """As real clips show it: drone and ground at one end of the range, the sky darkest at the horizon, fixed columns."""
    made = renderer(palette=palette, air_c=5.0, scene=SCENES['field']())
    pictures = [made.render(view(index=n, daylight=0.001, exposure=30.0)) for n in range(12)]
    made.close()
    picture, truth = pictures[0].bgr, pictures[0].truth[0]
    x1, y1, x2, y2 = (round(side) for side in truth.box)
    inside = picture[y1:y2 + 1, x1:x2 + 1].astype(float)
    if palette == 'raw':
        assert picture.dtype == np.uint16 and inside.max() == pytest.approx(100 * (5.0 + 25.0 + 273.15), abs=800)
    else:
        white_hot = (picture if palette == 'white_hot' else 255 - picture).astype(float)
        columns = white_hot[:, 20:60].mean(axis=1)  # beside the drone
        assert picture.dtype == np.uint8 and white_hot[y1:y2 + 1, x1:x2 + 1].max() > 245
        horizon = int(np.argmax(np.diff(columns))) + 1
        assert columns[horizon + 5] - columns[horizon - 5] > 100 and 200 < horizon < 280
        assert columns[horizon - 100] > columns[horizon - 5] + 5
    assert picture.ndim == 2 and [box.target_id for box in pictures[0].boxes] == [2]
    still = np.mean([one.bgr[:120].astype(float) for one in pictures], axis=0)
    columns, noise = np.diff(still.mean(axis=0)).std(), np.diff(picture[:120].astype(float), axis=1).std()
    assert columns > 0.1 * noise  # white noise alone would leave 0.03 of it


def test_pixels_average_the_heat_of_parts_smaller_than_they_are():
    """A far drone's heat does not depend on where between the pixels its motors are."""
    made = renderer(palette='raw', scene=SCENES['field']())
    heat = []
    for shift in np.arange(0.0, 0.08, 0.01):  # m, a fifth of a pixel
        drone = dataclasses.replace(DRONE, position=EYE + np.array([30.0, shift, 6.0]))
        thermal = made.render(view(drones=[drone])).thermal
        warmer = (thermal - np.median(thermal, axis=1, keepdims=True))[136:161, 296:341]
        heat.append(warmer[warmer > 1.0].sum())
    made.close()
    assert np.std(heat) < 0.1 * np.mean(heat), heat  # of one sample a pixel: 0.24


def test_heat_comes_through_fog_that_hides_light():
    """The oracle's score of a drone in fog is higher before a thermal camera, and the same picture comes again."""
    foggy = view(atmosphere=Atmosphere(0.35))
    seen, felt = image(foggy), image(foggy, palette='white_hot')
    assert felt.boxes[0].score > max((box.score for box in seen.boxes), default=0.0)
    np.testing.assert_array_equal(image(foggy, palette='white_hot').bgr, felt.bgr)


@pytest.mark.parametrize('atmosphere', [
    Atmosphere(0.2), Atmosphere(0.0, clouds=(Cloud(np.array([5.0, 0.5, 1.0]), 1.5, 0.8),)),
    Atmosphere(0.05, 10.0, (Cloud(np.array([2.0, -1.0, 2.0]), 0.7, 2.0),))])
def test_optical_depth_is_the_integral_of_the_extinction(rng, atmosphere):
    directions = rng.standard_normal((20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[0] = [1.0, 0.0, 0.0]
    distance = rng.uniform(1.0, 15.0, 20)
    steps = (np.arange(20_000) + 0.5) / 20_000
    for direction, far, depth in zip(directions, distance,
                                     atmosphere.optical_depth(EYE, directions, distance), strict=True):
        points = EYE + steps[:, np.newaxis] * far * direction
        extinction = np.full(len(points), 1.076 * atmosphere.rain_mm_h**0.67 * np.log(10) / 1e4)
        extinction += atmosphere.fog
        for cloud in atmosphere.clouds:
            offset = np.sum((points - cloud.centre) ** 2, axis=1)
            extinction += cloud.density * np.exp(-offset / (2 * cloud.radius**2))
        assert depth == pytest.approx(extinction.mean() * far, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize('atmosphere', [
    Atmosphere(0.02, 12.0, (Cloud(np.array([4.0, 0.0, 1.0]), 2.0, 0.7),)), Atmosphere(0.02, 5.0),
    Atmosphere(clouds=(Cloud(np.array([4.0, 0.0, 1.0]), np.float64(2.0), 0.7),))])
def test_every_kind_of_air_can_be_rendered(rng, atmosphere):
    made = image(view(atmosphere=atmosphere), everything=True)
    assert made.bgr.shape == (480, 640, 3) and made.thermal.dtype == np.float32
    directions = rng.standard_normal((9, 3)).astype(np.float32)
    assert atmosphere.optical_depth(EYE.astype(np.float32), directions, np.ones(9)).dtype == np.float32


def test_light_scales_the_image_and_gain_brings_noise():
    grey = np.full((480, 640, 3), 100, np.uint8)
    effects = CameraEffects(640, 480, 1)
    noon, dusk = effects.apply(grey, view()), effects.apply(grey, view(daylight=0.1, exposure=10.0))
    assert noon.mean() == pytest.approx(100, abs=1) and dusk.mean() == pytest.approx(100, abs=1)
    assert dusk.std() > 2.5 * noon.std()
    assert (effects.apply(grey, view(exposure=8.0)) == 255).mean() > 0.9


def test_motion_blur_smears_along_the_motion():
    line = np.zeros((101, 101, 3), np.uint8)
    line[:, 50] = 255
    blurred = motion_blurred(line, (1000.0, 0.0), shutter_s=0.01)[50, :, 0].astype(float)
    assert blurred.sum() == pytest.approx(255, abs=15)
    assert 9 <= (blurred > 5).sum() <= 12
    assert motion_blurred(line, (10.0, 0.0), shutter_s=0.01) is line


def test_credibility_rises_with_size_contrast_and_visible_part():
    assert score(30.0, 1.0) > 0.9
    values = [score(30.0, t) for t in np.linspace(0, 1, 50)]
    assert (np.diff(values) >= 0).all() and values[0] == 0.0
    assert score(8.0, 1.0) == pytest.approx(0.5, abs=0.02)
    assert score(30.0, 1.0, 0.0) == 0.0
    assert min(value for value in values if value > 0) >= LEAST


def test_the_flat_renderer_puts_the_drone_where_the_camera_model_does():
    made = FlatRenderer(CAMERA.model, EMPTY, 1).render(view())
    centre = CAMERA.model.project([(DRONE.position - EYE) @ LEVEL])[0]
    dark = made.bgr[..., 1] < 60
    assert np.flatnonzero(dark.any(axis=0)).mean() == pytest.approx(centre[0], abs=2.0)
    assert [box.target_id for box in made.boxes] == [2]


@pytest.mark.parametrize(('shift', 'fraction'), [(0.0, 0.0), (0.2, 0.5), (0.6, 1.0)])
def test_the_flat_renderer_hides_a_drone_behind_what_stands_before_it(shift, fraction):
    """A wall at half the distance, moved aside by no, half and more than half a drone's width, as seen there."""
    board = Solid('box', (3.0, -shift, 2.0), (0.02, 0.5, 1.0), (0.9, 0.9, 0.9))
    drone = dataclasses.replace(DRONE, position=np.array([6.0, 0.6, 2.5]))
    made = FlatRenderer(CAMERA.model, EMPTY, 1, [board]).render(view(drones=[drone]))
    assert made.truth[0].visible_fraction == pytest.approx(fraction, abs=0.15)
    assert bool(made.boxes) == (fraction > 0.0)
