"""Simulator to decoders: one event must have one time in sound, image and truth.

Where time matters it is the test's own: it passes while the simulator sleeps, and nothing depends on the machine's speed.
"""

import contextlib
import dataclasses
import math
import multiprocessing
import os
import signal
import socket
import threading
import time

import cv2
import numpy as np
import pytest
from network_hosts import OTHER, RIG, STRANGER, two_hosts
from scipy.spatial.transform import Rotation
from udp_ports import free_ports

from av_audio.ring_buffer import RingBuffer
from av_common.launched import BEAT_PERIOD_S, RUN_FOLDER, started_file
from av_common.rig import load_rig
from av_sim_bridge.receiving.common_clock import CommonClock
from av_sim_bridge.receiving.receiver import Receiver, open_port
from av_sim_bridge.receiving.streams import AudioStream, ImageStream
from av_sim_bridge.vehicle import VehicleState, from_truth, to_truth
from av_sim_bridge.wire.audio import AudioFormat, decode_header
from av_sim_bridge.wire.gimbal import decode_gimbal
from av_sim_bridge.wire.image import decode_fragment
from av_sim_bridge.wire.oracle import decode_oracle, is_oracle
from av_sim_bridge.wire.rig_control import RigControl, encode_rig_control
from av_sim_bridge.wire.time_sync import decode_time_sync
from av_sim_bridge.wire.truth import decode_truth, encode_truth
from av_simulator import Line, Scenario, Simulator, Static, Target, Weather, WireOptions, World, find_config, open_world
from av_simulator.rendering import render_process
from av_simulator.rendering.scenes import Field, Woodland
from av_simulator.sound import FormulaSignal, Noise

pytestmark = pytest.mark.system

CLICK = 2.0       # s, when the drone clicks
DURATION = 4.0


def click(times):
    return 2.0 * np.exp(-((times - CLICK) / 2e-4) ** 2)


SCENARIO = Scenario(
    name='event', duration=DURATION, scene=Woodland(trees=0), noise=Noise(self_noise_db_spl=10.0), weather=Weather(),
    targets=(Target(Line((10.0, -8.0, 2.6), (0.0, 4.0, 0.0)), signal=FormulaSignal(click)),))


class Decoders:
    """The bridge without ROS: keeps all that comes out of the streams."""

    def __init__(self, layout=AudioFormat()):  # noqa: B008 (frozen)
        self.clock = CommonClock()
        self.layout, self.ring = layout, RingBuffer(layout.channels, 4_000_000, layout.dtype)
        self.audio, self.times = AudioStream(layout, self.clock), {}
        self.images, self.boxes, self.states, self.depths, self.gimbal = [], [], [], [], []
        self.image_stream, self.depth_stream = ImageStream(self.clock), ImageStream(self.clock, 'image depth')

    def take_audio(self, *datagram):
        for block, moment in self.audio.take(*datagram):
            self.times[block.first_sample] = moment
            self.ring.write(block.samples, block.first_sample)

    def stamp(self, sample):
        """ROS time in s of a sample that was received."""
        first = max(begin for begin in self.times if begin <= sample)
        return self.times[first] + (sample - first) / self.layout.sample_rate

    def take_image(self, *datagram):
        result = self.image_stream.take(*datagram)
        if result is not None:
            (self.boxes if isinstance(result[0], list) else self.images).append(result)

    def take_depth(self, *datagram):
        self.depths.extend(filter(None, [self.depth_stream.take(*datagram)]))

    def take_truth(self, datagram, arrival, sender):
        truth = decode_truth(datagram)
        stamp = self.clock.date_state(f'truth {truth.copter_id}', sender, truth.time, arrival)
        self.states.append((truth.copter_id, from_truth(truth), stamp))


class Listener(Decoders):
    """Decoders behind UDP ports and their threads."""

    def __init__(self, ports, layout=AudioFormat()):  # noqa: B008 (frozen)
        super().__init__(layout)
        handlers = {'audio': self.take_audio, 'image': self.take_image, 'rig_truth': self.take_truth,
                    'target_truth': self.take_truth}
        self.receivers = {name: Receiver(name, open_port(name, getattr(ports, name), 4 << 20), handle)
                          for name, handle in handlers.items()}

    def stop(self):
        for receiver in self.receivers.values():
            receiver.stop()


