"""What a task asks of the tracker: a command that comes before the answer takes its place."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from rclpy.task import Future

from av_interfaces.srv import SelectTarget
from av_reports import Follow, LookAt, Stop
from av_reports.nodes.rig_commands import BY_POLICY, RigCommands

NORTH = LookAt(0.0, 0.0, True)


class Rig:
    """A tracker whose answers are given by hand, and a gimbal that takes cues."""

    def __init__(self):
        self.asked, self.answers, self.cues, self.done = [], [], [], []
        client = SimpleNamespace(srv_name='select', service_is_ready=lambda: True, call_async=self.call)
        cues = SimpleNamespace(get_subscription_count=lambda: 1, publish=self.cues.append)
        node = SimpleNamespace(create_client=lambda *_: client, create_publisher=lambda *_: cues)
        self.commands = RigCommands(node, True, lambda: 0.0)

    def call(self, request):
        self.asked.append(request.id)
        self.answers.append(Future())
        return self.answers[-1]

    def perform(self, command):
        self.commands.perform(command, self.done.append)

    def answer(self, number, success=True):
        self.answers[number].set_result(SelectTarget.Response(success=success))


@pytest.mark.parametrize('next_one', [Stop(), NORTH])
def test_what_comes_before_the_answer_of_the_tracker_takes_its_place(next_one):
    """A tracker answers in order: it is asked to choose by itself after it has selected."""
    rig = Rig()
    rig.perform(Follow(3))
    rig.perform(next_one)
    rig.answer(0)
    assert rig.asked == [3, BY_POLICY]
    rig.commands.repeat()
    assert len(rig.cues) == (2 if next_one == NORTH else 0)
    rig.perform(Stop())
    assert rig.asked == [3, BY_POLICY], 'nothing is followed any more'


def test_a_refusal_changes_nothing():
    rig = Rig()
    rig.perform(NORTH)
    rig.perform(Follow(3))
    rig.answer(0, success=False)
    rig.commands.repeat()
    assert rig.done == ['', 'the tracker refuses'] and len(rig.cues) == 2
    rig.perform(Stop())
    assert rig.asked == [3]
