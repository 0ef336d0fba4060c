"""A live rig that reports what it tracks, to a fusion node of SAPIENT and to a file."""

from __future__ import annotations

import csv

import pytest
from rig_process import RigProcess

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from sapient_peer import NODE, FusionNode
from wire_decoder import dig, fields

pytestmark = pytest.mark.system
GOODBYE = 5


def test_a_live_rig_reports_its_target_and_says_goodbye(tmp_path):
    parameters = tmp_path / 'reports.yaml'
    parameters.write_text(f'/**/report_node:\n  ros__parameters:\n    sapient: {{node_id: {NODE}}}\n')
    fusion = FusionNode()
    rig = RigProcess('scenario:=circle', 'oracle:=true', 'monitor:=false', f'sapient:={fusion.address}',
                     f'params:={parameters}', f'track_log:={tmp_path}/log')
    try:
        fusion.accept()
        report = fusion.next(7)
        where = fields(dig(report, 5))
        assert 0.0 <= where[2][0] < 360.0 and 0.0 < where[5][0] < 45.0 and 3 not in where
        rig.interrupt()
        while dig(fusion.next(6), 2) != GOODBYE:
            pass
        rig.finish()
    finally:
        fusion.close()
    assert not rig.leftovers()
    table, = (tmp_path / 'log').glob('*.csv')
    with table.open(newline='') as file:
        assert {row['true_north'] for row in csv.DictReader(file)} == {'True'}
