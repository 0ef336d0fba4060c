"""Parameters without the node against the node itself, for a package that is generated here."""

from __future__ import annotations

import importlib
import os
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
import rclpy
from generate_parameter_library_py.generate_python_module import (
    run as generate_parameters,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from ros_domains import free_domain

from av_common import parameters
from av_common.node import RigNode
from av_common.parameter_files import sections_of
from av_common.parameters import (
    COMMON,
    QOS_OVERRIDES,
    check_parameter_file,
    node_modules,
    node_parameters,
)

DESCRIPTION = """
tracker:
  tau: {type: double, default_value: 0.5, description: time constant, validation: {bounds<>: [0.0, 10.0]}}
  rate: {type: double, default_value: 20.0, description: Hz}
  count: {type: int, default_value: 3, description: how many}
  method: {type: string, default_value: bayes, description: which, validation: {one_of<>: [[bayes, gated]]}}
  classes: {type: string_array, default_value: [drone], description: names}
  limits: {type: double_array, default_value: [-1.0, 1.0], description: rad, validation: {fixed_size<>: [2]}}
  rotation:
    enabled: {type: bool, default_value: true, description: whether}
    patience: {type: double, default_value: 1.0, description: s}
"""
NODE = """
from av_common import parameters
from av_common.node import RigNode

class Tracker(RigNode):
    pass
"""


@pytest.fixture(scope='module', autouse=True)
def package(tmp_path_factory):
    """The package `toy` with the node `tracker`."""
    root = tmp_path_factory.mktemp('packages')
    nodes = root / 'toy' / 'nodes'
    nodes.mkdir(parents=True)
    (nodes / 'tracker.py').write_text(NODE)
    (nodes / 'tracker_parameters.yaml').write_text(DESCRIPTION)
    with redirect_stdout(None):
        generate_parameters(str(nodes / 'tracker_parameters.py'), str(nodes / 'tracker_parameters.yaml'), '')
    sys.path.insert(0, str(root))
    yield
    sys.path.remove(str(root))


@pytest.fixture(scope='module')
def context():
    """rclpy, up and down again."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=free_domain())
    yield context
    rclpy.shutdown(context=context)


def plain(struct):
    """A generated struct as a dictionary."""
    return {name: plain(value) if hasattr(value, '__dict__') else value
            for name in dir(struct) if not name.startswith('_') and name != 'stamp_' for value in [getattr(struct, name)]}


def of_the_node(context, namespace, *files):
    """The parameters as a node has them that is given the files."""
    arguments = ['--ros-args', *(word for file in files for word in ('--params-file', str(file)))]
    node = Node('tracker', namespace=namespace, context=context, cli_args=arguments)
    try:
        module = importlib.reload(importlib.import_module('toy.nodes.tracker_parameters'))    # as a process of its own has it
        return module.tracker.ParamListener(node).get_params()
    finally:
        node.destroy_node()


@pytest.mark.parametrize('namespace', ['', 'rig_1', 'fleet/rig_1'])
@pytest.mark.parametrize('section', [
    '/**', '/**/tracker', 'tracker', '/tracker', '/rig_1/tracker', '/*/tracker', '/rig_2/tracker', '/**/other', '/*',
    '/**/rig_1/tracker', 'rig_1/tracker', '/fleet/*/tracker'])
def test_sections_of_files_fit_as_in_ros(tmp_path, context, section, namespace):
    """Wildcards and namespaces pick the same sections as rcl's own parser."""
    file = tmp_path / 'params.yaml'
    file.write_text(f'{section}:\n  ros__parameters: {{tau: 0.25, rotation: {{patience: 2.0}}}}\n')
    ours = node_parameters('toy', 'tracker', [file], namespace=namespace)
    assert plain(ours) == plain(of_the_node(context, namespace, file))


def test_nested_sections_and_later_files_count(tmp_path, context):
    """A section below its namespace; the last file wins; an override wins over all."""
    a, b = tmp_path / 'a.yaml', tmp_path / 'b.yaml'
    a.write_text("rig_1:\n  tracker:\n    ros__parameters: {tau: 0.25, rate: 10.0, classes: ['1', uav]}\n")
    b.write_text('/**:\n  ros__parameters: {tau: 0.75, use_sim_time: true, limits: [-2.0, 3.5]}\n')
    ours = node_parameters('toy', 'tracker', [a, b], namespace='rig_1')
    assert (ours.tau, ours.rate, ours.classes, ours.limits) == (0.75, 10.0, ['1', 'uav'], [-2.0, 3.5])
    assert plain(ours) == plain(of_the_node(context, 'rig_1', a, b))
    assert node_parameters('toy', 'tracker', [a, b], {'tau': 2, 'rotation.enabled': False}, 'rig_1').tau == 2.0


@pytest.mark.parametrize('number', ['5e-1', '-.5', '+.5', '5.e-1', '2.5E0', '-12e-1', '.5'])
def test_numbers_are_those_of_ros(tmp_path, context, number):
    """PyYAML alone takes most of them for texts."""
    file = tmp_path / 'params.yaml'
    file.write_text(f'/**: {{ros__parameters: {{limits: [{number}, 9.0]}}}}')
    ours = node_parameters('toy', 'tracker', [file])
    assert ours.limits == [float(number), 9.0]
    assert plain(ours) == plain(of_the_node(context, '', file))


def test_nested_values_of_one_call_stay_there():
    """The generated class holds nested structs, in which the values of one node would be the defaults of the next."""
    changed = node_parameters('toy', 'tracker', overrides={'rotation.enabled': False, 'tau': 3.0})
    usual = node_parameters('toy', 'tracker')
    assert (usual.rotation.enabled, usual.tau) == (True, 0.5)
    assert (changed.rotation.enabled, changed.tau) == (False, 3.0)


def test_without_files_there_are_the_defaults(context):
    """The struct is the node's own."""
    assert plain(node_parameters('toy', 'tracker')) == plain(of_the_node(context, ''))


@pytest.mark.parametrize(('text', 'complaint'), [
    ('/**: {ros__parameters: {tau: high}}', "tracker: tau is 'high', expected double"),
    ('/**: {ros__parameters: {tau: 11.0}}', 'tracker: .*tau'),
    ('/**: {ros__parameters: {method: best}}', 'best'),
    ('/**: {ros__parameters: {classes: drone}}', "classes is 'drone', expected string_array"),
    ('/**: {ros__parameters: {limits: [1.0]}}', 'limits'),
    ('/**: {ros__parameters: {count: true}}', 'count is True, expected integer'),
    ('/**: {ros__parameters: {rotation: {enabled: 1}}}', r'rotation\.enabled is 1, expected bool'),
    ('just words', 'expected NODE: ros__parameters: NAME: VALUE'),
])
def test_wrong_parameters_are_named(tmp_path, text, complaint):
    """Types, bounds, choices, and files that are none."""
    (tmp_path / 'params.yaml').write_text(text)
    with pytest.raises(ValueError, match=complaint):
        node_parameters('toy', 'tracker', [tmp_path / 'params.yaml'])


def test_an_integer_is_refused_by_the_node_where_a_real_number_is_due(tmp_path, context):
    """The one difference: without the node, whole numbers are taken for real ones."""
    (tmp_path / 'params.yaml').write_text('/**: {ros__parameters: {tau: 1}}')
    with pytest.raises(ParameterException):
        of_the_node(context, '', tmp_path / 'params.yaml')
    assert node_parameters('toy', 'tracker', [tmp_path / 'params.yaml']).tau == 1.0


def parameter_file(text):
    return f'/**/tracker:\n  ros__parameters: {text}\n'


@pytest.mark.parametrize(('text', 'words'), [
    ('a: [', 'not YAML in line'), ('[' * 3000, 'levels of nesting'), ('- 1', 'its content is'), ('rate: 3', '/rate is 3'),
    ('tracker: {ros__parameters: 7}', '/tracker is 7'), ('tracker: {ros__parameters: {5: 1}}', '/tracker has the key 5'),
    (parameter_file('{rotation: {patience: null}}'), '/**/tracker rotation.patience is None'),
    (parameter_file('{limits: [1, 2.0]}'), '/**/tracker limits is'), (parameter_file('{limits: [[1]]}'), 'limits is'),
    (parameter_file(f'{{count: {10**30}}}'), 'count is'), (parameter_file(f'{{count: {"9" * 400}}}'), ''),
    ('&a {ros__parameters: {b: *a}}', 'alias'), ('\0', 'not YAML'),
    (parameter_file('\n    tau: 0.5\n    rate: 30.0\n    tau: 0.9'), 'line 5: tau is given twice')])
def test_what_is_no_parameter_file_is_named_before_any_node_starts(tmp_path, text, words):
    """In one line with file and key; the middleware's reader would hang, end the process, or name nothing."""
    file = tmp_path / 'params.yaml'
    file.write_text(text)
    if not words:
        sections_of(file)    # a text, whatever it looks like
        return
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        sections_of(file)
    assert str(file) in str(error.value) and '\n' not in str(error.value)


def test_a_pipe_is_no_parameter_file(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(OSError, match='pipe is a pipe, expected a file'):
        sections_of(tmp_path / 'pipe')


@pytest.mark.parametrize('name', ['rig_params.yaml'])
def test_shipped_parameter_files_are_accepted(name):
    file = Path(__file__).resolve().parents[3] / 'config' / name
    assert not check_parameter_file(file, [f'/left/{node}' for node in node_modules()])


NODES = ('/left/tracker', '/left/looker', '/right/tracker')


@pytest.fixture
def suite(monkeypatch):
    """The nodes `tracker` of the package `toy`, and `looker` and `idle` without parameters of their own."""
    monkeypatch.setattr(parameters, 'node_modules', lambda: {
        'tracker': 'toy.nodes.tracker', 'looker': 'toy.nodes.looker', 'idle': 'toy.nodes.idle'})


@pytest.mark.parametrize(('sections', 'mistake'), [
    ('/**/tracker: {ros__parameters: {tau: 1.0, rotation: {patience: 2.0}, rotation.enabled: true}}', ''),
    ('left: {tracker: {ros__parameters: {tau: 1.0}}}', ''), ('/*/tracker: {ros__parameters: {tau: 1.0}}', ''),
    ('/left/**: {ros__parameters: {tau: 1.0, use_sim_time: true, qos_overrides: {/tf: {publisher: {depth: 3}}}}}', ''),
    ('/right/*: {ros__parameters: {tau: 1.0}}', ''), ('/**: {ros__parameters: {tau: 1.0}}', ''),
    ('/left/looker: {ros__parameters: {autostart: false}}', ''),
    ('tracker: {ros__parameters: {tau: 1.0}}', 'no node is /tracker, the nearest is /left/tracker'),
    ('/**/traker: {ros__parameters: {}}', 'no node is /**/traker, the nearest is /**/tracker'),
    ('/rigth/tracker: {ros__parameters: {tau: 1.0}}', 'no node is /rigth/tracker, the nearest is /right/tracker'),
    ('/left: {trackr: {ros__parameters: {tau: 1.0}}}', 'no node is /left/trackr, the nearest is /left/tracker'),
    ('/**/left/lokker: {ros__parameters: {}}', 'no node is /**/left/lokker, the nearest is /**/left/looker'),
    ('/middle/**: {ros__parameters: {tau: 1.0}}', 'no node is /middle/**, the nearest is /'),
    ('/*: {ros__parameters: {tau: 1.0}}', 'no node is /*, the nearest is /'),
    ('ros__parameters: {tau: 1.0}', 'no node is without a name'),
    ('/**/tracker: {ros__parameters: {taw: 1.0}}', '/**/tracker has no parameter taw, the nearest is tau'),
    ('/**/tracker: {ros__parameters: {rotation: {patiense: 1.0}}}',
     'no parameter rotation.patiense, the nearest is rotation.patience'),
    ('/**/tracker: {ros__parameters: {patience: 1.0}}', 'no parameter patience, the nearest is rotation.patience'),
    ('/**: {ros__parameters: {use_sim_tyme: true}}', '/** has no parameter use_sim_tyme, the nearest is use_sim_time'),
    ('/left/looker: {ros__parameters: {tau: 1.0}}', '/left/looker has no parameter tau')])
def test_sections_and_names_that_would_have_no_effect_are_named_with_the_nearest(tmp_path, suite, sections, mistake):
    file = tmp_path / 'params.yaml'
    file.write_text(sections)
    if not mistake:
        assert check_parameter_file(file, NODES) == []
        return
    with pytest.raises(ValueError, match=re.escape(mistake)) as error:
        check_parameter_file(file, NODES)
    assert str(file) in str(error.value) and '\n' not in str(error.value)


def test_all_mistakes_are_named_at_once(tmp_path, suite):
    file = tmp_path / 'params.yaml'
    file.write_text('/**/traker: {ros__parameters: {tau: 1.0}}\n/**/tracker: {ros__parameters: {taw: 1.0, rates: 2.0}}')
    with pytest.raises(ValueError, match='traker.*taw.*rates'):
        check_parameter_file(file, NODES)


def test_a_node_of_the_suite_that_is_not_started_is_told_and_its_names_are_checked(tmp_path, suite):
    file = tmp_path / 'params.yaml'
    file.write_text('/left/idle: {ros__parameters: {autostart: false}}')
    note, = check_parameter_file(file, NODES)
    assert str(file) in note and '/left/idle has no effect' in note
    file.write_text('/**/idle: {ros__parameters: {autostrat: false}}')
    with pytest.raises(ValueError, match='no parameter autostrat, the nearest is autostart'):
        check_parameter_file(file, NODES)


def test_the_parameters_of_all_nodes_are_known(context):
    node = RigNode('bare', context=context)
    names = {name for name in node.list_parameters([], 0).names if not name.startswith(QOS_OVERRIDES)}
    node.destroy_node()
    assert names <= set(COMMON)


@pytest.mark.parametrize(('name', 'words'), [
    ('parameters/no_slash.yaml', 'no node is /fusion_node, the nearest is /left/fusion_node'),
    ('parameters/misspelt_node.yaml', 'no node is /**/fusion_nod, the nearest is /**/fusion_node'),
    ('two_rigs/right_params.yaml', 'fusion_nod, .*no parameter detection_probabillity, the nearest is detection_probability')])
def test_the_files_of_the_field(name, words):
    file = Path(__file__).resolve().parents[4] / 'shared/data/field_cases' / name
    if not file.exists():
        pytest.skip('needs ../shared/data')
    with pytest.raises(ValueError, match=words.replace('/**', r'/\*\*')):
        check_parameter_file(file, ['/left/fusion_node', '/left/pointing_node'])
