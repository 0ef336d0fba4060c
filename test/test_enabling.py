"""What moves from the start: the own simulator's rig; what comes through the network moves nothing before it is enabled."""

from __future__ import annotations

import pytest

pytest.importorskip('launch_ros', reason='needs ROS 2')
from av_common.launched import RUN_FOLDER


@pytest.mark.parametrize(('arguments', 'moves'), [
    ({'source': 'sim'}, True), ({'source': 'sim', 'px4': 'true'}, False), ({'source': 'udp'}, False),
    ({'source': 'udp', 'enable_pointing': 'true'}, True), ({'source': 'hardware'}, False), ({'source': 'file'}, False),
    ({'source': 'sim', 'enable_pointing': 'false'}, False)])
def test_only_the_own_simulator_is_enabled_from_the_start(launch_file, arguments, moves, tmp_path):
    values = {name: default for name, (default, _, _) in launch_file.ARGUMENTS.items()} | arguments
    values[RUN_FOLDER] = str(tmp_path)
    assert launch_file.may_move(values) == moves
    if values['px4'] == 'false':
        logs = [action for action in launch_file.start(values) if type(action).__name__ == 'LogInfo']
        assert len(logs) == (0 if moves else 1)
        assert moves or 'enable_pointing:=true' in logs[0].msg[0].text


def test_addresses_reach_the_bridge(launch_file):
    values = {name: default for name, (default, _, _) in launch_file.ARGUMENTS.items()} | {
        'source': 'udp', 'bind_address': '0.0.0.0', 'allowed_senders': '192.168.1.20,10.0.0.0/24', 'namespace': 'left'}
    (log,) = [action for action in launch_file.start(values) if type(action).__name__ == 'LogInfo']
    assert '/left/pointing_node/enable' in log.msg[0].text
