"""The session of a node with its fusion node: tracks and bytes in, bytes and commands out. It knows no sockets and no ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from av_reports.contacts import BearingTrack, Place, PositionTrack, is_due
from av_reports.identifiers import ObjectIds
from av_reports.sapient.encoder import (
    LONGEST_REASON,
    bearing_report,
    envelope,
    position_report,
    status_report,
    task_ack,
)
from av_reports.sapient.protocol import ICD_VERSION, Error, Task, TaskAck
from av_reports.sapient.registration import REQUESTS, STATUS_S, registration_message
from av_reports.sapient.task_desk import Answer, TaskDesk
from av_reports.sapient.validation import check, parse
from av_reports.settings import SapientSettings
from av_reports.tasking import Command

REPORT_S = 0.5  # between two reports of an object
AGAIN_S = 30.0  # after this time without an acknowledgement a node registers again
LONGEST_PACKET = 1024  # bytes of an unusable message that are sent back
ERROR_INTERVAL_S = 1.0  # at most one error in this time is sent, whatever comes
Reported = BearingTrack | PositionTrack


class Reaction(NamedTuple):
    """What follows from an event: messages to send, each without its length, and what the rig is to do; None for nothing."""

    messages: tuple[bytes, ...] = ()
    command: Command | None = None


class Health(NamedTuple):
    """What a status report says of the rig.

    Parameters:
        place: where it stands; None while unknown.
        problems: what is wrong, in words.
        error: whether it detects nothing because of it.
    """

    place: Place | None = None
    problems: tuple[str, ...] = ()
    error: bool = False


@dataclass
class _Session:
    """What ends with a connection.

    Attributes:
        accepted, refusal: see `SapientStage`.
        registered, status_sent (s): when the registration and the newest status report were sent.
        shown: health and task of the newest status report; None before the first.
        reported: by id, each track as it was reported last, and from when on (s) it may be reported again.
        error, error_time (s): what is wrong between both by its newest message about that, and when; empty before the first.
    """

    accepted: bool = False
    refusal: str = ''
    registered: float = -math.inf
    status_sent: float = -math.inf
    shown: tuple[Health, str] | None = None
    reported: dict[int, tuple[Reported, float]] = field(default_factory=dict)
    error: str = ''
    error_time: float = -math.inf


class SapientStage:
    """A node of SAPIENT: it registers, reports once it has been accepted, and answers tasks.

    All times are UTC in s since 1970.

    Attributes:
        problem: what was wrong with the newest unusable message.
        desk: the tasks.
        counts: numbers of what was sent and received, by name.

    Parameters:
        settings: what the node is and does.
    """

    def __init__(self, settings: SapientSettings) -> None:
        self._settings = settings
        self._objects = ObjectIds()
        self.desk = TaskDesk(self._objects, settings.obey_tasks)
        self._taskers: dict[str, str] = {}  # UUIDs of the fusion nodes that asked last for the present tasks, by the tasks' ids
        self._newest_error, self.problem = -math.inf, ''
        self.counts = dict.fromkeys(('detection reports', 'status reports', 'unusable messages', 'messages for others',
                                     'errors of the fusion node'), 0)
        self._session = _Session()

    @property
    def accepted(self) -> bool:
        """Whether the fusion node has accepted the registration."""
        return self._session.accepted

    @property
    def refusal(self) -> str:
        """Why it has not; empty while it has not answered."""
        return self._session.refusal

    def complaint(self, now: float) -> str:
        """What is wrong with a message of either; empty after AGAIN_S without another one."""
        return '' if is_due(now, self._session.error_time, AGAIN_S) else self._session.error

    def on_connected(self, now: float) -> Reaction:
        """Register with a fusion node that has just been connected to."""
        self._session = _Session(registered=now)
        return Reaction((self._pack(now, registration=registration_message(self._settings)),))

    def on_disconnected(self) -> Reaction:
        """End the task, as nobody watches over it any longer."""
        self._session = _Session()
        return Reaction(command=self.desk.abandon())

    def on_message(self, data: bytes, place: Place | None, now: float) -> Reaction:
        """Answer a message of the fusion node.

        Parameters:
            data: the message without its length.
            place: where the rig stands; None while unknown.
            now (s): time of its arrival.
        """
        try:
            message = parse(data)
        except ValueError as error:
            return self._on_unusable(data, str(error), now)
        if message.destination_id and message.destination_id.lower() != self._settings.node_id:
            self.counts['messages for others'] += 1
            return Reaction()
        kind = message.WhichOneof('content')
        if kind == 'registration_ack':
            answer = message.registration_ack
            self._session.accepted = answer.acceptance
            self._session.refusal = '' if answer.acceptance else '; '.join(answer.ack_response_reason)[:LONGEST_REASON]
            return Reaction(command=None if answer.acceptance else self.desk.abandon())
        if kind == 'error':
            self.counts['errors of the fusion node'] += 1
            words = '; '.join(message.error.error_message)[:LONGEST_REASON] or 'without words'
            self._session.error, self._session.error_time = f'reports an error: {words}', now
        elif kind == 'task':
            self._taskers[message.task.task_id] = message.node_id
            if message.task.control == Task.CONTROL_START and message.task.command.WhichOneof('command') == 'request':
                return self._on_request(message.task, now)
            if not self.accepted:
                return self._answer(self.desk.refuse(message.task.task_id, 'this node is not registered'), now)
            return self._answer(self.desk.on_task(message.task, place, now), now)
        return Reaction()

    def on_done(self, command: Command, reason: str, now: float) -> Reaction:
        """The rig has begun what the command of a task asked, or cannot.

        Parameters:
            command: what was asked.
            reason: why it cannot; empty if it has begun.
            now (s): the time.
        """
        return self._answer(self.desk.on_done(command, reason), now)

    def on_tracks(self, tracks: Sequence[Reported], now: float) -> Reaction:
        """Report tracks, and for the last time those that are no longer among them.

        Parameters:
            tracks: all that are to be reported; of the kind that the settings name.
            now (s): the time.
        """
        if not self.accepted:
            return Reaction()
        reported = self._session.reported
        messages: list[bytes] = []
        command = None
        for gone in set(reported) - {track.id for track in tracks}:
            messages.append(self._detection(reported.pop(gone)[0], now, lost=True))
            ended = self._answer(self.desk.on_lost(gone), now)
            messages += ended.messages
            command = ended.command or command
        for track in tracks:
            due = reported[track.id][1] if track.id in reported else now
            if not due - REPORT_S <= now < due:
                # On a grid of its own: what is looked for some times a second is else reported at a fraction of that rate.
                reported[track.id] = (track, due + REPORT_S if 0.0 <= now - due < REPORT_S else now + REPORT_S)
                messages.append(self._detection(track, now))
        return Reaction(tuple(messages), command)

    def on_time(self, health: Health, now: float) -> Reaction:
        """Report the rig's state when that is due or has changed, and end what has taken its time.

        Parameters:
            health: state of the rig.
            now (s): the time.
        """
        if not self.accepted:
            return self.on_connected(now) if is_due(now, self._session.registered, AGAIN_S) else Reaction()
        ended = self._answer(self.desk.on_time(now), now)
        shown = (health, self._task)
        changed = shown != self._session.shown
        if changed or is_due(now, self._session.status_sent, STATUS_S):
            self._session.shown, self._session.status_sent = shown, now
            return ended._replace(messages=(*ended.messages, self._status(health, changed, now)))
        return ended

    def farewell(self, now: float) -> Reaction:
        """The last status report of a node that is about to disconnect."""
        return Reaction((self._status(Health(), True, now, goodbye=True),) if self.accepted else ())

    def _on_request(self, task: Any, now: float) -> Reaction:
        """Answer a task that asks for a message. It moves nothing, so it is answered whatever tasks are obeyed."""
        wanted, shown = task.command.request.strip().lower(), self._session.shown
        if wanted not in map(str.lower, REQUESTS) or (wanted == 'status' and shown is None):
            return self._answer(self.desk.refuse(task.task_id, f'{task.command.request!r:.40} is not supported, only '
                                                 f'{" and ".join(REQUESTS)}'), now)
        states = TaskAck.TASK_STATUS_ACCEPTED, TaskAck.TASK_STATUS_COMPLETED
        accepted, done = self._answer(Answer(tuple(task_ack(task.task_id, state) for state in states)), now).messages
        answer = (self._pack(now, registration=registration_message(self._settings)) if shown is None or wanted != 'status'
                  else self._status(shown[0], False, now))
        return Reaction((accepted, answer, done))

    @property
    def _task(self) -> str:
        return self.desk.active.task_id if self.desk.active else ''

    def _on_unusable(self, data: bytes, reason: str, now: float) -> Reaction:
        self.counts['unusable messages'] += 1
        self.problem = reason
        self._session.error_time = now
        self._session.error = (f'sends what cannot be read by {ICD_VERSION}, the only version spoken here: '
                               f'{reason[:LONGEST_REASON]}')
        if not is_due(now, self._newest_error, ERROR_INTERVAL_S):
            return Reaction()
        self._newest_error = now
        error = Error(packet=data[:LONGEST_PACKET], error_message=[reason[:LONGEST_REASON]])
        return Reaction((self._pack(now, error=error),))

    def _answer(self, answer: Answer, now: float) -> Reaction:
        messages = tuple(self._pack(now, self._taskers[ack.task_id], task_ack=ack) for ack in answer.acks)
        self._taskers = {task: tasker for task, tasker in self._taskers.items() if task in self.desk.tasks}
        return Reaction(messages, answer.command)

    def _detection(self, track: Reported, now: float, lost: bool = False) -> bytes:
        """The report of a track, stamped with the instant for which it holds."""
        self.counts['detection reports'] += 1
        object_id = self._objects.ulid(track.id, now)
        report = (bearing_report(track, object_id, now, lost) if isinstance(track, BearingTrack)
                  else position_report(track, object_id, now, lost))
        return self._pack(now if lost else track.time, detection_report=report)

    def _status(self, health: Health, changed: bool, now: float, goodbye: bool = False) -> bytes:
        self.counts['status reports'] += 1
        return self._pack(now, status_report=status_report(now, changed, health.place, health.problems, error=health.error,
                                                           goodbye=goodbye, task_id=self._task))

    def _pack(self, now: float, destination: str = '', **content: Any) -> bytes:
        """A message as it is sent. Raises ValueError, a fault of this program, where the standard does not allow it."""
        message = envelope(self._settings.node_id, now, destination, **content)
        check(message)
        return bytes(message.SerializeToString())
