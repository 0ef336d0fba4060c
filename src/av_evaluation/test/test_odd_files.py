"""Every reader of files, given what is no such file: one line that names it, soon, and with little memory."""

from __future__ import annotations

import os
import re
import resource
import struct
import time
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import soundfile

from av_audio.cli.calibrate import read_truth
from av_audio.ego_noise import NoiseRecording
from av_audio.file_source import FileSource, read_sound
from av_bags.reader import Bag
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import node_parameters
from av_common.rig import load_rig
from av_simulator import load_scenario
from av_simulator.sound.source import load_profile
from av_simulator.sound.source_signals import RecordedSignal
from av_vision.nodes.camera_node import load_calibration
from av_vision.sources.capture import SourceError
from av_vision.sources.files import Recording
from av_vision.yolo.detector import Detector

SECONDS = 2.0       # of this process, so that the load of the machine does not count
MEGABYTES = 200.0
YAML = {
    'scenario': load_scenario,
    'rig': load_rig,
    'drone': load_profile,
    'array': MicrophoneArray.load,
    'camera': load_calibration,
    'parameters': lambda path: node_parameters('av_fusion', 'fusion_node', [path]),
}
SOUND = {
    'sound': read_sound,
    'played sound': FileSource,
    'ego-noise': NoiseRecording.load,
    'recorded signal': lambda path: RecordedSignal(path).stream(48_000, (1,), None),
}
OTHERS = {
    'model': Detector,
    'video': lambda path: list(Recording(path).frames()),
    'bag': Bag,
    'azimuths': read_truth,
}
ENDINGS = dict.fromkeys(YAML, '.yaml') | dict.fromkeys(SOUND, '.wav') | {
    'model': '.onnx', 'video': '.mp4', 'bag': '.mcap', 'azimuths': '.csv'}
READERS = YAML | SOUND | OTHERS


def refused(read, path):
    """The reason for which a file is refused: one line that names it, soon, without much memory."""
    began, held = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises((ValueError, OSError, SourceError)) as error:
        read(path)
    assert time.process_time() - began < SECONDS
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held) / 1024 < MEGABYTES
    text = str(error.value)
    assert str(path) in text
    assert '\n' not in text
    assert len(text) < 400 + 2 * len(str(path)), text
    return text


def missing(path):
    """Create nothing."""


def sparse(path):
    with path.open('wb') as file:
        file.truncate(10**9)


def unreadable_name(path):
    path.symlink_to(path)


def device(path):
    path.symlink_to('/dev/zero')


ODD = {
    'missing': missing,
    'folder': Path.mkdir,
    'empty': Path.touch,
    'pipe': os.mkfifo,
    'device': device,
    'loop': unreadable_name,
    'a gigabyte of zeros': sparse,
    'noise': lambda path: path.write_bytes(np.random.default_rng(1).bytes(100_000)),
    'text': lambda path: path.write_text('what is this?\n' * 1000),
    'page': lambda path: path.write_text('<!DOCTYPE html><html><body>404</body></html>'),
    'picture': lambda path: path.write_bytes(b'\x89PNG\r\n\x1a\n' + bytes(1000)),
    'archive': lambda path: zipfile.ZipFile(path, 'w').writestr('a', bytes(1000)),
}


@pytest.mark.parametrize('odd', ODD)
@pytest.mark.parametrize('reader', READERS)
def test_what_is_no_such_file_is_refused(tmp_path, reader, odd):
    if (reader, odd) == ('parameters', 'empty'):
        pytest.skip('an empty file sets no parameters')
    path = tmp_path / f'odd{ENDINGS[reader]}'
    ODD[odd](path)
    refused(READERS[reader], path)


BOMB = 'a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 10)}]\n' for k in range(1, 12))
ODD_YAML = {
    'deep list': '[' * 3000 + ']' * 3000,
    'deep mapping': ''.join(f'{" " * k}a:\n' for k in range(1000)),
    'deep and open': '{a: ' * 100_000,
    'bomb': BOMB,
    'recursive': 'a: &a [*a]\n',
    'merged bomb': BOMB + '<<: *a0\n',
    'unknown alias': 'name: *nothing\n',
    'many values': f'name: [{"1, " * 300_000}]\n',
    'huge integer': f'name: {"9" * 400}\n',
    'larger integer': f'name: {"9" * 5000}\n',
    'hexadecimal': f'name: 0x{"f" * 100_000}\n',
    'sexagesimal': f'name: {"1:" * 100_000}1\n',
    'long text': f'name: [{"x" * 900_000}]\n',
    'long key': f'{"x" * 900_000}: 1\n',
    'no date': 'name: 2001-13-45\n',
    'list as key': '? [a, b]\n: 1\n',
    'python object': 'name: !!python/object/apply:os.system ["true"]\n',
    'binary': 'name: !!binary "####"\n',
    'number': '4\n',
    'null': '~\n',
    'list': '- a\n- b\n',
    'two documents': 'a: 1\n---\na: 2\n',
    'tabs': 'a:\n\t- b\n',
    'control characters': 'a: \x01\n',
    'zero byte': 'a: "\\0"\n',
    'unknown key': 'nonsense: 1\n',
    'not UTF-8': 'name: \xff\xfe\n',
}


