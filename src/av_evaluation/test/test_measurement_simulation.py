"""The simulation of measurements: their errors are those that they state, and they show what can be heard and seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_common.angles import wrap
from av_evaluation.experiments.measurement_simulation import HALF_VIEW, RESOLUTION, WINDOW_S, MeasurementSimulation
from av_simulator import find_config, load_scenario


def scenario(name):
    """A shipped scenario."""
    return load_scenario(find_config(name, 'scenarios'))


@pytest.mark.parametrize('pair', [False, True])
def test_errors_are_as_stated(pair):
    """Errors in standard deviations have a variance of one, and windows that share nothing are independent."""
    normalised = []
    for scan in MeasurementSimulation(scenario('circle'), 1, pair=pair, sound_clutter=0.0).scans():
        x, y, _ = scan.truth[0]
        for doa in scan.doas:
            if doa.cone is not None:
                normalised.append((doa.cone.cosine - y) / math.sqrt(doa.cone.variance))
            else:
                first = doa.hypotheses[0]
                normalised.append(wrap(first.azimuth - math.atan2(y, x)) / math.sqrt(first.across_variance))
    values = np.array(normalised)
    assert len(values) > 500
    assert abs(values.mean()) < 0.2 and 0.8 < values.std() < 1.2
    overlap = round(10.0 * WINDOW_S)
    assert abs(np.corrcoef(values[:-overlap], values[overlap:])[0, 1]) < 0.2
    assert np.corrcoef(values[:-1], values[1:])[0, 1] == pytest.approx(1.0 - 1.0 / overlap, abs=0.1)


def test_fog_hides_and_clear_air_shows():
    """Detections without clutter: most targets in view in clear air, hardly any behind dense fog."""
    shares = {}
    for name in ('swarm_5', 'crossing'):
        detected = possible = 0
        for scan in MeasurementSimulation(scenario(name), 2, sight_clutter=0.0).scans():
            azimuth = np.arctan2(scan.truth[:, 1], scan.truth[:, 0])
            possible += int((np.abs(azimuth) < HALF_VIEW).sum())
            detected += len(scan.image.detections)
        shares[name] = detected / possible
    assert 0.6 < shares['swarm_5'] < 0.95 and shares['crossing'] < 0.01


def test_sources_closer_than_the_resolution_are_one():
    """While two drones cross, at most one direction is heard near them."""
    for scan in MeasurementSimulation(scenario('crossing'), 3, sound_clutter=0.0).scans():
        apart = math.acos(min(float(scan.truth[0] @ scan.truth[1]), 1.0))
        assert len(scan.doas) <= (1 if apart < RESOLUTION else 2)


def test_the_same_seed_gives_the_same_measurements():
    """And another seed others."""
    first, again, other = ([scan.doas for scan in MeasurementSimulation(scenario('swarm_5'), seed).scans()]
                           for seed in (4, 4, 5))
    assert first == again and first != other
