"""What only rosbag2 asks for: metadata.yaml beside the file, and the quality of service of each topic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

FOREVER = {'sec': 9223372036, 'nsec': 854775807}
# What every rosbag2 from Humble on reads.
VERSION = 5


class PlainDumper(yaml.SafeDumper):
    """Writes equal parts out each time: not every reader knows YAML's anchors."""

    def ignore_aliases(self, data: object) -> bool:
        """Make no anchor, whatever the data."""
        return True


@dataclass(frozen=True)
class TopicQos:
    """Quality of service with the numbers of rmw: 1 reliable, 2 best effort; 1 transient local, 2 volatile."""

    reliability: int = 1
    durability: int = 2

    def to_yaml(self) -> str:
        """As rosbag2 writes it."""
        return _profile(self)


DEFAULT_QOS = TopicQos()
LATCHED = TopicQos(durability=1)


@dataclass(frozen=True)
class TopicRecord:
    """What was recorded of one topic."""

    name: str
    kind: str
    qos: TopicQos
    count: int


def write_metadata(file: Path, topics: list[TopicRecord], start_ns: int, end_ns: int) -> None:
    """Describe the mcap `file` in a metadata.yaml beside it."""
    count = sum(topic.count for topic in topics)
    span = {'starting_time': {'nanoseconds_since_epoch': start_ns}, 'duration': {'nanoseconds': end_ns - start_ns}}
    content = {'rosbag2_bagfile_information': {
        'version': VERSION, 'storage_identifier': 'mcap', **span, 'message_count': count,
        'topics_with_message_count': [{
            'topic_metadata': {'name': topic.name, 'type': topic.kind, 'serialization_format': 'cdr',
                               'offered_qos_profiles': topic.qos.to_yaml()},
            'message_count': topic.count} for topic in topics],
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': [file.name],
        'files': [{'path': file.name, **span, 'message_count': count}]}}
    draft = file.with_name('metadata.yaml.tmp')
    draft.write_text(to_yaml(content), encoding='utf-8')
    draft.replace(file.with_name('metadata.yaml'))


@cache
def _profile(qos: TopicQos) -> str:
    return to_yaml([{
        'history': 3, 'depth': 0, 'reliability': qos.reliability, 'durability': qos.durability,
        'deadline': FOREVER, 'lifespan': FOREVER, 'liveliness': 1, 'liveliness_lease_duration': FOREVER,
        'avoid_ros_namespace_conventions': False}])


def to_yaml(content: object) -> str:
    """YAML without anchors, in the order given."""
    return yaml.dump(content, Dumper=PlainDumper, sort_keys=False)
