"""The benchmark's own evaluation of SRP-DNN: layers by other libraries, features and steering by geometry."""

from __future__ import annotations

import io
import pickle
import struct
from zipfile import ZipFile

import numpy as np
import pytest
from scipy.signal import correlate2d

from av_evaluation.hearing.srp_dnn import FRAMES, FREQUENCIES, RATE, SrpDnn, pair_features
from av_evaluation.hearing.torch_weights import read_weights

C = 343.0


def storage_pickle(arrays):
    """A pickle of protocol 2 with tensors as PyTorch writes them, made of its opcodes."""
    def text(value):
        return b'X' + struct.pack('<I', len(value)) + value.encode()

    def number(value):
        return b'J' + struct.pack('<i', value)

    def numbers(values):
        return b'(' + b''.join(number(value) for value in values) + b't'

    out = b'\x80\x02}(' + text('model') + b'ccollections\nOrderedDict\n)R('
    for key, (name, array) in enumerate(arrays.items()):
        storage = text('storage') + b'ctorch\nFloatStorage\n' + text(str(key)) + text('cuda:0') + number(array.size)
        reference = b'(' + storage + b'tQ'
        strides = np.array(array.strides) // array.itemsize
        tensor = b'(' + reference + number(0) + numbers(array.shape) + numbers(strides) + b'\x89ccollections\nOrderedDict\n)Rt'
        out += text('module.' + name) + b'ctorch._utils\n_rebuild_tensor_v2\n' + tensor + b'R'
    return out + b'uu.'


@pytest.fixture
def weights():
    rng = np.random.default_rng(1)
    shapes = {'rnn.weight_ih_l0': (768, 256), 'rnn.weight_hh_l0': (768, 256), 'rnn.bias_ih_l0': (768,),
              'rnn.bias_hh_l0': (768,), 'rnn_fc.0.weight': (512, 256), 'rnn_fc.0.bias': (512,)}
    for block in range(0, 10, 2):
        for layer in (1, 2):
            shapes[f'cnn.{block}.conv{layer}.weight'] = (64, 4 if block == 0 and layer == 1 else 64, 3, 3)
            shapes |= {f'cnn.{block}.bn{layer}.{name}': (64,) for name in ('weight', 'bias', 'running_mean', 'running_var')}
    return {name: (0.1 * np.abs(rng.standard_normal(shape)) if name.endswith('var') else 0.05 * rng.standard_normal(shape)
                   ).astype('f') for name, shape in shapes.items()}


@pytest.fixture
def path(tmp_path, weights):
    with ZipFile(tmp_path / 'model.tar', 'w') as archive:
        archive.writestr('archive/data.pkl', storage_pickle(weights))
        for key, array in enumerate(weights.values()):
            archive.writestr(f'archive/data/{key}', array.tobytes())
    return tmp_path / 'model.tar'


def test_weights_are_those_of_the_checkpoint(path, weights):
    read = read_weights(path)
    assert read.keys() == weights.keys()
    for name, array in weights.items():
        np.testing.assert_array_equal(read[name], array)


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path):
    with ZipFile(tmp_path / 'model.tar', 'w') as archive:
        archive.writestr('archive/data.pkl', b'cos\nsystem\n(X\x04\x00\x00\x00exittR.')
    with pytest.raises(ValueError, match=r'os\.system|posix\.system'):
        read_weights(tmp_path / 'model.tar')


@pytest.mark.parametrize('content', [b'', b'no zip', pickle.dumps(3)])
def test_files_that_are_no_checkpoint_are_named(tmp_path, content):
    (tmp_path / 'model.tar').write_bytes(content)
    with pytest.raises(ValueError, match='model.tar'):
        SrpDnn(tmp_path / 'model.tar')


def test_a_checkpoint_of_another_network_is_refused(tmp_path):
    buffer = io.BytesIO()
    with ZipFile(buffer, 'w') as archive:
        archive.writestr('archive/data.pkl', storage_pickle({'other': np.ones(1, 'f')}))
        archive.writestr('archive/data/0', np.ones(1, 'f').tobytes())
    (tmp_path / 'model.tar').write_bytes(buffer.getvalue())
    with pytest.raises(ValueError, match='no model of SRP-DNN'):
        SrpDnn(tmp_path / 'model.tar')


def test_convolutions_are_causal_correlations(path, weights):
    values = np.random.default_rng(2).standard_normal((4, 16, 9)).astype('f')
    kernel = weights['cnn.0.conv1.weight'][7]
    padded = np.pad(values, ((0, 0), (1, 1), (2, 0)))
    expected = sum(correlate2d(channel, part, 'valid') for channel, part in zip(padded, kernel, strict=True))
    mean, variance, scale, offset = (weights[f'cnn.0.bn1.{name}'][7]
                                     for name in ('running_mean', 'running_var', 'weight', 'bias'))
    expected = np.maximum((expected - mean) / np.sqrt(variance + 1e-5) * scale + offset, 0.0)
    np.testing.assert_allclose(SrpDnn(path)._convolved(values, 'cnn.0.', 1)[7], expected, atol=1e-5)


def test_outputs_do_not_depend_on_later_frames(path):
    features = np.random.default_rng(3).standard_normal((4, 256, 3 * FRAMES + 5)).astype('f')
    network = SrpDnn(path)
    whole, part = network.phases(features), network.phases(features[..., :2 * FRAMES])
    assert whole.shape == (3, 512)
    np.testing.assert_allclose(whole[:2], part, atol=1e-6)
    assert np.abs(whole).max() <= 2.0


def test_features_are_relative_to_the_mean_level():
    sound = np.random.default_rng(4).standard_normal((RATE, 2))
    features = pair_features(sound)
    assert features.shape == (4, 256, 1 + (RATE - 512) // 256)
    np.testing.assert_allclose(pair_features(100.0 * sound)[:2], features[:2], atol=1e-3)
    assert np.log10(np.mean(10.0 ** features[:2])) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize('aperture', [0.08, 0.2])
@pytest.mark.parametrize('cosine', [-0.9, 0.0, 0.4])
def test_true_phase_differences_give_the_true_direction(path, monkeypatch, aperture, cosine):
    heard = RATE * min(1.0, 0.12 / aperture)
    turns = 2.0 * np.pi * FREQUENCIES * heard * cosine * aperture / C
    network = SrpDnn(path)
    monkeypatch.setattr(network, 'phases', lambda _: np.concatenate([np.cos(turns), np.sin(turns)])[None])
    sound = np.random.default_rng(5).standard_normal((RATE // 2, 2))
    assert network.cosine(sound, RATE, aperture, C) == pytest.approx(cosine, abs=2e-3)
