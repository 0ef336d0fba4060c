"""The security policy and the nodes agree: each node is permitted what it has, and nothing else."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from fnmatch import fnmatchcase
from importlib.metadata import entry_points
from pathlib import Path

import node_endpoints
import pytest
from node_endpoints import variants
from ros_domains import free_domain

from av_bringup.security.policy import DISCOVERY, RULES, read_policy

CONFIG = Path(__file__).resolve().parent.parent / 'config'
POLICY = {enclave.path.lstrip('/'): enclave for enclave in read_policy(CONFIG / 'security' / 'policy.xml')}
NODES = sorted({program.name for program in entry_points(group='console_scripts')
                if program.module.startswith('av_') and '.nodes.' in program.module})
SECOND = {'second_camera_node': 'camera_node', 'second_camera_detector_node': 'detector_node'}  # of a rig with two cameras
# Beside a vehicle only: PX4's topics, and what is made of those that not every firmware sends.
ELSEWHERE = {'px4_node': {'rt/fmu/in/*', 'rt/fmu/out/*', 'rt/motor_speeds'}}
# ROS 2 Humble has no such service.
UNKNOWN = set() if importlib.util.find_spec('rclpy.type_description_service') else {'get_type_description'}
KIND = {'publish': 'topics', 'subscribe': 'topics', 'reply': 'services', 'request': 'services'}


def dds_topics(endpoints: dict[str, set[str]]) -> tuple[set[str], set[str]]:
    """Names of the DDS topics that a node with these endpoints publishes, and subscribes to."""
    found: tuple[set[str], set[str]] = {DISCOVERY}, {DISCOVERY}
    for kind, names in endpoints.items():
        for topics, patterns in zip(found, RULES[KIND[kind], kind], strict=True):
            topics |= {pattern.format(name) for pattern in patterns for name in names}
    return found


def test_every_node_has_an_enclave_and_every_enclave_a_node():
    assert set(POLICY) == {*NODES, *SECOND, 'operator'}


@pytest.mark.parametrize(('second', 'first'), SECOND.items())
def test_nodes_of_a_second_camera_may_do_as_those_of_the_first(second, first):
    """Under other names; what the rig shares, they read."""
    for verb in ('publish', 'subscribe'):
        may, others = (sorted(getattr(POLICY[name], verb)) for name in (second, first))
        renamed = {pattern.replace(first, second).replace('rt/camera/', 'rt/second_camera/') for pattern in others}
        own = {pattern for pattern in may if pattern not in renamed}
        assert len(may) == len(others) and all(pattern.startswith('rt/second_camera/') for pattern in own), own


@pytest.mark.system
@pytest.mark.parametrize('name', NODES)
def test_a_node_is_permitted_what_it_has_and_nothing_else(name, tmp_path):
    has_by_kind, log = {}, ''
    for variant in range(len(variants(name))):
        (folder := tmp_path / str(variant)).mkdir()
        command = [sys.executable, node_endpoints.__file__, name, str(variant), folder]
        # Other tests' nodes of the same name would be found in the graph first.
        run = subprocess.run(command, text=True, capture_output=True, check=False,
                             env={**os.environ, 'ROS_DOMAIN_ID': str(free_domain())})
        assert run.returncode == 0, run.stderr
        log += run.stderr
        for kind, names in json.loads(run.stdout.splitlines()[-1]).items():
            has_by_kind.setdefault(kind, set()).update(names)
    permitted = POLICY[name].publish, POLICY[name].subscribe
    for has, may, verb in zip(dds_topics(has_by_kind), permitted, ('publishes', 'subscribes to'), strict=True):
        missing = {topic for topic in has if not any(fnmatchcase(topic, pattern) for pattern in may)}
        unused = {pattern for pattern in may if not any(fnmatchcase(topic, pattern) for topic in has)
                  and not any(name in pattern for name in UNKNOWN)}
        assert not missing, f'config/security/policy.xml does not permit what {name} {verb}: {missing}; {log}'
        assert not unused - ELSEWHERE.get(name, set()), \
            f'config/security/policy.xml permits what {name} no longer {verb}: {unused}; {log}'