@pytest.mark.parametrize('odd', ODD_YAML)
@pytest.mark.parametrize('reader', YAML)
def test_odd_yaml_is_refused(tmp_path, reader, odd):
    content = ODD_YAML[odd]
    if reader == 'parameters':
        if odd == 'null':
            pytest.skip('an empty file sets no parameters')
        content = re.sub(r'^name: (.{,10000})\n$', r'/**: {ros__parameters: {tau: \1}}\n', content, flags=re.DOTALL)
    path = tmp_path / 'odd.yaml'
    path.write_bytes(content.encode('latin-1'))
    refused(YAML[reader], path)


def save_model(path, nodes, shape=(1, 3, 'h', 'w'), kind='FLOAT', metadata=(), side=10**6):
    """An ONNX file with an input x of a shape, an output y, and an integer constant s = (1, side, side)."""
    onnx = pytest.importorskip('onnx')
    tensor, number = onnx.helper.make_tensor_value_info, getattr(onnx.TensorProto, kind)
    size = onnx.helper.make_tensor('s', onnx.TensorProto.INT64, [3], [1, side, side])
    graph = onnx.helper.make_graph([onnx.helper.make_node(*node[:3], **node[3]) for node in nodes], 'odd',
                                   [tensor('x', number, shape)], [tensor('y', number, None)], [size])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid('', 17)], ir_version=8)
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.save(model, path)


MEAN = ('ReduceMean', ['x'], ['r'], {'keepdims': 0})
SMALL = [MEAN, ('Expand', ['r', 's'], ['y'], {})]
FOLDED = [MEAN, ('ConstantOfShape', ['s'], ['c'], {}), ('Add', ['c', 'r'], ['y'], {})]
ODD_MODELS = {
    'output of 4 TB': partial(save_model, nodes=SMALL),
    'output of 10 GB': partial(save_model, nodes=SMALL, side=50_000),
    'constant of 4 TB': partial(save_model, nodes=FOLDED),
    'constant of 10 GB': partial(save_model, nodes=FOLDED, side=50_000),
    'output 3 x 3': partial(save_model, nodes=SMALL, side=3),
    'image of a million pixels a side': partial(save_model, nodes=SMALL, shape=(1, 3, 10**6, 10**6), side=3),
    'image of no pixels': partial(save_model, nodes=SMALL, shape=(1, 3, 0, 0), side=3),
    'images of integers': partial(save_model, nodes=SMALL, kind='INT64', side=3),
    'no image': partial(save_model, nodes=SMALL, shape=(), side=3),
    'unknown size': partial(save_model, nodes=SMALL, side=3, metadata={'imgsz': 'large'}),
    'huge size': partial(save_model, nodes=SMALL, side=3, metadata={'imgsz': '[32000000, 32000000]'}),
    'deep metadata': partial(save_model, nodes=SMALL, side=3, metadata={'imgsz': '[' * 100_000}),
    'no threshold': partial(save_model, nodes=SMALL, side=3, metadata={'score_threshold': 'high'}),
    'threshold nan': partial(save_model, nodes=SMALL, side=3, metadata={'score_threshold': 'nan'}),
}


@pytest.mark.parametrize('odd', ODD_MODELS)
def test_odd_models_are_refused(tmp_path, odd):
    ODD_MODELS[odd](tmp_path / 'odd.onnx')
    refused(Detector, tmp_path / 'odd.onnx')


def header(rate=48_000, channels=2, bits=16, form=1, size=2**31):
    """The beginning of a WAV file."""
    frame = channels * bits // 8 % 2**16
    return struct.pack('<4sI4s4sIHHIIHH4sI', b'RIFF', 36 + size & 0xffffffff, b'WAVE', b'fmt ', 16, form, channels, rate,
                       rate * frame % 2**32, frame, bits, b'data', size & 0xffffffff)


ODD_SOUNDS = {
    'rate 2^32-1': header(rate=2**32 - 1),
    'rate 0': header(rate=0),
    'rate 1': header(rate=1),
    '65535 channels': header(channels=65_535),
    'no channels': header(channels=0),
    '257 bits': header(bits=257),
    'unknown format': header(form=4321),
    'cut': header()[:30],
}


@pytest.mark.parametrize('odd', ODD_SOUNDS)
@pytest.mark.parametrize('reader', SOUND)
def test_odd_sounds_are_refused(tmp_path, reader, odd):
    path = tmp_path / 'odd.wav'
    path.write_bytes(ODD_SOUNDS[odd] + bytes(10_000))
    refused(SOUND[reader], path)


@pytest.mark.parametrize('reader', ['sound', 'ego-noise'])
def test_a_sound_too_long_to_be_read_as_a_whole_is_refused(tmp_path, monkeypatch, reader):
    monkeypatch.setattr('av_audio.file_source.MOST_SAMPLES', 100_000)
    path = tmp_path / 'long.flac'
    soundfile.write(path, np.zeros((96_000, 2), np.int16), 48_000)
    refused(SOUND[reader], path)


def test_a_length_that_only_the_header_states_takes_no_memory(tmp_path):
    """What is there is read, where blocks are; a signal that is read as a whole is refused."""
    path = tmp_path / 'long.flac'
    soundfile.write(path, np.zeros((1000, 2), np.int16), 48_000)
    with path.open('r+b') as file:
        file.seek(22)       # the lower 32 bits of the number of frames in a FLAC header
        file.write(b'\xff\xff\xff\xff')
    assert len(SOUND['sound'](path)[0]) == 1000
    refused(SOUND['recorded signal'], path)
