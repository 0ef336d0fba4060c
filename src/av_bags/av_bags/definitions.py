"""Definitions of messages, as installed and as bags carry them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from av_bags.errors import UnknownTypeError

SEPARATOR = '=' * 80 + '\n'
# Of a package that bags often hold but few installations have.
AUDIO_COMMON = {'audio_common_msgs/msg/AudioData': 'uint8[] data\n',
                'audio_common_msgs/msg/AudioDataStamped': 'std_msgs/Header header\naudio_common_msgs/AudioData audio\n',
                'audio_common_msgs/msg/AudioInfo': 'uint8 channels\nuint32 sample_rate\nstring sample_format\n'
                                                   'uint32 bitrate\nstring coding_format\n'}


@cache
def definition(name: str) -> str:
    """The installed definition of the message `name` ('package/msg/Type') with all its parts, as ros2msg.

    Raises UnknownTypeError naming the package that is not installed or lacks the message.
    """
    texts: dict[str, str] = {}
    waiting = [name]
    while waiting:
        kind = waiting.pop(0)
        if kind not in texts:
            texts[kind] = _text(kind)
            waiting += _parts(kind, texts[kind])
    own, *parts = texts.items()
    return own[1] + ''.join(f'\n{SEPARATOR}MSG: {kind.replace("/msg/", "/")}\n{text}' for kind, text in parts)


def parse(name: str, text: MessageDefinition) -> Typesdict:
    """Fields of a message and its parts as rosbags has them, by their names. Raises what rosbags raises."""
    if text.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text.data, name)
    found: Typesdict = {}
    for part in filter(str.strip, text.data.split(SEPARATOR)):
        found.update(get_types_from_idl(part.split('\n', 1)[1] if part.startswith('IDL: ') else part))
    return found


def installed(name: str) -> MessageDefinition:
    """The same as rosbags has it. Raises UnknownTypeError."""
    return MessageDefinition(MessageDefinitionFormat.MSG, definition(name))


@cache
def serialiser(name: str) -> Callable[[Any], bytes]:
    """What makes CDR of messages of an installed type, in a thirtieth of rclpy's time.

    Messages may be of rclpy or rosbags, but those of rclpy without sequences of numbers. Raises UnknownTypeError.
    """
    store = get_typestore(Stores.EMPTY)
    store.register(parse(name, installed(name)))
    return lambda message: bytes(store.serialize_cdr(message, name))


def _text(name: str) -> str:
    if name in AUDIO_COMMON:
        return AUDIO_COMMON[name]
    package, *_, kind = name.split('/')
    try:
        file = Path(get_package_share_directory(package), 'msg', f'{kind}.msg')
    except (PackageNotFoundError, ValueError) as error:
        raise UnknownTypeError(f'the message type {name} is unknown: package {package!r} is not installed') from error
    if not file.is_file():
        raise UnknownTypeError(f'the message type {name} is unknown: {file} does not exist')
    return file.read_text(encoding='utf-8')


def _parts(name: str, text: str) -> list[str]:
    """Names of the messages among a definition's fields."""
    found = []
    for _, (node, value) in get_types_from_msg(text, name)[name][1]:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, value = value[0]
        if node == Nodetype.NAME:
            found.append(value)
    return found
