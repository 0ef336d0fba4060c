"""Names of PX4's topics, which may end in the version of their message."""

from __future__ import annotations

import re
from collections.abc import Iterable


class VersionError(ValueError):
    """The firmware's version of a message is not that of the installed px4_msgs."""


def find_topic(base: str, names: Iterable[str]) -> str | None:
    """The topic of the newest message version, None if there is none.

    Parameters:
        base: name without version
        names: names of existing topics; candidates are `base` and `base_v<N>`
    """
    found = [(int(match.group(1) or 0), name) for name in names
             if (match := re.fullmatch(rf'{re.escape(base)}(?:_v(\d+))?', name))]
    return max(found)[1] if found else None


def check_version(topic: str, message_type: type) -> None:
    """Raise VersionError if the topic's version is not that of the message definition: its bytes would be misread.

    Parameters:
        topic: full name of the topic, with or without a version
        message_type: class of px4_msgs.msg
    """
    match = re.search(r'_v(\d+)$', topic)
    sent, known = int(match.group(1)) if match else 0, int(getattr(message_type, 'MESSAGE_VERSION', 0))
    if sent != known:
        raise VersionError(f'{topic} is version {sent} of {message_type.__name__}, the installed px4_msgs has version {known}: '
                           'build the branch of px4_msgs that belongs to the firmware (release/1.16 for 1.16)')
