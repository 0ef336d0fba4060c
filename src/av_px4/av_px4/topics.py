"""Names of PX4's topics, which may end in the version of their message.

An agent that outlives a change of the firmware goes on offering the topics of the former one. Of the versions that are
offered only that of the installed px4_msgs can be read. Another one that sends while that one is silent shows that px4_msgs
belongs to another firmware.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

SILENT_S = 2.0    # time without a message after which a topic is not alive


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
