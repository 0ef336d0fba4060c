"""Simulations as files: complete, true to the geometry, and the same each time."""

import csv
import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import soundfile

from av_common.rig import load_rig
from av_simulator import Circle, RigMotion, World, find_config, load_scenario, open_world, steps
from av_simulator.cli import simulate, simulator
from av_simulator.offline.files import FileRecorder


def turning_world(description='rig', seed=None):
    scenario = load_scenario(find_config('circle', 'scenarios'))
    rig = RigMotion(trajectory=Circle((1.0, 2.0, 1.5), radius=2.0, period=20.0), yaw_deg=10.0, yaw_rate_deg=20.0)
    return open_world(dataclasses.replace(scenario, rig=rig), description, seed)


def rendered(world, duration=0.4):
    taken = list(steps(world, duration, image_rate=10.0, renderer='flat'))
    return np.concatenate([step.sound for step in taken]), [image.bgr for step in taken for _, image in step.images]


def test_same_scenario_and_seed_give_the_same_bytes():
    (sound, images), (again, images_again) = rendered(turning_world()), rendered(turning_world())
    assert sound.tobytes() == again.tobytes()
    assert [image.tobytes() for image in images] == [image.tobytes() for image in images_again]
    other, _ = rendered(turning_world(seed=99))
    assert sound.tobytes() != other.tobytes()


def test_bearings_follow_from_poses():
    for step in steps(turning_world(), 1.0, image_rate=0.0, truth_rate=10.0):
        for sample in step.truth:
            yaw = np.deg2rad(10.0 + 20.0 * sample.time)
            offset = sample.targets[0].position - sample.rig.position
            expected = np.arctan2(offset[1], offset[0]) - yaw
            assert np.angle(np.exp(1j * (sample.bearings[0].azimuth - expected))) == pytest.approx(0.0, abs=1e-9)
            assert sample.bearings[0].distance == pytest.approx(np.linalg.norm(offset))


def test_commands_turn_the_rig_between_steps():
    world = turning_world()
    for step in steps(world, 2.0, image_rate=0.0):
        world.dynamics.command(np.deg2rad(-30.0), step.end)
    assert step.truth[-1].rig.rate_flu[2] == pytest.approx(np.deg2rad(-30.0))


def test_files_are_complete(tmp_path):
    world = turning_world()
    recorder = FileRecorder(tmp_path, world, image_rate=10.0, everything=True)
    for step in steps(world, 1.0, 10.0, renderer='flat'):
        recorder.write(step)
    recorder.close()
    wav = (tmp_path / 'sound.wav').read_bytes()
    peak = wav.find(b'PEAK')    # libsndfile dates this chunk, and the same run would give other bytes
    assert peak < 0 or wav[peak + 12:peak + 16] == bytes(4)
    sound, rate = soundfile.read(tmp_path / 'sound.wav')
    assert (rate, sound.shape) == (48_000, (48_000, 2))
    video = cv2.VideoCapture(str(tmp_path / 'video.mp4'))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 10
    truth = list(csv.DictReader((tmp_path / 'truth.csv').open()))
    boxes = list(csv.DictReader((tmp_path / 'boxes.csv').open()))
    assert (len(truth), len(boxes)) == (100, 10)
    assert float(truth[-1]['time']) == 1.0
    assert float(truth[-1]['rig_yaw']) == pytest.approx(np.deg2rad(30.0), abs=1e-5)
    assert len(list((tmp_path / 'frames').glob('*_rgb.png'))) == 10


