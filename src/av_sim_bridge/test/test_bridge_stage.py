"""The stage without sockets, threads and wall clock: stamps, oracle, vehicles, commands."""

import contextlib
import dataclasses
from operator import attrgetter
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_interfaces.msg', reason='needs the built workspace')

from av_common.freshness import Instant
from av_common.rig import GimbalMount, load_rig
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import GimbalState, PointingCommand
from av_sim_bridge.messages import make_header, odometry_message
from av_sim_bridge.stage import BridgeStage
from av_sim_bridge.vehicle import VehicleState, to_truth
from av_sim_bridge.wire.audio import AudioFormat, AudioHeader, encode_audio
from av_sim_bridge.wire.error import UndatedError, WireError
from av_sim_bridge.wire.gimbal import GimbalSample, encode_gimbal
from av_sim_bridge.wire.image import EncodedImage, encode_image
from av_sim_bridge.wire.imu import ImuSample, encode_imu
from av_sim_bridge.wire.oracle import OracleBox, encode_oracle
from av_sim_bridge.wire.rig_control import decode_rig_control
from av_sim_bridge.wire.truth import encode_truth
from av_vision.messages import image_from_message

RIG = Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml'
EPOCH = 1_700_000_000.0    # s, ROS time of the sender's zero
SENDER = ('127.0.0.1', 50_000)
BLOCK, RATE = 1600, 48_000
PICTURE = cv2.imencode('.png', np.zeros((2, 2, 3), np.uint8))[1].tobytes()
DEPTH = cv2.imencode('.png', np.zeros((2, 2), np.uint16))[1].tobytes()


def make_stage(rig='rig', **settings):
    return BridgeStage(load_rig(RIG.with_name(f'{rig}.yaml')), AudioFormat(), **settings)


def delays(count, rng):
    """Delays of datagrams in s: at best 1 ms, mostly some, and now and then a stall that holds back all that follows."""
    sent = np.arange(count) / 30
    arrival = sent + 0.001 + rng.exponential(0.005, count)
    arrival[::10] = sent[::10] + 0.001
    for stalled in range(5, count, 30):
        arrival[stalled:] = np.maximum(arrival[stalled:], arrival[stalled] + 0.3)
    return arrival - sent


@pytest.mark.parametrize('header', [True, False])
def test_stamps_of_sound_are_capture_times(rng, header):
    """Whatever the delay of each datagram: the error is that of the quickest one."""
    stage, errors = make_stage(), []
    late = delays(100, rng) if header else 0.001 + 0.004 * rng.random(100)
    for number, delay in enumerate(late):
        begin = number * BLOCK / RATE
        datagram = encode_audio(AudioFormat(), np.full((BLOCK, 2), 0.1), AudioHeader(number, BLOCK, begin) if header else None)
        for _, message in stage.on_audio(datagram, EPOCH + begin + BLOCK / RATE + delay, SENDER):
            assert message.header.frame_id == 'microphones' and message.sample_rate == RATE
            errors.append(to_seconds(message.header.stamp) - EPOCH - message.first_sample / RATE)
    assert len(errors) == 100
    assert min(errors[30:]) >= 0.0 and max(errors[1:]) < 6e-3


def test_image_calibration_and_oracle_carry_one_stamp(rng):
    stage = make_stage(oracle_detections=True)
    data = cv2.imencode('.png', rng.integers(0, 255, (240, 320, 3), np.uint8))[1].tobytes()
    for number, delay in enumerate(delays(20, rng)):
        results = [stage.on_image(datagram, EPOCH + number / 30 + delay + 0.002 * part, SENDER)
                   for part, datagram in enumerate(encode_image(EncodedImage(number / 30, data)))]
        assert len(results) > 1 and not any(results[:-1])
        boxes = encode_oracle([OracleBox(2, 0.75, 10.0, 20.0, 30.0, 60.0)])
        (topic, report), = stage.on_image(boxes, EPOCH + number / 30 + 0.2, SENDER)
        image, info = (message for _, message in results[-1])
        assert topic == 'detections' and [name for name, _ in results[-1]] == ['camera/image_raw', 'camera/camera_info']
        assert image.header == info.header == report.header and (info.width, info.height) == (320, 240)
        assert to_seconds(image.header.stamp) - EPOCH == pytest.approx(number / 30, abs=6e-3)
        assert (report.detections[0].id, report.detections[0].results[0].hypothesis.class_id) == ('oracle', 'drone')


