"""The fusion stage: what messages and the passing of time give."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.frames import FLU_TO_OPTICAL
from av_common.parameters import node_parameters
from av_common.rig import CAMERAS, ArrayMount, Rig
from av_common.stamps import to_seconds, to_stamp
from av_fusion.consistency.events import Fault
from av_fusion.measurement.converter import fixed_rotations
from av_fusion.nodes.fusion_node import FusionNode
from av_fusion.stage import make_fusion_stage
from av_interfaces.msg import Bearing, Doa, DoaArray, PointingCommand, Visibility

START = 1000.0
ROTATIONS = {'microphones': np.eye(3), 'camera': FLU_TO_OPTICAL.T}


class Recorder:
    """An observer that keeps everything."""

    def __init__(self) -> None:
        self.doa, self.camera, self.tracks = [], [], []

    def on_pose(self, pose):
        pass

    def on_doa(self, measurements, arrival):
        self.doa += measurements

    def on_camera(self, measurement, message, arrival):
        self.camera.append(measurement)

    def on_track(self, track, time):
        self.tracks.append(track)


def make_stage(observer=None, **values):
    return make_fusion_stage(node_parameters('av_fusion', 'fusion_node', overrides=values), fixed_rotations(ROTATIONS),
                             observer=observer)


def doa(stamp, azimuth, frame='microphones', confidence=0.9):
    images = [Doa(direction=Vector3(x=math.cos(a), y=math.sin(a), z=0.0), azimuth=a, azimuth_variance=4e-4,
                  elevation_variance=math.inf, cosine=math.sin(a), cosine_variance=4e-4 * math.cos(a)**2, confidence=confidence)
              for a in (azimuth, math.pi - azimuth)]
    message = DoaArray(window=0.5, method='test', axis=Vector3(x=0.0, y=1.0, z=0.0), hypotheses=images)
    message.header.stamp, message.header.frame_id = to_stamp(stamp), frame
    return message


def detections(stamp, *boxes, frame='camera'):
    """Boxes are (column, score, class)."""
    message = Detection2DArray()
    message.header.stamp, message.header.frame_id = to_stamp(stamp), frame
    for column, score, name in boxes:
        result = ObjectHypothesisWithPose()
        result.hypothesis.class_id, result.hypothesis.score = name, score
        detection = Detection2D(results=[result])
        detection.bbox.center.position.x, detection.bbox.center.position.y = column, 239.5
        detection.bbox.size_x = detection.bbox.size_y = 30.0
        message.detections.append(detection)
    return message


def camera_info(focal=457.0):
    return CameraInfo(width=640, height=480, k=[focal, 0.0, 319.5, 0.0, focal, 239.5, 0.0, 0.0, 1.0], d=[0.0] * 5,
                      distortion_model='plumb_bob')


def odometry(stamp, yaw, yaw_rate=0.0):
    message = Odometry()
    message.header.stamp = to_stamp(stamp)
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    message.twist.twist.angular.z = yaw_rate
    return message


def test_directions_and_detections_give_bearings():
    stage = make_stage()
    stage.on_camera_info(camera_info())
    for k in range(20):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 1.0), now)
        output = stage.on_doa(doa(now - 0.3, 0.2), now)
        output = stage.on_detections(detections(now - 0.1, (319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')), now)
        assert to_seconds(output.bearing.header.stamp) == to_seconds(output.state.header.stamp) == pytest.approx(now)
    bearing, state, targets = output
    assert bearing.azimuth == pytest.approx(0.2, abs=0.01) and bearing.azimuth_world == pytest.approx(1.2, abs=0.01)
    assert bearing.resolved and bearing.state == state.state == Bearing.STATE_VISUAL_ACTIVE
    assert bearing.requested_rotation == 0.0 and bearing.header.frame_id == 'base_link'
    assert not state.missing
    assert targets.header == bearing.header and targets.selected == targets.tracks[0].id == 1
    assert targets.tracks[0].azimuth_world == bearing.azimuth_world


def test_two_cameras_of_one_target_give_one_bearing_each_with_its_own_frame_and_lens():
    """A thermal camera looks 20 deg to the left, with fewer pixels; its images come later than newer ones of the other."""
    recorder, aside = Recorder(), math.radians(20.0)
    turned = np.array([[math.cos(aside), -math.sin(aside), 0.0], [math.sin(aside), math.cos(aside), 0.0], [0.0, 0.0, 1.0]])
    rotations = ROTATIONS | {'thermal': turned @ FLU_TO_OPTICAL.T}
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), fixed_rotations(rotations), observer=recorder,
                              cameras=CAMERAS)
    for camera, frame, size, focal in ((CAMERAS[0], 'camera', (640, 480), 457.0), (CAMERAS[1], 'thermal', (320, 256), 343.0)):
        info = camera_info(focal)
        info.header.frame_id, (info.width, info.height) = frame, size
        info.k[2], info.k[5] = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
        stage.on_camera_info(info, camera)
    for k in range(20):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 1.0), now)
        stage.on_visibility(Visibility(header=detections(now).header, visibility=0.2))
        output = stage.on_detections(detections(now - 0.05, (319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')), now)
        warm = detections(now - 0.12, (159.5 - 343.0 * math.tan(0.2 - aside), 0.9, 'drone'), frame='thermal')
        for one in warm.detections:
            one.bbox.center.position.y = 127.5
        output = stage.on_detections(warm, now, CAMERAS[1])
    assert output.bearing.azimuth == pytest.approx(0.2, abs=0.005) and len(output.targets.tracks) == 1
    assert not output.state.missing or output.state.missing == ['doa']
    seen, felt = recorder.camera[-2:]
    assert seen.detections[0].azimuth == pytest.approx(felt.detections[0].azimuth, abs=2e-3)
    assert seen.half_view != felt.half_view and seen.visibility == pytest.approx(0.2) and math.isnan(felt.visibility)
    stage.refuse_contested({'second_camera/detections': ['/a', '/b']})
    assert stage.on_detections(warm, now, CAMERAS[1]) is None


@pytest.mark.parametrize('is_seen', [False, True])
def test_a_pair_one_above_the_other_says_nothing_of_the_azimuth(is_seen):
    """Mounted with a roll of 90 deg: what it hears begins no target, and is no second one beside what is seen."""
    upright = ROTATIONS | {'microphones': np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'), fixed_rotations(upright))
    stage.on_camera_info(camera_info())
    for k in range(40):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 0.0), now)
        output = stage.on_doa(doa(now - 0.3, 0.02), now)
        if is_seen:
            output = stage.on_detections(detections(now - 0.1, (319.5 - 457.0 * math.tan(0.5), 0.9, 'drone')), now)
    assert [round(track.azimuth, 1) for track in output.targets.tracks] == [0.5] * is_seen


def two_cameras(yaw=0.0):
    """A stage with a second camera, of the same lens, that is turned by `yaw` (rad)."""
    turned = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    stage = make_fusion_stage(node_parameters('av_fusion', 'fusion_node'),
                              fixed_rotations(ROTATIONS | {'thermal': turned @ FLU_TO_OPTICAL.T}),
                              cameras=CAMERAS)
    for camera in CAMERAS:
        stage.on_camera_info(camera_info(), camera)
    return stage


@pytest.mark.parametrize('blind', ['camera', 'thermal'])
def test_a_camera_that_sees_nothing_does_not_take_the_lead_from_one_that_does(blind):
    """The visible one at night, or the thermal one before a warm wall."""
    stage, states = two_cameras(), []
    names = {'camera': CAMERAS[0], 'thermal': CAMERAS[1]}
    for k in range(40):
        now = START + 0.05 * k
        stage.on_odometry(odometry(now, 0.0), now)
        stage.on_visibility(Visibility(header=detections(now).header, visibility=0.0 if blind == 'camera' else 0.9))
        stage.on_doa(doa(now - 0.3, 0.2), now)
        boxes = [] if (frame := ('camera', 'thermal')[k % 2]) == blind else [(319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')]
        output = stage.on_detections(detections(now - 0.04, *boxes, frame=frame), now, names[frame])
        states.append(output.state.state)
        assert not output.state.visibility > 0.0 or blind == 'thermal'
    assert set(states[10:]) == {Bearing.STATE_VISUAL_ACTIVE}
    for k in range(20):    # nor is what the camera that died saw last a reason to lead
        now = START + 2.0 + 0.05 * k
        output = stage.on_detections(detections(now - 0.04, frame=blind), now, names[blind])
    assert output.state.state != Bearing.STATE_VISUAL_ACTIVE


@pytest.mark.parametrize('aside', [None, math.pi])
def test_a_second_camera_that_looks_elsewhere_takes_nothing_from_what_the_first_one_tells(aside):
    """A pair hears a target behind: the first camera, whose view is clear and empty, excludes the front as fast as alone."""
    stage = two_cameras(0.0 if aside is None else aside)
    for k in range(40):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 0.0), now)
        stage.on_visibility(Visibility(header=detections(now).header, visibility=1.0))
        stage.on_doa(doa(now - 0.3, 0.2), now)
        if aside is not None:
            stage.on_detections(detections(now - 0.055, frame='thermal'), now, CAMERAS[1])
        output = stage.on_detections(detections(now - 0.05), now)
    assert output.state.front_probability < 0.05


@pytest.mark.parametrize(('unsearched', 'is_left'), [(0.9, True), (0.0, False), (math.nan, False)])
def test_an_image_that_was_searched_in_part_is_no_evidence_against_what_it_does_not_show(unsearched, is_left):
    """A pair hears a drone ahead beside another one, which is all that the looked-at part of each image shows for a second.

    A detector that says nothing of that searches all of its images, as it always has.
    """
    stage = make_stage()
    stage.on_camera_info(camera_info())
    for k in range(20):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 0.0), now)
        stage.on_visibility(Visibility(header=detections(now).header, visibility=0.9, unsearched=unsearched))
        output = stage.on_doa(doa(now - 0.3, -0.3), now)
        if k >= 10:
            output = stage.on_detections(detections(now - 0.1, (319.5 - 457.0 * math.tan(0.3), 0.9, 'drone')), now)
    other = next(one for one in output.targets.tracks if not one.last_seen.sec)
    assert (abs(other.azimuth) < 1.0) == is_left


def test_what_sight_told_of_the_side_outlives_an_echo_that_comes_to_the_same_place():
    """A pair hears the echo of a drone that only the camera knows to be ahead; unseen, both become one track of that side."""
    stage = make_stage()
    stage.on_camera_info(camera_info())
    for k in range(60):
        now, echo = START + 0.1 * k, min(max(1.2 - 0.06 * (k - 20), 0.1), 1.2)
        stage.on_odometry(odometry(now, 0.0), now)
        if k < 20:
            stage.on_detections(detections(now - 0.1, (319.5 - 457.0 * math.tan(0.1), 0.9, 'drone')), now)
        output = stage.on_doa(doa(now - 0.3, echo), now)
        assert k < 10 or k > 40 or len(output.targets.tracks) == 2
    assert [track.id for track in output.targets.tracks] == [1]
    assert output.bearing.resolved and output.bearing.azimuth == pytest.approx(0.1, abs=0.1)


def test_a_stamp_of_another_clock_is_counted_and_not_used():
    recorder = Recorder()
    stage = make_stage(recorder)
    stage.on_camera_info(camera_info())
    assert stage.on_doa(doa(START - 5.0, 0.2), START) is None
    assert stage.on_detections(detections(START + 5.0), START) is None
    stage.on_odometry(odometry(START + 3.0, 1.0), START)
    assert stage.gate.foreign_stamps == {'doa': 1, 'detections': 1, 'odometry': 1}
    assert not recorder.doa and not recorder.camera and not recorder.tracks
    assert stage.on_time(START).bearing.azimuth_world != 1.0


def test_a_stamp_from_the_future_does_not_keep_later_measurements_out():
    stage = make_stage()
    stage.on_camera_info(camera_info())
    for k in range(5):
        stage.on_detections(detections(START + 0.1 * k, (319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')), START + 0.1 * k)
    assert stage.on_doa(doa(START + 2.4, 0.2), START + 0.5) is None
    assert stage.on_detections(detections(START + 2.4), START + 0.5) is None
    assert stage.gate.foreign_stamps == {'doa': 1, 'detections': 1, 'odometry': 0}
    output = stage.on_detections(detections(START + 0.5, (319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')), START + 0.5)
    assert to_seconds(output.bearing.measured) == pytest.approx(START + 0.5)


def test_time_alone_gives_outputs_at_the_rate():
    stage = make_stage()
    assert stage.on_time(START) is not None
    assert stage.on_time(START + 0.025) is None
    assert stage.on_time(START + 0.0499) is not None  # timers are not exact
    assert stage.on_doa(doa(START - 0.1, 0.2), START + 0.075) is not None
    assert stage.on_time(START + 0.1) is None
    times = [to_seconds(output.bearing.header.stamp) for output in stage.outputs_until(START + 0.6)]
    np.testing.assert_allclose(times, START + 0.075 + 0.05 * np.arange(1, 11))
    assert stage.on_time(START - 50.0) is not None  # the clock was restarted
    assert len(list(stage.outputs_until(START + 9000.0))) == 1  # a pause is not filled


def test_missing_inputs_are_named():
    stage = make_stage()
    assert stage.on_time(START).state.missing == ['doa', 'detections', 'odometry']
    stage.on_odometry(odometry(START, 0.0), START)
    assert stage.on_doa(doa(START, 0.2), START).state.missing == ['detections']
    assert stage.missing(START + 1.5) == ['doa', 'detections', 'odometry']


def test_visibility_belongs_to_images_of_its_time():
    recorder = Recorder()
    stage = make_stage(recorder)
    stage.on_camera_info(camera_info())
    message = Visibility(visibility=0.75)
    message.header.stamp = to_stamp(START)
    stage.on_visibility(message)
    for stamp in (START + 0.5, START + 1.5):
        stage.on_detections(detections(stamp), stamp)
    assert recorder.camera[0].visibility == 0.75 and math.isnan(recorder.camera[1].visibility)


def test_only_detections_of_drones_count():
    recorder = Recorder()
    stage = make_stage(recorder)
    stage.on_camera_info(camera_info())
    stage.on_detections(detections(START, (100.0, 0.9, 'drone'), (200.0, 0.8, 'plane'), (300.0, 0.7, 'bird')), START)
    assert [detection.score for detection in recorder.camera[0].detections] == [0.9]


@pytest.mark.parametrize(('jitter', 'names', 'copies'), [(0.0, ['drone'], 1), (1.0, ['drone'], 1), (4.0, ['drone'], 3)])
def test_one_object_twice_in_an_image_is_one_target(jitter, names, copies):
    """Of a detector of another package that does not suppress duplicates; a second object beside it stays one."""
    recorder, rng, states = Recorder(), np.random.default_rng(4), []
    stage = make_stage(recorder)
    stage.on_camera_info(camera_info())
    for k in range(40):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 0.0), now)
        boxes = [(250.0 + (c > 0) * jitter * rng.uniform(-1.0, 1.0), 0.9 - 0.1 * c, names[c % len(names)])
                 for c in range(copies + 1)]
        if k >= 20:
            boxes.append((300.0, 0.8, names[0]))
        states.append(stage.on_detections(detections(now - 0.05, *boxes), now).bearing.state)
    assert [len(image.detections) for image in recorder.camera] == [1] * 20 + [2] * 20
    assert set(states[2:]) == {Bearing.STATE_VISUAL_ACTIVE}


@pytest.mark.parametrize(('wrong', 'name'), [
    ((480.0, 240.0, 20.0, 10.0, 87.0), 'a score beyond 0 to 1'), ((480.0, 240.0, 20.0, 10.0, math.nan), 'a score'),
    ((0.75, 0.5, 0.03, 0.02, 0.9), 'shares of the image'), ((480.0, 240.0, -20.0, 10.0, 0.9), 'a negative size'),
    ((1500.0, 240.0, 20.0, 10.0, 0.9), 'outside the images of 640 x 480 pixels')])
def test_boxes_of_another_detector_in_other_units_are_refused_and_say_nothing(wrong, name):
    """Percent, shares of the image, pixels of a larger one, corners exchanged: the image is not empty, either."""
    recorder = Recorder()
    stage = make_stage(recorder)
    stage.on_camera_info(camera_info())
    message = detections(START, (300.0, wrong[4], 'drone'))
    box = message.detections[0].bbox
    box.center.position.x, box.center.position.y, box.size_x, box.size_y = wrong[:4]
    with pytest.raises(ValueError, match=name):
        stage.on_detections(message, START)
    message.header.stamp = to_stamp(START + 0.1)
    message.detections += detections(START, (300.0, 0.8, 'drone')).detections
    stage.on_detections(message, START + 0.1)
    assert [[seen.score for seen in image.detections] for image in recorder.camera] == [[0.8]]


def test_detections_in_the_frame_of_the_camera_body_are_refused_by_name():
    """Many drivers' frame_id: the camera would look up, and an image that shows nothing would say so of the sky."""
    stage = make_stage()
    stage.converter.optical_frames = Rig(ArrayMount(Path('none.yaml'))).optical_frames
    stage.on_camera_info(camera_info())
    with pytest.raises(ValueError, match="'camera_link', which has x ahead, expected the optical frame 'camera_optical_frame'"):
        stage.on_detections(detections(START, (300.0, 0.9, 'drone'), frame='camera_link'), START)


