"""The camera model against geometry and its own inverse."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from av_common.camera import PinholeCamera

DISTORTED = PinholeCamera(640, 480, 450.0, 455.0, 322.0, 238.0, (-0.28, 0.09, 0.001, -0.0007, -0.01))


def test_field_of_view_reaches_the_edges():
    camera = PinholeCamera.from_fov(640, 480, np.radians(70.0))
    edges = camera.rays([[-0.5, 239.5], [639.5, 239.5]])
    angles = np.degrees(np.arctan2(edges[:, 0], edges[:, 2]))
    assert angles == pytest.approx([-35.0, 35.0], abs=1e-9)
    assert np.degrees(camera.horizontal_fov_rad) == pytest.approx(70.0)


def test_projection_is_the_pinhole_formula():
    camera = PinholeCamera(100, 100, 50.0, 60.0, 40.0, 45.0)
    assert camera.project([[1.0, 2.0, 4.0]]) == pytest.approx(np.array([[50 * 0.25 + 40, 60 * 0.5 + 45]]))


@pytest.mark.parametrize('camera', [
    DISTORTED, PinholeCamera(640, 480, 450.0, 455.0, 322.0, 238.0, (0.1, 0.05, 0.0, 0.0, 0.01, 0.2, 0.1, 0.02))])
def test_rays_undo_projection_over_the_whole_image(camera):
    x, y = np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 13))
    pixels = np.stack([x, y], -1).reshape(-1, 2)
    rays = camera.rays(pixels)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(np.ones(len(rays)))
    assert camera.project(5.0 * rays) == pytest.approx(pixels, abs=1e-3)


def test_points_behind_the_lens_have_no_pixel():
    pixels = DISTORTED.project([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    assert np.isnan(pixels[0]).all()
    assert pixels[1] == pytest.approx([322.0, 238.0])
    assert DISTORTED.rays(np.empty((0, 2))).shape == (0, 3)


def test_a_scaled_picture_shows_the_same_directions():
    half = DISTORTED.scaled(320, 240)
    points = np.array([[0.3, -0.2, 1.0], [-0.5, 0.4, 2.0]])
    assert half.project(points) == pytest.approx((DISTORTED.project(points) + 0.5) / 2 - 0.5, abs=1e-9)


def camera_info(**changes):
    """Of a sensor of 1280 x 960 pixels with a distorted lens."""
    region = changes.pop('roi', (0, 0, 0, 0))
    values = {'width': 1280, 'height': 960, 'd': [-0.2, 0.06, 0.001, -0.0007, 0.0], 'distortion_model': 'plumb_bob',
              'k': [900.0, 0.0, 633.0, 0.0, 905.0, 470.0, 0.0, 0.0, 1.0], 'binning_x': 0, 'binning_y': 0, **changes}
    return SimpleNamespace(**values, roi=SimpleNamespace(
        **dict(zip(('x_offset', 'y_offset', 'width', 'height'), region, strict=True))))


POINTS = np.array([[0.2, -0.1, 1.0], [-0.15, 0.12, 1.0], [0.05, 0.2, 1.0]])


@pytest.mark.parametrize(('binning', 'roi', 'size'), [
    ((0, 0), (0, 0, 0, 0), (1280, 960)), ((1, 1), (0, 0, 1280, 960), (1280, 960)), ((2, 2), (0, 0, 0, 0), (640, 480)),
    ((4, 2), (0, 0, 0, 0), (320, 480)), ((0, 0), (400, 100, 700, 801), (700, 801)), ((3, 3), (402, 99, 702, 801), (234, 267)),
    ((2, 2), (300, 0, 0, 0), (490, 480))])
def test_pixels_of_binned_regions_show_what_the_sensor_sees_there(binning, roi, size):
    info = camera_info(binning_x=binning[0], binning_y=binning[1], roi=roi)
    camera = PinholeCamera.from_camera_info(info)
    assert (camera.width, camera.height) == size
    sensor = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), np.reshape(info.k, (3, 3)), np.array(info.d))[0][:, 0]
    # The first pixel of the image is the mean of the first block of the region.
    blocks = np.maximum(binning, 1)
    seen = (sensor - roi[:2] - 0.5 * (blocks - 1)) / blocks
    assert camera.project(POINTS) == pytest.approx(seen, abs=1e-6)
    assert camera.rays(seen) == pytest.approx(POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True), abs=1e-7)


FISHEYE = {'distortion_model': 'equidistant', 'k': [300.0, 0, 640, 0, 310, 470, 0, 0, 1], 'd': [0.03, -0.01, 0.004, -0.001]}


def test_a_fisheye_lens_is_that_of_opencv():
    camera = PinholeCamera.from_camera_info(camera_info(**FISHEYE))
    points = np.random.default_rng(3).normal(size=(200, 3))
    points[:, 2] = np.abs(points[:, 2]) + 0.2
    matrix = np.reshape(FISHEYE['k'], (3, 3)).astype(float)
    pixels = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(FISHEYE['d']))[0][:, 0]
    assert camera.project(points) == pytest.approx(pixels, abs=1e-3)
    assert camera.rays(pixels) == pytest.approx(points / np.linalg.norm(points, axis=1, keepdims=True), abs=1e-6)


def test_a_fisheye_lens_sees_beyond_a_right_angle_and_ends_where_its_polynomial_falls():
    ideal = PinholeCamera(1000, 1000, 280.0, 280.0, 499.5, 499.5, (), equidistant=True)
    off_axis = np.radians([0.0, 47.8, 89.9, 100.0])
    pixels = np.column_stack([499.5 + 280.0 * off_axis, np.full(4, 499.5)])
    rays = ideal.rays(pixels)
    assert np.degrees(np.arctan2(rays[:, 0], rays[:, 2])) == pytest.approx([0.0, 47.8, 89.9, 100.0], abs=1e-4)
    assert ideal.project(2.0 * rays) == pytest.approx(pixels, abs=1e-3)
    assert np.degrees(ideal.horizontal_fov_rad) == pytest.approx(np.degrees(1000 / 280.0))
    ends = PinholeCamera(1000, 1000, 280.0, 280.0, 499.5, 499.5, (-0.2, 0.0, 0.0, 0.0), equidistant=True)
    far = 1.0 / np.sqrt(0.6)   # where a - 0.2 a^3 is greatest
    assert np.isnan(ends.rays([[999.0, 499.5]])).all()
    assert np.isnan(ends.project([[np.sin(1.05 * far), 0.0, np.cos(1.05 * far)]])).all()
    assert ends.horizontal_fov_rad == pytest.approx(2.0 * far, abs=0.01)


@pytest.mark.parametrize('distortion', [(-0.35, 0.0, 0.0, 0.0), (-0.45, 0.3, 0.0, 0.0, -0.1), (-0.2, -0.03, 0.001, -0.0005)])
def test_a_polynomial_that_falls_gives_no_direction_beyond(distortion):
    """The rays of a wide lens that is calibrated as plumb_bob are right or none, and nothing beyond appears in the image."""
    camera = PinholeCamera(1280, 720, 430.0, 435.0, 640.0, 360.0, distortion)
    k1, k2, k3 = distortion[0], distortion[1], distortion[4] if len(distortion) > 4 else 0.0
    radii = np.sqrt([root.real for root in np.roots([7 * k3, 5 * k2, 3 * k1, 1]) if root.real > 0.0 == abs(root.imag)])
    far = np.arctan(radii.min())    # the derivative of r + k1 r^3 + k2 r^5 + k3 r^7 is 0
    angles = np.linspace(0.02, 1.5, 75)
    points = np.column_stack([np.sin(angles), 0.3 * np.sin(angles), np.hypot(1.0, 0.3) * np.cos(angles)])
    seen = camera.project(points)
    assert (np.isfinite(seen[:, 0]) == (angles < far)).all()
    rays = camera.rays(seen[angles < 0.95 * far])
    assert rays == pytest.approx((points / np.hypot(1.0, 0.3))[angles < 0.95 * far], abs=1e-3)
    x, y = np.meshgrid(np.arange(0.0, 1280.0, 40.0), np.arange(0.0, 720.0, 40.0))
    pixels = np.stack([x, y], -1).reshape(-1, 2)
    found = camera.rays(pixels)
    known = np.isfinite(found[:, 0])
    assert 0 < np.count_nonzero(known) < len(pixels)
    assert camera.project(found[known]) == pytest.approx(pixels[known], abs=0.1)
    assert np.arccos(found[known, 2]).max() < far
    assert camera.horizontal_fov_rad == pytest.approx(2.0 * far, abs=0.01)


@pytest.mark.parametrize('changes', [{}, {'roi': (700, 40, 500, 300)}, {'binning_x': 2, 'binning_y': 2},
                                     {**FISHEYE, 'roi': (280, 500, 700, 400)}])
def test_the_field_of_view_is_that_of_the_image(changes):
    camera = PinholeCamera.from_camera_info(camera_info(**changes))
    column, row = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    edges = camera.rays([(-0.5, row), (camera.width - 0.5, row), (column, -0.5), (column, camera.height - 0.5)])
    left, right = (np.arctan2(x, z) for x, _, z in edges[:2])
    upper, lower = (np.arctan2(y, np.hypot(x, z)) for x, y, z in edges[2:])
    assert (camera.horizontal_fov_rad, camera.vertical_fov_rad) == pytest.approx((right - left, lower - upper))
    middle = camera.view[:, 2]
    assert np.arctan2(middle[0], middle[2]) == pytest.approx(0.5 * (left + right))
    assert np.arcsin(middle[1]) == pytest.approx(0.5 * (upper + lower))
    assert camera.view @ camera.view.T == pytest.approx(np.eye(3))
    assert np.linalg.det(camera.view) == pytest.approx(1.0)


def test_the_mistakes_of_camera_info_are_named():
    for changes, named in (({'k': [0.0] * 9}, 'not calibrated'), ({'distortion_model': 'omni'}, "'omni'.*equidistant"),
                           ({'roi': (900, 0, 640, 480)}, '640 x 480 pixels at 900, 0 is not within 1280 x 960'),
                           ({**FISHEYE, 'd': [0.1] * 5}, r'expected one of \(0, 4\)'),
                           ({'binning_x': 2**32 - 1}, 'fx')):
        with pytest.raises(ValueError, match=named):
            PinholeCamera.from_camera_info(camera_info(**changes))


@pytest.mark.parametrize(('size', 'fits'), [((320, 240), True), ((213, 160), True), ((1280, 960), True), ((640, 360), False),
                                            ((640, 496), False), ((480, 640), False)])
def test_only_the_sides_ratio_of_the_calibration_fits(size, fits):
    if fits:
        assert DISTORTED.scaled(*size).width == size[0]
    else:
        with pytest.raises(ValueError, match=f'{size[0]} x {size[1]} pixels.*640 x 480'):
            DISTORTED.scaled(*size)


@pytest.mark.parametrize(('change', 'name'), [({'fx': 0.0}, 'fx'), ({'width': -1}, 'width'), ({'cx': np.nan}, 'cx'),
                                              ({'width': 2**31}, 'width'), ({'fx': 1e300}, 'fx'), ({'fy': 1e-300}, 'fy'),
                                              ({'cy': -1e300}, 'cy'), ({'fx': np.inf}, 'fx'),
                                              ({'distortion': (1e300, 0.0, 0.0, 0.0)}, 'distortion'),
                                              ({'distortion': (1.0, 2.0)}, 'distortion')])
def test_impossible_cameras_are_named(change, name):
    with pytest.raises(ValueError, match=name):
        PinholeCamera(**{'width': 640, 'height': 480, 'fx': 1.0, 'fy': 1.0, 'cx': 1.0, 'cy': 1.0, **change})
