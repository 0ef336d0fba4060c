"""The health of a rig's nodes in words, from /diagnostics, and what to do about what is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from av_view.advice import ADVICE

SILENT_S = 5.0  # after its newest status, from which a node counts as ended
FORGET_S = 600.0
MOST_NODES, MOST_VALUES, LONGEST_TEXT = 60, 60, 400
WAITING = ('recorder_node', 'not active')  # for its button, as it should
LEVELS = ('ok', 'warning', 'error', 'stale')


@dataclass
class _Node:
    level: int
    message: str
    values: list[tuple[str, str]]
    arrival: float


class Health:
    """The newest status of each node. Of bounded size, whatever arrives."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Node] = {}

    def on_diagnostics(self, message: Any, now: float) -> None:
        """Take a `DiagnosticArray`.

        Parameters:
            message: the message.
            now (s): time of its arrival.
        """
        for status in message.status:
            name = '/' + status.name.partition(':')[0].strip('/')[:LONGEST_TEXT]
            if name in self._nodes or len(self._nodes) < MOST_NODES:
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                values = [(entry.key[:LONGEST_TEXT], entry.value[:LONGEST_TEXT]) for entry in status.values[:MOST_VALUES]]
                self._nodes[name] = _Node(min(level, len(LEVELS) - 1), status.message[:LONGEST_TEXT], values, now)

    def report(self, now: float, namespace: str = '') -> list[dict[str, Any]]:
        """The nodes of a namespace, worst first: name, level, words, advice, values, and age of the status (s).

        Parameters:
            now (s): the present.
            namespace: such as '/left'; empty for nodes outside of any namespace.
        """
        self._nodes = {name: node for name, node in self._nodes.items() if now - node.arrival < FORGET_S}
        entries = [_entry(name, node, now) for name, node in self._nodes.items() if name.rpartition('/')[0] == namespace]
        return sorted(entries, key=lambda entry: (-LEVELS.index(entry['level']), entry['node']))


def _entry(name: str, node: _Node, now: float) -> dict[str, Any]:
    age = now - node.arrival
    words, level = node.message, LEVELS[node.level]
    if age > SILENT_S:
        words, level = f'says nothing for {age:.0f} s: it hangs or has ended. Before: {node.message}', 'stale'
    advice = list(advise(name.rpartition('/')[2], words)) if level != 'ok' else []
    level = 'ok' if (name.rpartition('/')[2], words) == WAITING else level
    return {'node': name, 'level': level, 'words': words, 'advice': advice, 'values': node.values, 'age': round(age, 1)}


def advise(node: str, words: str) -> Iterable[str]:
    """What to do about a status, in the order of what it says; nothing where nothing is known.

    Parameters:
        node: name of the node without its namespace.
        words: message of the status.
    """
    for nodes, pattern, text in ADVICE:
        if re.fullmatch(nodes, node) and re.search(pattern, words):
            yield text.replace('NODE', node)
