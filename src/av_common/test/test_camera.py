"""The camera model against geometry and its own inverse."""

from types import SimpleNamespace

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


def test_camera_info_and_its_mistakes():
    info = SimpleNamespace(width=640, height=480, d=[0.1, 0, 0, 0, 0], k=[400.0, 0, 320, 0, 410, 240, 0, 0, 1],
                           distortion_model='plumb_bob')
    assert PinholeCamera.from_camera_info(info).fy == 410.0
    info.k = [0.0] * 9
    with pytest.raises(ValueError, match='not calibrated'):
        PinholeCamera.from_camera_info(info)
    info.k, info.distortion_model = [400.0, 0, 320, 0, 410, 240, 0, 0, 1], 'equidistant'
    with pytest.raises(ValueError, match='equidistant'):
        PinholeCamera.from_camera_info(info)


@pytest.mark.parametrize(('change', 'name'), [({'fx': 0.0}, 'fx'), ({'width': -1}, 'width'), ({'cx': np.nan}, 'cx'),
                                              ({'width': 2**31}, 'width'), ({'fx': 1e300}, 'fx'), ({'fy': 1e-300}, 'fy'),
                                              ({'cy': -1e300}, 'cy'), ({'fx': np.inf}, 'fx'),
                                              ({'distortion': (1e300, 0.0, 0.0, 0.0)}, 'distortion'),
                                              ({'distortion': (1.0, 2.0)}, 'distortion')])
def test_impossible_cameras_are_named(change, name):
    with pytest.raises(ValueError, match=name):
        PinholeCamera(**{'width': 640, 'height': 480, 'fx': 1.0, 'fy': 1.0, 'cx': 1.0, 'cy': 1.0, **change})