def test_sound_without_header_goes_on_when_a_long_delay_ends(rng):
    """Of 0.1 s for over two seconds, for which three datagrams were taken for lost: nothing is, and stamps are right again."""
    stage, published, late = make_stage(), [], 0.002 * rng.random(300)
    late[100:170] += 0.1
    arrivals = EPOCH + np.maximum.accumulate((np.arange(300) + 1) * BLOCK / RATE + late)
    for number, arrival in enumerate(arrivals):
        for _, message in stage.on_audio(encode_audio(AudioFormat(), np.full((BLOCK, 2), 0.1)), arrival, SENDER):
            published.append((to_seconds(message.header.stamp) - EPOCH - number * BLOCK / RATE, message.first_sample))
    assert len(published) == 300 and stage.counts()['audio blocks undated'] == 0
    assert max(abs(error) for error, _ in published[180:]) < 5e-3
    assert [first for _, first in published[180:]] == [number * BLOCK for number in range(180, 300)]


@pytest.mark.parametrize('header', [False, True])
@pytest.mark.parametrize('rate', [16_000, 44_100, 47_500, 48_000, 96_000])
def test_sound_of_another_rate_is_told(rng, rate, header):
    """By how many samples come: with delays, some lost, and after a pause in which none come."""
    stage, frames = make_stage(), 1470
    for number in range(26 * rate // frames):
        time = number * frames / rate + 30.0 * (number > 5)
        datagram = encode_audio(AudioFormat(), np.zeros((frames, 2)), AudioHeader(number, frames, time) if header else None)
        if number % 100:
            with contextlib.suppress(WireError):
                stage.on_audio(datagram, EPOCH + time + frames / rate + 0.01 * rng.random(), SENDER)
    if abs(rate - RATE) <= 500:
        assert not stage.problem
    else:
        assert int(stage.problem.split()[0]) == pytest.approx(rate, rel=0.02)


def test_boxes_that_come_twice_or_without_their_image_are_left_out():
    """Else they would be those of the image before."""
    stage, reported = make_stage(oracle_detections=True), []
    for number in range(30):
        time = number / 15
        if number % 7:    # each seventh image is lost
            stage.on_image(encode_image(EncodedImage(time, PICTURE))[0], EPOCH + time, SENDER)
        for _ in range(1 + (number % 5 == 0)):
            reports = stage.on_image(encode_oracle([]), EPOCH + time + 0.001, SENDER)
            reported += [to_seconds(report.header.stamp) - EPOCH for _, report in reports]
    assert reported == pytest.approx([number / 15 for number in range(30) if number % 7], abs=1e-3)


@pytest.mark.parametrize('late', [0, 1, 2])
def test_a_fragment_that_comes_after_the_next_image_has_begun_is_of_its_image(rng, late):
    """By 80 ms, 15 images a second: none is lost, and boxes are those of the image that began last."""
    stage, events = make_stage(oracle_detections=True), []
    data = cv2.imencode('.png', rng.integers(0, 255, (240, 320, 3), np.uint8))[1].tobytes()
    for number in range(40):
        time = number / 15
        for part, datagram in enumerate(encode_image(EncodedImage(time, data))):
            events.append((time + 0.001 * part + 0.08 * (part == late), datagram))
        events.append((time + 0.01, encode_oracle([])))
    outputs = [output for arrival, datagram in sorted(events) for output in stage.on_image(datagram, EPOCH + arrival, SENDER)]
    for topic in ('camera/image_raw', 'detections'):
        stamps = [to_seconds(message.header.stamp) - EPOCH for name, message in outputs if name == topic]
        assert stamps == pytest.approx([number / 15 for number in range(40)], abs=0.01)


@pytest.mark.parametrize('port', [SENDER[1], 50_001])
def test_boxes_of_a_restarted_simulator_wait_for_its_first_dated_image(port):
    """They are neither of the last image before the restart, nor of a foreign sender, from whatever port they come."""
    stage, stamps = make_stage(oracle_detections=True), []
    for number in range(200):
        begun, sender = (0, SENDER) if number < 60 else (100, (SENDER[0], port))
        arrival, time = number / 30 + 2.0 * (number >= 60), (number - begun) / 30 + 5.0
        with contextlib.suppress(UndatedError):
            stage.on_image(encode_image(EncodedImage(time, PICTURE))[0], EPOCH + arrival, sender)
        boxes = encode_oracle([OracleBox(2, 0.75, 10.0, 20.0, 30.0, 60.0)])
        for _, report in stage.on_image(boxes, EPOCH + arrival + 0.001, sender):
            stamps.append(to_seconds(report.header.stamp))
            assert stamps[-1] == pytest.approx(EPOCH + arrival, abs=0.01)
    assert len(stamps) > 150 and np.diff(stamps).min() > 0.0


def test_the_oracle_is_silent_unless_asked_for():
    stage = make_stage()
    stage.on_image(encode_image(EncodedImage(0.0, PICTURE))[0], EPOCH, SENDER)
    assert stage.on_image(encode_oracle([]), EPOCH, SENDER) == []


def test_each_of_two_cameras_has_topics_and_a_frame_of_its_own(rng):
    """Raw counts of a thermal camera arrive as they were; at one time of capture both images carry one stamp."""
    stage = make_stage('rig_two_cameras', oracle_detections=True)
    seen, counts = rng.integers(0, 255, (48, 64, 3), np.uint8), rng.integers(27_000, 31_000, (256, 320), np.uint16)
    topics, messages = [], []
    for camera, image in (('camera', seen), ('second_camera', counts)):
        encoded = EncodedImage(2.0, cv2.imencode('.png', image)[1].tobytes())
        *_, outputs = [stage.on_image(datagram, EPOCH + 2.0, SENDER, camera) for datagram in encode_image(encoded)]
        boxes = encode_oracle([OracleBox(2, 0.75, 10.0, 20.0, 30.0, 60.0)])
        (_, report), = stage.on_image(boxes, EPOCH + 2.0, SENDER, camera)
        topics += [topic for topic, _ in outputs]
        messages.append([message for _, message in outputs])
        assert {message.header.frame_id for message in messages[-1]} == {report.header.frame_id}
    assert topics == ['camera/image_raw', 'camera/camera_info', 'second_camera/image_raw', 'second_camera/camera_info']
    (colour, _), (thermal, info) = messages
    assert (colour.encoding, colour.header.frame_id) == ('bgr8', 'camera_optical_frame')
    assert (thermal.encoding, thermal.header.frame_id) == ('mono16', 'thermal_optical_frame')
    assert thermal.header.stamp == colour.header.stamp and (info.width, info.height) == (320, 256)
    np.testing.assert_array_equal(image_from_message(thermal), counts)
    grey = cv2.imencode('.jpg', np.full((256, 320), 90, np.uint8))[1].tobytes()
    (_, image), _ = make_stage('rig_thermal').on_image(encode_image(EncodedImage(0.0, grey))[0], EPOCH, SENDER)
    assert (image.encoding, image.header.frame_id) == ('mono8', 'thermal_optical_frame')


@pytest.mark.parametrize('streams', [('camera', 'depth'), ('camera', 'second_camera'), ('camera', 'second_camera', 'depth')])
def test_all_images_together_have_one_vote_on_the_common_clock(streams):
    """They come 80 ms late, and the rig's true states at once: stamps are capture times whoever is in the majority."""
    stage, errors = make_stage('rig_two_cameras'), []
    events = [(0.01 * number + 0.001, 'truth', 0.01 * number) for number in range(600)]
    events += [(number / 15 + 0.08, name, number / 15) for name in streams for number in range(80)]
    for arrival, name, time in sorted(events):
        if name == 'truth':
            stage.on_truth(encode_truth(to_truth(VehicleState(time, np.zeros(3)), 1)), EPOCH + arrival, SENDER)
            continue
        datagram, = encode_image(EncodedImage(time, DEPTH if name == 'depth' else PICTURE))
        (_, image), *_ = (stage.on_depth(datagram, EPOCH + arrival, SENDER) if name == 'depth' else
                          stage.on_image(datagram, EPOCH + arrival, SENDER, name))
        errors.append(to_seconds(image.header.stamp) - EPOCH - time)
    assert len(errors) == 80 * len(streams) and max(map(abs, errors)) < 0.01


def test_depth_carries_the_stamp_of_its_image():
    """Also when it comes much later, and from another thread's port."""
    stage, depth = make_stage(), np.full((48, 64), 65_535, np.uint16)
    depth[10, 20] = 1234
    (_, image), _ = stage.on_image(encode_image(EncodedImage(5.0, PICTURE))[0], EPOCH + 5.0, SENDER)
    late = encode_image(EncodedImage(5.0, cv2.imencode('.png', depth)[1].tobytes()))[0]
    (topic, message), = stage.on_depth(late, EPOCH + 5.3, SENDER)
    assert message.header == image.header
    assert topic == 'camera/depth/image_raw' and message.encoding == '16UC1' and message.step == 128
    values = np.frombuffer(message.data, np.uint16).reshape(48, 64)
    assert values[10, 20] == 1234 and np.count_nonzero(values) == 1


@pytest.mark.parametrize('data', [b'no image', b'\xff\xd8\xff\xe0' + bytes(100)])
def test_what_is_no_image_is_a_value_error(data):
    with pytest.raises(ValueError, match='image'):
        make_stage().on_image(encode_image(EncodedImage(0.0, data))[0], EPOCH, SENDER)


def test_the_gimbal_reports_its_orientation_in_the_time_of_the_others(rng):
    """The stamp is the capture time by the common clock, not the arrival; the frames are those of the rig's description."""
    rig = dataclasses.replace(load_rig(RIG), gimbal=GimbalMount(frame='turret'))
    stage = BridgeStage(rig, AudioFormat())
    orientation = np.array([0.5, -0.5, 0.5, 0.5])
    for number, delay in enumerate(delays(100, rng)):
        stage.on_imu(encode_imu(ImuSample(number, number / 30, np.zeros(3), np.zeros(3))), EPOCH + number / 30 + 0.001, SENDER)
        datagram = encode_gimbal(GimbalSample(number, number / 30, orientation, 0.25))
        (topic, message), = stage.on_gimbal(datagram, EPOCH + number / 30 + delay, SENDER)
        assert not stage.on_gimbal(datagram, EPOCH + number / 30 + delay, SENDER)    # once
        assert to_seconds(message.header.stamp) - EPOCH == pytest.approx(number / 30, abs=6e-3)
    assert topic == 'gimbal/state'
    assert (message.header.frame_id, message.child_frame_id) == ('base_link', 'turret')
    assert (message.variance, message.source) == (0.25, GimbalState.SOURCE_FEEDBACK)
    q = message.orientation
    assert (q.w, q.x, q.y, q.z) == pytest.approx(orientation)
    assert make_stage().on_gimbal(datagram, EPOCH, SENDER) == []    # a rig without a gimbal


@pytest.mark.parametrize('stream', ['rig', 'target', 'imu'])
def test_states_that_come_again_or_out_of_order_are_left_out(rng, stream):
    """Each topic's stamps increase. What comes too late is lost, and nothing else is; after a restart all goes on."""
    stage, stamps = make_stage(), []

    def take(number, arrival):
        time = 0.005 * number
        if stream == 'imu':
            outputs = stage.on_imu(encode_imu(ImuSample(number, time, np.zeros(3), np.zeros(3))), EPOCH + arrival, SENDER)
        else:
            state = to_truth(VehicleState(time, np.zeros(3)), 1 if stream == 'rig' else 2)
            outputs = stage.on_truth(encode_truth(state), EPOCH + arrival, SENDER)
        stamps.extend(to_seconds(message.header.stamp) for _, message in outputs[:1])

    order = np.arange(1000, 2000)
    order[100:900:10], order[101:900:10] = order[101:900:10], order[100:900:10].copy()    # neighbours change places
    for place, number in enumerate(order):
        for _ in range(1 + (place % 7 == 0)):
            take(number, 0.005 * (1000 + place) + 0.001)
    assert len(stamps) == 1000 - 80 and np.diff(stamps).min() > 0.0
    for number in range(600):
        with contextlib.suppress(WireError):
            take(number, 10.5 + 0.005 * number)
    assert len(stamps) > 920 + 350 and np.diff(stamps).min() > 0.0


def test_each_vehicle_has_its_topic():
    stage = make_stage(targets=3)

    def topics(number):
        datagram = encode_truth(to_truth(VehicleState(1.0, np.zeros(3)), number))
        return [(topic, message.child_frame_id) for topic, message in stage.on_truth(datagram, EPOCH + 1.0, SENDER)]

    assert topics(1) == [('odometry', 'base_link'), ('truth/rig', 'base_link')]
    assert topics(2) == [('truth/target', 'target')]
    assert topics(4) == [('truth/target_4', 'target_4')]
    assert topics(5) == topics(9) == []


def test_commands_without_a_finite_gimbal_leave_it_alone():
    stage = make_stage()
    command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.25, move_gimbal=True,
                              pan=float('nan'), tilt=0.1)
    first, second = (decode_rig_control(stage.on_command(command, Instant(5.0, 0.0))) for _ in range(2))
    assert (first.yaw_rate, first.pan, first.tilt) == (0.25, None, None)
    assert second.sequence == first.sequence + 1


