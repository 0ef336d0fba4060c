"""Message definitions, so that bags are written and read without the middleware's type support."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_share_directory,
)
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

# Of a package that bags often hold but few installations have.
AUDIO_COMMON = {'audio_common_msgs/msg/AudioData': 'uint8[] data\n',
                'audio_common_msgs/msg/AudioDataStamped': 'std_msgs/Header header\naudio_common_msgs/AudioData audio\n',
                'audio_common_msgs/msg/AudioInfo': 'uint8 channels\nuint32 sample_rate\nstring sample_format\n'
                                                   'uint32 bitrate\nstring coding_format\n'}


class UnknownTypeError(ValueError):
    """No definition of a message type is at hand."""


@cache
def rig_types() -> Typestore:
    """The standard messages of ROS 2; `learn` adds those of installed packages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register({name: fields for kind, text in AUDIO_COMMON.items()
                    for name, fields in get_types_from_msg(text, kind).items()})
    return store


def learn(name: str) -> Typestore:
    """`rig_types()` with the message `name` ('package/msg/Type') and its parts, from the packages' share folders.

    Raises UnknownTypeError naming the package that is not installed or lacks the message.
    """
    store = rig_types()
    found: dict = {}
    wanted = [name]
    while wanted:
        name = wanted.pop()
        if name not in store.fielddefs and name not in found:
            found.update(get_types_from_msg(_definition_file(name).read_text(encoding='utf-8'), name))
            wanted += _parts(found[name])
    if found:
        store.register(found)
    return store


def definition(name: str) -> str:
    """A message's full definition (ros2msg: with the definitions of all parts).

    Raises UnknownTypeError.
    """
    store = learn(name)
    try:
        return store.generate_msgdef(name, ros_version=2)[0]
    except TypesysError as error:
        raise UnknownTypeError(f'the message type {name} has no usable definition: {error}') from error


def _definition_file(name: str) -> Path:
    package, *_, kind = name.split('/')
    try:
        file = Path(get_package_share_directory(package), 'msg', f'{kind}.msg')
    except (PackageNotFoundError, ValueError) as error:
        raise UnknownTypeError(f'the message type {name} is unknown: package {package!r} is not installed') from error
    if not file.is_file():
        raise UnknownTypeError(f'the message type {name} is unknown: {file} does not exist')
    return file


def _parts(fields: tuple) -> Iterator[str]:
    """Names of the messages among a definition's fields."""
    for _, (node, value) in fields[1]:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, value = value[0]
        if node == Nodetype.NAME:
            yield value