class SleptTime:
    """A clock whose time passes by sleeping alone."""

    def __init__(self):
        self.slept = 0.0

    def monotonic(self):
        return self.slept

    def time(self):
        return 1_700_000_000.0 + self.slept

    def sleep(self, seconds):
        self.slept += max(seconds, 1e-6)


class SlowTime:
    """A clock at a fifth of the speed, so that images are rendered in time."""

    def monotonic(self):
        return 0.2 * time.monotonic()

    def time(self):
        return 0.2 * time.time()

    def sleep(self, seconds):
        time.sleep(5.0 * seconds)


def run(options, scenario=SCENARIO, at=None, rig='rig'):
    """A run of a simulator whose datagrams take 0.2 ms to the decoders; at(s) is called before each of them."""
    decoders, clock, ports = Decoders(), SleptTime(), options.ports
    handlers = {ports.audio: decoders.take_audio, ports.image: decoders.take_image, ports.depth: decoders.take_depth,
                ports.rig_truth: decoders.take_truth, ports.target_truth: decoders.take_truth,
                ports.gimbal: lambda datagram, *_: decoders.gimbal.append(decode_gimbal(datagram))}

    def send(datagram, address):
        if at is not None:
            at(clock.slept)
        if address[1] in handlers:
            handlers[address[1]](datagram, clock.time() + 2e-4, ('127.0.0.1', 50_000))

    simulator = Simulator(World(scenario, load_rig(find_config(rig))), options, clock, send)
    simulator.run(scenario.duration)
    simulator.close()
    return simulator, decoders


def wait_for_rest(listener):
    """Until nothing has come for half a second: what was sent may still be on its way."""
    received, since = -1, time.monotonic()
    while time.monotonic() - since < 0.5:
        if (now := sum(receiver.meter.count + receiver.failed for receiver in listener.receivers.values())) != received:
            received, since = now, time.monotonic()
        time.sleep(0.05)


@pytest.fixture(scope='module', params=[False, True], ids=['as RFlySim', 'with audio header'])
def streams(request):
    return run(WireOptions(ports=free_ports(), audio_header=request.param))


def test_everything_sent_is_received(streams):
    simulator, listener = streams
    assert simulator.counts['unsent'] == simulator.counts['late_blocks'] == simulator.counts['images_skipped'] == 0
    assert listener.ring.available == simulator.counts['audio_frames'] == DURATION * 48_000
    assert len(listener.images) == len(listener.boxes) == simulator.counts['images']
    assert len(listener.states) == 2 * DURATION * 100


def test_sound_and_truth_agree_within_5_ms(streams):
    _, listener = streams
    first, samples = listener.ring.read()
    heard = first + int(np.argmax(np.abs(samples[:, 0].astype(float))))
    target = [state for number, state, _ in listener.states if number == 2]
    stamps = np.array([stamp for number, _, stamp in listener.states if number == 2])
    emitted = int(np.argmin([abs(state.time - CLICK) for state in target]))
    rig = load_rig(find_config('rig'))
    microphone = rig.array.positions[0] + [0.0, 0.0, 1.5]
    flight = np.linalg.norm(target[emitted].position - microphone) / (331.3 * np.sqrt(1 + 15 / 273.15))
    assert listener.stamp(heard) - flight == pytest.approx(stamps[emitted], abs=5e-3)


def test_image_and_truth_agree_within_5_ms(streams):
    _, listener = streams
    stamps = np.array([stamp for number, _, stamp in listener.states if number == 2])
    positions = np.array([state.position for number, state, _ in listener.states if number == 2])
    rig = load_rig(find_config('rig'))
    errors = []
    for image, stamp in listener.images:
        grey = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_GRAYSCALE)
        _rows, columns = np.nonzero(grey[:290] < 70)    # the drone is the only dark thing above the ground
        if len(columns) < 50 or columns.min() < 2 or columns.max() > 637:
            continue
        seen = (columns.min() + columns.max()) / 2
        world = positions - [0.0, 0.0, 1.5] - rig.camera.mount.position
        pixels = rig.camera.model.project(world @ rig.camera.optical_to_body)[:, 0]
        in_view = np.abs(pixels - 320) < 330
        order = np.argsort(pixels[in_view])
        passed = np.interp(seen, pixels[in_view][order], stamps[in_view][order])
        errors.append(stamp - passed)
    assert len(errors) >= 10
    assert np.abs(np.median(errors)) < 5e-3
    assert np.percentile(np.abs(errors), 90) < 8e-3    # half a pixel is 4 ms here


