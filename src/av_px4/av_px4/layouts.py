"""Names of PX4's topics, and whether their messages have the fields of the installed px4_msgs.

DDS compares the names of types only: a message of another firmware is decoded all the same, into numbers that mean nothing. PX4
1.15 and later tell a hash of a topic's fields on request (`message_format_request`).

Names of topics may end in the version of their message. An agent that outlives a change of the firmware goes on offering the
topics of the former one. Of the versions that are offered only that of the installed px4_msgs can be read. Another one that
sends while that one is silent shows that px4_msgs belongs to another firmware.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping

PROTOCOL = 1         # protocol_version of request and response
ANSWER_S = 0.3       # time for an answer
TRIES = 5            # of one question, after which PX4 counts as mute
BASIC = frozenset({'bool', 'byte', 'char', 'float32', 'float64', 'string', 'wstring',
                   *(f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64))})
_FIELD = re.compile(r'^\s*([a-zA-Z0-9_/]+)(\[[^\]]*\])?[ \t]+(\w+)[ \t]*(=)?', re.MULTILINE)
SILENT_S = 2.0    # time without a message after which a topic is not alive, and PX4 that reads no questions (1.14) is mute


def layout_hash(kind: str, definition: Callable[[str], str]) -> int:
    """PX4's hash of a message: FNV-1a of 32 bits (RFC 9923) over types and names of its fields, nested ones included.

    Parameters:
        kind: name of the message
        definition: gives the text of a message's definition by its name
    """
    value = 0x811C9DC5
    for byte in _fields(kind, definition).encode():
        value = (value ^ byte) * 0x01000193 & 0xFFFFFFFF
    return value


def _fields(kind: str, definition: Callable[[str], str]) -> str:
    text = ''
    for base, array, name, constant in _FIELD.findall(definition(kind)):
        if not constant:
            text += f'{base}{array} {name}\n' + ('' if base in BASIC else _fields(base, definition))
    return text


class LayoutCheck:
    """Asks PX4 for the hashes of topics, one after the other.

    Attributes:
        mute: PX4 cannot be asked, or does not answer; its messages are then taken as they are.

    Parameters:
        hash_of: gives the hash of a message of the installed px4_msgs by its name, None where its definition is missing.
    """

    def __init__(self, hash_of: Callable[[str], int | None]) -> None:
        self.mute = False
        self._hash_of = hash_of
        self._kinds: dict[str, str] = {}     # topics, and their messages
        self._open: dict[str, None] = {}     # topics to ask for, in order
        self._equal: dict[str, bool] = {}    # what PX4 said of them
        self._asked, self._tries, self._until = '', 0, 0.0

    def begin(self) -> None:
        """Ask for all topics, also for those that are known: PX4 may be another one. What it said before holds until then."""
        self.mute, self._asked, self._until = False, '', 0.0
        self._open = dict.fromkeys(self._kinds)

    def add(self, topic: str, kind: str) -> None:
        """Have a topic (such as `out/vehicle_status`) with the message `kind` checked."""
        if self._kinds.setdefault(topic, kind) == kind and topic not in self._equal:
            self._open[topic] = None

    def question(self, time: float) -> str | None:
        """The topic to ask for at `time` (s, monotonic), None if nothing is due."""
        if not self._open or self.mute or time < self._until:
            return None
        topic = next(iter(self._open))
        self._tries = self._tries + 1 if self._asked == topic else 1
        self._asked, self._until = topic, time + ANSWER_S
        self.mute = self._tries > TRIES
        return None if self.mute else self._asked

    def answer(self, topic: str, success: bool, message_hash: int) -> None:
        """Process an answer; what PX4 does not know counts as equal.

        Parameters:
            topic: as in the question
            success, message_hash: fields of MessageFormatResponse
        """
        if topic == self._asked:
            self._equal[topic] = not success or self._hash_of(self._kinds[topic]) in (message_hash, None)
            self._open.pop(topic, None)
            self._asked, self._until = '', 0.0

    def may_use(self, topic: str) -> bool:
        """Whether a topic's messages may be decoded and sent: PX4 said so, or cannot say."""
        return self._equal.get(topic, self.mute)

    def problem(self, topic: str) -> str:
        """What is wrong with a topic; empty if nothing is known to be."""
        if self._equal.get(topic, True):
            return ''
        return (f'{topic} is not used: the fields of {self._kinds[topic]} in the firmware are not those of the installed '
                'px4_msgs: build the branch of px4_msgs that belongs to the firmware')


def offered_versions(base: str, names: Iterable[str]) -> dict[int, str]:
    """Topics by version; 0 is the one without a suffix.

    Parameters:
        base: name without version
        names: names of existing topics; those that count are `base` and `base_v<N>`
    """
    return {int(match.group(1) or 0): name for name in names
            if (match := re.fullmatch(rf'{re.escape(base)}(?:_v(\d+))?', name))}


def version_of(message_type: type) -> int:
    """Version of a message in the installed px4_msgs; 0 where it has none."""
    return int(getattr(message_type, 'MESSAGE_VERSION', 0))


def mismatch(message_type: type, offered: Mapping[int, str], ages: Mapping[str, float]) -> str:
    """Why a message cannot be received by any of the versions that are offered; empty if it can.

    Parameters:
        message_type: class of px4_msgs.msg
        offered: topics by version
        ages (s): time since the newest message of each topic; inf before the first
    """
    known = version_of(message_type)
    if not offered or (known in offered and ages.get(offered[known], math.inf) <= SILENT_S):
        return ''
    others = sorted(version for version in offered if version != known)
    alive = [version for version in others if ages.get(offered[version], math.inf) <= SILENT_S]
    if known in offered and not alive:
        return ''    # nobody sends: that is reported by what misses it
    sent = (alive or others)[-1]
    return (f'{offered[sent]} is version {sent} of {message_type.__name__}, the installed px4_msgs has version {known}'
            + (f', and {offered[known]} is silent' if known in offered else '')
            + ': build the branch of px4_msgs that belongs to the firmware (release/1.16 for 1.16)')
