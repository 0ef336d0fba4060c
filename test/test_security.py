"""The secured rig under `ros2 launch`, among participants with its keys, without keys, and with keys of others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import participant
import pytest
from rig_process import RigProcess
from ros_domains import free_domain
from udp_ports import free_offset

from av_bringup.cli.security import main as security

pytestmark = pytest.mark.system
BEARING, COMMAND = 'target/bearing', 'pointing/command'
PATIENCE_S = 200.0    # for a slow machine; without load, all is seen after some 15 s


def environment(domain: int, node: str, keystore: Path | None) -> dict[str, str]:
    """The environment of a process with the keys of a node; without security where there is no keystore."""
    keys = {'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce', 'ROS_SECURITY_KEYSTORE': str(keystore),
            'ROS_SECURITY_ENCLAVE_OVERRIDE': f'/{node}'} if keystore else {}
    return {**os.environ, 'ROS_DOMAIN_ID': str(domain), **keys}


class Participant:
    """A process of participant.py.

    Parameters:
        domain: the ROS domain.
        node: the node's name, and that of its enclave.
        words: arguments of participant.py.
        keystore: its keys; None for a participant without security.
    """

    def __init__(self, domain: int, node: str, *words: str, keystore: Path | None = None) -> None:
        self._process = subprocess.Popen([sys.executable, participant.__file__, node, *words], text=True,
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         env=environment(domain, node, keystore))
        self._lines: list[str] = []
        threading.Thread(target=lambda: self._lines.extend(self._process.stdout), daemon=True).start()

    @property
    def report(self) -> dict:
        """The newest report."""
        return json.loads(self._lines[-1]) if self._lines else {'heard': {}, 'refused': [], 'answered': [], 'nodes': []}

    def heard(self, what: str) -> int:
        """Number of messages received."""
        return self.report['heard'].get(what, 0)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def join():
    """Start a participant."""
    joined = []

    def start(*words, **options):
        joined.append(Participant(*words, **options))
        return joined[-1]

    yield start
    for one in joined:
        one.close()


@pytest.fixture(scope='module')
def keystores(tmp_path_factory):
    """Two keystores of the same policy: the rig's, and one of other authorities."""
    made = [tmp_path_factory.mktemp('keys') / name for name in ('ours', 'theirs')]
    assert all(security(['--keystore', str(keystore)]) == 0 for keystore in made)
    return made


def wait_for(condition: Callable[[], bool], *participants: Participant, rig: RigProcess | None = None) -> None:
    """Wait until the condition holds. Raises AssertionError where it never does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert rig is None or rig.running_now, rig.output
        assert time.monotonic() < deadline, [one.report for one in participants]
        time.sleep(0.2)


@pytest.mark.timeout(900)
def test_the_secured_rig_tracks_and_only_its_keys_take_part(keystores, join):
    """Those without keys, or with keys of others, hear each other, but neither the rig nor are they heard by it."""
    ours, theirs = keystores
    rig = RigProcess('oracle:=true', f'security:={ours}', f'port_offset:={free_offset()}', 'monitor:=false')
    operator = join(rig.domain, 'operator', 'test_operator', keystore=ours)
    wait_for(lambda: operator.heard('tracks') > 20, operator, rig=rig)

    strangers = [join(rig.domain, f'stranger_{number}', f'test_stranger_{number}', '--call', BEARING, COMMAND)
                 for number in (1, 2)]
    foreign = [join(rig.domain, 'fusion_node', 'test_foreign_fusion', BEARING, keystore=theirs),
               join(rig.domain, 'pointing_node', 'test_foreign_pointing', COMMAND, keystore=theirs),
               join(rig.domain, 'operator', 'test_foreign_operator', '--call', keystore=theirs)]
    unpermitted = join(rig.domain, 'doa_node', 'test_unpermitted', '--call', BEARING, COMMAND, keystore=ours)
    everybody = (operator, *strangers, *foreign, unpermitted)
    before = operator.heard('tracks')
    wait_for(lambda: strangers[0].heard(f'{BEARING} of test_stranger_2') > 100
             and strangers[1].heard(f'{COMMAND} of test_stranger_1') > 100
             and foreign[1].heard(f'{BEARING} of test_foreign_fusion') > 100
             and foreign[2].heard(f'{COMMAND} of test_foreign_pointing') > 100
             and operator.heard('tracks') > before + 100 and bool(unpermitted.report['refused']), *everybody, rig=rig)

    assert not [what for what in operator.report['heard'] if 'test_' in what], 'the rig\'s participants heard a stranger'
    for one in (*strangers, *foreign, unpermitted):
        assert not [what for what in one.report['heard'] if 'the rig' in what], one.report
        assert not one.report['answered'], one.report
    assert not {'bridge_node', 'rig_frames_node'} & {node for one in (*strangers, *foreign) for node in one.report['nodes']}
    assert set(unpermitted.report['refused']) >= {BEARING, COMMAND, f'hear {BEARING}', 'call pointing_node/set_parameters'}

    caller = join(rig.domain, 'operator', 'test_caller', '--call', keystore=ours)
    wait_for(lambda: len(caller.report['answered']) == len(participant.REQUESTS), caller, rig=rig)
    echo = subprocess.run(['ros2', 'topic', 'echo', '--no-daemon', '--once', f'/{BEARING}'], text=True, capture_output=True,
                          check=False, timeout=PATIENCE_S, env=environment(rig.domain, 'operator', ours))
    assert 'azimuth:' in echo.stdout, echo.stderr
    rig.interrupt()
    rig.finish()
    assert not rig.leftovers()


@pytest.mark.timeout(600)
def test_the_agent_of_px4_needs_no_keys_for_its_own_topics(tmp_path, join):
    keystore, domain = tmp_path / 'keys', free_domain()
    assert security(['--keystore', str(keystore), '--px4']) == 0
    agent = join(domain, 'agent', 'test_agent', 'fmu/out/x', BEARING)
    px4 = join(domain, 'px4_node', 'test_px4', 'fmu/in/x', keystore=keystore)
    fusion = join(domain, 'fusion_node', 'test_fusion', BEARING, keystore=keystore)
    wait_for(lambda: agent.heard('fmu/in/x of test_px4') > 50 and px4.heard('fmu/out/x of test_agent') > 50
             and px4.heard(f'{BEARING} of test_fusion') > 50, agent, px4, fusion)
    assert not agent.heard(f'{BEARING} of test_fusion')
    assert not px4.heard(f'{BEARING} of test_agent')


def test_a_node_without_keys_is_named_before_anything_starts(tmp_path):
    rig = RigProcess(f'security:={tmp_path}')
    assert rig.finish() != 0
    complaints = [line for line in rig.output.splitlines() if 'no such file' in line]
    assert len(complaints) == 1 and f'{tmp_path}/enclaves/' in complaints[0], rig.output
    assert 'process started' not in rig.output