def truths(begin, started, slow=0.0, until=9.0, stopped=0.0):
    """Wall time and place of the target in each datagram of a simulator that is started so many seconds (s) after `begin`.

    Also the simulator, and the headers of its sound.
    """
    clock, sent, options = SleptTime(), [], WireOptions(ports=free_ports(), image_rate=0.0, audio_header=True)
    headers = []
    clock.slept += started

    class Slow(World):
        def advance(self, samples):
            clock.sleep(0.002 + slow * (7.0 < clock.slept < 7.02))
            self.dynamics.step(self.time, (self._samples + samples) / self.sample_rate)
            self._samples += samples
            return np.zeros((samples, 2))

    def send(datagram, address):
        clock.sleep(stopped * (7.0 < clock.slept < 7.02))
        if address[1] == options.ports.target_truth:
            sent.append((clock.slept, *decode_truth(datagram).position_ned))
        elif address[1] == options.ports.audio:
            headers.append(decode_header(AudioFormat(), datagram))

    scenario = dataclasses.replace(SCENARIO, targets=[Target(Line([0.0, 30.0, 5.0], [4.0, 0.0, 0.0]))])
    simulator = Simulator(Slow(scenario, load_rig(find_config('rig'))), options, clock, send)
    simulator.run(until, begin + 1_700_000_000.0)
    simulator.close()
    return np.array(sent), simulator, headers


@pytest.mark.parametrize('started, slow, stopped', [(0.2, 0.0, 0.0), (5.0, 0.0, 0.0), (0.2, 1.6, 0.0), (0.2, 0.0, 1.6)])
def test_who_begins_late_or_falls_behind_is_in_the_same_world(started, slow, stopped):
    """Both say at any time where the target is then: one that begins 3 s late, or stands still for 1.6 s, at work or between.

    What was due while it stood still is sent later: the rest of one step.
    """
    first, *_ = truths(2.0, 0.0)
    second, simulator, headers = truths(2.0, started, slow, stopped=stopped)
    expected = np.interp(second[:, 0], first[:, 0], first[:, 2])
    assert np.ptp(expected) > 10.0 and np.sum(np.abs(second[:, 2] - expected) > 4.0 * 0.15) <= 4 * bool(stopped)
    assert abs(second[-1, 0] - first[-1, 0]) < 0.05
    assert second[0, 0] < max(started, 2.0) + 1.0 and not simulator.counts['resynchronised']
    # What was left out is missing in the numbers of the sound, too.
    assert max(abs((header.time - headers[0].time) - (header.sequence - headers[0].sequence) / 30) for header in headers) < 0.02


def test_a_world_is_joined_an_hour_after_its_beginning():
    """It is at once at the present simulated time: the target flies east at 4 m/s."""
    sent, *_ = truths(2.0, 3602.0, until=3603.0)
    assert sent[0, 0] < 3603.0 and np.abs(sent[:, 2] - 4.0 * (sent[:, 0] - 2.0)).max() < 4.0 * 0.15


def test_what_follows_a_skip_sounds_as_if_nothing_had_been_skipped():
    """From 20 ms after it on: a drone with turning rotors above ground."""
    whole, skipped = (open_world('circle') for _ in range(2))
    expected = np.concatenate([whole.advance(1600) for _ in range(90)])
    skipped.advance(1600)
    skipped.skip(59 * 1600 / 48_000)
    assert skipped.time == pytest.approx(2.0)
    sound = np.concatenate([skipped.advance(1600) for _ in range(30)])
    assert np.abs(sound - expected[60 * 1600:])[1024:].max() < 1e-3 * np.abs(expected).max()


def test_a_camera_process_that_stands_still_ends_the_simulator(monkeypatch):
    monkeypatch.setattr(render_process, 'HUNG', 1.0)
    options = WireOptions(ports=free_ports(), renderer='flat')

    def stop_the_camera(datagram, address):
        if address[1] == options.ports.image:
            for process in multiprocessing.active_children():
                os.kill(process.pid, signal.SIGSTOP)

    monkeypatch.setattr(render_process, 'LAST', math.inf)    # no time is waited for its end: else this test does not end
    simulator = Simulator(World(SCENARIO, load_rig(find_config('rig'))), options, send=stop_the_camera)
    with pytest.raises(TimeoutError, match='no image within 1 s'):
        simulator.run(20.0)
    simulator.close()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize('waiting', [0, 1, 2])
