"""Parameters that contradict each other end the node at its start, and are refused at run time."""

from __future__ import annotations

import pytest

from av_common.parameters import node_parameters


@pytest.mark.parametrize(('given', 'complaint'), [
    ({'rigs': ['left', 'right'], 'positions': [0.0, 0.0, 1.5]},
     '3 positions, 2 pose_sources and 2 headings_deg for 2 rigs, expected 6, 2 and 2'),
    ({'rigs': ['left', 'left/'], 'positions': [0.0] * 6}, 'expected different namespaces'),
    ({'rigs': ['left'], 'pose_sources': ['gps'], 'positions': [0.0] * 3}, r"pose_sources has \['gps'\], expected surveyed"),
    ({'rigs': ['left'], 'pose_sources': ['fix']}, 'needs latitude, longitude and altitude of datum'),
    ({'join': True}, r'expected \[odometry\] or \[fix\] where rigs join'),
    ({'join': True, 'pose_sources': ['gps']}, r'expected \[odometry\] or \[fix\] where rigs join'),
    ({'join': True, 'pose_sources': ['fix']}, 'needs latitude, longitude and altitude of datum'),
    ({'join': True, 'pose_sources': ['odometry']}, ''),
    ({}, ''), ({'rigs': ['left'], 'pose_sources': ['fix'], 'datum.latitude': 48.0}, '')])
def test_contradictions_are_named(given, complaint):
    if not complaint:
        node_parameters('av_network', 'network_node', overrides=given)
        return
    with pytest.raises(ValueError, match=complaint):
        node_parameters('av_network', 'network_node', overrides=given)
