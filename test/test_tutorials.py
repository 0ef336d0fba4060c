"""The tutorials, walked: each command of a page is run here, with stand-ins for microphones and in less time."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import soundfile
import yaml
from bag_messages import EPOCH, bag, doa, flight, odometry
from machine_load import skip_figures_where_overloaded
from rig_process import RigProcess
from tutorials import PROJECT, STAND_INS, block, commands, found, run, typed, words
from udp_ports import free_offset

from av_bags.reader import Bag
from av_bringup.launching import launched_nodes
from av_common.launched import RUN_FOLDER
from av_vision.methods import DETECTORS

# Whose pages are walked in whole; what is not run, and why.
PAGES = ('first_run.md', 'microphones_and_camera.md', 'own_recording.md', 'own_method.md', 'on_a_drone.md')
NOT_RUN = {r'^make demo DEMO="duration:=300"': 'the first demo, for longer',
           r'^pip install': 'installs into the environment; test_own_method.py installs elsewhere',
           r'^ros2 run av_view setup': 'asks; src/av_view/test/test_setup.py answers',
           r'^ros2 run av_view doctor': 'needs devices; src/av_view/test/test_doctor.py'}


def test_every_command_of_these_tutorials_is_run():
    """By a test that takes it from its page."""
    texts = [file.read_text() for file in Path(__file__).parent.glob('test_*.py')]
    patterns = {found for text in texts for found in re.findall(r"typed\('([\w.]+)', r?'(.+?)'\)", text)}
    left = [f'{page}: {command}' for page in PAGES for command in commands(page)
            if not any(re.search(pattern, command) for other, pattern in patterns if other == page)
            and not any(re.search(pattern, command) for pattern in NOT_RUN)]
    assert not left


def planned(launch_file, command):
    """Names of the nodes that a launch of a page would start in the current folder, after all checks of its arguments."""
    given = dict(word.split(':=', 1) for word in words(command) if ':=' in word)
    values = {name: default or '' for name, (default, _, _) in launch_file.ARGUMENTS.items()}
    assert set(given) <= set(values)
    return {node.full_name for node in launched_nodes(launch_file.start({**values, RUN_FOLDER: str(Path.cwd()), **given}))}


@pytest.mark.system
def test_the_first_run(tmp_path):
    """The demo with its result, recorded as the next tutorial says, and what a second shell shows of it; then the recording."""
    demo = words(typed('first_run.md', 'out:=results/demo'))
    recorded = words(typed('own_recording.md', 'record:=results/flight'))[4:]
    arguments = [word for word in (*demo, *recorded) if not word.startswith('duration:=')]
    rig = RigProcess(*(word.replace('results/', f'{tmp_path}/results/') for word in arguments), 'duration:=30',
                     f'port_offset:={free_offset()}')
    rig.wait_for(r'deg \+-')
    domain = {'ROS_DOMAIN_ID': str(rig.domain)}
    assert 'azimuth_variance' in found(typed('first_run.md', 'echo /target/bearing') + ' --once', tmp_path, **domain)
    assert 'reason' in found(typed('first_run.md', 'echo /fusion/state') + ' --once', tmp_path, **domain)
    assert 'Score of a detection' in found(typed('first_run.md', 'param describe'), tmp_path, **domain)
    assert rig.finish() == 0, rig.output
    assert not rig.leftovers()
    tracked = re.findall(r'deg \+- .*', rig.output)
    assert sum('| truth' in line for line in tracked) > 0.8 * len(tracked), rig.output
    assert (tmp_path / 'results/demo/bearing.png').stat().st_size > 20_000
    skip_figures_where_overloaded()    # without gaps on any machine: test_offline_run.py
    assert rig.value('coverage') > 90.0, rig.output
    assert rig.value('median') < 3.0, rig.output
    assert rig.value('resolved in') < 10.0, rig.output
    assert json.loads((tmp_path / 'results/demo/metrics.json').read_text())['fused']['coverage'] > 0.9
    (tmp_path / 'other.yaml').write_text('/**/fusion_node: {ros__parameters: {tau: 0.6}}\n')
    assert 'coverage' in run(typed('own_recording.md', '--from doa --params other.yaml'), tmp_path)


def test_other_scenarios(launch_file, tmp_path, monkeypatch):
    assert 'scenario' in run(typed('first_run.md', 'rig.launch.py -s'), PROJECT)
    monkeypatch.chdir(tmp_path)
    assert '/fusion_node' in planned(launch_file, typed('first_run.md', 'scenario:=behind_in_fog'))
    names = re.findall(r'`(\w+)`', ''.join(re.findall(r'^\| (`.*?) \|', (PROJECT / 'docs/tutorials/first_run.md').read_text(),
                                                      re.MULTILINE)))
    assert len(names) > 8 and all((PROJECT / f'config/scenarios/{name}.yaml').exists() for name in names)


def test_a_recording_is_replayed_and_compared(launch_file, replay_file, tmp_path, monkeypatch):
    flight(tmp_path / 'results' / 'flight.mcap', duration=3.0)
    assert 'coverage' in run(typed('own_recording.md', 'replay results/flight.mcap --report'), tmp_path)
    assert (tmp_path / 'results' / 'flight').exists()
    run(typed('own_recording.md', '--methods fused gated kalman'), tmp_path)
    assert {'fused', 'gated', 'kalman'} <= set(json.loads((tmp_path / 'results/compared/metrics.json').read_text()))
    with bag(tmp_path / 'their.mcap') as write:
        for k in range(30):
            write('/robot/odom', EPOCH + 0.1 * k, odometry(EPOCH + 0.1 * k))
            write('/doa', EPOCH + 0.1 * k, doa(EPOCH + 0.1 * k - 0.25, 0.4))
    assert 'coverage' in run(typed('own_recording.md', 'replay their.mcap'), tmp_path)
    monkeypatch.chdir(tmp_path)
    assert '/player_node' in planned(replay_file, typed('own_recording.md', 'only:=raw rate:=2'))
    soundfile.write('drone.wav', np.zeros((4800, 2)), 48_000)
    video = cv2.VideoWriter('drone.mp4', cv2.VideoWriter.fourcc(*'mp4v'), 15.0, (64, 48))
    video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    assert '/camera_node' in planned(launch_file, typed('own_recording.md', 'source:=file'))


def test_a_method_is_named_as_the_rig_accepts_it(launch_file, tmp_path, monkeypatch):
    """What the page compares, and installs, is in test_own_method.py."""
    monkeypatch.chdir(PROJECT)
    assert '/doa_node' in planned(launch_file, typed('own_method.md', 'rig.launch.py .*own_method/params.yaml'))
    monkeypatch.setitem(DETECTORS._places, 'dark_specks', 'own_method:dark_specks')  # as if it were installed
    assert '/detector_node' in planned(launch_file, typed('own_method.md', 'rig.launch.py .*model:=dark_specks'))


@pytest.fixture
def hardware(tmp_path, monkeypatch):
    """Stand-ins for a sound card and for ALSA's recorder; returns what makes them play samples."""
    monkeypatch.setenv('STAND_IN_SOUND', str(tmp_path / 'heard.wav'))
    monkeypatch.setenv('PYTHONPATH', f'{STAND_INS}{os.pathsep}{os.environ["PYTHONPATH"]}')
    monkeypatch.setenv('PATH', f'{STAND_INS}{os.pathsep}{os.environ["PATH"]}')
    return lambda samples, rate: soundfile.write(tmp_path / 'heard.wav', samples, rate)


