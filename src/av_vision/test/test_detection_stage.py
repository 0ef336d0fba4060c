"""The detection stage: messages in, messages out, without a node."""

import math
from array import array
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip('av_vision.nodes.detector_node_parameters', reason='needs the workspace to be built')

import yolo_models
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_common.parameters import node_parameters
from av_interfaces.msg import Bearing
from av_vision import Candidates, Detections, camera_info_message, image_message
from av_vision.stage import make_detection_stage

CAMERA = PinholeCamera.from_fov(416, 416, math.radians(70.0))
BELOW = CAMERA.rays(np.indices((416, 416))[::-1].reshape(2, -1).T)[:, 1].reshape(416, 416)    # sine of the angle below level
GROUND = np.where(BELOW > 1e-3, 3.0 / np.maximum(BELOW, 1e-3), np.inf)    # m, of flat ground 3 m below the camera


@pytest.fixture
def model(tmp_path):
    return str(yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata={'names': "['bird', 'drone', 'kite']"}))


def header(time):
    return Header(stamp=Time(sec=int(time), nanosec=round(time % 1 * 1e9)), frame_id='camera_optical_frame')


def image_at(time, pixels=None):
    return image_message(header(time), np.zeros((416, 416, 3), np.uint8) if pixels is None else pixels)


def foggy_field(extinction):
    """Flat ground of dark and bright patches in even fog."""
    patches = np.where(np.random.default_rng(0).random((416, 416)) < 0.5, 40.0, 120.0)
    left = np.exp(-extinction * GROUND)
    return np.repeat((patches * left + 200.0 * (1.0 - left)).astype(np.uint8)[..., None], 3, axis=2)


def make(model, camera=None, **parameters):
    stage = make_detection_stage(node_parameters('av_vision', 'detector_node', overrides={'model': model, **parameters}))
    stage.mount(lambda frame, time: None, camera)
    return stage


def test_detections_carry_the_header_and_their_tracks(model):
    stage = make(model)
    for time in (5.0, 5.25):
        message, _ = stage.on_image(image_at(time), time + 0.1)
        assert message.header == header(time)
        drone, = message.detections
        assert (drone.id, drone.results[0].hypothesis.class_id) == ('1', 'drone')
    stage.reset()
    assert stage.on_image(image_at(6.0), 6.1)[0].detections[0].id == '2'


def test_raw_compressed_and_foreign_messages_give_the_same(model):
    raw, _ = make(model).on_image(image_at(5.0), 5.0)
    data = array('B', cv2.imencode('.png', np.zeros((416, 416, 3), np.uint8))[1].tobytes())
    compressed, _ = make(model).on_image(CompressedImage(header=header(5.0), format='png', data=data), 5.0)
    image = image_at(5.0)
    fields = {name: getattr(image, name) for name in ('height', 'width', 'encoding', 'is_bigendian', 'step', 'data')}
    stamp = SimpleNamespace(sec=5, nanosec=0)
    foreign, _ = make(model).on_image(
        SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id='camera_optical_frame'), **fields), 5.0)
    assert raw == compressed == foreign


def test_visibility_comes_at_its_rate_and_after_a_loop(model):
    stage = make(model)
    times = [10.0, 10.1, 10.4, 10.5, 10.6, 3.0, 3.1]
    due = [stage.on_image(image_at(time), time)[1] is not None for time in times]
    assert due == [True, False, False, True, False, True, False]
    assert make(model, camera_kind='thermal').on_image(image_at(1.0), 1.0)[1] is None


def test_visibility_has_a_range_where_the_ground_is_known(model):
    image = image_at(1.0, foggy_field(0.1))
    unscaled = make(model, camera_height=3.0)
    assert math.isnan(unscaled.on_image(image, 1.0)[1].range)
    known = make(model, CAMERA, camera_height=3.0).on_image(image, 1.0)[1]
    assert known.range == pytest.approx(math.log(20.0) / 0.1, rel=0.2)
    assert known.visibility == pytest.approx(0.9 * math.exp(-1.0), abs=0.1)
    assert make(model, CAMERA, camera_height=3.0).on_image(image_at(1.0, foggy_field(1e-4)), 1.0)[1].visibility < 0.9
    learnt = make(model, camera_height=3.0)
    learnt.on_camera_info(camera_info_message(header(0.5), CAMERA))
    assert learnt.on_image(image, 1.0)[1] == known


