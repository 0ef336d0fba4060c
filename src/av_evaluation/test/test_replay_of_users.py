"""Replays of bags as they are in the field: clocks that were set, no camera, messages that cannot be read."""

from __future__ import annotations

import math
from pathlib import Path

import bag_messages as make
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer

from av_bags.reader import Bag
from av_bags.writer import BagWriter
from av_common.track import State, Track
from av_common.track_messages import bearing_message
from av_evaluation.cli.replay import main
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.evaluation import evaluate_run

FIELD_CASES = Path(__file__).resolve().parents[4] / 'shared' / 'data' / 'field_cases'


def directions(write, begin, seconds, azimuth=0.5):
    """A source at a known azimuth that is also seen, and a rig that stands."""
    for k in range(round(50 * seconds)):
        time = begin + k / 50.0
        write('/odometry', time, make.odometry(time))
        if k % 5 == 0:
            write('/doa', time, make.doa(time - 0.25, azimuth))
        if k % 4 == 0:
            write('/detections', time, make.detections(time, azimuth))


def bearings(path):
    with AnyReader([path]) as reader:
        return [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages(
            [connection for connection in reader.connections if connection.topic == '/target/bearing'])]


def test_bearings_of_another_clock_are_left_out(tmp_path, capsys):
    """As of a node that began before its clock was set: figures over 50 years take more memory than there is."""
    with BagWriter(tmp_path / 'bag.mcap') as bag:
        bag.add_topic('/target/bearing', 'av_interfaces/msg/Bearing')
        for k in range(60):
            time = make.EPOCH + 0.05 * k
            track = Track(0.05 * k if 20 <= k < 40 else time, State.ACOUSTIC_ACTIVE, azimuth=0.1, measured=time)
            bag.write('/target/bearing', round(1e9 * time), serialize_message(bearing_message(track, 'base_link')))
    assert main([str(tmp_path / 'bag.mcap'), '--quiet']) == 3
    printed = capsys.readouterr()
    assert '20 messages of target/bearing: stamp is more than 60 s off the clock' in printed.err and 'coverage' in printed.out


def test_a_start_behind_the_end_of_a_bag_is_refused(tmp_path, capsys):
    with make.bag(tmp_path / 'bag') as write:
        directions(write, make.EPOCH, 2.0)
    assert main([str(tmp_path / 'bag'), '--start', '60']) == 1
    assert 's long, start is 60 s' in capsys.readouterr().err


def test_methods_are_compared_behind_a_clock_that_was_set_as_before(tmp_path):
    """What they measured is compared with the truth of its time; one time for all is 4 s off."""
    errors = {}
    for jump in (0.0, -4.0, 3e8):
        with make.bag(tmp_path / f'{jump}') as write:
            for k in range(800):
                time, azimuth = make.EPOCH + k / 50.0 + (jump if k >= 400 else 0.0), 0.3 + 0.05 * k / 50.0
                write('/odometry', time, make.odometry(time))
                write('/truth/rig', time, make.odometry(time))
                write('/truth/target', time, make.odometry(time, 10.0 * math.cos(azimuth), 10.0 * math.sin(azimuth)))
                if k % 5 == 0 and k % 400 > 20:
                    write('/doa', time, make.doa(time - 0.25, azimuth - 0.05 * 0.25))
        with Bag(tmp_path / f'{jump}') as bag:
            result = evaluate_run('', Replay(bag, keeps_events=True).run(), ('sound', 'kalman'))
        errors[jump] = result.methods['kalman']
        assert np.abs(result.methods['sound'].error_deg).max() < 1.0
        assert np.abs(errors[jump].error_deg).max() < 3.0 and errors[jump].coverage > 0.95
        assert len(errors[jump].error_deg) == pytest.approx(len(errors[0.0].error_deg), abs=10)


@pytest.mark.parametrize('jump', [3e8, 40.0, -4.0, -86_400.0])
def test_a_replay_goes_on_behind_a_clock_that_was_set(tmp_path, capsys, jump):
    """As two bags: each part gives what it gives alone, the output is as small, and says what was left out."""
    for name, parts in (('bag', 2), ('alone', 1)):
        with make.bag(tmp_path / name) as write:
            directions(write, make.EPOCH, 8.0)
            if parts == 2:
                directions(write, make.EPOCH + 8.0 + jump, 8.0, -0.4)
    options = ['--out', str(tmp_path / 'out.mcap'), '--quiet', '--report', str(tmp_path / 'report')]
    assert main([str(tmp_path / 'bag'), *options]) == 0
    printed = capsys.readouterr()
    assert 'a new segment begins, and what lies between is left out' in printed.err
    assert '16.0 s replayed' in printed.out and (tmp_path / 'out.mcap').stat().st_size < 600_000
    found = bearings(tmp_path / 'out.mcap')
    with Bag(tmp_path / 'alone') as bag, BagWriter(tmp_path / 'alone.mcap') as out:
        Replay(bag).run(out)
    alone = bearings(tmp_path / 'alone.mcap')
    with Bag(tmp_path / 'out.mcap') as bag:
        stamps = [time_ns for topic, time_ns, _ in bag.messages() if topic == '/target/bearing']
        assert len(bag.segments) == 2 and np.argmax(np.abs(np.diff(stamps))) == len(alone) - 1
    second = found[len(alone):] if jump > 0.0 else None
    if second:    # AnyReader gives them in order of time
        np.testing.assert_array_equal([one.azimuth for one in found[:len(alone)]], [one.azimuth for one in alone])
        assert second[-1].azimuth == pytest.approx(-0.4, abs=0.05) and len(second) == pytest.approx(len(alone), abs=3)