@pytest.mark.system
def test_microphones_and_camera(hardware, tmp_path):
    """The files of the page, a source 30 degrees to the left; there is no camera, which the rig says and survives."""
    (tmp_path / 'my_pair.yaml').write_text(block('microphones_and_camera.md', 'name: my_pair'))
    (tmp_path / 'my_params.yaml').write_text(block('microphones_and_camera.md', '# my_params.yaml'))
    rig = yaml.safe_load((PROJECT / 'config/rig.yaml').read_text())
    rig['array']['file'] = 'my_pair.yaml'
    (tmp_path / 'my_rig.yaml').write_text(yaml.safe_dump(rig))
    noise = 0.1 * np.random.default_rng(1).standard_normal(20 * 48_000)
    lag = round(0.2 * np.sin(np.radians(30.0)) / 343.0 * 48_000)  # the left microphone hears it first
    hardware(np.stack([noise, np.roll(noise, lag)], axis=1), 48_000)
    run(typed('microphones_and_camera.md', 'arecord -D'), tmp_path)
    azimuths = re.findall(r'-?\d+\.\d', run(typed('microphones_and_camera.md', 'localize recording.wav'), tmp_path))
    assert any(abs(float(azimuth) - 30.0) < 3.0 for azimuth in azimuths)
    assert 'USB' in run('python3 -m sounddevice', tmp_path)
    launch = words(typed('microphones_and_camera.md', 'source:=hardware'))[4:]
    arguments = [re.sub(r'(?<=:=)(?=my_|first)', f'{tmp_path}/', word) for word in launch]
    launched = RigProcess(*arguments)
    domain = {'ROS_DOMAIN_ID': str(launched.domain)}
    launched.wait_for('no images')
    assert 'level' in found(typed('microphones_and_camera.md', 'echo /diagnostics') + ' --once', tmp_path, **domain)
    enable = typed('microphones_and_camera.md', 'service call /pointing_node/enable')
    assert 'success=True' in found(enable, tmp_path, **domain)
    launched.interrupt()
    launched.finish(60.0)
    assert not launched.leftovers()
    with Bag(tmp_path / 'first.mcap') as recording:
        heard = [recording.decode(topic, data) for topic, _, data in recording.messages(['/doa'])]
    nearest = [min(abs(np.degrees(one.azimuth) - 30.0) for one in each.hypotheses) for each in heard if each.hypotheses]
    assert len(nearest) > 10 and np.median(nearest) < 2.0


