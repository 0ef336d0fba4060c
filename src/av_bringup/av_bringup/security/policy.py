"""SROS 2 policies: what the nodes of each enclave may publish, subscribe, serve and call, as topics of DDS."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

INCLUDE = '{http://www.w3.org/2001/XInclude}include'
PATH = re.compile(r'(/[A-Za-z_]\w*)+', re.ASCII)
DISCOVERY = 'ros_discovery_info'  # every ROS node publishes and reads here which node has which topics
# Attribute of `topics` or `services`: the DDS topics that it lets a node publish, and those that it lets it subscribe to.
RULES = {
    ('topics', 'publish'): (('rt{}',), ()),
    ('topics', 'subscribe'): ((), ('rt{}',)),
    ('services', 'reply'): (('rr{}Reply',), ('rq{}Request',)),
    ('services', 'request'): (('rq{}Request',), ('rr{}Reply',)),
}


@dataclass(frozen=True)
class Enclave:
    """Permissions of the nodes that share one key.

    Parameters:
        path: the enclave's name, such as `/rig1/fusion_node`
        publish: expressions of the DDS topics that may be published
        subscribe: expressions of the DDS topics that may be subscribed to
    """

    path: str
    publish: tuple[str, ...]
    subscribe: tuple[str, ...]


def read_policy(file: Path, namespace: str = '') -> list[Enclave]:
    """The enclaves of a policy. Raises ValueError that names the file, or OSError.

    The format is that of `ros2 security`: topics and services with ALLOW, profiles, and XInclude of the children of an
    element. DENY and actions are refused, as no node of the suite has them.

    Parameters:
        file: the policy, version 0.2.0
        namespace: namespace of a rig, such as `/rig1`: prefix of the enclaves and of the profiles' `ns`
    """
    namespace = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    if namespace and not PATH.fullmatch(namespace):
        raise ValueError(f'namespace {namespace!r} is not a name of ROS, expected one such as /rig1')
    try:
        return [_enclave(enclave, namespace) for enclave in _read(file, 'policy').iterfind('enclaves/enclave')]
    except (ET.ParseError, ValueError) as error:
        raise ValueError(f'{file}: {error}') from error


def _read(file: Path, root: str, including: tuple[Path, ...] = ()) -> Element:
    """The root element of a file, with what its XIncludes name in their place. `including`: the files that include it."""
    if file.resolve() in including:
        raise ValueError(f'{file.name} includes itself')
    tree = ET.parse(file).getroot()
    if tree.tag != root:
        raise ValueError(f'the first element of {file.name} is <{tree.tag}>, expected <{root}>')
    for parent in list(tree.iter()):
        for index, child in reversed(list(enumerate(parent))):
            if child.tag == INCLUDE:
                parent[index:index + 1] = _included(child, (*including, file.resolve()))
    return tree


def _included(include: Element, including: tuple[Path, ...]) -> list[Element]:
    match = re.fullmatch(r'xpointer\(/(\w+)/((?:\w+/)*\*)\)', include.get('xpointer', ''))
    if match is None:
        raise ValueError(f'xpointer {include.get("xpointer")!r}, expected such as xpointer(/profile/*)')
    return _read(including[-1].parent / include.get('href', ''), match[1], including).findall(match[2])


def _enclave(element: Element, namespace: str) -> Enclave:
    path = namespace + element.get('path', '')
    if not PATH.fullmatch(path):
        raise ValueError(f'enclave {path!r}, expected a path such as /fusion_node')
    publish, subscribe = {DISCOVERY}, {DISCOVERY}
    for profile in element.iterfind('profiles/profile'):
        for name, (published, subscribed) in _rules(profile, namespace):
            publish |= {topic.format(name) for topic in published}
            subscribe |= {topic.format(name) for topic in subscribed}
    return Enclave(path, tuple(sorted(publish)), tuple(sorted(subscribe)))


def _rules(profile: Element, namespace: str) -> Iterator[tuple[str, tuple[tuple[str, ...], tuple[str, ...]]]]:
    """The full name of each topic and service of a profile, with what each of its rules permits."""
    namespace = (namespace + profile.get('ns', '/')).rstrip('/')
    for group in profile:
        for attribute, qualifier in group.items():
            rule = RULES.get((group.tag, attribute))
            if rule is None or qualifier != 'ALLOW':
                raise ValueError(f'<{group.tag} {attribute}="{qualifier}"> is not supported')
            for item in group:
                name = (item.text or '').strip()
                if name.startswith('~'):
                    name = f'{namespace}/{profile.get("node")}{name[1:]}'
                yield name if name.startswith('/') else f'{namespace}/{name}', rule
