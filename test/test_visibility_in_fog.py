"""Visibility in images of the simulator, whose fog is Beer-Lambert's by construction."""

import numpy as np
import pytest

renderer = pytest.importorskip('av_simulator.rendering.scene_renderer', reason='needs av_simulator')

from av_common.camera import PinholeCamera  # noqa: E402
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy  # noqa: E402
from av_simulator.rendering.atmosphere import Atmosphere  # noqa: E402
from av_simulator.rendering.scenes import SCENES  # noqa: E402
from av_simulator.rendering.view import View  # noqa: E402
from av_vision.visibility import estimate, ground_distances  # noqa: E402

HEIGHT = 1.55
CAMERA = PinholeCamera.from_fov(640, 480, np.radians(70.0))
ROTATION = rotation_from_rpy(0.0, np.radians(-8.0), 0.3) @ FLU_TO_OPTICAL.T


@pytest.fixture(scope='module', params=['woodland', 'field', 'urban'])
def scene(request):
    try:
        made = renderer.SceneRenderer(CAMERA, SCENES[request.param](), [], seed=3)
    except RuntimeError as error:
        pytest.skip(f'no rendering here: {error}')
    yield made
    made.close()


@pytest.mark.parametrize('extinction', [0.03, 0.06, 0.12, 0.25])
def test_what_is_left_of_contrast_follows_the_fog_within_a_fifth(scene, extinction):
    image = scene.render(View(0, 0.0, np.array([0.08, 0.0, HEIGHT]), ROTATION, Atmosphere(extinction)))
    columns, rows = np.meshgrid(np.arange(640), np.arange(480))
    rays = CAMERA.rays(np.stack([columns, rows], -1).reshape(-1, 2))
    for distance in (image.depth / rays[:, 2].reshape(480, 640), ground_distances(CAMERA, HEIGHT, ROTATION)):
        seen = estimate(image.bgr, distance, target_distance=6.0)
        assert seen.share == pytest.approx(np.exp(-6.0 * extinction), rel=0.2)
        # In thin fog walls brighter than the ground hide it: the share is right there, the range is rough.
        assert seen.extinction == pytest.approx(extinction, rel=0.2 if extinction >= 0.06 else 0.35)
