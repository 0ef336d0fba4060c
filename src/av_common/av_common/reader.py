"""Subscriptions that nothing wakes up for."""

from __future__ import annotations

import time
from typing import Any


class Reader:
    """Takes the messages of a subscription that no executor waits for; until then they wait in the middleware.

    For those who look at a topic now and then: messages that newer ones replace (by the depth of the queue) cost little.

    Attributes:
        subscription: of the node.

    Parameters:
        subscription: see `GuardedNode.create_reader`.
    """

    def __init__(self, subscription: Any) -> None:
        self.subscription = subscription

    def take(self) -> list[tuple[bytes, float]]:
        """The messages that wait, serialised, the oldest first, each with the time (s, Unix) at which it was published."""
        handle, found = self.subscription.handle, []
        with handle:
            while (taken := handle.take_message(self.subscription.msg_type, True)) is not None:
                data, info = taken
                found.append((data, 1e-9 * (info['source_timestamp'] or time.time_ns())))
        return found