def test_visibility_uses_depth_of_the_same_moment(model):
    image, depth = image_at(1.0, foggy_field(0.1)), np.where(np.isfinite(GROUND), GROUND, 0.0)
    stage = make(model)
    stage.on_depth(image_message(header(1.0), (1e3 * np.clip(depth, 0.0, 60.0)).astype(np.uint16)))
    assert stage.on_image(image, 1.0)[1].range == pytest.approx(math.log(20.0) / 0.1, rel=0.2)
    assert math.isnan(stage.on_image(image_at(3.0, foggy_field(0.1)), 3.0)[1].range)


def test_images_that_cannot_be_decoded_are_refused_and_the_next_is_used(model):
    stage = make(model)
    wrong = image_at(1.0)
    wrong.encoding = 'pink9'
    with pytest.raises(ValueError, match='pink9'):
        stage.on_image(wrong, 1.0)
    with pytest.raises(ValueError, match='pink9'):
        stage.on_depth(wrong)
    assert len(stage.on_image(image_at(2.0), 2.0)[0].detections) == 1


def test_images_with_dark_heat_are_searched_inverted(model, monkeypatch):
    image = np.random.default_rng(0).integers(0, 256, (416, 416), np.uint8)
    searched = []
    for kind, given in (('thermal', image), ('black_hot', 255 - image)):
        stage = make(model, camera_kind=kind)
        monkeypatch.setattr(stage.detector, 'detect', lambda image, *_: searched.append(image) or (Detections(), []))
        assert stage.on_image(image_at(1.0, given), 1.0)[1] is None
        assert np.array_equal(stage.shown, given)
    assert np.array_equal(*searched)


def test_raw_counts_of_a_thermal_camera_give_no_visibility_and_a_steady_picture(model):
    stage = make(model, camera_kind='thermal')
    counts = np.random.default_rng(0).normal(7300.0, 5.0, (416, 416)).astype(np.uint16)
    counts[50:60, 200:215] += 400
    message = image_message(header(1.0), counts, 'mono16')
    detections, visibility = stage.on_image(message, 1.0)
    assert len(detections.detections) == 1 and visibility is None
    assert stage.shown.dtype == np.uint8 and stage.shown[55, 205] == 255
    before = stage.shown.mean()
    counts[200:] += 3000  # the shutter of the sensor, or a wall, within one image
    stage.on_image(image_message(header(1.03), counts, 'mono16'), 1.03)
    assert abs(stage.shown[:40].mean() - before) < 15.0


@pytest.mark.parametrize('kind', ['visible', 'thermal'])
@pytest.mark.parametrize(('noise', 'shift'), [(0.2, 0), (0.3, 0), (0.3, 2)])
def test_a_plain_sky_of_few_counts_is_shown_grey_and_what_is_in_it_bright(model, kind, noise, shift):
    """Noise below a step of the converter, also where its bits are the upper ones: it was shown as black and white."""
    stage, counts = make(model, camera_kind=kind), np.random.default_rng(0).normal(700.2, noise, (416, 416))
    counts[50:56, 200:208] += 4.0
    stage.on_image(image_message(header(1.0), np.rint(counts).astype(np.uint16) << shift, 'mono16'), 1.0)
    assert stage.shown[100:].std() < 255.0 / 18.0
    assert stage.shown[50:56, 200:208].mean() > stage.shown[100:].mean() + 60.0


def test_a_stage_that_begins_again_knows_nothing_of_the_images_before(model):
    """A camera that was turned, and is covered, while detector_node was not active."""
    stage, image = make(model), np.full((416, 416, 3), 90, np.uint8)
    for time, yaw in ((1.0, 0.0), (9.0, 1.0)):
        stage.mount(lambda frame, time, yaw=yaw: rotation_from_rpy(0.0, 0.0, yaw) @ FLU_TO_OPTICAL.T, CAMERA)
        assert stage.on_image(image_at(time, image), 0.0)[0] is not None and stage.unchanged == 0.0
        stage.reset()


def test_a_camera_that_repeats_one_image_is_noticed(model):
    """A frozen or covered camera; noise in one pixel is enough to be alive. Nothing that it shows is so for ever."""
    stage, image = make(model), np.full((416, 416, 3), 90, np.uint8)
    found = [stage.on_image(image_at(1.0 + 0.5 * k, image.copy()), 0.0) for k in range(20)]
    assert stage.unchanged == 9.5
    assert all(detections is not None for detections, _ in found[:11]) and found[11:] == [(None, None)] * 9
    image[411, 7, 1] += 1
    assert stage.on_image(image_at(11.0, image), 0.0)[0] is not None
    assert stage.unchanged == 0.0


