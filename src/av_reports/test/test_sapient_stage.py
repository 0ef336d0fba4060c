"""A session: registration, reports once accepted, tasks obeyed or refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip('sapient_msg', reason='needs sapient-msg')
from report_tracks import NOW, bearing, position
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from sapient_msg.bsi_flex_335_v2_0.task_pb2 import Task
from sapient_peer import FUSION_NODE, NODE, accepted, acknowledgement, from_fusion_node, new_ulid, task

from av_reports import Follow, LookAt, Place, Stop
from av_reports.sapient.stage import AGAIN_S, LONGEST_PACKET, SapientStage
from av_reports.settings import SapientSettings

PLACE = Place(51.5, -0.12, 30.0)
HOUR_S = 3600.0    # of a task without an end
NORTH = {'range_bearing': {'azimuth': 0.0, 'elevation': 10.0, 'coordinate_system': 1, 'datum': 1}}
FIELD = {'type': 1, 'region_id': new_ulid(), 'region_name': 'field', 'region_area': NORTH}
ACCEPTED, REJECTED, COMPLETED, FAILED = 1, 2, 3, 4


def health(place=None, problems=(), error=False):
    return place, problems, error


def read(reaction):
    return [SapientMessage.FromString(data) for data in reaction.messages]


def kinds(reaction):
    return [message.WhichOneof('content') for message in read(reaction)]


def acks(reaction):
    return [(message.task_ack.task_status, ' '.join(message.task_ack.reason)) for message in read(reaction)
            if message.HasField('task_ack')]


@pytest.fixture
def stage(request):
    """A stage that a fusion node has accepted, and that has reported tracks 3 and 4."""
    stage = accepted(SapientSettings(NODE, obey_tasks=getattr(request, 'param', True)))
    stage.on_tracks([bearing(3), bearing(4)], NOW)
    return stage


def object_id(stage, track):
    return stage._objects.ulid(track, NOW)


def begin(stage, now=NOW, reason='', **content):
    """Ask for a task, and let the rig begin it."""
    asked = stage.on_message(task(**content), PLACE, now)
    assert asked.command is not None and acks(asked) == []
    return asked.command, stage.on_done(asked.command, reason, now)


def test_it_registers_and_reports_nothing_before_it_is_accepted():
    stage = SapientStage(SapientSettings(NODE))
    assert kinds(stage.on_connected(NOW)) == ['registration']
    assert not stage.on_tracks([bearing()], NOW).messages and not stage.on_time(*health(), NOW + 1).messages
    stage.on_message(acknowledgement(False, ['no licence']), None, NOW)
    assert not stage.session.accepted and stage.session.refusal == 'no licence'
    assert not stage.on_tracks([bearing()], NOW).messages
    assert kinds(stage.on_time(*health(), NOW + AGAIN_S)) == ['registration']
    stage.on_message(acknowledgement(), None, NOW + AGAIN_S)
    assert kinds(stage.on_time(*health(), NOW + AGAIN_S)) == ['status_report']
    assert kinds(stage.on_tracks([bearing()], NOW + AGAIN_S)) == ['detection_report']


def test_a_new_connection_begins_with_a_registration_and_objects_keep_their_names(stage):
    before = object_id(stage, 3)
    stage.on_disconnected()
    assert not stage.session.accepted and kinds(stage.on_connected(NOW + 5)) == ['registration']
    stage.on_message(acknowledgement(), PLACE, NOW + 5)
    assert read(stage.on_tracks([bearing(3)], NOW + 5))[0].detection_report.object_id == before


def test_status_is_reported_when_due_and_when_it_changes(stage):
    first, = read(stage.on_time(*health(PLACE), NOW))
    assert first.status_report.info == StatusReport.INFO_NEW and first.status_report.system == StatusReport.SYSTEM_OK
    assert not stage.on_time(*health(PLACE), NOW + 9.0).messages
    due, = read(stage.on_time(*health(PLACE), NOW + 10.0))
    assert due.status_report.info == StatusReport.INFO_UNCHANGED
    changed, = read(stage.on_time(*health(PLACE, ('no detections',)), NOW + 11.0))
    assert changed.status_report.system == StatusReport.SYSTEM_WARNING
    assert read(stage.farewell(NOW + 12.0))[0].status_report.system == StatusReport.SYSTEM_GOODBYE


def test_reports_have_the_time_of_the_track_a_limited_rate_and_an_end(stage):
    assert kinds(stage.on_tracks([bearing(3), bearing(4)], NOW + 0.1)) == []
    later = read(stage.on_tracks([bearing(3, time=NOW + 0.4), bearing(4)], NOW + 0.5))
    assert len(later) == 2 and later[0].timestamp.ToNanoseconds() * 1e-9 == pytest.approx(NOW + 0.4, abs=1e-5)
    gone, = read(stage.on_tracks([bearing(3)], NOW + 0.6))
    assert gone.detection_report.state == 'lost' and gone.detection_report.object_id == object_id(stage, 4)
    assert kinds(stage.on_tracks([], NOW + 0.7)) == ['detection_report'] and kinds(stage.on_tracks([], NOW + 9.0)) == []


@pytest.mark.parametrize('step', [0.2, 0.03, 0.7])
def test_the_rate_is_the_one_asked_for(stage, step):
    """Two a second, whatever the rate is at which is looked for what is due, as long as that is not lower."""
    times = NOW + step * np.arange(1, int(30.0 / step))
    sent = sum(len(stage.on_tracks([bearing(3), bearing(4)], float(time)).messages) for time in times)
    assert sent / 2 / 30.0 == pytest.approx(min(2.0, 1.0 / step), rel=0.05)


def test_an_error_of_the_fusion_node_is_told_in_its_words(stage):
    assert not stage.complaint(NOW)
    error = {'packet': b'123', 'error_message': ['node_id is no UUIDv4', 'no location']}
    assert not stage.on_message(from_fusion_node(error=error), PLACE, NOW).messages
    assert stage.complaint(NOW + 5.0) == 'reports an error: node_id is no UUIDv4; no location'
    assert not stage.complaint(NOW + 31.0) and stage.counts['errors of the fusion node'] == 1
    stage.on_message(b'rubbish', PLACE, NOW + 40.0)
    assert 'cannot be read by BSI Flex 335 v2.0' in stage.complaint(NOW + 41.0)


@pytest.mark.parametrize('stage', [False, True], indirect=True)
def test_requests_are_answered_whatever_tasks_are_obeyed(stage):
    stage.on_time(*health(PLACE), NOW)
    for wanted, kind in (('Registration', 'registration'), ('status', 'status_report')):
        answer = stage.on_message(task(command={'request': wanted}), PLACE, NOW)
        assert kinds(answer) == ['task_ack', kind, 'task_ack'] and answer.command is None
        assert [status for status, _ in acks(answer)] == [ACCEPTED, COMPLETED] and stage.desk.active is None


def test_a_changed_task_is_told_at_once(stage):
    stage.on_time(*health(PLACE), NOW)
    command, _ = begin(stage, command={'follow': {'follow_object_id': object_id(stage, 4)}})
    told, = read(stage.on_time(*health(PLACE), NOW + 0.2))
    assert told.status_report.active_task_id == stage.desk.active.task_id and command == Follow(4)
    assert not stage.on_time(*health(PLACE), NOW + 0.4).messages
    stage.on_message(task(Task.CONTROL_STOP, task_id=stage.desk.active.task_id), PLACE, NOW + 0.5)
    told, = read(stage.on_time(*health(PLACE), NOW + 0.6))
    assert not told.status_report.active_task_id and told.status_report.info == StatusReport.INFO_NEW


def test_the_region_that_is_offered_is_obeyed(stage):
    """An area of interest that is a direction: the registration names no other kind."""
    registered, = read(SapientStage(SapientSettings(NODE, obey_tasks=True)).on_connected(NOW))
    offered = registered.registration.mode_definition[0].task.region_definition
    assert list(offered.region_type) == [1] and [area.WhichOneof('coordinates_oneof') for area in offered.region_area] == [
        'range_bearing_units']
    command, answer = begin(stage, region=[FIELD])
    assert command == LookAt(0.0, pytest.approx(math.radians(10.0)), True) and acks(answer) == [(ACCEPTED, '')]


def test_positions_are_reported_likewise(stage):
    report, = read(SapientStage.on_tracks(stage, [bearing(3), bearing(4), position(9)], NOW + 0.1))
    assert report.detection_report.WhichOneof('location_oneof') == 'location'


def test_object_ids_are_forgotten_a_minute_after_their_tracks(stage):
    def name(after):
        found, = [one.detection_report.object_id for one in read(stage.on_tracks([bearing(3)], NOW + after))
                  if one.detection_report.state != 'lost']
        stage.on_tracks([], NOW + after + 1.0)
        return found

    first = name(1.0)
    assert name(60.0) == first and name(122.5) != first
    _, refused = begin(stage, now=NOW + 130.0, command={'look_at': NORTH}), stage.on_message(
        task(command={'follow': {'follow_object_id': first}}), PLACE, NOW + 130.0)
    assert acks(refused) == [(REJECTED, f'{first!r} is no object that is tracked')]


def test_names_of_objects_are_read_in_small_letters_too(stage):
    assert begin(stage, command={'follow': {'follow_object_id': object_id(stage, 4).lower()}})[0] == Follow(4)


@pytest.mark.parametrize('stage', [False], indirect=True)
def test_by_default_every_task_is_refused_with_the_reason(stage):
    for control in (Task.CONTROL_START, Task.CONTROL_STOP, Task.CONTROL_PAUSE):
        answer = stage.on_message(task(control, command={'follow': {'follow_object_id': object_id(stage, 3)}}), PLACE, NOW)
        (status, reason), = acks(answer)
        assert status == REJECTED and 'obey_tasks' in reason and answer.command is None
        assert read(answer)[0].destination_id == FUSION_NODE
    assert stage.desk.active is None and stage.desk.refused == 3


def test_follow_is_accepted_when_the_rig_follows(stage):
    command, answer = begin(stage, command={'follow': {'follow_object_id': object_id(stage, 4)}})
    assert command == Follow(4) and acks(answer) == [(ACCEPTED, '')]
    status, = read(stage.on_time(*health(), NOW))
    assert status.status_report.active_task_id == stage.desk.active.task_id
    lost = stage.on_tracks([bearing(3)], NOW + 1.0)
    assert acks(lost) == [(FAILED, 'the object is lost')] and lost.command == Stop() and stage.desk.active is None


def test_what_the_rig_cannot_do_is_refused_with_its_words(stage):
    _, answer = begin(stage, reason='no such track', command={'follow': {'follow_object_id': object_id(stage, 4)}})
    assert acks(answer) == [(REJECTED, 'no such track')] and stage.desk.active is None
    asked = stage.on_message(task(command={'follow': {'follow_object_id': object_id(stage, 4)}}), PLACE, NOW)
    assert acks(stage.on_time(*health(), NOW + 6.0)) == [(REJECTED, 'the rig does not answer')]
    assert not stage.on_done(asked.command, '', NOW + 7.0).messages


def test_look_at_turns_directions_and_places_into_azimuths_from_north(stage):
    command, answer = begin(stage, command={'look_at': {'range_bearing': {
        'azimuth': -90.0, 'elevation': 10.0, 'coordinate_system': 1, 'datum': 1}}})
    assert command == LookAt(pytest.approx(1.5 * math.pi), pytest.approx(math.radians(10.0)), True)
    assert acks(answer) == [(ACCEPTED, '')]
    command, answer = begin(stage, command={'look_at': {'location_list': {'locations': [
        {'x': -0.12, 'y': 51.51, 'z': 30.0, 'coordinate_system': 1, 'datum': 1}]}}})
    assert command.azimuth % math.tau == pytest.approx(0.0, abs=1e-6) and command.elevation == pytest.approx(0.0, abs=1e-3)
    assert acks(answer) == [(COMPLETED, 'another task has taken its place'), (ACCEPTED, '')]


@pytest.mark.parametrize('content, reason', [
    ({'command': {'follow': {'follow_object_id': new_ulid()}}}, 'is no object that is tracked'),
    ({'command': {'move_to': {'locations': [{'x': 0.0, 'y': 0.0, 'coordinate_system': 1, 'datum': 1}]}}},
     'move_to is not supported'),
    ({'command': {'request': 'fire'}}, "'fire' is not supported, only Registration and Status"),
    ({'region': [{**FIELD, 'type': 2}]}, 'one area of interest'),
    ({'region': [FIELD], 'command': {'follow': {'follow_object_id': new_ulid()}}}, 'one area of interest'),
    ({}, 'without a command is not supported'),
    ({'command': {'look_at': {'range_bearing': {'azimuth': 0.0, 'coordinate_system': 1, 'datum': 2}}}}, 'true north'),
    ({'command': {'look_at': {'range_bearing': {'elevation': 0.0, 'coordinate_system': 1, 'datum': 1}}}}, 'no azimuth'),
    ({'command': {'look_at': {'range_bearing': {'azimuth': 0.0, 'elevation': 91.0, 'coordinate_system': 1, 'datum': 1}}}},
     '91 deg'),
    ({'command': {'look_at': {'location_list': {'locations': [
        {'x': 0.0, 'y': 0.0, 'coordinate_system': 1, 'datum': 1}]}}}}, 'an altitude'),
    ({'command': {'look_at': {'location_list': {'locations': [
        {'x': 500000.0, 'y': 5e6, 'z': 0.0, 'coordinate_system': 5, 'datum': 1}]}}}}, 'degrees on the ellipsoid'),
    ({'command': {'look_at': {'location_list': {'locations': [
        {'x': -0.12, 'y': 51.5, 'z': 30.0, 'coordinate_system': 1, 'datum': 1}]}}}}, 'that of this node'),
    ({'control': Task.CONTROL_PAUSE}, 'started and stopped only'),
    ({'control': Task.CONTROL_STOP}, 'does not perform that task'),
])
def test_what_is_not_understood_is_refused_with_the_reason(stage, content, reason):
    answer = stage.on_message(task(**content), PLACE, NOW)
    (status, words), = acks(answer)
    assert status == REJECTED and reason in words and answer.command is None and stage.desk.active is None


def test_a_place_is_no_direction_for_a_rig_that_does_not_know_where_it_stands(stage):
    answer = stage.on_message(task(command={'look_at': {'location_list': {'locations': [
        {'x': -0.12, 'y': 51.51, 'z': 30.0, 'coordinate_system': 1, 'datum': 1}]}}}), None, NOW)
    assert acks(answer) == [(REJECTED, 'this node does not know where it stands')]


def test_a_task_ends_by_a_stop_by_its_time_and_with_the_connection(stage):
    follow = {'follow': {'follow_object_id': object_id(stage, 3)}}
    name = new_ulid()
    begin(stage, task_id=name, command=follow)
    stopped = stage.on_message(task(Task.CONTROL_STOP, task_id=name), PLACE, NOW + 1)
    assert acks(stopped) == [(COMPLETED, 'stopped')] and stopped.command == Stop()
    begin(stage, command=follow)
    assert stage.on_time(*health(), NOW + HOUR_S - 1.0).command is None
    over = stage.on_time(*health(), NOW + HOUR_S)
    assert acks(over) == [(COMPLETED, 'its time is over')] and over.command == Stop()
    begin(stage, command=follow)
    assert stage.on_disconnected().command == Stop() and stage.desk.active is None
    assert stage.on_disconnected().command is None


def test_a_refused_registration_ends_the_task_and_allows_none(stage):
    begin(stage, command={'follow': {'follow_object_id': object_id(stage, 3)}})
    assert stage.on_message(acknowledgement(False), PLACE, NOW).command == Stop() and stage.desk.active is None
    assert acks(stage.on_message(task(command={'look_at': NORTH}), PLACE, NOW)) == [(REJECTED, 'this node is not registered')]


def test_a_task_that_is_stopped_while_it_begins_leaves_the_former_one(stage):
    """The rig may have obeyed already."""
    follow, name = {'follow': {'follow_object_id': object_id(stage, 4)}}, new_ulid()
    for former, left in ((None, Stop()), (NORTH, LookAt(0.0, pytest.approx(math.radians(10.0)), True))):
        if former:
            begin(stage, command={'look_at': former})
        asked = stage.on_message(task(task_id=name, command=follow), PLACE, NOW)
        stopped = stage.on_message(task(Task.CONTROL_STOP, task_id=name), PLACE, NOW)
        assert acks(stopped) == [(COMPLETED, 'stopped')] and stopped.command == left
        assert not stage.on_done(asked.command, '', NOW).messages and bool(stage.desk.active) is bool(former)


def test_a_task_that_ends_while_another_begins_stops_nothing_until_that_is_refused(stage):
    name = new_ulid()
    begin(stage, task_id=name, command={'look_at': NORTH})
    asked = stage.on_message(task(command={'follow': {'follow_object_id': object_id(stage, 4)}}), PLACE, NOW)
    assert stage.on_message(task(Task.CONTROL_STOP, task_id=name), PLACE, NOW).command is None
    assert stage.on_done(asked.command, 'no such track', NOW).command == Stop()


@pytest.mark.parametrize('values, reason', [({'task_start_time': {'seconds': 2**62}}, 'begin later'),
                                            ({'task_end_time': {'nanos': 2**31 - 1}}, 'has ended before')])
def test_times_that_are_none_are_answered(stage, values, reason):
    (status, words), = acks(stage.on_message(task(command={'look_at': NORTH}, **values), PLACE, NOW))
    assert status == REJECTED and reason in words


def test_a_clock_that_is_set_back_silences_nothing(stage):
    stage.on_time(*health(), NOW)
    stage.on_message(b'rubbish', PLACE, NOW)
    begin(stage, command={'look_at': NORTH})
    before = NOW - 86_400.0
    assert kinds(stage.on_tracks([bearing(3), bearing(4)], before)) == ['detection_report'] * 2
    assert kinds(stage.on_message(b'rubbish', PLACE, before)) == ['error']
    ended = stage.on_time(*health(), before)
    assert acks(ended) == [(COMPLETED, 'its time is over')] and kinds(ended) == ['task_ack', 'status_report']
    assert not stage.on_tracks([bearing(3), bearing(4)], before + 0.1).messages


def test_who_asked_for_a_task_is_told_of_its_end(stage):
    other = '00000000-0000-4000-8000-000000000001'
    begin(stage, command={'look_at': NORTH})
    refused = stage.on_message(from_fusion_node(node_id=other, task=Task(task_id=new_ulid(), control=1)), PLACE, NOW)
    over = stage.on_time(*health(), NOW + HOUR_S)
    assert [message.destination_id for reaction in (refused, over) for message in read(reaction)
            if message.HasField('task_ack')] == [other, FUSION_NODE]


def test_messages_for_others_are_not_answered(stage):
    other = from_fusion_node('00000000-0000-4000-8000-000000000001', task=Task(task_id=new_ulid(), control=1))
    assert stage.on_message(other, PLACE, NOW) == ((), None) and stage.counts['messages for others'] == 1


def test_unusable_messages_are_answered_once_a_second_with_a_piece_of_them(stage):
    error, = read(stage.on_message(b'\xff' * 50_000, PLACE, NOW))
    assert error.error.packet == b'\xff' * LONGEST_PACKET and error.error.error_message
    assert not stage.on_message(from_fusion_node(task=Task(control=1)), PLACE, NOW + 0.5).messages
    assert 'task.task_id is missing' in stage.complaint(NOW + 0.5) and stage.counts['unusable messages'] == 2
    error, = read(stage.on_message(b'\x00', PLACE, NOW + 1.0))
    assert error.WhichOneof('content') == 'error'