def test_a_detector_that_knows_no_drone_is_told():
    stage = make_stage()
    stage.on_camera_info(camera_info())
    stage.on_detections(detections(START, (300.0, 0.9, 'uav'), (100.0, 0.9, '4')), START)
    assert stage.converter.foreign_classes == ['4', 'uav']
    stage.on_detections(detections(START + 0.1, (300.0, 0.9, 'drone')), START + 0.1)
    assert stage.converter.foreign_classes == []


def test_frames_and_cameras_that_are_unknown_are_left_out():
    recorder = Recorder()
    stage = make_stage(recorder)
    assert stage.on_detections(detections(START), START) is None
    assert 'no camera/camera_info' in stage.converter.problems['camera']
    stage.on_camera_info(CameraInfo())
    assert 'not calibrated' in stage.converter.problems['camera']
    stage.on_camera_info(camera_info())
    assert not stage.converter.problems
    assert stage.on_detections(detections(START, frame='elsewhere'), START) is None
    assert stage.on_doa(doa(START, 0.2, frame='elsewhere'), START) is not None  # time has passed all the same
    assert not recorder.doa and not recorder.camera


def test_an_unknown_attitude_is_refused():
    stage = make_stage()
    stage.on_odometry(odometry(START, 1.0), START)
    unknown = odometry(START + 0.1, 0.0)
    unknown.pose.pose.orientation.w = 0.0
    with pytest.raises(ValueError, match='attitude of norm 0, expected 1'):
        stage.on_odometry(unknown, START + 0.1)
    for k in range(5):
        bearing = stage.on_doa(doa(START + 0.1 * k, 0.2), START + 0.1 * k).bearing
    assert bearing.azimuth_world - bearing.azimuth == pytest.approx(1.0)


