"""Finds the topics of the rig in a bag that was recorded under other names, namespaces or types."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from av_bags.definitions import BagError
from av_bags.reader import Bag
from av_common.rig import CAMERAS, camera_topic, camera_topics

AUDIO, DOA, ODDS, IMAGE, CAMERA = 'audio/frames', 'doa', 'doa/odds', 'camera/image_raw', 'camera/camera_info'
DETECTIONS, VISIBILITY, ODOMETRY = 'detections', 'visibility', 'odometry'
BEARING, STATE, COMMAND = 'target/bearing', 'fusion/state', 'pointing/command'
TRUE_TARGET, TRUE_RIG, FRAMES, MOTORS = 'truth/target', 'truth/rig', 'tf_static', 'motor_speeds'
GIMBAL, TARGETS, MARKS, CUE = 'gimbal/state', 'targets', 'marks', 'target/cue'

COMPRESSED = '/compressed'    # added by image_transport to the name of the same images
_POSES = ('nav_msgs/msg/Odometry', 'geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PoseWithCovarianceStamped')
# Types of each topic that can be read: the rig's own type first, then those that are converted to it.
OF_CAMERA: dict[str, tuple[str, ...]] = {
    IMAGE: ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'),
    CAMERA: ('sensor_msgs/msg/CameraInfo',),
    DETECTIONS: ('vision_msgs/msg/Detection2DArray',),
    VISIBILITY: ('av_interfaces/msg/Visibility',),
}
KINDS: dict[str, tuple[str, ...]] = {
    AUDIO: ('av_interfaces/msg/AudioFrame', 'audio_common_msgs/msg/AudioData', 'audio_common_msgs/msg/AudioDataStamped',
            'audio_common_msgs/msg/AudioStamped'),
    DOA: ('av_interfaces/msg/DoaArray',),
    ODDS: ('av_interfaces/msg/DoaOdds',),
    **{camera_topic(camera, name): kinds for camera in CAMERAS for name, kinds in OF_CAMERA.items()},
    ODOMETRY: (*_POSES, 'sensor_msgs/msg/Imu'),
    BEARING: ('av_interfaces/msg/Bearing',),
    STATE: ('av_interfaces/msg/FusionState',),
    COMMAND: ('av_interfaces/msg/PointingCommand',),
    TRUE_TARGET: _POSES,
    TRUE_RIG: _POSES,
    FRAMES: ('tf2_msgs/msg/TFMessage',),
    MOTORS: ('std_msgs/msg/Float32MultiArray',),
    GIMBAL: ('av_interfaces/msg/GimbalState',),
    TARGETS: ('av_interfaces/msg/TrackArray',),
    MARKS: ('rcl_interfaces/msg/Log',),
    CUE: ('geometry_msgs/msg/PointStamped',),
}

# The cameras, and what the topics are called for the first one, by their topics.
_BY_CAMERA = {camera_topic(camera, name): (camera, name) for camera in CAMERAS for name in OF_CAMERA}
_SEEN = camera_topics(CAMERAS, DETECTIONS)
_CONTEXT = (*camera_topics(CAMERAS, CAMERA, VISIBILITY), ODOMETRY, GIMBAL, TRUE_TARGET, TRUE_RIG, FRAMES, MARKS, CUE)
# Topics to play for each stage from which on the results are computed again.
STAGES: dict[str, tuple[str, ...]] = {
    'raw': (AUDIO, MOTORS, *camera_topics(CAMERAS, IMAGE), *_SEEN, *_CONTEXT),
    'doa': (DOA, ODDS, *_SEEN, *_CONTEXT),
    'bearing': (BEARING, TARGETS, STATE, DOA, *_SEEN, *_CONTEXT),
    'all': tuple(KINDS),
}
# Types among KINDS whose messages have no stamp.
WITHOUT_HEADER = ('audio_common_msgs/msg/AudioData', 'tf2_msgs/msg/TFMessage', 'std_msgs/msg/Float32MultiArray')


@dataclass(frozen=True)
class Found:
    """Result of `find_topics`.

    Parameters:
        topics: topics of the bag, by the rig's names.
        missing: reasons why the other topics were not found, by the rig's names.
        unused: those of them that the bag has messages of, which are of another type, or of several topics.
    """

    topics: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    unused: set[str] = field(default_factory=set)

    def __contains__(self, name: str) -> bool:
        return name in self.topics


def find_topics(bag: Bag, names: Iterable[str], remappings: Mapping[str, str] | None = None,
                namespace: str = '') -> Found:
    """Find topics of the rig in a bag: by remapping, by the same name in the namespace, or by a unique ending.

    What is known of a camera whose images are remapped is beside these, as `image_transport` has it.
    Where the rig's namespace is stated, topics outside of it are taken by their own name only, as the frames of a robot on
    /tf_static: another rig's are not.

    Parameters:
        bag: the bag to search.
        names: the rig's names of the topics to find.
        remappings: topics of the bag by the rig's names, which replace the search.
        namespace: namespace of the recorded rig.

    Raises BagError when a remapping names a topic that is not in the bag or has an unusable type.
    """
    remappings = {name.lstrip('/'): topic for name, topic in (remappings or {}).items()}
    unknown = set(remappings) - set(KINDS)
    if unknown:
        raise BagError(f'{", ".join(sorted(unknown))} cannot be remapped, only {", ".join(KINDS)}')
    remappings = _beside_images(bag, remappings) | remappings
    found = Found()
    for name in names:
        if name in remappings:
            found.topics[name] = _remapped(bag, name, remappings[name])
            continue
        candidates = _candidates(bag, name, namespace)
        usable = [topic for topic in candidates if bag.topics[topic].kind in KINDS[name] and bag.topics[topic].count]
        usable = sorted({topic.removesuffix(COMPRESSED): topic for topic in sorted(usable, reverse=True)}.values())
        if len(usable) == 1:
            found.topics[name] = usable[0]
        else:
            found.missing[name] = _why(bag, name, candidates, usable)
            found.unused.update([name] if any(bag.topics[topic].count for topic in candidates) else [])
    return found


def parse_remappings(texts: Iterable[str]) -> dict[str, str]:
    """Parse remappings such as 'doa:=/robot/doa' to a mapping. Raises BagError for other texts."""
    pairs = [text.split(':=') for text in texts if text]
    for pair in pairs:
        if len(pair) != 2 or not all(pair):
            raise BagError(f'remapping {":=".join(pair)!r}, expected NAME:=TOPIC such as odometry:=/robot/odom')
    return dict(pairs)


def absolute(name: str, namespace: str = '') -> str:
    """The absolute name of the rig's topic `name` in `namespace`; names that begin with / are unchanged.

    Parameters:
        name: name of the topic, relative or absolute.
        namespace: namespace of the rig; empty for none.
    """
    return name if name.startswith('/') else f'/{namespace.strip("/")}/{name}'.replace('//', '/')


def of_camera(name: str) -> tuple[str, str]:
    """The camera of a topic, and what the topic is called for the first one; no camera ('') and the same name for others."""
    return _BY_CAMERA.get(name, ('', name))


def _beside_images(bag: Bag, remappings: Mapping[str, str]) -> dict[str, str]:
    """The camera_info beside images that are remapped, by the rig's names."""
    beside = {camera_topic(camera, CAMERA): f'{images.rpartition("/")[0]}/camera_info' for camera in CAMERAS
              if (images := remappings.get(camera_topic(camera, IMAGE), '').removesuffix(COMPRESSED))}
    return {name: topic for name, topic in beside.items() if topic in bag.topics}