def test_the_output_of_a_clock_that_was_set_replays_alike(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        directions(write, make.EPOCH, 6.0)
        directions(write, make.EPOCH + 2.5, 6.0, -0.4)
    logs = []
    for source, name in (('bag', 'out.mcap'), ('out.mcap', 'again.mcap')):
        with Bag(tmp_path / source) as bag, BagWriter(tmp_path / name) as out:
            logs.append(Replay(bag, ReplaySettings(stage='doa')).run(out))
    np.testing.assert_array_equal(logs[0].fused['azimuth'], logs[1].fused['azimuth'])
    assert np.degrees(logs[0].fused['azimuth'][[150, -1]]) == pytest.approx(np.degrees([0.5, -0.4]), abs=3.0)
    assert np.diff(logs[0].fused['time']).max() < 1.0


def test_a_recording_without_a_camera_is_replayed_from_raw(tmp_path, capsys):
    """The recorder had announced the camera's topics, and nothing came."""
    with Writer(tmp_path / 'bag', version=9) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=make.TYPES) for name, kind in (
            ('/camera/camera_info', 'sensor_msgs/msg/CameraInfo'), ('/detections', 'vision_msgs/msg/Detection2DArray'),
            ('/audio/frames', 'av_interfaces/msg/AudioFrame'), ('/tf_static', 'tf2_msgs/msg/TFMessage'))}
        for frame in make.audio_frames(make.EPOCH, make.sound_of(0.6, 4.0)):
            time_ns = round((frame.header.stamp.sec + 1e-9 * frame.header.stamp.nanosec) * 1e9)
            writer.write(topics['/audio/frames'], time_ns, make.cdr(frame))
    assert main([str(tmp_path / 'bag'), '--from', 'raw', '--quiet', '--out', str(tmp_path / 'out.mcap')]) == 0
    assert '/camera/camera_info holds no messages' in capsys.readouterr().err
    assert len(bearings(tmp_path / 'out.mcap')) > 50


def test_what_was_dropped_is_said_with_its_count_and_by_the_exit_code(tmp_path, capsys):
    with make.bag(tmp_path / 'bag') as write:
        directions(write, make.EPOCH, 3.0)
        for k in range(7):
            write('/doa', make.EPOCH + 0.4 * k + 0.01, make.doa(make.EPOCH + 1e6, 0.5))
    assert main([str(tmp_path / 'bag'), '--quiet']) == 3
    assert '7 messages of doa left out: their stamps' in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'like'), [('bags/split_overlap', 'bags/ref'), ('bags/two_recorders', 'bags/ref'),
                                            ('schemas/empty_odometry.mcap', 'schemas/good.mcap'),
                                            ('schemas/schema_crlf.mcap', 'schemas/good.mcap')])
def test_the_bags_of_the_field(tmp_path, name, like):
    if not FIELD_CASES.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    for source, out in ((name, 'a.mcap'), (like, 'b.mcap')):
        assert main([str(FIELD_CASES / source), '--from', 'doa', '--quiet', '--out', str(tmp_path / out)]) == 0
    assert (tmp_path / 'a.mcap').read_bytes() == (tmp_path / 'b.mcap').read_bytes()


def test_the_clock_of_the_field(tmp_path, capsys):
    if not FIELD_CASES.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    path = FIELD_CASES / 'clock_set' / 'jump_from_1970'
    assert main([str(path), '--from', 'doa', '--quiet', '--out', str(tmp_path / 'out.mcap')]) == 0
    assert 'the clock goes on 20717.6 days later' in capsys.readouterr().err
    assert (tmp_path / 'out.mcap').stat().st_size < 100_000


@pytest.mark.parametrize('ahead', [0.4, 1.5])
def test_a_recorder_whose_clock_is_behind_loses_nothing(tmp_path, ahead):
    """On another computer than the rig: nothing is recorded before it was stamped."""
    logs = {}
    for offset in (0.0, ahead):
        with Bag(make.flight(tmp_path / f'{offset}', duration=4.0, offset=offset)) as bag:
            replay = Replay(bag)
            logs[offset] = replay.run()
            assert not replay.lost and not replay.notes
    assert len(logs[ahead].fused['azimuth']) == pytest.approx(len(logs[0.0].fused['azimuth']), abs=5) != 0


@pytest.mark.parametrize('taken', [True, False])
def test_recorded_cues_count_where_the_rig_took_them(tmp_path, taken):
    """Another rig sees the target behind; the sound of a pair alone does not tell the side."""
    behind = math.radians(140.0)
    with make.bag(tmp_path / 'bag') as write:
        for k in range(250):
            time = make.EPOCH + k / 50.0
            write('/odometry', time, make.odometry(time))
            if k % 5 == 0:
                write('/doa', time, make.doa(time - 0.25, behind))
            if k % 10 == 0 and k > 150:
                point = make.make('geometry_msgs/msg/Point', 60.0 * math.cos(behind), 60.0 * math.sin(behind), 10.0)
                write('/target/cue', time, make.make('geometry_msgs/msg/PointStamped', make.header(time, 'rig/world'), point))
    parameters = tmp_path / 'parameters.yaml'
    parameters.write_text(f'/**/fusion_node:\n  ros__parameters:\n    use_cues: {str(taken).lower()}\n')
    with Bag(tmp_path / 'bag') as bag:
        log = Replay(bag, ReplaySettings(parameters=(str(parameters),))).run()
    assert bool(log.fused['resolved'][-1]) is taken and not log.fused['resolved'][:50].any()
    assert not taken or math.cos(log.fused['azimuth'][-1] - behind) > 0.99
