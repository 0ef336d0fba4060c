"""What nodes report, in words."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from av_view.health import MOST_NODES, SILENT_S, Health, advise


def array(*statuses):
    values = [KeyValue(key='rate (Hz)', value='10.0')]
    return DiagnosticArray(status=[DiagnosticStatus(name=f'{name}: status', level=level, message=message, values=values)
                                   for name, level, message in statuses])


def test_the_worst_comes_first_and_each_rig_has_its_own():
    health = Health()
    health.on_diagnostics(array(('doa_node', DiagnosticStatus.OK, 'active'),
                                ('audio_node', DiagnosticStatus.ERROR, 'the device has disappeared'),
                                ('left/doa_node', DiagnosticStatus.WARN, 'no audio frames')), 10.0)
    report = health.report(11.0)
    assert [(entry['node'], entry['level']) for entry in report] == [('/audio_node', 'error'), ('/doa_node', 'ok')]
    assert report[0]['advice'] and not report[1]['advice'] and report[1]['values'] == [('rate (Hz)', '10.0')]
    (left,) = health.report(11.0, '/left')
    assert left['node'] == '/left/doa_node' and 'Nothing is heard' in left['advice'][0]


def test_a_node_that_falls_silent_is_reported_and_comes_back():
    health = Health()
    health.on_diagnostics(array(('doa_node', DiagnosticStatus.OK, 'active')), 0.0)
    (silent,) = health.report(SILENT_S + 2.0)
    assert silent['level'] == 'stale'
    assert 'says nothing for 7 s: it hangs' in silent['words'] and 'If doa_node does' in silent['advice'][0]
    health.on_diagnostics(array(('doa_node', DiagnosticStatus.OK, 'active')), 8.0)
    assert health.report(8.5)[0]['level'] == 'ok'


def test_a_recorder_that_waits_for_its_button_is_well_and_says_so():
    health = Health()
    health.on_diagnostics(array(('recorder_node', DiagnosticStatus.WARN, 'not active'),
                                ('doa_node', DiagnosticStatus.WARN, 'not active')), 0.0)
    other, recorder = health.report(1.0)
    assert other['node'] == '/doa_node' and other['level'] == 'warning'
    assert recorder['level'] == 'ok' and 'button' in recorder['advice'][0]


def test_all_rigs_of_a_network_have_their_health():
    """64 rigs join one at most; of those beyond the limit the page said that commands move nothing."""
    health = Health()
    for number in range(64):
        health.on_diagnostics(array(*((f'rig{number}/{node}', DiagnosticStatus.OK, 'active') for node in 'abcdefghij')), 0.0)
    assert all(len(health.report(1.0, f'/rig{number}')) == 10 for number in range(64))


def test_hostile_diagnostics_take_no_memory():
    health = Health()
    for number in range(1000):
        health.on_diagnostics(array((f'node_{number}' + 'x' * 10_000, b'\xff', 'y' * 10_000)), 0.0)
    report = health.report(1.0)
    assert len(report) == MOST_NODES and max(len(entry['words']) + len(entry['node']) for entry in report) < 1000


@pytest.mark.parametrize(('node', 'words', 'part'), [
    ('camera_node', 'no images', 'camera'), ('second_camera_node', 'no images', 'camera'),
    ('pointing_node', 'no target/bearing', 'fusion_node'),
    ('fusion_node', 'no doa, odometry', 'odometry'), ('any_node', 'not active', 'lifecycle')])
def test_advice_fits_what_nodes_say(node, words, part):
    assert any(part in text for text in advise(node, words))
    assert not list(advise(node, 'active'))