def test_a_command_that_is_frozen_or_waited_in_a_queue_moves_nothing():
    stage = make_stage()

    def rate(stamp, time, yaw_rate=0.25):
        command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=yaw_rate, move_gimbal=True)
        command.header.stamp = to_stamp(EPOCH + stamp)
        control = decode_rig_control(stage.on_command(command, Instant(50.0 + time, EPOCH + time)))
        assert control.yaw_rate == 0.0 or control.pan is not None
        return control.yaw_rate

    assert rate(0.0, 0.05) == 0.25
    assert rate(0.1, 0.1, float('nan')) == 0.0
    assert [rate(0.2, 0.2 + 0.04 * k) for k in range(8)] == [0.25] * 6 + [0.0] * 2
    assert rate(1.0, 1.3) == 0.0
    assert rate(9.0, 2.0) == 0.0


def test_commands_of_two_publishers_move_nothing():
    stage = make_stage()

    def rate(stamp, time):
        command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.25)
        command.header.stamp = to_stamp(EPOCH + stamp)
        return decode_rig_control(stage.on_command(command, Instant(50.0 + time, EPOCH + time))).yaw_rate

    assert [rate(0.05 * k, 0.05 * k + 0.01) for k in range(3)] == [0.25] * 3
    stage.contested = {'pointing/command': ['/pointing_node', '/other']}
    assert [rate(0.2 + 0.02 * k, 0.2 + 0.02 * k) for k in range(5)] == [0.0] * 5
    stage.contested = {}
    assert rate(0.6, 0.6) == 0.25