def hum(stamp, drone_probability, azimuth=0.7):
    """Directions of arrival of a source with a probability of a drone."""
    message = doa(stamp, azimuth)
    for hypothesis in message.hypotheses:
        hypothesis.drone_probability = drone_probability
    return message


def test_what_stays_and_is_no_drone_is_a_fixed_emitter_until_it_is_forgotten():
    """A hum that is heard from one place for minutes: then its sound must be clearly a drone's to be followed."""
    stage = make_stage()
    for step in range(900):
        state = stage.on_doa(hum(START + 0.2 * step, 0.45), START + 0.2 * step).state
    assert state.state == Bearing.STATE_NONE and 'judged not a drone' in state.reason
    assert any(name.startswith('fixed emitter') for name in stage.tracker.diagnostics())
    assert stage.tracker.forget_emitters() >= 1
    assert not any(name.startswith('fixed emitter') for name in stage.tracker.diagnostics())


@pytest.mark.parametrize('step', [-0.2, -3.0])
def test_what_was_heard_before_a_step_of_the_clock_back_is_not_heard_again(step):
    """The messages of before come again when their time does, each once more, beside new ones."""
    recorder, sent = Recorder(), [START + 0.05 * k for k in range(60)]
    stage = make_stage(recorder)
    for time in sent:
        assert stage.on_doa(doa(time, 0.2), time + 0.02)
    for k in range(len(sent)):
        now = sent[-1] + step + 0.07 + 0.05 * k
        assert stage.on_doa(doa(now - 0.01, 0.2), now)
        again = [old for old in sent if now - 0.05 < old <= now]
        assert all(stage.on_doa(doa(old, 0.2), now) is None for old in again)
    assert len(recorder.doa) == 2 * len(sent)


