"""The process that sends hostile messages and requests as a peer on the same domain."""

from __future__ import annotations

import time
from collections import Counter
from random import Random
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py.utilities import get_message
from std_srvs.srv import SetBool

from av_evaluation.attack import observer
from av_evaluation.attack.hostile import MARK, HostileValues
from av_evaluation.attack.worker import paced

NAME = 'attack_messages'
OWN = (NAME, observer.NAME)
COMMAND, ENABLE = '/pointing/command', '/pointing_node/enable'
ALWAYS = {'/clock': 'rosgraph_msgs/msg/Clock', '/tf': 'tf2_msgs/msg/TFMessage'}
HEADER = 4                 # bytes of any serialized message
MOST_TEMPLATE = 100_000    # bytes; larger messages would make the load of the machine the attack
# s by which a stamp jumps
JUMPS = (1e-3, -1e-3, 0.05, -0.05, 0.4, -0.4, 1.0, -1.0, 10.0, -10.0, 1e3, -1e3, 1e6, -1e6, 2e9, -2e9)
# What leads towards the active state, by state; and what a request does not ask for, as only a new process could undo it.
FORWARD = {State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
           State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE}
SHUTDOWNS = (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, Transition.TRANSITION_INACTIVE_SHUTDOWN,
             Transition.TRANSITION_ACTIVE_SHUTDOWN)
MOST_OPEN = 50     # requests without an answer
NUMBERS = (0, -1, 1, 2**31, 2**62, -2**63)
NAMES = ('', 'x' * 5000, 'a.b', '\u202e', 'rate')


class Target:
    """A topic under attack, for which a genuine message, if there is one, is the template.

    Parameters:
        topic: its name.
        kind: class of its messages.
        qos: quality of service that all subscribers accept.
        template: the newest genuine message as it was serialized; empty without.
    """

    def __init__(self, topic: str, kind: Any, qos: QoSProfile, template: bytes = b'') -> None:
        self.topic, self.kind, self.qos, self.template = topic, kind, qos, template

    def message(self) -> Any:
        """A genuine message, or an empty one."""
        return deserialize_message(self.template, self.kind) if self.template else self.kind()

    def keep(self, data: bytes) -> None:
        """Take a genuine message as the template."""
        if len(data) < MOST_TEMPLATE and MARK not in data:
            self.template = data


