"""The layouts for other viewers name topics and fields that exist."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml
from rosidl_runtime_py.utilities import get_message

from av_bags import KINDS

CONFIG = Path(__file__).resolve().parents[1] / 'config'
TOPICS = {f'/{name.lstrip("/")}': kinds[0] for name, kinds in KINDS.items()}
ELSEWHERE = {'/view/markers', '/diagnostics'}  # of view_node and of every node
# Settings of Foxglove's panels, by the types in the sources of its open fork Lichtblick (packages/suite-base/src/panels).
CAMERA_STATE = {'distance', 'perspective', 'phi', 'thetaOffset', 'target', 'targetOffset', 'fovy', 'near', 'far'}
SCENE = {'cameraState', 'followTf', 'followMode', 'scene', 'transforms', 'topics', 'layers', 'imageMode'}
PANELS = {
    'Image': SCENE,
    'RawMessages': {'topicPath', 'diffEnabled', 'diffMethod', 'diffTopicPath', 'showFullMessageForDiff'},
    'Plot': {'paths', 'showLegend', 'legendDisplay', 'isSynced', 'xAxisVal', 'followingViewWidth', 'minYValue', 'maxYValue'}}
PATH = {'value', 'enabled', 'color', 'label', 'showLine', 'timestampMethod'}
# Classes of RViz, by plugins_description.xml of rviz_default_plugins and rviz_common.
CLASSES = {
    'Panels': {'rviz_common/Displays', 'rviz_common/Views'}, 'Tools': {'rviz_default_plugins/MoveCamera'},
    'Displays': {f'rviz_default_plugins/{name}' for name in ('Grid', 'TF', 'MarkerArray', 'Odometry', 'Image')},
    'Views': {'rviz_default_plugins/Orbit'}}


def has_field(topic, path):
    """Whether messages of a topic have a field such as hypotheses[0].azimuth."""
    message = get_message(TOPICS[topic])
    for step in path.split('.'):
        kind = message.get_fields_and_field_types().get(step.partition('[')[0], '')
        if not kind or ('[' in step) != kind.startswith('sequence'):
            return False
        inner = re.sub(r'sequence<(.*)>', r'\1', kind)
        message = get_message(inner.replace('/', '/msg/', 1)) if '/' in inner else None
    return True


def test_plotjuggler():
    curves = [curve.get('name') for curve in ET.parse(CONFIG / 'plotjuggler.xml').iter('curve')]
    assert curves
    for curve in curves:
        topic = max((topic for topic in TOPICS if curve.startswith(topic + '/')), key=len)
        assert has_field(topic, curve.removeprefix(topic + '/').replace('/', '.')), curve


def test_foxglove():
    layout = json.loads((CONFIG / 'foxglove.json').read_text())
    for name, panel in layout['configById'].items():
        assert set(panel) <= PANELS[name.partition('!')[0]] | {'foxglovePanelTitle'}, name
        assert set(panel.get('cameraState', {})) <= CAMERA_STATE
        for path in panel.get('paths', []):
            assert set(path) <= PATH
            topic, field = path['value'].split('.', 1)
            assert has_field(topic, field), path
        asked = {panel.get('imageMode', {}).get('imageTopic'), panel.get('topicPath', '').split('.')[0] or None,
                 *(path['value'].split('.')[0] for path in panel.get('paths', []))} - {None}
        assert asked <= {*TOPICS, '/camera/image_raw/compressed'}, 'a bag has no more'
    shown = set(re.findall(r'"(\w+!\w+)"', json.dumps(layout['layout'])))
    assert shown == set(layout['configById'])


def test_rviz():
    layout = yaml.safe_load((CONFIG / 'rig.rviz').read_text())
    manager = layout['Visualization Manager']
    displays = manager['Displays']
    for kind, found in {'Panels': layout['Panels'], 'Displays': displays, 'Tools': manager['Tools'],
                        'Views': [manager['Views']['Current']]}.items():
        assert {one['Class'] for one in found} <= CLASSES[kind]
    topics = [f'/{display["Topic"]["Value"]}' for display in displays if 'Topic' in display]
    assert topics and all(topic in TOPICS or topic in ELSEWHERE for topic in topics)


def test_every_node_is_in_one_group_of_the_aggregated_diagnostics():
    groups = yaml.safe_load((CONFIG / 'diagnostic_aggregator.yaml').read_text())['/**/analyzers']['ros__parameters']
    named = [name for group in groups.values() if isinstance(group, dict) for name in group['contains']]
    programs = ''.join(setup.read_text() for setup in CONFIG.parents[1].glob('*/setup.py'))
    nodes = re.findall(r"'(\w+_node) = ", programs)
    assert set(nodes) <= set(named) and len(named) == len(set(named))


def test_a_field_that_does_not_exist_is_found():
    assert not has_field('/doa', 'hypotheses.azimuth') and not has_field('/doa', 'loudness')
    with pytest.raises(KeyError):
        has_field('/none', 'x')
