import math
import re
import subprocess
import sys
from dataclasses import replace
from unittest import mock

import bag_messages as make
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from scipy.spatial.transform import Rotation

from av_bags.converters import AudioLayout
from av_bags.definitions import BagError
from av_bags.reader import Bag
from av_bags.writer import BagWriter, CompressionType
from av_common.track import Source, State
from av_evaluation.cli.replay import main
from av_evaluation.metrics.results import metrics_of
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.evaluation import SENSES, evaluate_run


def replayed(path, **settings):
    with Bag(path) as bag:
        replay = Replay(bag, ReplaySettings(**settings))
        return replay, replay.run()


def fused_errors(log):
    following = log.fused['state'] != State.NONE
    time = log.fused['time'][following]
    error = np.angle(np.exp(1j * (log.fused['azimuth'][following] - log.true_azimuth(time))))
    return np.degrees(np.abs(error[np.isfinite(error)]))


@pytest.mark.parametrize('storage', list(StoragePlugin))
def test_a_bag_of_others_gives_the_true_bearings(tmp_path, storage):
    replay, log = replayed(make.flight(tmp_path / 'bag', storage=storage))
    assert replay.stage == 'doa'
    assert not replay.notes
    errors = fused_errors(log)
    assert len(errors) > 300
    assert np.sqrt(np.mean(errors**2)) < 2.0
    assert log.sight['azimuth'][0] == pytest.approx(0.3, abs=0.02)
    fused = metrics_of([evaluate_run('', log, SENSES, filtered=False)])['fused']
    assert fused['coverage'] == 1.0


def test_replaying_twice_gives_the_same_bytes(tmp_path):
    path = make.flight(tmp_path / 'bag')
    for name in ('a.mcap', 'b.mcap'):
        with Bag(path) as bag, BagWriter(tmp_path / name) as out:
            Replay(bag, ReplaySettings(commands=True)).run(out)
    content = (tmp_path / 'a.mcap').read_bytes()
    assert content == (tmp_path / 'b.mcap').read_bytes()
    assert len(content) > 100_000


def test_the_output_holds_what_was_computed_and_what_it_rests_on(tmp_path):
    with Bag(make.flight(tmp_path / 'bag', prefix='/rig_1')) as bag, BagWriter(tmp_path / 'out.mcap') as out:
        log = Replay(bag, ReplaySettings(namespace='rig_1', commands=True)).run(out)
    with AnyReader([tmp_path / 'out.mcap']) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        bearings = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages(
            [c for c in reader.connections if c.topic == '/rig_1/target/bearing'])]
    assert counts['/rig_1/truth/rig'] == counts['/rig_1/odometry'] == 1000
    assert (counts['/rig_1/doa'], counts['/rig_1/detections'], counts['/rig_1/tf_static']) == (200, 250, 1)
    assert len({counts[f'/rig_1/{name}'] for name in ('target/bearing', 'targets', 'fusion/state', 'pointing/command')}) == 1
    np.testing.assert_allclose([b.azimuth for b in bearings], log.fused['azimuth'], atol=1e-6)
    assert bearings[-1].header.frame_id == 'base_link'


def test_an_output_replays_like_its_bag(tmp_path):
    with Bag(make.flight(tmp_path / 'bag')) as bag, BagWriter(tmp_path / 'out.mcap') as out:
        first = Replay(bag).run(out)
    _, second = replayed(tmp_path / 'out.mcap', stage='doa')
    np.testing.assert_array_equal(first.fused['azimuth'], second.fused['azimuth'])
    replay, third = replayed(tmp_path / 'out.mcap', stage='bearing')
    assert replay.stage == 'bearing'
    np.testing.assert_allclose(third.fused['azimuth'], first.fused['azimuth'], atol=1e-6)