def test_a_camera_process_that_is_killed_is_named(waiting):
    """Whether it waits for a view, renders one, or has another one waiting."""
    world = World(SCENARIO, load_rig(find_config('rig')))
    camera = render_process.RenderProcess(world.renderer_factory(), 'flat', world.view(0, 0.0))
    camera.open(lambda: True)
    process, = multiprocessing.active_children()
    os.kill(process.pid, signal.SIGSTOP)
    for number in range(waiting):
        assert camera.request(world.view(number, 0.0))
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with pytest.raises(RuntimeError, match='camera: its process ended with exit code -9'):
        _ = camera.ready(10.0) if waiting else camera.request(world.view(0, 0.0))
    assert camera.close() == []


def test_unix_time_is_told_after_the_schedule_was_shifted():
    """On a machine that stood still for 1.6 s: what is sent as the time of sending, and as that of the clock's zero."""
    clock, synced, options = SleptTime(), [], WireOptions(ports=free_ports(), image_rate=0.0)

    def send(datagram, address):
        if address[1] == options.ports.time_sync:
            synced.append((clock.time(), decode_time_sync(datagram)))
        if address[1] == options.ports.audio and 1.5 < clock.slept < 1.55:
            clock.slept += 1.6

    simulator = Simulator(World(SCENARIO, load_rig(find_config('rig'))), options, clock, send)
    simulator.run(4.0)
    simulator.close()
    assert simulator.counts['resynchronised'] == 1 and len(synced) == 4
    assert max(abs(now - 1e-3 * sync.now_ms) for now, sync in synced) < 0.01
    assert [sync.now_ms - sync.start_ms for _, sync in synced] == [1000, 2000, 3000, 4000]


@pytest.mark.parametrize('begin', [None, 1_700_000_003.0])
def test_the_heartbeat_is_that_of_the_simulation(tmp_path, monkeypatch, begin):
    """It goes on from step to step, and while others who share the world are awaited; busy while renderers open and close."""
    monkeypatch.setenv(RUN_FOLDER, str(tmp_path))
    file, beats = started_file(tmp_path, os.getpid()), []

    class Watched(SleptTime):
        def sleep(self, seconds):
            super().sleep(seconds)
            if file.exists():
                beats.append((self.slept, file.read_text()))
                file.unlink()

    simulator = Simulator(World(SCENARIO, load_rig(find_config('rig'))), WireOptions(ports=free_ports(), image_rate=0.0),
                          Watched(), lambda *_: None)
    simulator.run(2.0, begin)
    simulator.close()
    times, texts = zip(*beats, strict=True)
    assert all(map(float, texts)) and file.read_text().startswith('busy')
    assert times[0] < 0.2 and times[-1] > simulator._clock.slept - 2 * BEAT_PERIOD_S
    assert np.abs(np.diff(times) - BEAT_PERIOD_S).max() < 0.15


def test_the_oracle_reports_each_image_once_with_its_stamp(streams):
    _, listener = streams
    assert [stamp for _, stamp in listener.boxes] == [stamp for _, stamp in listener.images]
    seen = [len(boxes) for boxes, _ in listener.boxes]
    assert 0 in seen and 1 in seen      # it flies into view and out of it


def the_bridge_at(options):
    """A socket at the port of the rig's true state, by which the simulator knows the bridge."""
    bridge = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bridge.bind(('127.0.0.1', options.ports.rig_truth))
    return bridge


def test_a_command_turns_the_rig_and_ceases_to_after_half_a_second():
    options = WireOptions(ports=free_ports(), image_rate=0.0)
    control = the_bridge_at(options)
    commanded = []

    def command(now):
        if len(commanded) < 20 and now >= 0.1 * len(commanded):
            commanded.append(now)
            control.sendto(encode_rig_control(RigControl(len(commanded), 1, yaw_rate=np.deg2rad(30.0))),
                           ('127.0.0.1', options.ports.control))
            control.sendto(bytes(8 if len(commanded) % 2 else 168), ('127.0.0.1', options.ports.control))    # no rate, no pose

    simulator, listener = run(options, at=command)
    control.close()
    rig = [(state.time, state.rate_flu[2]) for number, state, _ in listener.states if number == 1]
    rates = np.rad2deg([rate for _, rate in rig])
    assert rates.max() == pytest.approx(30.0, abs=0.1)
    assert rates[-1] == 0.0
    assert np.abs(np.diff(rates)).max() <= 120.0 * 0.01 + 0.1      # acceleration limit at 100 states a second
    assert simulator.counts['commands'] == simulator.counts['malformed_commands'] == 20


