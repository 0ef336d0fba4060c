"""Who publishes the inputs of a node, by the graph: an input with a second publisher is not used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rclpy.node import Node

# After a node died without a word the graph still holds its publisher for the lease of the middleware's discovery (10 s of
# Cyclone DDS, 20 s of Fast DDS): for so long a node of the same name is taken for its successor.
LEASE_S = 20.0
PERIOD_S = 0.05  # between two looks at the graph


class Publishers:
    """Watches the publishers of some inputs.

    Which of two publishers is genuine cannot be seen from what they say, since a forged message is as plausible as its sender
    wants it to be. One publisher is one source, whatever its stamps do. What keeps forgers out is SROS 2.

    Parameters:
        node: the node that subscribes.
        topics: names of its inputs, relative to the node's namespace.
        besides: for an input that one of the rig's own nodes may publish besides its source, that node's name.
    """

    def __init__(self, node: Node, topics: Iterable[str], besides: Mapping[str, str] | None = None) -> None:
        self._node, self._besides = node, dict(besides or {})
        self._topics = {topic: node.resolve_topic_name(topic) for topic in topics}  # those of the graph, which counts no others
        self._doubled: dict[str, float] = {}  # since when (s, steady) an input has two publishers of one name

    def contested(self, now: float) -> dict[str, list[str]]:
        """Names of the publishers of each input that has more than one.

        Parameters:
            now (s): by a steady clock.
        """
        found = {}
        for topic, name in self._topics.items():
            if self._node.count_publishers(name) < 2:  # the usual case costs no list of all of them
                self._doubled.pop(topic, None)
                continue
            names = sorted(f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                           for info in self._node.get_publishers_info_by_topic(name))
            own = f'{self._node.get_namespace().rstrip("/")}/{self._besides.get(topic, "")}'
            single = len(names) - (own in names) < 2
            if single:
                self._doubled.pop(topic, None)
            elif len(set(names) - {own}) > 1 or now - self._doubled.setdefault(topic, now) > LEASE_S:
                found[topic] = names
        return found