@pytest.mark.parametrize('palette', ['white_hot', 'raw'])
def test_a_thermal_camera_has_a_video_and_pictures_of_its_counts(tmp_path, palette):
    rig = load_rig(find_config('rig_thermal'))
    rig = dataclasses.replace(rig, camera=dataclasses.replace(rig.camera, palette=palette))
    world = World(load_scenario(find_config('circle', 'scenarios')), rig)
    recorder = FileRecorder(tmp_path, world, image_rate=10.0, everything=True)
    pictures = []
    for step in steps(world, 0.4, 10.0, renderer='scene'):
        recorder.write(step)
        pictures += [image.bgr for _, image in step.images]
    recorder.close()
    assert cv2.VideoCapture(str(tmp_path / 'video.mp4')).get(cv2.CAP_PROP_FRAME_COUNT) == 4
    read = cv2.imread(str(tmp_path / 'frames' / '000001_rgb.png'), cv2.IMREAD_UNCHANGED)
    assert read.dtype == pictures[0].dtype == (np.uint16 if palette == 'raw' else np.uint8)
    np.testing.assert_array_equal(read, pictures[0])


def test_the_sound_in_the_file_comes_from_where_the_truth_says():
    """Broadband delay between both channels against d sin(azimuth) / c."""
    scenario = load_scenario(find_config('circle', 'scenarios'))
    scenario = dataclasses.replace(scenario, noise=dataclasses.replace(scenario.noise, snr=None))
    taken = list(steps(open_world(scenario), 1.0, image_rate=0.0))
    sound = np.concatenate([step.sound for step in taken])[24_000:]
    truth = taken[22].truth[0].bearings[0]
    spectrum = np.fft.rfft(sound, 2 * len(sound), axis=0)
    correlation = np.fft.irfft(spectrum[:, 1] * spectrum[:, 0].conj(), 64 * len(sound))[:64 * 40]
    late = np.argmax(correlation) / (32 * 48_000)
    speed = 331.3 * np.sqrt(1 + 15 / 273.15)
    assert late == pytest.approx(0.2 * np.sin(truth.azimuth) * np.cos(truth.elevation) / speed, abs=10e-6)