def test_the_rig_alone_is_recorded_and_rated(hardware, tmp_path):
    """Four rotors near a square of microphones, whose noise is that of four places; then a flight with it."""
    rate, random = 48_000, np.random.default_rng(4)
    square = 0.05 * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    (tmp_path / 'my_array.yaml').write_text(f'name: my_array\nmicrophones: {square.tolist()}\n')
    omega = 2.0 * np.pi * np.fft.rfftfreq(12 * rate, 1.0 / rate)
    sound = 1e-3 * random.standard_normal((12 * rate, 4))
    for rotor in 6.0 * square + [0.0, 0.0, 0.05]:
        distance = np.linalg.norm(square - rotor, axis=1)
        spectrum = np.fft.rfft(random.standard_normal(12 * rate))[:, None] * np.exp(-1j * omega[:, None] * distance / 343.0)
        sound += 0.02 * np.fft.irfft(spectrum, 12 * rate, axis=0) / distance
    hardware(sound, rate)
    soundfile.write(tmp_path / 'flight.wav', sound[:2 * rate], rate)
    for command, seconds in ((typed('on_a_drone.md', '--throttle'), 1), (typed('on_a_drone.md', 'while it hovers'), 4)):
        run(f'{command.partition("#")[0]} --dwell {seconds}', tmp_path, typed_in='\n' * 4)
    soundfile.write(tmp_path / 'alone.wav', sound, rate)
    verdict = run(typed('on_a_drone.md', 'record_ego_noise alone.wav .*--judge'), tmp_path)
    assert re.fullmatch(r'the recording buys \d+ dB: targets are heard under own noise .*', verdict.strip())
    assert len(run(typed('on_a_drone.md', 'localize flight.wav'), tmp_path).splitlines()) > 15
