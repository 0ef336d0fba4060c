"""Lifecycle and parameter requests to every node of the rig, and the restoration of what a permitted one changed."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.node import Node
from std_srvs.srv import SetBool

from av_evaluation.attack.hostile import HostileValues
from av_evaluation.attack.pace import paced

ENABLE = '/pointing_node/enable'
SHUTDOWNS = (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, Transition.TRANSITION_INACTIVE_SHUTDOWN,
             Transition.TRANSITION_ACTIVE_SHUTDOWN)
# What leads towards the active state, by state.
FORWARD = {State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
           State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE}
MOST_OPEN = 50     # requests without an answer
NUMBERS = (0, -1, 1, 2**31, 2**62, -2**63)


class Requests:
    """Calls services of the rig's nodes.

    Parameters:
        node: the node that calls.
        spin: takes what arrives, for a number of seconds.
    """

    def __init__(self, node: Node, spin: Callable[[float], None]) -> None:
        self._node, self._spin = node, spin
        self._clients: dict[tuple[Any, str], Any] = {}
        self._open: list[Any] = []
        self._values: dict[str, list[Any]] = {}

    def lifecycle(self, seconds: float, rate: float, seed: int) -> dict[str, int]:
        """Request transitions in random order, most of them invalid; returns the number of requests by node.

        None is shut down, after which only a new process could be active.

        Parameters:
            seconds: duration.
            rate (Hz): of all requests.
            seed: of the random values.
        """
        random, sent, names = Random(seed), Counter[str](), self._nodes('lifecycle_msgs/srv/ChangeState')
        valid = [1, 2, 3, 4]
        for number in paced(seconds, rate if names else 0.0, lambda: self._spin(0.0)):
            name = names[number % len(names)]
            transition = random.choice(valid) if random.random() < 0.7 else random.randrange(256)
            if transition in SHUTDOWNS:
                continue
            request = ChangeState.Request(transition=Transition(id=transition))
            sent[name] += self._send(ChangeState, f'{name}/change_state', request)
        return dict(sent)

    def parameters(self, seconds: float, rate: float, seed: int) -> dict[str, int]:
        """Ask for, describe and set parameters of real and invented names to hostile values; returns the number by node."""
        random, sent, names = Random(seed), Counter[str](), self._nodes('rcl_interfaces/srv/SetParameters')
        values = HostileValues(random)
        known = {name: self._remember(name) for name in names}
        for number in paced(seconds, rate if names else 0.0, lambda: self._spin(0.0)):
            name = names[number % len(names)]
            own = known[name] or ['']
            chosen = [random.choice(own) if random.random() < 0.8 else random.choice(('', 'x' * 5000, 'a.b', '\u202e', 'rate'))
                      for _ in range(random.choice((1, 1, 2, 10)))]
            kind = random.choice((SetParameters, SetParameters, SetParametersAtomically, GetParameters, DescribeParameters,
                                  ListParameters))
            request = kind.Request()
            if hasattr(request, 'parameters'):
                request.parameters = [Parameter(name=one, value=_value(values)) for one in chosen]
            elif hasattr(request, 'names'):
                request.names = chosen
            else:
                request.prefixes, request.depth = chosen, values.integer(64, unsigned=True)
            sent[name] += self._send(kind, f'{name}/{_service(kind)}', request)
        return dict(sent)

    def restore(self, timeout: float = 20.0) -> list[str]:
        """Set what was before, activate every node, enable pointing; returns the nodes that cannot be active again."""
        deadline = time.monotonic() + timeout
        for name, before in self._values.items():
            self._call(SetParameters, f'{name}/set_parameters', SetParameters.Request(parameters=before))
        waiting = dict.fromkeys(self._nodes('lifecycle_msgs/srv/ChangeState'), -1)
        while time.monotonic() < deadline:
            for name in list(waiting):
                answer = self._call(GetState, f'{name}/get_state', GetState.Request())
                waiting[name] = answer.current_state.id if answer is not None else -1
                if waiting[name] == State.PRIMARY_STATE_ACTIVE:
                    del waiting[name]
                elif waiting[name] in FORWARD:
                    request = ChangeState.Request(transition=Transition(id=FORWARD[waiting[name]]))
                    self._call(ChangeState, f'{name}/change_state', request)
            if all(state == State.PRIMARY_STATE_FINALIZED for state in waiting.values()):
                break
            self._spin(0.05)
        self.enable(True)
        return sorted(waiting)

    def enable(self, enabled: bool) -> bool:
        """Permit or forbid that commands move the rig; returns whether the pointing node agreed."""
        answer = self._call(SetBool, ENABLE, SetBool.Request(data=enabled))
        return answer is not None and answer.success

    def _nodes(self, kind: str) -> list[str]:
        """Names of the rig's nodes with a service of a type such as `std_srvs/srv/SetBool`."""
        own = self._node.get_fully_qualified_name()
        return sorted({service.rpartition('/')[0] for service, kinds in self._node.get_service_names_and_types()
                       if kind in kinds and not service.startswith((own, '/attack_', '/launch_ros'))})

    def _remember(self, name: str) -> list[str]:
        """Names of a node's parameters; their values are kept for `restore`."""
        listed = self._call(ListParameters, f'{name}/list_parameters', ListParameters.Request())
        names = list(listed.result.names) if listed is not None else []
        if names and name not in self._values:
            answer = self._call(GetParameters, f'{name}/get_parameters', GetParameters.Request(names=names))
            self._values[name] = [] if answer is None else [
                Parameter(name=one, value=value) for one, value in zip(names, answer.values, strict=True)
                if value.type != ParameterType.PARAMETER_NOT_SET]
        return names

    def _client(self, kind: Any, service: str) -> Any:
        if (kind, service) not in self._clients:
            self._clients[kind, service] = self._node.create_client(kind, service)
        return self._clients[kind, service]

    def _send(self, kind: Any, service: str, request: Any) -> bool:
        """Send a request without waiting for its answer; False where too many are open."""
        self._open = [future for future in self._open if not future.done()]
        client = self._client(kind, service)
        if len(self._open) >= MOST_OPEN:
            self._spin(0.1)
            self._open = self._open[MOST_OPEN // 2:]
        if not client.service_is_ready():
            self._spin(0.02)
            return False
        self._open.append(client.call_async(request))
        return True

    def _call(self, kind: Any, service: str, request: Any, timeout: float = 2.0) -> Any:
        """The answer to a request, None without one in time."""
        client, deadline = self._client(kind, service), time.monotonic() + timeout
        while not client.service_is_ready() and time.monotonic() < deadline:
            self._spin(0.05)
        future = client.call_async(request)
        while not future.done() and time.monotonic() < deadline:
            self._spin(0.02)
        if not future.done():
            client.remove_pending_request(future)
        return future.result() if future.done() else None


def _service(kind: Any) -> str:
    return {SetParameters: 'set_parameters', SetParametersAtomically: 'set_parameters_atomically',
            GetParameters: 'get_parameters', DescribeParameters: 'describe_parameters', ListParameters: 'list_parameters'}[kind]


def _value(values: HostileValues) -> ParameterValue:
    """A parameter of any type, in bounds or not; the type may not agree with the value."""
    random = values.random
    return ParameterValue(
        type=random.choice((*range(10), 255)), bool_value=random.random() < 0.5,
        integer_value=random.choice((*NUMBERS, random.randrange(100_000))), double_value=values.real(),
        string_value=values.value('string'), double_array_value=[values.real() for _ in range(random.randrange(4))],
        integer_array_value=[random.choice(NUMBERS) for _ in range(random.randrange(4))],
        string_array_value=[values.value('string') for _ in range(random.randrange(3))])