@pytest.mark.parametrize(('arguments', 'message'), [
    (['nowhere', '--out', 'x'], 'nowhere'),
    (['circle', '--out', 'x', '--drone-recording', 'none.wav'], 'none.wav'),
    (['circle', '--out', 'x', '--rig', 'none.yaml'], 'none.yaml'),
])
def test_errors_are_named(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert simulate.main(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(('program', 'arguments'), [
    (simulate, '--duration -1'), (simulate, '--image-rate -3'), (simulate, '--seed 1.5'), (simulator, '--image-rate -1'),
    (simulator, '--image-rate none'), (simulator, '--port-offset 60000'),
    (simulator, '--begin nan'), (simulator, '--begin inf'), (simulator, '--at nan 0 1 90')])
def test_impossible_arguments_are_named_with_their_value(program, arguments, capsys):
    option, *values = arguments.split()
    with pytest.raises(SystemExit, match='2'):
        program.parse(['circle', *(['--out', 'x'] if program is simulate else []), option, *values])
    assert f"argument {option}: '{values[0]}', expected a" in capsys.readouterr().err


def test_a_drone_beyond_what_the_lens_model_describes_is_in_no_picture(tmp_path):
    """The curve of k1 = -0.19 turns back 53 deg off the axis; the drone is at 66 deg."""
    rig = find_config('rig').read_text().replace('[-0.08, 0.02, 0.0005, -0.0003, 0.0]', '[-0.19, 0.0, 0.0, 0.0, 0.0]')
    (tmp_path / 'rig.yaml').write_text(rig.replace('arrays/', f'{find_config("rig").parent}/arrays/'))
    (tmp_path / 'over.yaml').write_text('{name: over, targets: [{trajectory: {kind: static, position: [2, 0, 9]}}]}')
    assert simulate.main([str(tmp_path / 'over.yaml'), '--rig', str(tmp_path / 'rig.yaml'), '--out', str(tmp_path / 'out'),
                          '--duration', '0.1']) == 0
    row, = csv.DictReader((tmp_path / 'out' / 'boxes.csv').open())
    assert (row['min_x'], float(row['visible_fraction']), float(row['score'])) == ('', 0.0, 0.0)


@pytest.mark.parametrize('renderer', ['scene', 'flat'])
def test_a_lens_that_does_not_fill_the_picture_is_named(renderer):
    """With k1 = -0.35 nothing is farther than 0.65 focal lengths from the middle; the corners are 0.87."""
    rig = load_rig(find_config('rig'))
    rig = dataclasses.replace(rig, camera=dataclasses.replace(rig.camera, distortion=(-0.35, 0.0, 0.0, 0.0)))
    world = World(load_scenario(find_config('circle', 'scenarios')), rig)
    with pytest.raises(ValueError, match='-0.35.* does not fill 640 x 480 pixels'):
        next(steps(world, 0.1, renderer=renderer))


def test_what_was_simulated_is_simulated_again_in_its_folder(tmp_path):
    arguments = ['--out', str(tmp_path), '--duration', '0.1', '--image-rate', '0']
    assert simulate.main(['circle', *arguments]) == 0
    sound = (tmp_path / 'sound.wav').read_bytes()
    assert simulate.main([str(tmp_path / 'scenario.yaml'), *arguments]) == 0
    assert (tmp_path / 'sound.wav').read_bytes() == sound


@pytest.mark.parametrize('images', [[], ['--image-rate', '0']])
def test_a_folder_whose_name_is_not_utf8_is_refused(tmp_path, capsys, images):
    assert simulate.main(['circle', '--out', str(tmp_path / '\udcff'), '--duration', '0.1', *images]) == 2
    assert 'is not UTF-8' in capsys.readouterr().err


def test_a_folder_that_looks_like_a_protocol_has_a_video_and_pictures_that_cannot_be_written_are_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = turning_world()
    recorder = FileRecorder(Path('a:b'), world, image_rate=10.0, everything=True)
    Path('a:b/frames').rmdir()
    with pytest.raises(FileNotFoundError, match='_rgb.png'):
        for step in steps(world, 0.2, 10.0, renderer='flat'):
            recorder.write(step)
    recorder.close()
    assert Path('a:b/video.mp4').stat().st_size > 1000


def test_a_run_that_would_write_into_a_bag_changes_no_file(tmp_path, capsys):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    pytest.importorskip('av_interfaces.msg', reason='needs the built workspace')
    arguments = ['circle', '--out', str(tmp_path), '--duration', '0.1', '--image-rate', '0', '--bag']
    assert simulate.main(arguments) == 0
    before = {file: file.read_bytes() for file in tmp_path.rglob('*') if file.is_file()}
    assert simulate.main([*arguments, '--seed', '9']) == 2
    assert 'bag exists already' in capsys.readouterr().err
    assert before == {file: file.read_bytes() for file in tmp_path.rglob('*') if file.is_file()}


@pytest.mark.parametrize('rig', ['rig', 'rig_gimbal'])
def test_bags_hold_the_topics_of_the_rig(tmp_path, rig):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    pytest.importorskip('av_interfaces.msg', reason='needs the built workspace')
    from rosbags.highlevel import AnyReader

    from av_simulator.offline.bag import EPOCH, BagRecorder
    world = turning_world(rig)
    recorder = BagRecorder(tmp_path / 'bag', world)
    for step in steps(world, 1.0, 10.0, renderer='flat'):
        recorder.write(step)
    recorder.close()
    with AnyReader([tmp_path / 'bag']) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        audio = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages(
            [each for each in reader.connections if each.topic == '/audio/frames'])]
    gimbal = {'/gimbal/state': 100} if rig == 'rig_gimbal' else {}
    assert counts == gimbal | {'/audio/frames': 30, '/camera/image_raw': 10, '/camera/camera_info': 10, '/detections': 10,
                      '/odometry': 100, '/truth/rig': 100, '/truth/target': 100, '/tf_static': 1}
    assert [message.first_sample for message in audio] == list(range(0, 48_000, 1600))
    assert audio[3].header.stamp.sec == int(EPOCH)
    assert audio[3].header.stamp.nanosec == pytest.approx(1e8, abs=500)