def test_a_repeated_image_of_a_camera_that_has_turned_is_refused(model):
    """What it shows would turn the body on and on, what it does not show would count against a target."""
    stage, image = make(model), np.random.default_rng(1).integers(0, 255, (416, 416, 3), np.uint8)
    stage.mount(lambda frame, time: FLU_TO_OPTICAL.T, CAMERA)
    for k, yaw in enumerate((0.0, 0.0, 0.02, -0.02, 0.04)):
        odometry = Odometry(header=header(1.0 + 0.1 * k))
        odometry.pose.pose.orientation = Quaternion(w=math.cos(0.5 * yaw), z=math.sin(0.5 * yaw))
        stage.on_odometry(odometry)
        stage.on_image(image_at(1.0 + 0.1 * k, image), 0.0)
    odometry.header, odometry.pose.pose.orientation = header(1.5), Quaternion(w=math.cos(0.1), z=math.sin(0.1))
    stage.on_odometry(odometry)
    for _ in range(2):
        with pytest.raises(ValueError, match='same to the bit after it turned by 11 deg'):
            stage.on_image(image_at(1.5, image), 0.0)
    image[7, 3] ^= 1
    stage.on_image(image_at(1.5, image), 0.0)


def test_only_distances_are_depth(model):
    stage = make(model, CAMERA)
    for wrong in (np.zeros((416, 416), np.uint8), np.zeros((416, 416, 3), np.uint8)):
        with pytest.raises(ValueError, match=r'expected 16UC1 .mm. or 32FC1 .m.'):
            stage.on_depth(image_at(1.0, wrong))


def bearing_to(azimuth, **fields):
    return Bearing(state=Bearing.STATE_ACOUSTIC_ACTIVE, azimuth=azimuth, azimuth_variance=1e-4, elevation_variance=math.inf,
                   measured=header(5.0).stamp, **fields)


def test_the_bearing_selects_the_regions_and_a_wrong_one_is_refused(monkeypatch):
    camera = PinholeCamera.from_fov(640, 512, 1.2)
    stage = make('', camera, regions=1)
    stage.mount(lambda frame, time: FLU_TO_OPTICAL.T, camera)
    planned, plan = [], stage.detector.planner.plan
    monkeypatch.setattr(stage.detector.planner, 'plan', lambda *given: planned.append(plan(*given)) or [])
    monkeypatch.setattr(stage.detector.detector, 'candidates',
                        lambda *_: Candidates(np.empty((0, 4)), np.empty((0, 4))))
    stage.on_bearing(bearing_to(0.4))  # to the left of the middle
    for k in range(7):
        stage.on_image(image_at(5.0 + 0.1 * k, np.zeros((512, 640, 3), np.uint8)), 5.0)
    column = float(camera.project([[-math.tan(0.4), 0.0, 1.0]])[0, 0])
    tiles = [region for regions in planned for region in regions if region.kind == 'tile']
    assert {region.y for region in tiles} == {0, 152, 304}
    assert all(region.x <= column <= region.x + region.width for region in tiles)
    with pytest.raises(ValueError, match='bearing'):
        stage.on_bearing(bearing_to(math.nan))
    stage.on_bearing(Bearing(state=Bearing.STATE_NONE, azimuth=math.nan))


def test_nothing_detected_says_nothing_until_all_has_been_searched():
    stage = make('', regions=1)
    black = np.zeros((512, 640, 3), np.uint8)
    assert stage.on_image(image_at(5.0, black), 5.0)[0] is not None  # the first image is searched whole
    assert stage.on_image(image_at(8.0, black), 8.0)[0] is None