def test_a_command_turns_the_gimbal_and_the_images_with_it():
    """Its reports follow to what was commanded, and it holds that; the drone that it looks at comes into the oracle's boxes."""
    options = WireOptions(ports=free_ports(), renderer='flat')
    beside = dataclasses.replace(SCENARIO, duration=3.0, targets=(Target(Static((0.5, -8.0, 2.6))),))
    control, looked = the_bridge_at(options), np.deg2rad([-85.0, 8.0])

    def command(now):
        if now < 2.0:
            look = encode_rig_control(RigControl(1, 1, pan=looked[0], tilt=looked[1]))
            control.sendto(look, ('127.0.0.1', options.ports.control))

    _, listener = run(options, beside, command, 'rig_gimbal')
    control.close()
    sight = np.array([Rotation.from_quat(sample.orientation_wxyz[[1, 2, 3, 0]]).apply([1.0, 0.0, 0.0])
                      for sample in listener.gimbal])
    pan, tilt = np.arctan2(sight[:, 1], sight[:, 0]), np.arcsin(sight[:, 2])
    times = np.array([sample.time for sample in listener.gimbal])
    assert len(times) == 300 and np.ptp(np.diff(times)) < 1e-6
    np.testing.assert_allclose(np.stack([pan, tilt])[:, times > 1.2].mean(axis=1), looked, atol=2e-3)
    assert np.abs(pan[1:] - pan[:-1]).max() < np.deg2rad(120.0 * 0.01 + 1.0)
    seen = [bool(boxes) for boxes, _ in listener.boxes]
    assert not any(seen[:3]) and all(seen[-15:])


def test_a_rig_without_a_gimbal_sends_no_orientation():
    _, listener = run(WireOptions(ports=free_ports(), image_rate=0.0), dataclasses.replace(SCENARIO, duration=0.5))
    assert not listener.gimbal and listener.states


def test_an_autopilot_moves_the_rig():
    """A state of the rig on the control port, as PX4 or RFlySim have it, takes it there."""
    options = WireOptions(ports=free_ports(), renderer='flat')
    control = the_bridge_at(options)
    given = VehicleState(0.0, np.array([2.0, 3.0, 4.0]),
                         attitude_wxyz=np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0]))
    datagram = encode_truth(to_truth(given, 1))
    _, listener = run(options, dataclasses.replace(SCENARIO, duration=1.0),
                      at=lambda now: control.sendto(datagram, ('127.0.0.1', options.ports.control)))
    control.close()
    state = [state for number, state, _ in listener.states if number == 1][-1]
    np.testing.assert_allclose(state.position, given.position, atol=1e-5)
    np.testing.assert_allclose(state.rotation, given.rotation, atol=1e-5)


def test_commands_and_poses_that_come_late_or_again_and_those_of_other_vehicles_move_nothing():
    simulator = Simulator(open_world(SCENARIO), WireOptions(ports=free_ports(), image_rate=0.0), send=lambda *_: None)
    dynamics, counts, port = simulator.world.dynamics, simulator.counts, simulator.options.ports.control

    def sent(*datagrams):
        for datagram in datagrams:
            control.sendto(datagram, ('127.0.0.1', port))
        simulator._take_commands()
        simulator.world.advance(1600)
        return counts['commands'], counts['old_commands'], counts['malformed_commands']

    def turn(number, rate):
        return encode_rig_control(RigControl(number, 1, yaw_rate=rate))

    def pose(time, x, vehicle=1):
        return encode_truth(to_truth(VehicleState(time, np.array([x, 0.0, 2.0])), vehicle))

    with contextlib.closing(simulator), contextlib.closing(the_bridge_at(simulator.options)) as control:
        assert sent(turn(7, 0.5), turn(9, 0.0), turn(8, 0.5), turn(7, 0.5)) == (2, 2, 0)
        assert dynamics.motion.state(simulator.world.time).rate_flu[2] == 0.0
        assert sent(pose(5.0, 1.0), pose(4.99, 0.0), pose(5.0, 9.0, vehicle=2)) == (3, 3, 1)
        assert dynamics.motion.state(simulator.world.time).position[0] == pytest.approx(1.0)
        for _ in range(7):
            sent()
        assert sent(turn(1, 0.5), pose(0.0, 2.0)) == (5, 3, 1)    # of a bridge, and of an autopilot, that begin anew


