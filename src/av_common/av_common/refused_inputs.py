"""Inputs that a node could not use: counted by source, logged once for each reason, reported while recent."""

from __future__ import annotations

import os
import re
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.impl.implementation_singleton import rclpy_implementation

from av_common.files import LONGEST_LINE

__all__ = ('BAD_INPUT', 'RefusedInputs')

# Errors that an input may cause: ValueError of stages, and RCLError (with RMWError) of the middleware.
BAD_INPUT: tuple[type[Exception], ...] = (ValueError, rclpy_implementation.RCLError, rclpy_implementation.RMWError)
# With this variable set, as in every test, all other errors are raised again: they are faults of the program.
STRICT_VARIABLE = 'AV_STRICT'
RECENT_S = 5.0  # for which a refusal raises the status: five reports, so that a person sees it
LOGGED_REASONS = 20  # of each source; afterwards its inputs are only counted


@dataclass
class _Source:
    count: int = 0
    reason: str = ''
    level: bytes = DiagnosticStatus.WARN
    newest: float = 0.0
    logged: set[str] = field(default_factory=set)


class RefusedInputs:
    """Counts of refused inputs by their source: a topic, a service, a timer. Thread-safe, and of bounded size.

    Parameters:
        logger: function that returns the node's logger.
    """

    def __init__(self, logger: Callable[[], Any]) -> None:
        self._logger = logger
        self._sources: dict[str, _Source] = {}
        self._lock = threading.Lock()

    def refuse(self, source: str, error: BaseException) -> None:
        """Count an error. An error that is none of BAD_INPUT is logged with its traceback, or raised again in tests.

        Parameters:
            source: name of the topic, service or timer.
            error: what processing the input raised.
        """
        unexpected = not isinstance(error, BAD_INPUT)
        if unexpected and os.environ.get(STRICT_VARIABLE):
            raise error
        reason = (str(error) or repr(error)).encode(errors='replace').decode()[:LONGEST_LINE]
        kind = re.sub(r'[\d.]+', '#', reason)  # the same reason with other numbers is not logged again
        with self._lock:
            entry = self._sources.setdefault(source, _Source())
            entry.count += 1
            entry.reason, entry.newest = reason, time.monotonic()
            entry.level = DiagnosticStatus.ERROR if unexpected else DiagnosticStatus.WARN
            log = kind not in entry.logged and len(entry.logged) < LOGGED_REASONS
            entry.logged.add(kind) if log else None
        if log and unexpected:
            self._logger().error(f'{source}: {"".join(traceback.format_exception(error))}')
        elif log:
            self._logger().warning(f'{source} refused: {reason}')

    @property
    def counts(self) -> dict[str, int]:
        """Number of refused inputs by source."""
        with self._lock:
            return {name: entry.count for name, entry in self._sources.items()}

    def report(self, status: DiagnosticStatusWrapper) -> None:
        """Add the counts to a status; sources whose newest refusal is recent raise its level and say why."""
        with self._lock:
            for name, entry in self._sources.items():
                status.add(f'{name} refused', str(entry.count))
                if time.monotonic() - entry.newest <= RECENT_S:
                    status.mergeSummary(entry.level, f'{name} refused: {entry.reason}')