def test_a_drone_that_no_region_held_is_not_reported_as_absent(monkeypatch):
    """One region of each image: a message has the drone, or there is none; once it is gone, empty ones come."""
    stage, black = make('', regions=1), np.zeros((512, 640, 3), np.uint8)
    detector, centre, there = stage.detector.detector, np.array([150.0, 120.0]), True
    probabilities = np.eye(4)[[detector._names.index('drone')]] * 0.9

    def candidates(image, floor, regions):
        held = there and (not regions or any(region.holds(centre, 40.0) for region in regions))
        return Candidates(np.array([[130.0, 100.0, 170.0, 140.0]])[:held], probabilities[:held])

    monkeypatch.setattr(detector, 'candidates', candidates)
    alive = [np.where(np.arange(512)[:, None, None] == k, 1, black).astype(np.uint8) for k in range(90)]
    given = [stage.on_image(image_at(5.0 + k / 15.0, image), 5.0) for k, image in enumerate(alive)]
    answers = [answer for answer, _ in given]
    unsearched = [visibility.unsearched for _, visibility in given if visibility is not None]
    assert unsearched[0] == 0.0 and 0.5 < unsearched[-1] < 1.0    # one region of each image holds a small part of it
    counts = [len(answer.detections) for answer in answers if answer is not None]
    assert set(counts) == {1} and 30 < len(counts) < 90
    there = False
    later = [stage.on_image(image_at(11.0 + k / 15.0, alive[k]), 11.0)[0] for k in range(60)]
    assert any(answer is not None and not answer.detections for answer in later)


def test_images_of_another_size_than_their_camera_info_are_refused_with_both_sizes(model):
    stage = make(model)
    info = camera_info_message(header(5.0), PinholeCamera.from_fov(832, 832, 1.2))
    stage.on_camera_info(info)
    with pytest.raises(ValueError, match='416 x 416.*832 x 832'):
        stage.on_image(image_at(5.0), 5.0)
    info.binning_x = info.binning_y = 2
    stage.on_camera_info(info)
    assert stage.on_image(image_at(5.1), 5.1)[0] is not None


@pytest.fixture(scope='module')
def searching():
    """A stage with the shipped networks that searches one region of each image."""
    return make('', regions=1)


@pytest.mark.parametrize('by', ['mount', 'attitude'])
@pytest.mark.parametrize('roll', [0, 90, 180, -90, 5, 20, -33, 140])
def test_the_network_sees_images_upright(monkeypatch, searching, roll, by):
    """Sky above, whatever the roll of the mount or of the rig; boxes are in the image as it came, also those of regions.

    A level camera has the drone 60 pixels to the left and 100 above the middle. A roll to the right turns that to the left.
    """
    cos, sin = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    y, x = np.mgrid[:480, :640] - np.array([239.5, 319.5])[:, None, None]
    right, down = cos * x - sin * y, sin * x + cos * y    # in the picture of a level camera
    image = np.where((np.abs(right + 60) < 15) & (np.abs(down + 100) < 10), 255, np.where(down < 0, 90, 0)).astype(np.uint8)
    stage, begin = searching, 1000.0 * (by == 'mount') + 2.0 * (roll + 180)
    stage.reset()
    mount = FLU_TO_OPTICAL.T @ [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]] if by == 'mount' else FLU_TO_OPTICAL.T
    stage.mount(lambda frame, time: mount, PinholeCamera.from_fov(640, 480, 1.2))
    detector, upright = stage.detector.detector, []
    probabilities = np.eye(4)[[detector._names.index('drone')]] * 0.9

    def candidates(searched, floor, regions):
        grey = searched if searched.ndim == 2 else searched[..., 0]
        above, below = np.array_split(grey[:, grey.shape[1] // 2 - 60:grey.shape[1] // 2 + 60][100:-100], 2)
        upright.append(np.median(above) == 90 and np.median(below) == 0 and (above[-20:] == 90).mean() > 0.6)
        rows, columns = np.nonzero(grey > 200)
        box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], float)
        centre, size = 0.5 * (box[:2] + box[2:]), float((box[2:] - box[:2]).max())
        held = not regions or any(region.holds(centre, size) for region in regions)
        return Candidates(box[None][:held], probabilities[:held])

    monkeypatch.setattr(detector, 'candidates', candidates)
    boxes = []
    for k in range(12):
        if by == 'attitude':
            half = 0.5 * math.radians(roll)
            odometry = Odometry(header=header(begin + 0.1 * k))
            odometry.pose.pose.orientation = Quaternion(w=math.cos(half), x=math.sin(half))
            stage.on_odometry(odometry)
        answer, _ = stage.on_image(image_at(begin + 0.1 * k, image), 0.0)
        boxes += [answer.detections[0].bbox] if answer is not None else []
    assert all(upright) and len(boxes) > 6
    for box in boxes:
        assert box.center.position.x == pytest.approx(320.0 - 60.0 * cos - 100.0 * sin, abs=1.5)
        assert box.center.position.y == pytest.approx(240.0 + 60.0 * sin - 100.0 * cos, abs=1.5)
        assert max(box.size_x, box.size_y) == pytest.approx(30.0, abs=6.0)
    assert (boxes[0].size_x < boxes[0].size_y) == (roll in (90, -90))


