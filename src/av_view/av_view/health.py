"""The health of a rig's nodes in words, from /diagnostics, and what to do about what is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from av_view.feed import LONGEST_TEXT

SILENT_S = 5.0  # after its newest status, from which a node counts as ended
FORGET_S = 600.0  # a node that has ended for longer belongs to another run
MOST_NODES = 640  # ten of each of 64 rigs
MOST_VALUES = 60
WAITING = ('recorder_node', 'not active')  # for its button, as it should
LEVELS = ('ok', 'warning', 'error', 'stale')
ADVICE: tuple[tuple[str, str, str], ...] = (
    ('.*', r'says nothing for',
     'A process of the launch that has ended is started again within a second, one that hangs is replaced after 8 s. If NODE '
     'does not come back, look at its last lines in ~/.ros/log.'),
    ('.*', r'\d+ publishers .* not used', 'Nothing moves on an input of two programs: `ros2 topic info -v TOPIC` shows both.'),
    ('recorder_node', r'^not active', 'It waits for the button, or for `ros2 lifecycle set NODE configure` and `activate`.'),
    ('(?!recorder_node).*', r'^not active', 'The node is inactive: `ros2 lifecycle set NODE activate`.'),
    ('.*', r'stamps from the future|stamps? .*expected', 'Two clocks differ: run `chronyc tracking` on each machine; '
     'for simulators see docs/reference/clocks.md.'),
    ('.*', r' refused: ', 'Something sends messages that cannot be used: the name before "refused" is the topic or service.'),
    ('audio_node', r'silent', 'Is the microphone muted? `alsamixer`, then `ros2 run av_view doctor` with a clap.'),
    ('audio_node', r'device', 'Is it plugged in, and used by no other program? `ros2 run av_view doctor` lists the devices.'),
    ('doa_node', r'no audio', 'Nothing is heard: look at audio_node, or at bridge_node and the simulator.'),
    ('doa_node', r'motor speeds', 'Publish motor_speeds, or set the parameter ego_rotor_blades of doa_node to 0.'),
    ('(.*_)?camera_node', r'no images|failed', 'Is the camera plugged in, and used by no other program? '
     '`ros2 run av_view doctor` opens it as camera_node does.'),
    ('(.*_)?detector_node', r'no images', 'Nothing is seen: look at camera_node, or at bridge_node and the simulator.'),
    ('bridge_node', r'no data', 'Is the simulator running, and does it send to these ports?'),
    ('bridge_node', r'allowed_senders', 'Name the simulator\'s address in allowed_senders:=, if it may send.'),
    ('fusion_node', r'no .*odometry', 'The attitude of the rig is unknown: px4:=true, or publish odometry. On a mast that '
     'never turns this is harmless.'),
    ('fusion_node', r'no .*(doa|detections)', 'A sensor gives nothing: its node above says why.'),
    ('fusion_node', r'transform', 'Is rig_frames_node running, or the robot\'s own publisher of tf, in the '
     'rig\'s namespace?'),
    ('pointing_node', r'no target/bearing', 'fusion_node gives no bearing: look there.'),
    ('pointing_node', r'no odometry', 'The body stands still without odometry: px4:=true, or publish odometry.'),
    ('recorder_node', r'messages lost', 'The disk is too slow: record fewer topics or images:=jpeg, or onto another disk.'),
    ('recorder_node', r'No space', 'The disk is full.'),
    ('px4_node', r'.', 'See docs/guides/px4.md, "Before the first flight, without propellers".'),
)


class Health:
    """The newest status of each node. Of bounded size, whatever arrives."""

    def __init__(self) -> None:
        # Arrival, level, message and values of the newest status of each node.
        self._nodes: dict[str, tuple[float, str, str, list[tuple[str, str]]]] = {}

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
                self._nodes[name] = now, LEVELS[min(level, len(LEVELS) - 1)], status.message[:LONGEST_TEXT], values

    def report(self, now: float, namespace: str = '') -> list[dict[str, Any]]:
        """The nodes of a namespace, worst first: name, level, words, advice, values, and age of the status (s).

        Parameters:
            now (s): the present.
            namespace: such as '/left'; empty for nodes outside of any namespace.
        """
        self._nodes = {name: node for name, node in self._nodes.items() if now - node[0] < FORGET_S}
        entries = [_entry(name, now - arrival, level, words, values)
                   for name, (arrival, level, words, values) in self._nodes.items() if name.rpartition('/')[0] == namespace]
        return sorted(entries, key=lambda entry: (-LEVELS.index(entry['level']), entry['node']))


def _entry(name: str, age: float, level: str, words: str, values: list[tuple[str, str]]) -> dict[str, Any]:
    if age > SILENT_S:
        words, level = f'says nothing for {age:.0f} s: it hangs or has ended. Before: {words}', 'stale'
    advice = list(advise(name.rpartition('/')[2], words)) if level != 'ok' else []
    level = 'ok' if (name.rpartition('/')[2], words) == WAITING else level
    return {'node': name, 'level': level, 'words': words, 'advice': advice, 'values': values, 'age': round(age, 1)}


def advise(node: str, words: str) -> Iterable[str]:
    """What to do about a status, in the order of what it says; nothing where nothing is known.

    Parameters:
        node: name of the node without its namespace.
        words: message of the status.
    """
    for nodes, pattern, text in ADVICE:
        if re.fullmatch(nodes, node) and re.search(pattern, words):
            yield text.replace('NODE', node)
