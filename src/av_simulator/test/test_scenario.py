"""Scenarios: the shipped ones are what they claim, broken ones are named by file, key and value."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from av_common.config_reader import ConfigError
from av_simulator import find_config
from av_simulator.cli.scenario_schema import schema
from av_simulator.scenario import Scenario, load_scenario, value_at
from av_simulator.trajectories import TRAJECTORIES, acceleration, velocity

SCENARIOS = Path(__file__).resolve().parents[3] / 'config' / 'scenarios'
GOOD = {'name': 'test', 'targets': [{'trajectory': {'kind': 'static', 'position': [1, 2, 3]}}]}


def test_the_schema_in_config_is_that_of_the_reader():
    """Written by: ros2 run av_simulator scenario_schema > config/scenario.schema.json"""
    assert json.loads((SCENARIOS.parent / 'scenario.schema.json').read_text()) == schema(Scenario)


@pytest.mark.parametrize('file', sorted(SCENARIOS.glob('*.yaml')), ids=lambda file: file.stem)
def test_shipped_scenarios_keep_the_schema(file):
    jsonschema = pytest.importorskip('jsonschema')
    jsonschema.validate(yaml.safe_load(file.read_text()), schema(Scenario))


@pytest.mark.parametrize('file', sorted(SCENARIOS.glob('*.yaml')), ids=lambda file: file.stem)
def test_shipped_scenarios_load_and_are_named_after_their_file(file):
    scenario = load_scenario(file)
    assert scenario.name == file.stem
    times = np.linspace(-1.0, scenario.duration, 500)
    for target in scenario.targets:
        assert np.isfinite(target.trajectory(times)).all()
        assert target.trajectory(times)[:, 2].min() > 0.2


def test_fog_woodland_can_be_followed():
    scenario = load_scenario(SCENARIOS / 'fog_woodland.yaml')
    times = np.arange(0, scenario.duration, 0.02)
    path = scenario.targets[0].trajectory(times)
    azimuth = np.unwrap(np.arctan2(path[:, 1], path[:, 0]))
    distance = np.linalg.norm(path - [0, 0, 1.5], axis=1)
    assert np.abs(np.rad2deg(azimuth[0])) > 110            # behind the rig, which looks along x
    assert np.rad2deg(np.abs(np.gradient(azimuth, times))).max() < 25
    assert distance.min() > 7.5 and distance.max() < 12.5
    transmission = np.exp(-value_at(scenario.weather.fog, times) * distance)
    assert 0.35 < (transmission > 0.2).mean() < 0.65


BROKEN = [
    ({'faults': {'lost_datagrams': 2}}, r'faults.lost_datagrams: 2.0 is beyond 1.0'),
    ({'ground': {'flow_resistivity': -5.0}}, r'ground.flow_resistivity: -5.0 is below 1000'),
    ({'reverberation': [{'minimum': [0, 0, 0], 'maximum': [1, 1, 1], 'decay_s': 0}]}, r'decay_s: 0.0 is below 0.05'),
    ({'ground': {'surface': 'lava'}}, r"ground: .*'lava'"),
    ({'ground': {}, 'room': {'minimum': [0, 0, 0], 'maximum': [1, 1, 1]}}, r'ground and room'),
    ({'obstacles': [{'kind': 'box', 'center': [0, 0, 0], 'size': [1, 1, 0]}]}, r'obstacles\[0\]: .*three positive'),
    ({'noise': {'wind': {'velocity': [0, 0, 0]}}}, r'noise.wind: .*speed above 0'),
    ({'noise': {'self_noise_db_spl': None, 'snr': {'ratio_db': 3.0}}}, r'noise: snr is given without noise'),
    ({'scene': {'kind': 'moon'}}, r"scene.kind: 'moon', one of woodland, field, indoors, urban"),
    ({'weather': {'smoke': [{'position': [0, 0, 1], 'density': -1}]}}, r'weather.smoke\[0\].density: -1.0 is below 0'),
    ({'weather': {'temperature_c': 300}}, r'weather.temperature_c: 300.0 is beyond 55'),
    ({'foo': 1}, r'foo: unknown key'),
    ({'duration': -1}, r'duration: -1.0 must be more than 0'),
    ({'duration': 'long'}, r"duration: 'long', a number expected"),
    ({'duration': float('inf')}, r'duration: inf'),
    ({'seed': 1.5}, r'seed: 1.5, a whole number expected'),
    ({'weather': {'fog': -0.1}}, r'weather.fog: -0.1 is below 0'),
    ({'weather': {'fog': [[0, 1], [0, 2]]}}, r'weather.fog: times are \(0.0, 0.0\), expected increasing'),
    ({'weather': {'fog': 'thick'}}, r"weather.fog: 'thick', a number expected"),
    ({'weather': 3}, r'weather: 3, a mapping expected'),
    ({'targets': []}, r'targets: none'),
    ({'targets': [{}]}, r'targets\[0\].trajectory: missing'),
    ({'targets': [{'trajectory': {'kind': 'zigzag'}}]}, r"targets\[0\].trajectory.kind: 'zigzag', one of static, line"),
    ({'targets': [{'trajectory': {'kind': 'static', 'position': [1, 2]}}]}, r'position: \[1, 2\], a list of 3'),
    ({'targets': [{'trajectory': {'kind': 'circle', 'center': [0, 0, 0], 'period': 0}}]}, r'trajectory: period: 0'),
    ({'targets': [{'trajectory': {'kind': 'static', 'position': [0, 0, 1]},
                   'signal': {'kind': 'recording', 'file': 'none.wav'}}]}, r'targets\[0\].signal: .*none.wav'),
    ({'targets': [{'trajectory': {'kind': 'static', 'position': [0, 0, 1]}, 'drone': 'ufo'}]},
     r'targets\[0\]: drone: ufo: no such file, the nearest is mini_quadrotor; shipped files are camera_quadrotor'),
    ({'targets': [{'trajectory': {'kind': 'circle', 'center': [0, 0, 9], 'radius': 10, 'period': 0.1}}]},
     r'targets\[0\].trajectory: 628 m/s at .* at most 136 m/s'),
    ({'rig': {'max_yaw_rate_deg': 0}}, r'rig.max_yaw_rate_deg: 0.0 must be more than 0'),
]


@pytest.mark.parametrize(('change', 'message'), BROKEN)
def test_broken_scenarios_name_file_key_and_value(tmp_path, change, message):
    file = tmp_path / 'broken.yaml'
    file.write_text(yaml.safe_dump(GOOD | change))
    with pytest.raises(ConfigError, match=f'broken.yaml: .*{message}'):
        load_scenario(file)


def test_what_is_not_yaml_is_named(tmp_path):
    file = tmp_path / 'broken.yaml'
    file.write_text('name: [')
    with pytest.raises(ConfigError, match='broken.yaml: not YAML'):
        load_scenario(file)


def test_an_unknown_name_lists_the_shipped_ones():
    with pytest.raises(ConfigError, match='nowhere: .*circle'):
        find_config('nowhere', 'scenarios')


PATHS = {
    'static': {'position': (1.0, 2.0, 3.0)}, 'line': {'position': (0.0, 0.0, 3.0), 'velocity': (20.0, 0.0, 0.0)},
    'circle': {'center': (0.0, 0.0, 3.0), 'radius_swing': 2.0, 'height_swing': 1.0},
    'figure_eight': {'center': (0.0, 0.0, 3.0), 'heading_deg': 30.0},
    'waypoints': {'points': ((0.0, 0.0, 0.0, 1.0), (4.0, 5.0, 1.0, 2.0), (9.0, 0.0, 9.0, 3.0))},
    'steps': {'center': (0.0, 0.0, 1.0)}, 'random': {'center': (0.0, 0.0, 5.0), 'seed': 4},
}


@pytest.mark.parametrize('kind', TRAJECTORIES)
def test_paths_are_pure_and_smooth(kind):
    path = TRAJECTORIES[kind](**PATHS[kind])
    times = np.linspace(-5, 30, 2000)
    positions = path(times)
    np.testing.assert_array_equal(positions[::-1], path(times[::-1]))
    np.testing.assert_array_equal(positions[700], path(times[700])[0])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max() < 25.0 * (times[1] - times[0])      # nothing jumps


def test_derivatives_of_a_circle_are_those_of_the_formula():
    path = TRAJECTORIES['circle'](center=(1.0, 2.0, 3.0), radius=10.0, period=20.0)
    times = np.array([0.0, 3.0, 7.0])
    omega = 2 * np.pi / 20
    angle = omega * times
    flat = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    inward = -np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    np.testing.assert_allclose(velocity(path, times), 10 * omega * flat, atol=1e-5)
    np.testing.assert_allclose(acceleration(path, times), 10 * omega**2 * inward, atol=1e-4)


def test_steps_stay_at_multiples_of_the_step():
    path = TRAJECTORIES['steps'](center=(0.0, 0.0, 1.0), radius=3.0, step_deg=20.0, dwell=4.0, move=1.0)
    positions = path(np.arange(18) * 5.0 + 2.0)
    azimuth = np.unwrap(np.arctan2(positions[:, 1], positions[:, 0]))
    np.testing.assert_allclose(np.rad2deg(azimuth), np.arange(18) * 20.0)
