"""What the algorithms say, as messages for a bag."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from av_bags import topics as names
from av_bags.definitions import definition, parse


class MessageMaker:
    """Makes messages, and bytes of them. `frame` is the body's."""

    def __init__(self, frame: str = 'base_link') -> None:
        self.frame = frame
        self._store = get_typestore(Stores.EMPTY)
        kinds = [names.KINDS[name][0] for name in (names.DOA, names.DETECTIONS, names.VISIBILITY, names.BEARING, names.STATE,
                                                   names.COMMAND)]
        self._store.register({name: fields for kind in kinds for name, fields in parse(
            kind, MessageDefinition(MessageDefinitionFormat.MSG, definition(kind))).items()})
        self._types = self._store.types

    def serialise(self, message: Any, name: str = '') -> memoryview:
        """A message as CDR: one of rosbags, or one of the topic `name` that has the same fields."""
        return self._store.serialize_cdr(message, names.KINDS[name][0] if name else message.__msgtype__)

    def deserialise(self, name: str, data: bytes | memoryview) -> Any:
        """The message of a topic (its name in the rig), of CDR."""
        return self._store.deserialize_cdr(data, names.KINDS[name][0])

    def output(self, name: str, content: Any) -> bytes | memoryview:
        """What a stage said, as CDR."""
        return content if isinstance(content, bytes | memoryview) else self.serialise(content, name)

    def header(self, time: float, frame: str) -> Any:
        """A std_msgs/Header."""
        stamp = divmod(round(time * 1e9), 10**9)
        return self._types['std_msgs/msg/Header'](self._types['builtin_interfaces/msg/Time'](*stamp), frame)
