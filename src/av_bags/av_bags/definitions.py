"""Message definitions: those of installed packages, and those that bags contain."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

SEPARATOR = '=' * 80 + '\n'  # of the parts of a definition, by rosbag2
# Definitions of a package that many bags use and few systems have installed. Another package of this name has other ones.
AUDIO_PACKAGE = 'audio_common_msgs/'
AUDIO_COMMON = {'audio_common_msgs/msg/AudioData': 'uint8[] data\n',
                'audio_common_msgs/msg/AudioDataStamped': 'std_msgs/Header header\naudio_common_msgs/AudioData audio\n',
                'audio_common_msgs/msg/AudioInfo': 'uint8 channels\nuint32 sample_rate\nstring sample_format\n'
                                                   'uint32 bitrate\nstring coding_format\n'}


class BagError(ValueError):
    """A bag cannot be read or written; the message names the bag and the reason."""


class UnknownTypeError(BagError):
    """A message type has no definition, neither in the bag nor among the installed packages."""


@cache
def definition(name: str) -> str:
    """The installed definition (ros2msg) of the message `name` ('package/msg/Type') and of the types of its fields.

    Raises UnknownTypeError when the package is not installed or lacks the message.
    """
    texts: dict[str, str] = {}
    waiting = [name]
    while waiting:
        kind = waiting.pop(0)
        if kind not in texts:
            texts[kind] = _text(kind)
            waiting += _parts(get_types_from_msg(texts[kind], kind)[kind])
    own, *parts = texts.items()
    return own[1] + ''.join(f'\n{SEPARATOR}MSG: {kind.replace("/msg/", "/")}\n{text}' for kind, text in parts)


def parse(name: str, text: MessageDefinition) -> Typesdict:
    """Fields of a message and of its parts, by type name, as rosbags represents them.

    Parameters:
        name: the message's type, 'package/msg/Type'.
        text: its definition as ros2msg or ros2idl.

    Raises the errors of rosbags for a definition that it cannot parse.
    """
    if text.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text.data, name)
    found: Typesdict = {}
    for part in filter(str.strip, text.data.split(SEPARATOR)):
        found.update(get_types_from_idl(part.split('\n', 1)[1] if part.startswith('IDL: ') else part))
    return found


@cache
def installed_types(name: str) -> Typesdict:
    """Fields of an installed message and of its parts, by type name. Raises UnknownTypeError."""
    return get_types_from_msg(definition(name), name)


def completed(types: Typesdict) -> Typesdict:
    """Types with those of their parts that a bag does not define, as installed. Raises UnknownTypeError where they are not."""
    found, waiting = dict(types), [part for fields in types.values() for part in _parts(fields)]
    while waiting:
        part = waiting.pop()
        if part not in found:
            found |= {name: fields for name, fields in installed_types(part).items() if name not in found}
    return found


@cache
def serialiser(name: str) -> Callable[[Any], bytes]:
    """A function that serialises messages of an installed type to CDR, in a thirtieth of the time of rclpy.

    It accepts objects of rosbags classes, and of rclpy classes without sequences of numbers. Raises UnknownTypeError.
    """
    store = _store(name)
    return lambda message: bytes(store.serialize_cdr(message, name))


@cache
def deserialiser(name: str) -> Callable[[bytes], Any]:
    """A function from CDR to an object with the fields of an installed type, in a third of the time of rclpy.

    Sequences of numbers are arrays that share the memory of the data, an image too. Raises UnknownTypeError; the function
    raises ValueError for malformed data.
    """
    store = _store(name)

    def deserialise(data: bytes) -> Any:
        try:
            return store.deserialize_cdr(memoryview(data), name)
        except SerdeError as error:
            raise ValueError(str(error)) from error

    return deserialise


def _store(name: str) -> Typestore:
    """The installed type `name` and those of its fields. Raises UnknownTypeError."""
    store = get_typestore(Stores.EMPTY)
    store.register(installed_types(name))
    return store


def _text(name: str) -> str:
    """The content of the installed .msg file of a type. Raises UnknownTypeError."""
    if name in AUDIO_COMMON:
        return AUDIO_COMMON[name]
    package, *_, kind = name.split('/')
    try:
        from ament_index_python.packages import get_package_share_directory  # a bag is read without ROS, too
        file = Path(get_package_share_directory(package), 'msg', f'{kind}.msg')
    except (ImportError, LookupError, ValueError) as error:
        raise UnknownTypeError(f'the message type {name} is unknown: package {package!r} is not installed') from error
    if not file.is_file():
        raise UnknownTypeError(f'the message type {name} is unknown: {file} does not exist')
    return file.read_text(encoding='utf-8')


def _parts(fields: Any) -> list[str]:
    """Names of the message types among the fields of a type, as rosbags represents it."""
    found = []
    for _, (node, value) in fields[1]:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, value = value[0]
        if node == Nodetype.NAME:
            found.append(value)
    return found