def test_another_one_that_moves_the_rig_is_told_nothing():
    stage = make_stage(follow_odometry=True)
    command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.25)
    assert decode_rig_control(stage.on_command(command, Instant(5.0, 0.0))).yaw_rate is None
    datagram = encode_truth(to_truth(VehicleState(1.0, np.zeros(3)), 1))
    assert [topic for topic, _ in stage.on_truth(datagram, EPOCH, SENDER)] == ['truth/rig']


@pytest.mark.parametrize('number', [1e300, -1e300, float('inf'), float('nan'), 101.0])
def test_impossible_numbers_on_topics_never_reach_the_simulator(number):
    """An impossible rate stops the body, an impossible angle leaves the gimbal alone, an impossible pose is not sent."""
    stage = make_stage()
    single = min(max(number, -3e38), 3e38)    # fields of 32 bits
    command = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=single, move_gimbal=True, pan=0.1,
                              tilt=single)
    command.header.stamp = to_stamp(EPOCH)
    sent = decode_rig_control(stage.on_command(command, Instant(5.0, EPOCH)))
    assert (sent.yaw_rate, sent.pan, sent.tilt) == (0.0, None, None)
    assert stage.counts()['commands unusable'] == 1
    if number == 101.0:
        return
    for part, field in (('pose.pose.position', 'x'), ('twist.twist.linear', 'y'), ('twist.twist.angular', 'z'),
                        ('pose.pose.orientation', 'w')):
        odometry = odometry_message(make_header(EPOCH, 'map'), 'base_link', VehicleState(0.0, np.zeros(3)))
        setattr(attrgetter(part)(odometry), field, number)
        assert stage.on_odometry(odometry) is None
    assert stage.counts()['odometry unusable'] == 4