@pytest.mark.parametrize('roll', [20, -33])
def test_what_a_network_finds_beside_a_rolled_image_is_not_reported(monkeypatch, searching, roll):
    """Its picture is upright, and grey where it shows nothing of the image: the view is empty, and said to be."""
    stage, detector = searching, searching.detector.detector
    stage.reset()
    stage.mount(lambda frame, time: FLU_TO_OPTICAL.T @ rotation_from_rpy(0.0, 0.0, math.radians(roll)),
                PinholeCamera.from_fov(640, 480, 1.2))
    box, probabilities = np.array([[2.0, 2.0, 22.0, 22.0]], np.float32), np.eye(4)[[detector._names.index('drone')]] * 0.9
    searched = []

    def candidates(picture, floor, regions):
        searched.append(picture.shape)
        return Candidates(box, probabilities)

    monkeypatch.setattr(detector, 'candidates', candidates)
    image = np.full((480, 640, 3), 90, np.uint8)
    answers = [stage.on_image(image_at(3000.0 + 10.0 * roll + 0.1 * k, image), 0.0)[0] for k in range(12)]
    assert len(searched) == 12 and all(shape > (480, 640) for shape in searched)
    assert all(answer is not None and not answer.detections for answer in answers)


def test_an_image_that_was_overtaken_ends_no_track(model):
    """Images of a network may be exchanged; a loop of a file is another sequence."""
    stage = make(model)
    found = [stage.on_image(image_at(time), 0.0) for time in (5.0, 5.1, 5.3, 5.2, 5.4, 2.0)]
    assert found[3] == (None, None)
    assert [message.detections[0].id for message, _ in found if message is not None] == ['1', '1', '1', '1', '2']


def test_attitudes_are_interpolated_and_not_extrapolated_for_long(model, monkeypatch):
    """An attitude that was overtaken is left out; those of a loop begin anew."""
    stage, poses = make(model), []
    stage.mount(lambda frame, time: np.eye(3), CAMERA)

    def detect(image, time, pose, bearing):
        poses.append(pose)
        return Detections(), []

    monkeypatch.setattr(stage.detector, 'detect', detect)

    def attitude(time, yaw, norm=1.0):
        odometry = Odometry(header=header(time))
        odometry.pose.pose.orientation = Quaternion(w=norm * math.cos(0.5 * yaw), z=norm * math.sin(0.5 * yaw))
        stage.on_odometry(odometry)

    def yaw_at(time):
        stage.on_image(image_at(time, np.full((416, 416, 3), 10.0 * time, np.uint8)), 0.0)
        turned = poses[-1].to_world
        return None if turned is None else math.atan2(turned[1, 0], turned[0, 0])

    for k in range(11):
        attitude(5.0 + 0.1 * k, 0.02 * k)
    attitude(5.85, 1.0)
    assert yaw_at(1.0) is None
    assert yaw_at(5.55) == pytest.approx(0.11, abs=1e-6)
    assert yaw_at(6.1) == pytest.approx(0.2, abs=1e-6)
    assert yaw_at(6.5) is None
    with pytest.raises(ValueError, match='norm'):
        attitude(7.0, 0.0, 2.0)
    attitude(2.0, 0.0)
    assert yaw_at(2.05) == pytest.approx(0.0)


def blocks(seed):
    """A picture of blocks of any brightness, 416 x 416."""
    random = np.random.default_rng(seed)
    picture = np.kron(random.uniform(20.0, 230.0, (13, 13)), np.ones((32, 32)))
    return (picture + random.normal(0.0, 2.0, picture.shape)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize('blurred', [
    lambda image: cv2.GaussianBlur(image, (0, 0), 4.0), lambda image: cv2.GaussianBlur(image, (0, 0), 12.0),
    lambda image: cv2.blur(image, (21, 1)), lambda image: cv2.blur(image, (1, 21))], ids=['focus', 'strong', 'pan', 'tilt'])
@pytest.mark.parametrize('seed', range(3))
def test_what_a_blurred_image_does_not_show_says_nothing(model, seed, blurred):
    """Whether by focus, by water on the lens or by motion: nothing is found in such images of drones."""
    sharp, other = (make(model).on_image(image_at(1.0, image), 0.0)[1].visibility
                    for image in (blocks(seed), blurred(blocks(seed))))
    assert sharp > 0.7 and other < 0.2 * sharp