def _remapped(bag: Bag, name: str, topic: str) -> str:
    if topic not in bag.topics:
        raise BagError(f'{bag.path}: no topic {topic} for {name}; there are {", ".join(sorted(bag.topics))}')
    kind = bag.topics[topic].kind
    if kind not in KINDS[name]:
        raise BagError(f'{bag.path}: {topic} is {kind}; for {name} expected {" or ".join(KINDS[name])}')
    if not bag.topics[topic].count:
        raise BagError(f'{bag.path}: {topic} for {name} holds no messages')
    return topic


def _candidates(bag: Bag, name: str, namespace: str) -> list[str]:
    exact = absolute(name, namespace)
    if own := [topic for topic in (exact, exact + COMPRESSED) if topic in bag.topics]:
        return own
    endings, home = (f'/{name}', f'/{name}{COMPRESSED}'), absolute('', namespace)
    others = tuple(f'/{other}' for other in KINDS if other.endswith(endings[0]))  # of another camera
    return sorted(topic for topic in bag.topics
                  if topic.endswith(endings) and not topic.endswith(others) and (topic.startswith(home) or topic in endings))


def _why(bag: Bag, name: str, candidates: list[str], usable: list[str]) -> str:
    if len(usable) > 1:
        return f'more than one topic could be {name}: {", ".join(usable)}; remap one'
    empty = [topic for topic in candidates if not bag.topics[topic].count]
    if empty:
        return f'{", ".join(empty)} holds no messages'
    if candidates:
        kinds, count = ', '.join(f'{topic} is {bag.topics[topic].kind}' for topic in candidates), sum(
            bag.topics[topic].count for topic in candidates)
        return f'{kinds}, expected {" or ".join(KINDS[name])}; {count} messages are left out'
    others = tuple(f'/{other}' for other in _BY_CAMERA if other != name)
    alike = [topic.name for topic in bag.topics.values() if topic.kind in KINDS[name] and not topic.name.endswith(others)]
    hint = f' (by its type {" or ".join(alike)} could be it: {name}:={alike[0]})' if alike else ''
    return f'no topic {name}{hint}'
