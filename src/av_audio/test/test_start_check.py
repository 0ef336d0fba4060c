"""Parameters by which doa_node would hear nothing, or too late, are refused by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from av_audio.nodes.doa_node import DoaNode
from av_common.parameters import node_parameters

ARRAYS = sorted((Path(__file__).resolve().parents[3] / 'config' / 'arrays').glob('*.yaml'))
PAIR = next(path for path in ARRAYS if path.stem == 'two_microphones')


def check(array=PAIR, **values):
    DoaNode.check_parameters(node_parameters('av_audio', 'doa_node', overrides={'array_file': str(array), **values}))


@pytest.mark.parametrize('array', ARRAYS, ids=[path.stem for path in ARRAYS])
@pytest.mark.parametrize('values', [
    {}, {'method': 'phat'}, {'method': 'music'}, {'method': 'mvdr'}, {'method': 'plain'},
    {'window': 0.1, 'hop': 0.05}, {'window': 1.5}, {'band_low': 1000.0, 'band_high': 8000.0}, {'max_sources': 4},
    {'elevation_min_deg': -90.0}, {'temperature': -40.0}])
def test_what_hears_is_accepted(array, values):
    check(array, **values)


@pytest.mark.parametrize(('values', 'named'), [
    ({'band_low': 1000.0, 'band_high': 1000.1}, 'band_low is 1000 Hz and band_high 1000.1 Hz.* expected a wider band'),
    ({'band_low': 300.0, 'band_high': 300.1, 'window': 1.4}, 'band_high 300.1 Hz.* expected a wider band'),
    ({'band_low': 500.0, 'band_high': 520.0}, 'band_high 520 Hz.* expected a wider band'),
    ({'band_low': 900.0, 'band_high': 1000.0, 'method': 'mvdr'}, 'confidence of 0.*expected a wider band'),
    ({'band_low': 200.0, 'band_high': 300.0, 'window': 0.02, 'method': 'phat'}, 'band_high 300 Hz.* a longer window'),
    ({'window': 10.0}, 'window is 10 s.* expected at most 1.60 s'), ({'window': 10.0, 'hop': 0.001}, 'window is 10 s'),
    ({'hop': 60.0}, 'hop is 60 s.* expected at most 0.65 s'), ({'hop': 0.8}, 'hop is 0.8 s'),
    ({'hop': 0.001, 'window': 1.5}, r'hop is 0.001 s, but a window of 1.5 s takes 0.0\d+ s of one processor'),
    ({'band_low': 3000.0, 'band_high': 2000.0}, 'band_low is 3000')])
def test_what_is_deaf_is_refused_by_name_value_and_what_would_be_right(values, named):
    with pytest.raises(ValueError, match=named):
        check(**values)
