"""Pages do not rot: their commands can be typed, and the short ones of the tutorials do what the pages say."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from bag_messages import flight

PROJECT = Path(__file__).parents[1]
TUTORIALS = sorted(PROJECT.glob('docs/tutorials/*.md'))


def tool(name):
    """A program of tools/lint as a module."""
    specification = importlib.util.spec_from_file_location(f'lint_{name}', PROJECT / 'tools' / 'lint' / f'{name}.py')
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize('command', [
    'ros2 run av_audio lokalize x.wav', 'ros2 launch av_fusion rig.launch.py scenaro:=circle', 'make frob',
    'ros2 launch av_fusion rigg.launch.py', 'ros2 launch av_fusion rig.launch.py scenario:=nowhere',
    'ros2 run av_audio doa_node --ros-args -p metod:=phat',
    'ros2 run av_evaluation evaluate circle --sedes 3', 'ros2 run av_audio localize "x.wav'])
def test_a_command_that_cannot_be_typed_is_found(command):
    assert list(tool('commands').faults_of(command))


def test_a_parameter_that_no_node_has_is_found():
    faults_of_yaml = tool('commands').faults_of_yaml
    block = '/**/detector_node:\n  ros__parameters:\n    {}: 1\n'
    assert list(faults_of_yaml(block.format('modell'))) and not list(faults_of_yaml(block.format('regions')))


def test_long_sentences_are_found_and_others_are_not():
    sentences = tool('sentences')
    long, short = ' '.join(['word'] * 41), ' '.join(['word'] * 39)
    text = (f'# Title\n\n{short}. {short}.\n\n- {short}\n- {short}\n\n```bash\n{long}\n```\n\n| {long} |\n|---|\n\n'
            f'Then {long}.\n')
    found = [line for line, sentence in sentences.sentences(text) if sentences.words(sentence) > sentences.MOST]
    assert found == [15]


def run(command, folder):
    """A command of a page, as typed there."""
    done = subprocess.run(['bash', '-c', command], cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, 'MPLBACKEND': 'agg'})
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout


def typed(page, pattern):
    """The one command of a tutorial that a pattern describes."""
    found = [command for command in tool('commands').commands(PROJECT / 'docs/tutorials' / page) if re.search(pattern, command)]
    assert len(found) == 1, found
    return found[0]


def test_an_array_is_checked_as_the_tutorial_says(tmp_path):
    page = (PROJECT / 'docs/tutorials/microphones_and_camera.md').read_text()
    (tmp_path / 'my_pair.yaml').write_text(re.search(r'```yaml\n(name: my_pair\n.*?)```', page, re.DOTALL)[1])
    noise = np.random.default_rng(1).standard_normal(48_000 * 2)
    lag = round(0.2 * np.sin(np.radians(30.0)) / 343.0 * 48_000)  # the left microphone hears it first
    soundfile.write(tmp_path / 'recording.wav', 0.1 * np.stack([noise, np.roll(noise, lag)], axis=1), 48_000)
    table = run(typed('microphones_and_camera.md', 'localize recording.wav'), tmp_path)
    azimuths = [float(value) for value in re.findall(r'-?\d+\.\d', table)]
    assert any(abs(azimuth - 30.0) < 3.0 for azimuth in azimuths)


def test_a_recording_is_replayed_as_the_tutorial_says(tmp_path):
    (tmp_path / 'results').mkdir()
    flight(tmp_path / 'results' / 'flight.mcap', duration=3.0)
    assert 'coverage' in run(typed('own_recording.md', 'replay results/flight.mcap --report'), tmp_path)
    assert (tmp_path / 'results' / 'flight').exists()


def test_a_recording_of_the_rig_alone_is_rated_as_the_tutorial_says(tmp_path):
    """Four rotors near a square of microphones, whose noise is that of four places; then a flight with it."""
    rate, random = 16_000, np.random.default_rng(4)
    square = 0.05 * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    (tmp_path / 'my_array.yaml').write_text(f'name: my_array\nmicrophones: {square.tolist()}\n')
    omega = 2.0 * np.pi * np.fft.rfftfreq(12 * rate, 1.0 / rate)
    sound = 1e-3 * random.standard_normal((12 * rate, 4))
    for rotor in 6.0 * square + [0.0, 0.0, 0.05]:
        distance = np.linalg.norm(square - rotor, axis=1)
        spectrum = np.fft.rfft(random.standard_normal(12 * rate))[:, None] * np.exp(-1j * omega[:, None] * distance / 343.0)
        sound += 0.02 * np.fft.irfft(spectrum, 12 * rate, axis=0) / distance
    for name, samples in (('alone', sound), ('flight', sound[:2 * rate])):
        soundfile.write(tmp_path / f'{name}.wav', samples, rate)
    verdict = run(typed('on_a_drone.md', 'record_ego_noise alone.wav .*--judge'), tmp_path)
    assert re.fullmatch(r'the recording buys \d+ dB: targets are heard under own noise .*', verdict.strip())
    assert len(run(typed('on_a_drone.md', 'localize flight.wav'), tmp_path).splitlines()) > 15


def test_launch_files_show_the_arguments_of_the_tutorials():
    """What is launched is declared by the launch files themselves, not only by the text that lint reads."""
    lines = [shlex.split(command, comments=True) for page in TUTORIALS for command in tool('commands').commands(page)]
    wanted = {(words[3], one.partition(':=')[0]) for words in lines if words[:2] == ['ros2', 'launch'] and len(words) > 3
              for one in words[4:] if ':=' in one}
    for file in {file for file, _ in wanted}:
        shown = run(f'ros2 launch av_fusion {file} -s', PROJECT)
        assert {name for other, name in wanted if other == file} <= set(re.findall(r"'(\w+)'", shown))