def test_a_stamp_from_the_future_is_not_forgotten_beside_an_input_of_100_hz():
    """Its time comes 1 s and 100 other messages later."""
    stage = make_stage()
    assert stage.on_doa(doa(START + 1.0, 0.2), START) is None
    for k in range(1, 100):
        assert stage.on_doa(doa(START + 0.01 * k, 0.2), START + 0.01 * k)
    assert stage.on_doa(doa(START + 1.0, 0.2), START + 1.0) is None


@pytest.mark.parametrize('contested', ['doa', 'detections', 'odometry', 'gimbal/state', 'camera_info', 'visibility'])
def test_while_an_input_has_two_publishers_every_bearing_is_a_prediction(contested):
    """None of its messages is used, whatever else arrives; afterwards all is as before."""
    stage = make_stage()
    stage.on_camera_info(camera_info())

    def step(now):
        stage.on_odometry(odometry(now, 0.0), now)
        stage.on_doa(doa(now, 0.2), now)
        return stage.on_detections(detections(now, (319.5 - 457.0 * math.tan(0.2), 0.9, 'drone')), now) or stage.on_time(now)

    for k in range(10):
        before = step(START + 0.1 * k)
    assert before.bearing.source and before.bearing.state == Bearing.STATE_VISUAL_ACTIVE
    stage.refuse_contested({contested: ['/doa_node', '/forger']})
    for k in range(10, 20):
        during = step(START + 0.1 * k)
        if during is not None:
            assert during.bearing.source == 0 and during.bearing.state == Bearing.STATE_COASTING
            assert '/forger' in during.state.reason
    stage.refuse_contested({})
    assert step(START + 2.0).bearing.source != 0