@pytest.mark.parametrize(('allowed', 'obeyed'), [((), 0), (('127.0.0.1',), 20)])
def test_commands_of_another_program_are_refused_unless_it_is_allowed(allowed, obeyed):
    """Neither rates nor poses of a sender on the same machine that does not have the bridge's port."""
    options = WireOptions(ports=free_ports(), image_rate=0.0, allowed_senders=allowed)
    pose = encode_truth(to_truth(VehicleState(0.0, np.array([2.0, 3.0, 4.0])), 1))
    commanded = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        def command(now):
            if len(commanded) < 10 and now >= 0.1 * len(commanded):
                commanded.append(now)
                for datagram in (encode_rig_control(RigControl(len(commanded), 1, yaw_rate=0.5)), pose):
                    stranger.sendto(datagram, ('127.0.0.1', options.ports.control))

        simulator, listener = run(options, dataclasses.replace(SCENARIO, duration=2.0), at=command)
    assert (simulator.counts['commands'], simulator.counts['refused_commands']) == (obeyed, 20 - obeyed)
    states = [state for number, state, _ in listener.states if number == 1]
    moved = np.linalg.norm(states[-1].position - states[0].position) + np.abs(states[-1].rotation - states[0].rotation).max()
    assert (moved > 0.1) == bool(obeyed)


def test_only_the_bridges_host_steers_a_simulator_on_another_one():
    """The simulator is opened at the address by which it reaches the bridge; a third host and a fourth program are refused."""
    with two_hosts() as (rig, other):
        options = WireOptions(host=OTHER, ports=free_ports(), image_rate=0.0)
        simulator = rig.run(Simulator, World(SCENARIO, load_rig(find_config('rig'))), options, SleptTime(), lambda *_: None)
        assert simulator._control._socket.getsockname() == (RIG, options.ports.control)
        for address, port in ((STRANGER, options.ports.rig_truth), (OTHER, 0), (OTHER, options.ports.rig_truth)):
            source = other.run(socket.socket, socket.AF_INET, socket.SOCK_DGRAM)
            source.bind((address, port))
            for _ in range(3):
                source.sendto(encode_rig_control(RigControl(1, 1, yaw_rate=0.5)), (RIG, options.ports.control))
        simulator.run(0.2)
        simulator.close()
    assert (simulator.counts['commands'], simulator.counts['refused_commands']) == (3, 6)
    assert simulator._control.refusals.counts() == {OTHER: 3, STRANGER: 3}


def test_a_flood_on_the_control_port_does_not_stop_the_simulation():
    options, flooding = WireOptions(ports=free_ports(), image_rate=0.0), True

    def flood():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
            while flooding:
                source.sendto(bytes(32), ('127.0.0.1', options.ports.control))

    thread = threading.Thread(target=flood)
    thread.start()
    simulator, _ = run(options, dataclasses.replace(SCENARIO, duration=1.0))
    flooding = False
    thread.join()
    assert simulator.world.time == 1.0 and simulator.counts['refused_commands'] > 0


@pytest.mark.parametrize(('options', 'complaint'), [
    ({'bind_address': '0.0.0.0'}, 'bind_address is 0.0.0.0, which other machines reach, but allowed_senders is 127.0.0.1:'),
    ({'bind_address': '127.0.0.1', 'host': '192.0.2.77'}, 'bind_address 127.0.0.1 receives from this machine only'),
    ({'allowed_senders': ('somebody',)}, "allowed_senders has 'somebody'"),
    ({'host': 'no.such.host.invalid'}, "host is 'no.such.host.invalid'")])
def test_addresses_that_cannot_be_are_refused(options, complaint):
    with pytest.raises(ValueError, match=complaint):
        Simulator(World(SCENARIO, load_rig(find_config('rig'))), WireOptions(ports=free_ports(), **options))