def test_sound_is_localised_again(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        for frame in make.audio_frames(make.EPOCH, make.sound_of(0.5, 3.0)):
            write('/audio/frames', make.EPOCH + frame.first_sample / make.RATE + 0.06, frame)
    with Bag(tmp_path / 'bag') as bag, BagWriter(tmp_path / 'out.mcap') as out:
        replay = Replay(bag)
        log = replay.run(out)
    assert replay.stage == 'raw'
    assert len(log.sound) == 26  # windows of 0.5 s every 0.1 s in 3 s
    images = np.sort([log.sound['azimuth'], log.sound['mirrored']], axis=0)
    np.testing.assert_allclose(np.degrees(images[0]), np.degrees(0.5), atol=1.0)
    np.testing.assert_allclose(np.degrees(images[1]), 180.0 - np.degrees(0.5), atol=1.0)
    np.testing.assert_allclose(log.sound['time'], make.EPOCH + 0.25 + 0.1 * np.arange(26), atol=1e-5)
    with Bag(tmp_path / 'out.mcap') as bag:
        assert bag.topics['/doa'].count == 26
    assert any('no topic detections: the camera is not used' in note for note in replay.notes)


@pytest.mark.parametrize('stamped', [True, False])
@pytest.mark.parametrize('described', [True, False])
def test_bytes_of_sound_are_as_good_as_frames(tmp_path, stamped, described):
    pcm = np.round(make.sound_of(-0.4, 2.0) * 32767).astype('<i2').tobytes()
    with make.bag(tmp_path / 'bag', StoragePlugin.SQLITE3) as write:
        if described:
            write('/audio_info', make.EPOCH, make.make('audio_common_msgs/msg/AudioInfo', 2, make.RATE, 'S16LE', 0, 'wave'))
        for k in range(0, len(pcm), 1001):  # cut amid a sample
            data = make.make('audio_common_msgs/msg/AudioData', np.frombuffer(pcm[k:k + 1001], np.uint8))
            begin = make.EPOCH + k / 4 / make.RATE
            if stamped:
                data = make.make('audio_common_msgs/msg/AudioDataStamped', make.header(begin, 'microphones'), data)
            write('/mic/audio', begin + len(pcm[k:k + 1001]) / 4 / make.RATE + (0.05 if stamped else 0.0), data)
    given = ['--audio-rate', str(make.RATE), '--audio-channels', '2'] if not described else []
    assert main([str(tmp_path / 'bag'), '--remap', 'audio/frames:=/mic/audio', '--quiet', *given]) == 0
    layout = None if described else AudioLayout(make.RATE, 2)
    _, log = replayed(tmp_path / 'bag', remappings={'audio/frames': '/mic/audio'}, audio=layout)
    assert len(log.sound) == 16
    images = np.degrees(np.sort([log.sound['azimuth'], log.sound['mirrored']], axis=0))
    np.testing.assert_allclose(images[0], -180.0 + np.degrees(0.4), atol=1.0)
    np.testing.assert_allclose(images[1], -np.degrees(0.4), atol=1.0)
    np.testing.assert_allclose(log.sound['time'], make.EPOCH + 0.25 + 0.1 * np.arange(16), atol=2e-3)


def test_sound_without_description_is_refused_by_name(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        write('/audio/frames', make.EPOCH, make.make('audio_common_msgs/msg/AudioData', np.zeros(100, np.uint8)))
    with pytest.raises(BagError, match=r'/audio/frames is audio_common_msgs/msg/AudioData, which says neither rate'):
        replayed(tmp_path / 'bag')


def test_missing_topics_are_named_with_what_is_done_without(tmp_path):
    path = make.flight(tmp_path / 'bag', leave_out=('odometry', 'camera/camera_info', 'truth/target'), duration=2.0)
    replay, _ = replayed(path)
    notes = '\n'.join(replay.notes)
    assert 'no topic odometry' in notes
    assert 'the rig counts as standing still' in notes
    assert "no topic camera/camera_info: the camera of the rig's description is assumed" in notes
    assert 'no topic truth/target' in notes


def test_sound_that_gives_no_directions_says_why(tmp_path):
    """A publisher that does not count its samples, and a dead microphone, as doa_node reports them."""
    for name in ('uncounted', 'dead'):
        with make.bag(tmp_path / name) as write:
            for number, frame in enumerate(make.audio_frames(make.EPOCH, make.sound_of(-0.4, 6.0))):
                samples = frame.samples.copy()
                samples[1::2] *= name != 'dead'
                write('/audio/frames', make.EPOCH + 0.05 * (number + 1), replace(
                    frame, samples=samples, first_sample=0 if name == 'uncounted' else frame.first_sample))
    notes = ['\n'.join(replayed(tmp_path / name)[0].notes) for name in ('uncounted', 'dead')]
    assert 'audio/frames: 119 windows began anew, after gaps or steps back of first_sample' in notes[0]
    assert 'audio/frames: channel 1 is dead' in notes[1] and 'began anew' not in notes[1]


def test_a_rig_that_is_not_as_described_is_told(tmp_path):
    """A camera that is mounted 25 deg to the side, by what is heard and seen while the rig turns."""
    with make.bag(tmp_path / 'bag') as write:
        rng = np.random.default_rng(3)
        for k in range(2000):
            time = make.EPOCH + 0.02 * k
            yaw, before = (0.5 * math.sin(0.6 * at) for at in (0.02 * k, 0.02 * k - 0.25))
            write('/odometry', time, make.odometry(time, yaw=yaw, yaw_rate=0.3 * math.cos(0.012 * k)))
            if k % 5 == 0:
                write('/doa', time, make.doa(time - 0.25, 0.1 - before + rng.normal(0.0, 0.02)))
            if k % 4 == 0:
                write('/detections', time, make.detections(time, 0.1 - yaw - 0.44 + rng.normal(0.0, 0.003)))
                write('/camera/camera_info', time, make.camera_info(time))
        write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
    replay, _ = replayed(tmp_path / 'bag')
    assert any(note.startswith('the rig is not as described: the camera') for note in replay.notes), replay.notes


@pytest.mark.parametrize('topic', ['/mic/sound', '/left/audio/frames and /right/audio/frames'])
def test_inputs_of_other_names_are_hinted_at(tmp_path, topic):
    with make.bag(tmp_path / 'bag') as write:
        for name in topic.split(' and '):
            for frame in make.audio_frames(make.EPOCH, make.sound_of(-0.4, 0.2)):
                write(name, make.EPOCH, frame)
    with pytest.raises(BagError, match=re.escape('audio/frames:=/mic/sound' if topic == '/mic/sound' else 'remap one')):
        replayed(tmp_path / 'bag')


def test_without_anything_to_compute_from_the_bag_is_refused(tmp_path):
    path = make.flight(tmp_path / 'bag', leave_out=('doa', 'detections'), duration=1.0)
    with pytest.raises(BagError, match='cannot be replayed from raw: no topic audio/frames'):
        replayed(path, stage='raw')
    with pytest.raises(BagError, match='cannot be replayed from bearing: no topic target/bearing'):
        replayed(path)


def test_a_topic_of_a_wrong_type_is_named(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        write('/doa', make.EPOCH, make.odometry(make.EPOCH))
        write('/detections', make.EPOCH, make.detections(make.EPOCH))
    replay, _ = replayed(tmp_path / 'bag')
    assert any('/doa is nav_msgs/msg/Odometry, expected av_interfaces/msg/DoaArray' in note for note in replay.notes)
    assert replay.lost
    with pytest.raises(BagError, match='/doa is nav_msgs/msg/Odometry; for detections expected vision_msgs'):
        replayed(tmp_path / 'bag', remappings={'detections': '/doa'})
    with pytest.raises(BagError, match='no topic /nowhere for doa; there are /detections, /doa'):
        replayed(tmp_path / 'bag', remappings={'doa': '/nowhere'})


def test_odometry_of_other_types_turns_the_rig(tmp_path):
    """The same turn in four types: the world azimuth of a source that stands still stays put in all of them."""
    rate, world = math.radians(20.0), 0.7

    def pose(time, yaw):
        return make.make('geometry_msgs/msg/PoseStamped', make.header(time, 'map'), make.odometry(time, yaw=yaw).pose.pose)

    def pose_with_covariance(time, yaw):
        return make.make('geometry_msgs/msg/PoseWithCovarianceStamped', make.header(time, 'map'),
                         make.odometry(time, yaw=yaw).pose)

    def imu(time, yaw):
        return make.make('sensor_msgs/msg/Imu', make.header(time), make.attitude(yaw), np.zeros(9), make.vector(z=rate),
                         np.zeros(9), make.vector(), np.zeros(9))

    def odometry_proper(time, yaw):
        return make.odometry(time, yaw=yaw, yaw_rate=rate)

    for number, odometry in enumerate((odometry_proper, pose, pose_with_covariance, imu)):
        path = tmp_path / str(number)
        with make.bag(path) as write:
            for k in range(200):
                time = make.EPOCH + 0.02 * k
                write('/robot/state', time, odometry(time, rate * 0.02 * k))
                if k % 5 == 0:
                    write('/detections', time, make.detections(time, world - rate * 0.02 * k))
                    write('/camera/camera_info', time, make.camera_info(time))
            write('/tf_static', make.EPOCH, make.static_frames(make.EPOCH))
        with Bag(path) as bag, BagWriter(tmp_path / f'{number}.mcap') as out:
            Replay(bag, ReplaySettings(remappings={'odometry': '/robot/state'})).run(out)
        with Bag(tmp_path / f'{number}.mcap') as bag:
            assert bag.topics['/odometry'].kind == make.ODOMETRY
            bearings = [bag.decode(topic, data) for topic, _, data in bag.messages(['/target/bearing'])]
        known = [b.azimuth_world for b in bearings if b.state != State.NONE][20:]
        np.testing.assert_allclose(known, world, atol=0.02)


MOUNT = Rotation.from_euler('ZYX', [90.0, 0.0, 180.0], degrees=True)    # of a sensor on the body: turned, upside down


@pytest.mark.parametrize('kind', ['imu', 'tracking camera'])
def test_odometry_of_a_sensor_is_turned_to_the_body_that_carries_it(tmp_path, kind):
    """By tf_static; a tilted body that turns is right between the poses of 4 Hz, too."""
    tilt, world = Rotation.from_euler('x', 40.0, degrees=True), 0.7

    def quaternion(rotation):
        return make.make('geometry_msgs/msg/Quaternion', *map(float, rotation.as_quat()))

    def odometry(time, body, rate):
        attitude, rates = quaternion(body * MOUNT), make.vector(*(body * MOUNT).inv().apply([0.0, 0.0, rate]))
        if kind == 'imu':
            return make.make('sensor_msgs/msg/Imu', make.header(time, 'sensor'), attitude, np.zeros(9), rates, np.zeros(9),
                             make.vector(), np.zeros(9))
        message = make.odometry(time, child='sensor')
        return replace(message, pose=replace(message.pose, pose=replace(message.pose.pose, orientation=attitude)),
                       twist=replace(message.twist, twist=make.make('geometry_msgs/msg/Twist', make.vector(), rates)))

    with make.bag(tmp_path / 'bag') as write:
        frames = make.static_frames(make.EPOCH)
        mount = make.make('geometry_msgs/msg/Transform', make.vector(), quaternion(MOUNT))
        frames.transforms.append(make.make('geometry_msgs/msg/TransformStamped', make.header(make.EPOCH), 'sensor', mount))
        write('/tf_static', make.EPOCH, frames)
        for k in range(450):
            time = make.EPOCH + 0.02 * k
            body = Rotation.from_euler('z', world + 0.4 * math.sin(0.024 * k)) * tilt
            if k % 12 == 0:
                write('/odometry', time, odometry(time, body, 0.48 * math.cos(0.024 * k)))
            if k % 5 == 0:
                x, y, z = body.inv().apply([math.cos(world), math.sin(world), 0.0])
                at = (319.5 - 457.0 * y / x, 239.5 - 457.0 * z / x)
                write('/detections', time, make.detections(time, 0.0, at=at))
                write('/camera/camera_info', time, make.camera_info(time))
    with Bag(tmp_path / 'bag') as bag, BagWriter(tmp_path / 'out.mcap') as out:
        replay = Replay(bag, ReplaySettings())
        replay.run(out)
    assert not replay.lost and not any(note.startswith('odometry') for note in replay.notes)
    with Bag(tmp_path / 'out.mcap') as bag:
        bearings = [bag.decode(topic, data) for topic, _, data in bag.messages(['/target/bearing'])]
    known = [b.azimuth_world for b in bearings if b.source & Source.SIGHT][40:]
    assert len(known) > 100
    np.testing.assert_allclose(known, world, atol=0.03)


def test_odometry_that_cannot_be_used_is_counted_and_named(tmp_path):
    """A quaternion of norm 2, and a frame of which nothing is known."""
    with make.bag(tmp_path / 'bag') as write:
        for k in range(100):
            time = make.EPOCH + 0.02 * k
            message = make.odometry(time, child='robot_base')
            if k % 4 == 0:
                message = replace(message, pose=replace(message.pose, pose=replace(
                    message.pose.pose, orientation=make.make('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 2.0))))
            write('/odometry', time, message)
            if k % 5 == 0:
                write('/doa', time, make.doa(time - 0.25, 0.5))
    replay, _ = replayed(tmp_path / 'bag')
    assert replay.lost and '25 messages of odometry: attitude of norm 2, expected 1' in replay.notes
    assert "odometry of 'robot_base': no transform from it to the body, it counts as the body's" in replay.notes


def test_a_transform_without_rotation_is_left_out_and_named(tmp_path):
    """A quaternion of zeros, as of a message that nobody filled in, is no identity: the description of the rig counts."""
    with make.bag(tmp_path / 'bag') as write:
        nowhere = make.make('geometry_msgs/msg/Transform', make.vector(), make.make('geometry_msgs/msg/Quaternion', *4 * [0.0]))
        write('/tf_static', make.EPOCH, make.make('tf2_msgs/msg/TFMessage', [make.make(
            'geometry_msgs/msg/TransformStamped', make.header(make.EPOCH, 'base_link'), 'camera_optical_frame', nowhere)]))
        for k in range(40):
            time = make.EPOCH + 0.1 * k
            write('/odometry', time, make.odometry(time))
            write('/camera/camera_info', time, make.camera_info(time))
            write('/detections', time, make.detections(time, 0.0))
    replay, log = replayed(tmp_path / 'bag')
    assert "the transform of 'camera_optical_frame' is left out: its rotation is no unit quaternion" in replay.notes
    assert replay.lost and np.abs(log.fused['azimuth'][-10:]).max() < 0.1


def test_stamps_of_another_clock_are_taken_as_the_clock(tmp_path):
    shifted = make.flight(tmp_path / 'shifted', offset=-make.EPOCH + 100.0, duration=10.0)
    plain = make.flight(tmp_path / 'plain', duration=10.0)
    _, log = replayed(shifted)
    _, expected = replayed(plain)
    assert log.fused['time'][0] == pytest.approx(100.0, abs=0.1)
    assert len(fused_errors(log)) == pytest.approx(len(fused_errors(expected)), abs=3)
    rmse, usual = (np.sqrt(np.mean(fused_errors(each) ** 2)) for each in (log, expected))
    assert rmse == pytest.approx(usual, abs=0.2) and usual < 3.0


def test_a_part_can_be_replayed(tmp_path):
    path = make.flight(tmp_path / 'bag', duration=10.0)
    _, log = replayed(path, start=4.0, duration=2.0)
    assert log.sound['time'].min() > make.EPOCH + 3.5
    assert log.fused['time'].max() <= make.EPOCH + 6.0


def test_parameters_are_those_of_the_nodes(tmp_path):
    path = make.flight(tmp_path / 'bag', duration=10.0)
    parameters = tmp_path / 'params.yaml'
    parameters.write_text('/**/fusion_node:\n  ros__parameters: {method: gated, tau: 0.95}\n')
    _, log = replayed(path, parameters=(str(parameters),))
    assert State.VISUAL_ACTIVE not in log.fused['state']
    parameters.write_text('fusion_node:\n  ros__parameters: {tau: 1.5}\n')
    with pytest.raises(ValueError, match=r"fusion_node: .*'tau' must be within bounds \[0.0, 1.0\]"):
        replayed(path, parameters=(str(parameters),))


@mock.patch('av_bags.writer.COMPRESSION', CompressionType.NONE)
def test_a_damaged_bag_gives_what_it_holds_with_a_warning(tmp_path, capsys):
    with Bag(make.flight(tmp_path / 'bag')) as bag, BagWriter(tmp_path / 'whole.mcap') as out:
        Replay(bag).run(out)
    content = (tmp_path / 'whole.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(content[:len(content) // 2])
    assert main([str(tmp_path / 'cut.mcap'), '--from', 'doa', '--quiet']) == 0
    captured = capsys.readouterr()
    assert 'coverage' in captured.out
    assert 'cut.mcap ends after byte' in captured.err


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['nowhere.mcap'], 'nowhere.mcap: no such bag'),
    (['BAG', '--remap', 'doa=/x'], "remapping 'doa=/x', expected NAME:=TOPIC"),
    (['BAG', '--remap', 'sound:=/x'], 'sound cannot be remapped, only audio/frames'),
    (['BAG', '--rig', 'nowhere.yaml'], 'nowhere.yaml'),
    (['BAG', '--params', 'nowhere.yaml'], 'nowhere.yaml'),
    (['BAG', '--start', '-1'], 'start is -1.0 s'),
    (['BAG', '--out', 'BAG'], 'exists already'),
])
def test_the_program_reports_errors(tmp_path, capsys, arguments, complaint):
    bag = make.flight(tmp_path / 'bag', duration=1.0)
    assert main([str(bag) if argument == 'BAG' else argument for argument in arguments]) == 1
    assert complaint in capsys.readouterr().err


def test_the_program_shows_progress_table_and_plot(tmp_path, capsys):
    bag = make.flight(tmp_path / 'bag')
    assert main([str(bag), '--out', str(tmp_path / 'out.mcap'), '--report', str(tmp_path / 'report')]) == 0
    captured = capsys.readouterr()
    assert re.search(r'coverage +100\.0 %', captured.out)
    assert 's left' in captured.err and 'x real time' in captured.out
    assert (tmp_path / 'report' / 'bearing.png').stat().st_size > 10_000
    assert '"fused"' in (tmp_path / 'report' / 'metrics.json').read_text()


def test_no_middleware_is_started(tmp_path):
    code = 'import sys, rclpy; from av_evaluation.cli.replay import main; sys.exit(main(sys.argv[1:]) or rclpy.ok())'
    bag = make.flight(tmp_path / 'bag', duration=1.0)
    assert subprocess.run([sys.executable, '-c', code, str(bag), '--quiet'], check=False).returncode == 0