@pytest.mark.parametrize('method', ['bayes', 'gated', 'kalman'])
@pytest.mark.parametrize('step', [-100.0, -3.01, -0.71, 0.7, 100.0])  # no stamp comes twice
@pytest.mark.parametrize('heard_on', [0.0, 2.0])
def test_after_a_step_of_the_clock_silence_is_told_as_soon_as_ever(method, step, heard_on):
    """Heard and seen for 5 s, then the clock steps; heard on for a while, then silent: a prediction within 1.1 s by a watch."""
    stage, states = make_stage(method=method), []
    stage.on_camera_info(camera_info())
    column = 319.5 - 457.0 * math.tan(0.2)
    for k in range(200):
        passed = 0.05 * k  # by a watch
        now = START + passed + (step if passed > 5.0 else 0.0)
        output = stage.on_time(now)
        if passed <= 5.0 + heard_on:
            stage.on_odometry(odometry(now, 0.0), now)
            output = stage.on_doa(doa(now, 0.2), now)
            if passed <= 5.0:
                output = stage.on_detections(detections(now, (column, 0.9, 'drone')), now) or output
        if output is not None:
            states.append((passed - 5.0 - heard_on, output.bearing.state, output.bearing.source))
    active = (Bearing.STATE_ACOUSTIC_ACTIVE, Bearing.STATE_VISUAL_ACTIVE)
    assert any(state in active for _, state, _ in states)
    late = [passed for passed, state, source in states if passed > 1.11 and (state in active or source)]
    assert not late, f'{len(late)} outputs until {late[-1]:.2f} s after the last measurement'
    if heard_on:
        assert {state for passed, state, _ in states if -0.5 < passed <= 0.0} == {Bearing.STATE_ACOUSTIC_ACTIVE}
    assert set(stage.missing(now)) == {'doa', 'detections', 'odometry'}


