"""The layouts for other viewers name topics and fields that exist."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml
from rosidl_runtime_py.utilities import get_message

from av_bags.topics import KINDS

CONFIG = Path(__file__).resolve().parents[1] / 'config'
TOPICS = {f'/{name.lstrip("/")}': kinds[0] for name, kinds in KINDS.items()}
ELSEWHERE = {'/view/markers', '/diagnostics'}  # of view_node and of every node


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
    for panel in layout['configById'].values():
        for path in panel.get('paths', []):
            topic, field = path['value'].split('.', 1)
            assert has_field(topic, field), path
        for topic in [panel.get('imageMode', {}).get('imageTopic'), *panel.get('topics', {})]:
            assert topic is None or topic in TOPICS or topic in ELSEWHERE, topic
    shown = set(re.findall(r'"(\w+!\w+)"', json.dumps(layout['layout'])))
    assert shown == set(layout['configById'])


def test_rviz():
    displays = yaml.safe_load((CONFIG / 'rig.rviz').read_text())['Visualization Manager']['Displays']
    topics = [f'/{display["Topic"]["Value"]}' for display in displays if 'Topic' in display]
    assert topics and all(topic in TOPICS or topic in ELSEWHERE for topic in topics)


def test_a_field_that_does_not_exist_is_found():
    assert not has_field('/doa', 'hypotheses.azimuth') and not has_field('/doa', 'loudness')
    with pytest.raises(KeyError):
        has_field('/none', 'x')