def test_garbage_on_every_port_is_counted_and_harms_nothing():
    """Over real sockets; what a slow machine sends too late to be dated is refused, and counted."""
    options = WireOptions(ports=free_ports(), audio_header=True)
    random, scenario = np.random.default_rng(1), dataclasses.replace(SCENARIO, duration=2.0)
    listener = Listener(options.ports)
    simulator = Simulator(World(scenario, load_rig(find_config('rig'))), options)
    thread = threading.Thread(target=simulator.run, args=(scenario.duration,))
    thread.start()
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    while thread.is_alive() and listener.ring.available == 0:    # sound could not be told from garbage that came first
        thread.join(0.01)
    while thread.is_alive():    # its senders keep their streams; who sends a second after they ended would get them
        for port in dataclasses.astuple(options.ports):
            source.sendto(random.bytes(int(60_000 ** random.random())), ('127.0.0.1', port))
        thread.join(0.02)
    source.close()
    wait_for_rest(listener)
    simulator.close()
    listener.stop()
    late = {name.removesuffix(' undated'): count for name, count in listener.clock.counts.items() if name.endswith(' undated')}
    assert min(receiver.foreign.total + receiver.failed for receiver in listener.receivers.values()) > 20
    assert listener.ring.available == simulator.counts['audio_frames']
    assert len(listener.images) <= simulator.counts['images'] <= len(listener.images) + late['image']
    assert len(listener.states) + sum(count for name, count in late.items() if name.startswith('truth')) == 400


def test_depth_of_the_same_instant_goes_to_the_next_port():
    """A drone 8 m ahead is 8 m away there, where it is in the image, and nothing else is."""
    scenario = dataclasses.replace(SCENARIO, targets=(Target(Static((8.0, 0.0, 1.5))),), scene=Field(), duration=0.5)
    simulator, listener = run(WireOptions(ports=free_ports(), image_rate=4.0, depth=True, renderer='scene'), scenario)
    world, depths = simulator.world, listener.depths
    assert [image.time for image, _ in depths] == [image.time for image, _ in listener.images] == [0.25, 0.5]
    assert [stamp for _, stamp in depths] == [stamp for _, stamp in listener.images]
    depth = cv2.imdecode(np.frombuffer(depths[0][0].data, np.uint8), cv2.IMREAD_UNCHANGED)
    view = world.view(0, 0.5)
    (x, y), = world.rig.camera.model.project(view.to_optical(np.array([[8.0, 0.0, 1.5]])))
    assert depth.dtype == np.uint16 and depth.shape == (480, 640)
    assert depth[round(y), round(x)] == pytest.approx(8000.0 - 1000.0 * world.rig.camera.mount.position[0], abs=250.0)
    assert depth[5].min() == 65_535    # the sky


def test_a_second_camera_sees_the_same_instants_from_its_own_place():
    """One drone before a visible and a thermal camera: boxes of both, in pixels of each, at the next port but one."""
    scenario = dataclasses.replace(SCENARIO, targets=(Target(Static((8.0, 1.0, 2.5))),), scene=Field(), duration=0.5)
    ports, rig = free_ports(), load_rig(find_config('rig_two_cameras'))
    sent = {ports.image: [], ports.second_image: []}
    simulator = Simulator(World(scenario, rig), WireOptions(ports=ports, image_rate=4.0, renderer='scene'), SlowTime(),
                          send=lambda datagram, to: sent.get(to[1], []).append(datagram))
    simulator.run(0.5)
    simulator.close()
    for (camera, mount), datagrams in zip(rig.cameras.items(), sent.values(), strict=True):
        parts = [decode_fragment(one) for one in datagrams if not is_oracle(one)]
        first = b''.join(one.payload for one in parts if one.time == parts[0].time)
        pixels = cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_UNCHANGED)
        assert {one.time for one in parts} <= {0.25, 0.5}
        assert (pixels.dtype, pixels.shape[:2]) == ((np.uint8, (480, 640)) if camera == 'camera' else (np.uint16, (256, 320)))
        (box,), *_ = [decode_oracle(one) for one in datagrams if is_oracle(one)]
        view = simulator.world.view(0, 0.5, camera)
        (x, y), = mount.model.project(view.to_optical(np.array([[8.0, 1.0, 2.5]])))
        assert box.min_x - 2 < x < box.max_x + 2 and box.min_y - 2 < y < box.max_y + 2


def test_a_renderer_without_depth_says_so():
    world = World(SCENARIO, load_rig(find_config('rig')))
    simulator = Simulator(world, WireOptions(ports=free_ports(), depth=True, renderer='flat'))
    with pytest.raises(RuntimeError, match='depth requires the renderer'):
        simulator.run(0.5)
    simulator.close()