@pytest.mark.parametrize(('values', 'named'), [
    ({'tau': 1.0}, 'tau is 1, .*expected less than 1'), ({'follow_threshold': 1.0}, 'follow_threshold is 1, .*less than 1'),
    ({'detection_probability': 0.0}, 'detection_probability is 0, .*0.1 or more'),
    ({'detection_probability': 0.05}, 'detection_probability is 0.05, .*0.1 or more'),
    ({'sound_delay': -1.5}, 'sound_delay is -1.5 s, .*expected less'), ({'sight_delay': 0.6}, 'sight_delay is 0.6 s')])
def test_parameters_that_exclude_everything_are_refused_by_name(values, named):
    with pytest.raises(ValueError, match=named):
        FusionNode.check_parameters(node_parameters('av_fusion', 'fusion_node', overrides=values))
    FusionNode.check_parameters(node_parameters('av_fusion', 'fusion_node'))


class Failing(Recorder):
    """An observer that fails once."""

    def on_camera(self, measurement, message, arrival):
        super().on_camera(measurement, message, arrival)
        if len(self.camera) == 1:
            raise OSError('no space left')


def test_a_message_that_fails_is_not_tried_again():
    """What comes later is used, and outputs go on."""
    observer = Failing()
    stage = make_stage(observer)
    stage.on_camera_info(camera_info())
    with pytest.raises(OSError, match='no space'):
        stage.on_detections(detections(START, (100.0, 0.9, 'drone')), START)
    assert stage.on_time(START + 0.1) is not None and len(observer.camera) == 1
    assert stage.on_detections(detections(START + 0.1, (100.0, 0.9, 'drone')), START + 0.15) is not None


