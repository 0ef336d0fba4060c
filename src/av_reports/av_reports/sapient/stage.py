"""The session of a node with its fusion node: tracks and bytes in, bytes and commands out. It knows no sockets and no ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from av_reports.contacts import BearingTrack, Command, Place, PositionTrack, is_due
from av_reports.identifiers import ObjectIds
from av_reports.sapient.encoder import (
    LONGEST_REASON,
    bearing_report,
    envelope,
    position_report,
    status_report,
)
from av_reports.sapient.protocol import ICD_VERSION, Error, Task, TaskAck
from av_reports.sapient.registration import REQUESTS, STATUS_S, registration_message
from av_reports.sapient.tasks import Reaction, TaskDesk
from av_reports.sapient.validation import check, parse
from av_reports.settings import SapientSettings

REPORT_S = 0.5  # between two reports of an object
AGAIN_S = 30.0  # after this time without an acknowledgement a node registers again
LONGEST_PACKET = 1024  # bytes of an unusable message that are sent back
ERROR_INTERVAL_S = 1.0  # at most one error in this time is sent, whatever comes
Reported = BearingTrack | PositionTrack


@dataclass
class Session:
    """What ends with a connection.

    Attributes:
        accepted: whether the fusion node has accepted the registration.
        refusal: why it has not; empty while it has not answered.
        registered, status_sent (s): when the registration and the newest status report were sent.
        shown: place, problems, error and task of the newest status report; empty before the first.
        reported: by id, each track as it was reported last, and from when on (s) it may be reported again.
        error, error_time (s): what is wrong between both by its newest message about that, and when; empty before the first.
    """

    accepted: bool = False
    refusal: str = ''
    registered: float = -math.inf
    status_sent: float = -math.inf
    shown: tuple[Any, ...] = ()
    reported: dict[int, tuple[Reported, float]] = field(default_factory=dict)
    error: str = ''
    error_time: float = -math.inf


class SapientStage:
    """A node of SAPIENT: it registers, reports once it has been accepted, and answers tasks.

    All times are UTC in s since 1970.

    Attributes:
        desk: the tasks.
        session: what ends with the connection.
        counts: numbers of what was sent and received, by name.

    Parameters:
        settings: what the node is and does.
    """

    def __init__(self, settings: SapientSettings) -> None:
        self._settings = settings
        self._objects = ObjectIds()
        self.desk = TaskDesk(self._objects, settings.obey_tasks, self._pack)
        self._newest_error = -math.inf
        self.counts = dict.fromkeys(('detection reports', 'status reports', 'unusable messages', 'messages for others',
                                     'errors of the fusion node'), 0)
        self.session = Session()

    def complaint(self, now: float) -> str:
        """What is wrong with a message of either; empty after AGAIN_S without another one."""
        return '' if is_due(now, self.session.error_time, AGAIN_S) else self.session.error

    def on_connected(self, now: float) -> Reaction:
        """Register with a fusion node that has just been connected to."""
        self.session = Session(registered=now)
        return Reaction((self._pack(now, registration=registration_message(self._settings)),))

    def on_disconnected(self) -> Reaction:
        """End the task, as nobody watches over it any longer."""
        self.session = Session()
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
            self.session.accepted = answer.acceptance
            self.session.refusal = '' if answer.acceptance else '; '.join(answer.ack_response_reason)[:LONGEST_REASON]
            return Reaction(command=None if answer.acceptance else self.desk.abandon())
        if kind == 'error':
            self.counts['errors of the fusion node'] += 1
            words = '; '.join(message.error.error_message)[:LONGEST_REASON] or 'without words'
            self.session.error, self.session.error_time = f'reports an error: {words}', now
        elif kind == 'task':
            task, asker = message.task, message.node_id
            if task.control == Task.CONTROL_START and task.command.WhichOneof('command') == 'request':
                return self._on_request(task, asker, now)
            if not self.session.accepted:
                return self.desk.refuse(task.task_id, asker, 'this node is not registered', now)
            return self.desk.on_task(task, asker, place, now)
        return Reaction()

    def on_done(self, command: Command, reason: str, now: float) -> Reaction:
        """The rig has begun what the command of a task asked, or cannot.

        Parameters:
            command: what was asked.
            reason: why it cannot; empty if it has begun.
            now (s): the time.
        """
        return self.desk.on_done(command, reason, now)

    def on_tracks(self, tracks: Sequence[Reported], now: float) -> Reaction:
        """Report tracks, and for the last time those that are no longer among them.

        Parameters:
            tracks: all that are to be reported; of the kind that the settings name.
            now (s): the time.
        """
        if not self.session.accepted:
            return Reaction()
        reported = self.session.reported
        messages: list[bytes] = []
        command = None
        for gone in set(reported) - {track.id for track in tracks}:
            messages.append(self._detection(reported.pop(gone)[0], now, lost=True))
            ended = self.desk.on_lost(gone, now)
            messages += ended.messages
            command = ended.command or command
        for track in tracks:
            due = reported[track.id][1] if track.id in reported else now
            if not due - REPORT_S <= now < due:
                # On a grid of its own: what is looked for some times a second is else reported at a fraction of that rate.
                reported[track.id] = (track, due + REPORT_S if 0.0 <= now - due < REPORT_S else now + REPORT_S)
                messages.append(self._detection(track, now))
        return Reaction(tuple(messages), command)

    def on_time(self, place: Place | None, problems: tuple[str, ...], error: bool, now: float) -> Reaction:
        """Report the rig's state when that is due or has changed, and end what has taken its time.

        Parameters:
            place: where the rig stands; None while unknown.
            problems: what is wrong, in words.
            error: whether it detects nothing because of it.
            now (s): the time.
        """
        if not self.session.accepted:
            return self.on_connected(now) if is_due(now, self.session.registered, AGAIN_S) else Reaction()
        ended = self.desk.on_time(now)
        shown = (place, problems, error, self._task)
        changed = shown != self.session.shown
        if changed or is_due(now, self.session.status_sent, STATUS_S):
            self.session.shown, self.session.status_sent = shown, now
            return ended._replace(messages=(*ended.messages, self._status(shown, changed, now)))
        return ended

    def farewell(self, now: float) -> Reaction:
        """The last status report of a node that is about to disconnect."""
        shown = (None, (), False, self._task)
        return Reaction((self._status(shown, True, now, goodbye=True),) if self.session.accepted else ())

    def _on_request(self, task: Any, asker: str, now: float) -> Reaction:
        """Answer a task that asks for a message. It moves nothing, so it is answered whatever tasks are obeyed."""
        wanted, shown = task.command.request.strip().lower(), self.session.shown
        if wanted not in map(str.lower, REQUESTS) or (wanted == 'status' and not shown):
            return self.desk.refuse(task.task_id, asker, f'{task.command.request!r:.40} is not supported, only '
                                    f'{" and ".join(REQUESTS)}', now)
        accepted, done = (self.desk.ack(task.task_id, asker, now, state)
                          for state in (TaskAck.TASK_STATUS_ACCEPTED, TaskAck.TASK_STATUS_COMPLETED))
        answer = (self._pack(now, registration=registration_message(self._settings)) if wanted != 'status'
                  else self._status(shown, False, now))
        return Reaction((accepted, answer, done))

    @property
    def _task(self) -> str:
        return self.desk.active.task_id if self.desk.active else ''

    def _on_unusable(self, data: bytes, reason: str, now: float) -> Reaction:
        self.counts['unusable messages'] += 1
        self.session.error_time = now
        self.session.error = (f'sends what cannot be read by {ICD_VERSION}, the only version spoken here: '
                              f'{reason[:LONGEST_REASON]}')
        if not is_due(now, self._newest_error, ERROR_INTERVAL_S):
            return Reaction()
        self._newest_error = now
        error = Error(packet=data[:LONGEST_PACKET], error_message=[reason[:LONGEST_REASON]])
        return Reaction((self._pack(now, error=error),))

    def _detection(self, track: Reported, now: float, lost: bool = False) -> bytes:
        """The report of a track, stamped with the instant for which it holds."""
        self.counts['detection reports'] += 1
        object_id = self._objects.ulid(track.id, now)
        report = (bearing_report(track, object_id, now, lost) if isinstance(track, BearingTrack)
                  else position_report(track, object_id, now, lost))
        return self._pack(now if lost else track.time, detection_report=report)

    def _status(self, shown: tuple[Any, ...], changed: bool, now: float, goodbye: bool = False) -> bytes:
        self.counts['status reports'] += 1
        place, problems, error, task = shown
        return self._pack(now, status_report=status_report(now, changed, place, problems, error=error, goodbye=goodbye,
                                                           task_id=task))

    def _pack(self, now: float, destination: str = '', **content: Any) -> bytes:
        """A message as it is sent. Raises ValueError, a fault of this program, where the standard does not allow it."""
        message = envelope(self._settings.node_id, now, destination, **content)
        check(message)
        return bytes(message.SerializeToString())