def test_an_image_larger_than_the_camera_is_refused():
    """By more than twice its pixels."""
    large, = encode_image(EncodedImage(0.0, cv2.imencode('.png', np.zeros((960, 1280, 3), np.uint8))[1].tobytes()))
    for take in (make_stage().on_image, make_stage().on_depth):
        with pytest.raises(ValueError, match=r'1280x960 pixels, expected 1 to 614400 pixels'):
            take(large, EPOCH, SENDER)


@pytest.mark.parametrize('time', [1e300, 1e12, -0.0, 5e-324, 1e9])
@pytest.mark.parametrize('address', [SENDER, ('127.0.0.1', 40_000)])
def test_a_hostile_time_in_one_audio_header_leaves_the_sound_as_it_was(time, address):
    """Also as the first datagram of all, and again and again."""
    stage, published = make_stage(), 0
    for number in range(90):
        begin = 100.0 + number * BLOCK / RATE
        if number % 10 == 0:
            hostile = encode_audio(AudioFormat(), np.zeros((BLOCK, 2)), AudioHeader(number + 500, BLOCK, time))
            with contextlib.suppress(WireError):
                stage.on_audio(hostile, EPOCH + begin, address)
        genuine = encode_audio(AudioFormat(), np.full((BLOCK, 2), 0.1), AudioHeader(number, BLOCK, begin))
        with contextlib.suppress(WireError):
            for _, message in stage.on_audio(genuine, EPOCH + begin + BLOCK / RATE + 0.001, SENDER):
                if message.samples[0]:
                    published += 1
                    assert to_seconds(message.header.stamp) - EPOCH == pytest.approx(begin, abs=5e-3)
    assert published >= 55


def test_a_rising_intruder_in_one_stream_moves_no_other(rng):
    """869 inertial measurements whose time rises by 0.4 s each, from anybody."""
    stage, errors = make_stage(), []
    intruder = ('127.0.0.1', 40_000)
    for number in range(869):
        arrival = 0.005 * number
        sample = ImuSample(number, 0.4 * number, np.zeros(3), np.zeros(3))
        with contextlib.suppress(WireError):
            stage.on_imu(encode_imu(sample), EPOCH + arrival, intruder)
        datagram = encode_truth(to_truth(VehicleState(arrival, np.zeros(3)), 1))
        outputs = stage.on_truth(datagram, EPOCH + arrival + 0.001 + 0.001 * rng.random(), SENDER)
        errors.append(to_seconds(dict(outputs)['odometry'].header.stamp) - EPOCH - arrival)
    assert len(errors) == 869 and max(map(abs, errors)) < 5e-3
    assert stage.counts()['imu undated'] > 860 and stage.counts()['clock restarts'] == 0