def test_of_a_rig_that_is_not_as_described_targets_that_are_not_followed_are_uncertain_too():
    """Other rigs use them."""
    stage, resolved = make_stage(), []
    for k in range(40):
        now, fault = START + 0.1 * k, Fault('the microphones are exchanged', 'mend', 1.0, True) if k == 39 else None
        stage.consistency.advance = lambda _, fault=fault: fault
        message = doa(now, 0.2)
        message.axis, message.hypotheses = Vector3(), message.hypotheses[:1]
        message.hypotheses[0].drone_probability, message.hypotheses[0].cosine = 0.01, math.nan
        output = stage.on_doa(message, now)
        resolved += [one.resolved for one in output.targets.tracks]
    assert output.bearing.state == Bearing.STATE_NONE and len(output.targets.tracks) == 1
    assert resolved[-2:] == [True, False] and output.targets.tracks[0].source == 0


def test_a_command_of_no_number_leaves_what_is_known_of_the_heading():
    """It stands while others turn the rig: bearings in the world are uncertain by that, and finite."""
    stage = make_stage()
    for k in range(80):
        now = START + 0.1 * k
        stage.on_odometry(odometry(now, 0.0), now)
        stage.on_command(PointingCommand(move_body=True, yaw_rate=math.nan if k == 40 else 0.3), now)
        output = stage.on_doa(doa(now, 0.2), now)
    assert 'held' in stage.consistency.fault.text
    assert math.radians(20.0) ** 2 < output.bearing.covariance_world[0] < math.inf


def test_among_hundreds_of_classes_drones_are_noticed():
    stage = make_stage()
    stage.on_camera_info(camera_info())
    for k in range(150):
        stage.on_detections(detections(START + 0.1 * k, (100.0, 0.9, str(k))), START + 0.1 * k)
    assert len(stage.converter.foreign_classes) < 150
    stage.on_detections(detections(START + 15.0, (100.0, 0.9, 'drone')), START + 15.0)
    assert stage.converter.foreign_classes == []