class Messages(Node):
    """Publishes on every topic to which a node of the rig subscribes, while an attack lasts, and calls the nodes' services."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._targets: list[Target] = []
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._callers: dict[tuple[Any, str], Any] = {}
        self._values: dict[str, list[Parameter]] = {}    # of the nodes' parameters, before
        self._open: list[Any] = []

    def spin(self, seconds: float = 0.0) -> None:
        """Take what arrives, for at least `seconds`."""
        end = time.monotonic() + seconds
        self._executor.spin_once(timeout_sec=seconds)
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=max(end - time.monotonic(), 0.0))

    def find(self, seconds: float = 4.0) -> list[str]:
        """Find the topics, keep a genuine message of each, and what the parameters are; returns the topics' names."""
        self.spin(1.0)
        kinds, heard = ALWAYS | {topic: names[0] for topic, names in self.get_topic_names_and_types()}, []
        for topic, kind in sorted(kinds.items()):
            subscribers = [end for end in self.get_subscriptions_info_by_topic(topic) if end.node_name not in OWN]
            if subscribers or topic in ALWAYS:
                self._targets.append(Target(topic, get_message(kind), _qos(subscribers)))
                target = self._targets[-1]
                heard.append(self.create_subscription(target.kind, topic, target.keep, observer.DEEP, raw=True))
        self.spin(seconds)
        for subscription in heard:    # the next messages are the attack's own
            self.destroy_subscription(subscription)
        for name in self._nodes('rcl_interfaces/srv/SetParameters'):
            self._values[name] = self._read(name)
        return [target.topic for target in self._targets]

    def attack(self, seconds: float, rate: float, seed: int, stale: bool = False, spare: tuple[str, ...] = ()
               ) -> dict[str, int]:
        """Send well-formed messages with hostile fields, damaged ones, and genuine ones whose stamps jump, in turns.

        The publishers are made for the attack and taken away with it. Returns the number of messages by topic.

        Parameters:
            seconds: duration.
            rate (Hz): of the messages on each topic.
            seed: of the random values.
            stale: whether all stamps are far from now.
            spare: topics to leave alone.
        """
        values = HostileValues(Random(seed))
        values.stale = stale
        targets = [target for target in self._targets if target.topic not in spare]
        publishers = [self.create_publisher(target.kind, target.topic, target.qos) for target in targets]
        makers = (typed, malformed) if stale else (typed, malformed, jumping)
        sent: Counter[str] = Counter()
        for number in paced(seconds, rate * len(targets)):
            target = targets[number % len(targets)]
            try:
                publishers[number % len(targets)].publish(makers[number // len(targets) % len(makers)](target, values))
            except Exception as error:  # noqa: BLE001  the middleware refuses some of them; rclpy has no class for it
                sent[f'refused by the middleware: {str(error)[:60]}'] += 1
                continue
            sent[target.topic] += 1
        for publisher in publishers:
            self.destroy_publisher(publisher)
        return dict(sent)

    def request(self, seconds: float, rate: float, seed: int) -> dict[str, int]:
        """Ask for transitions in any order, and set parameters of real and invented names to values of any type and size.

        No node is shut down. Returns the number of requests by node. `restore` undoes what was permitted.

        Parameters:
            seconds: duration.
            rate (Hz): of all requests.
            seed: of the random values.
        """
        values, sent = HostileValues(Random(seed)), Counter[str]()
        random, names = values.random, sorted(self._values)
        for number in paced(seconds, rate if names else 0.0, lambda: self.spin(0.0)):
            name = names[number % len(names)]
            if number // len(names) % 2:
                transition = random.choice((1, 2, 3, 4)) if random.random() < 0.7 else random.randrange(256)
                if transition not in SHUTDOWNS:
                    request = ChangeState.Request(transition=Transition(id=transition))
                    sent[name] += self._send(ChangeState, f'{name}/change_state', request)
                continue
            own = [one.name for one in self._values[name]]
            chosen = [random.choice(own) if own and random.random() < 0.8 else random.choice(NAMES)
                      for _ in range(random.choice((1, 1, 2, 10)))]
            parameters = [Parameter(name=one, value=_value(values)) for one in chosen]
            sent[name] += self._send(SetParameters, f'{name}/set_parameters', SetParameters.Request(parameters=parameters))
        return dict(sent)

    def restore(self, timeout: float = 30.0) -> list[str]:
        """Set what was before, activate every node, enable pointing; returns the nodes that cannot be active again."""
        deadline = time.monotonic() + timeout
        for name, before in self._values.items():
            self._call(SetParameters, f'{name}/set_parameters', SetParameters.Request(parameters=before))
        waiting = dict.fromkeys(self._nodes('lifecycle_msgs/srv/ChangeState'), -1)
        while waiting and time.monotonic() < deadline:
            for name in list(waiting):
                answer = self._call(GetState, f'{name}/get_state', GetState.Request())
                state = answer.current_state.id if answer is not None else -1
                if state == State.PRIMARY_STATE_ACTIVE:
                    del waiting[name]
                elif state in FORWARD:
                    request = ChangeState.Request(transition=Transition(id=FORWARD[state]))
                    self._call(ChangeState, f'{name}/change_state', request)
            self.spin(0.05)
        self.enable(True)
        return sorted(waiting)

    def enable(self, enabled: bool) -> bool:
        """Permit or forbid that commands move the rig; returns whether the pointing node agreed."""
        answer = self._call(SetBool, ENABLE, SetBool.Request(data=enabled))
        return answer is not None and answer.success

    def _nodes(self, kind: str) -> list[str]:
        """Names of the rig's nodes with a service of a type such as `std_srvs/srv/SetBool`."""
        own = self.get_fully_qualified_name()
        return sorted({service.rpartition('/')[0] for service, kinds in self.get_service_names_and_types()
                       if kind in kinds and not service.startswith((own, '/attack_', '/launch_ros'))})

    def _read(self, name: str) -> list[Parameter]:
        """The parameters of a node."""
        listed = self._call(ListParameters, f'{name}/list_parameters', ListParameters.Request())
        names = list(listed.result.names) if listed is not None else []
        answer = self._call(GetParameters, f'{name}/get_parameters', GetParameters.Request(names=names)) if names else None
        return [] if answer is None else [
            Parameter(name=one, value=value) for one, value in zip(names, answer.values, strict=True)
            if value.type != ParameterType.PARAMETER_NOT_SET]

    def _client(self, kind: Any, service: str) -> Any:
        if (kind, service) not in self._callers:
            self._callers[kind, service] = self.create_client(kind, service)
        return self._callers[kind, service]

    def _send(self, kind: Any, service: str, request: Any) -> bool:
        """Send a request without waiting for its answer; False where too many are open."""
        self._open = [future for future in self._open if not future.done()]
        client = self._client(kind, service)
        if len(self._open) >= MOST_OPEN:
            self.spin(0.1)
            self._open = self._open[MOST_OPEN // 2:]
        if not client.service_is_ready():
            self.spin(0.02)
            return False
        self._open.append(client.call_async(request))
        return True

    def _call(self, kind: Any, service: str, request: Any, timeout: float = 2.0) -> Any:
        """The answer to a request, None without one in time."""
        client, deadline = self._client(kind, service), time.monotonic() + timeout
        while not client.service_is_ready() and time.monotonic() < deadline:
            self.spin(0.05)
        future = client.call_async(request)
        while not future.done() and time.monotonic() < deadline:
            self.spin(0.02)
        if not future.done():
            client.remove_pending_request(future)
        return future.result() if future.done() else None


def typed(target: Target, values: HostileValues) -> Any:
    """A well-formed message, made of a genuine one or of nothing, with hostile fields."""
    share = values.random.choice((0.02, 0.2, 0.7))
    message = target.message() if values.random.random() < 0.7 else target.kind()
    values.disturb(message, share)
    if hasattr(message, 'transforms'):
        _break_rotations(message, values)
    if target.topic == COMMAND:
        message.reason = MARK.decode() + message.reason[:100]
    return message


def malformed(target: Target, values: HostileValues) -> bytes:
    """A serialized message that is damaged: behind its header, and on best-effort topics in its header, too.

    The middleware drops the packet with a damaged header; a reliable publisher would repeat it, and what follows would wait.
    """
    made = target.topic == COMMAND or not target.template or values.stale
    data = serialize_message(typed(target, values)) if made else target.template
    if target.qos.reliability == ReliabilityPolicy.BEST_EFFORT and values.random.random() < 0.3:
        return values.random.randbytes(HEADER) + data[HEADER:]
    return data[:HEADER] + values.mutilate(data[HEADER:])


def jumping(target: Target, values: HostileValues) -> Any:
    """A genuine message whose stamp jumps."""
    message = target.message()
    seconds, fraction = divmod(min(max(time.time() + values.random.choice(JUMPS), -2.0**31), 2.0**31 - 1.0), 1.0)
    for item in (getattr(message, 'header', message), message):
        if hasattr(item, 'stamp'):
            item.stamp.sec, item.stamp.nanosec = int(seconds), int(1e9 * fraction)
    if hasattr(message, 'clock'):
        message.clock = values.stamp()
    if hasattr(message, 'transforms'):
        _break_rotations(message, values)
    if target.topic == COMMAND:
        message.reason = MARK.decode()
    return message


def _break_rotations(message: Any, values: HostileValues) -> None:
    """A peer may move a frame by a valid rotation, for good: names of the rig's frames go with invalid ones only."""
    for item in message.transforms:
        if values.random.random() < 0.5:
            item.child_frame_id = f'hostile_{values.random.randrange(20)}'
        else:
            item.transform.rotation.w = values.random.choice((float('nan'), float('inf'), 3.0))


def _value(values: HostileValues) -> ParameterValue:
    """A parameter of any type, in bounds or not; the type may not agree with the value."""
    random = values.random
    return ParameterValue(
        type=random.choice((*range(10), 255)), bool_value=random.random() < 0.5,
        integer_value=random.choice((*NUMBERS, random.randrange(100_000))), double_value=values.real(),
        string_value=values.value('string'), double_array_value=[values.real() for _ in range(random.randrange(4))],
        integer_array_value=[random.choice(NUMBERS) for _ in range(random.randrange(4))],
        string_array_value=[values.value('string') for _ in range(random.randrange(3))])


def _qos(subscribers: list[Any]) -> QoSProfile:
    profiles = [end.qos_profile for end in subscribers]
    reliable = any(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = any(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=10,
        reliability=ReliabilityPolicy.RELIABLE if reliable or latched else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def connected() -> Messages:
    """The attacker of a process, which is connected to the middleware."""
    rclpy.init(args=[])
    return Messages()
