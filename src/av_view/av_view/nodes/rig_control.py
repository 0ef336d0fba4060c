"""What viewers with the token may ask of a rig: each action is a service that the rig itself offers."""

from __future__ import annotations

import asyncio
import queue
import re
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import SetBool

TIMEOUT_S = 5.0
NODE_NAME = re.compile(r'(/[A-Za-z_]\w*)+')
MOST_PARAMETERS = 200
# Values of parameters that a page can enter.
KINDS = {ParameterType.PARAMETER_BOOL: Parameter.Type.BOOL, ParameterType.PARAMETER_INTEGER: Parameter.Type.INTEGER,
         ParameterType.PARAMETER_DOUBLE: Parameter.Type.DOUBLE, ParameterType.PARAMETER_STRING: Parameter.Type.STRING}
# Services of a rig by the action that needs them.
SERVICES = {'enable': 'pointing_node/enable', 'record': 'recorder_node/change_state', 'pause': 'player_node/pause'}
Done = Callable[[dict[str, Any]], None]


class RigControl:
    """Carries out requests in the thread of a node, by `work`; `act` is called in another thread.

    Parameters:
        node: calls the services.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._clients: dict[str, Any] = {}
        self._parameters: dict[str, AsyncParameterClient] = {}

    async def act(self, name: str, rig: str, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request. Raises ValueError, TypeError or KeyError for one that is none, TimeoutError without an answer.

        Parameters:
            name: of the action: `enable`, `record`, `pause`, `parameters` or `set`.
            rig: namespace of the rig.
            request: values of the action.
        """
        start = self._starter(name, rig, request)
        answer: Future[dict[str, Any]] = Future()

        def begin() -> None:
            try:
                start(answer.set_result)
            except Exception as error:  # noqa: BLE001  goes to the viewer, by the thread that waits
                answer.set_exception(ValueError(str(error)))

        self._work.put(begin)
        return await asyncio.wait_for(asyncio.wrap_future(answer), TIMEOUT_S)

    def work(self) -> None:
        """Begin what viewers asked for since the last call."""
        while not self._work.empty():
            self._work.get()()

    def offers(self, rig: str) -> list[str]:
        """The actions for which a rig has the service."""
        present = {name for name, _ in self._node.get_service_names_and_types()}
        return [action for action, service in SERVICES.items() if f'{rig}/{service}' in present]

    def _starter(self, name: str, rig: str, request: dict[str, Any]) -> Callable[[Done], None]:
        """What begins the action in the thread of the node."""
        if name in SERVICES:
            service, value = f'{rig}/{SERVICES[name]}', request['value']
            if not isinstance(value, bool):
                raise ValueError(f'value is {value!r}, expected true or false')
            return lambda done: self._switch(name, service, value, done)
        if name in ('parameters', 'set'):
            node = str(request['node'])
            if not NODE_NAME.fullmatch(node) or node.rpartition('/')[0] != rig:
                raise ValueError(f'node is {node[:80]!r}, expected one of the rig')
            if name == 'parameters':
                return lambda done: self._describe(node, done)
            parameter, value = str(request['name']), request['value']
            return lambda done: self._set(node, parameter, value, done)
        raise ValueError(f'do is {name[:40]!r}, expected {", ".join(SERVICES)}, parameters or set')

    def _switch(self, action: str, service: str, value: bool, done: Done) -> None:
        """Call a service that switches something on or off."""
        kind, wanted = SetBool, SetBool.Request(data=value)
        if action == 'record':
            change = Transition.TRANSITION_ACTIVATE if value else Transition.TRANSITION_DEACTIVATE
            kind, wanted = ChangeState, ChangeState.Request(transition=Transition(id=change))
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        client = self._clients[service]
        if not client.service_is_ready():
            raise ValueError(f'{service} is not offered at the moment')
        client.call_async(wanted).add_done_callback(lambda future: done(
            {'done': bool(future.result().success), 'words': getattr(future.result(), 'message', '')}))

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._parameters:
            self._parameters[node] = AsyncParameterClient(self._node, node)
        if not self._parameters[node].services_are_ready():
            raise ValueError(f'{node} does not answer at the moment: try again')
        return self._parameters[node]

    def _describe(self, node: str, done: Done) -> None:
        """The parameters of a node that can be changed at run time: three requests after one another."""
        client = self._client(node)

        def described(names: list[str], descriptors: list[ParameterDescriptor]) -> None:
            kept = [(name, one) for name, one in zip(names, descriptors, strict=True)
                    if not one.read_only and one.type in KINDS]
            client.get_parameters([name for name, _ in kept]).add_done_callback(lambda future: done(
                {'done': True, 'words': '', 'parameters': [
                    _entry(name, descriptor, parameter_value_to_python(value))
                    for (name, descriptor), value in zip(kept, future.result().values, strict=True)]}))

        def listed(names: list[str]) -> None:
            client.describe_parameters(names).add_done_callback(
                lambda future: described(names, future.result().descriptors))

        client.list_parameters([], 0).add_done_callback(
            lambda future: listed(sorted(future.result().result.names)[:MOST_PARAMETERS]))

    def _set(self, node: str, name: str, value: Any, done: Done) -> None:
        """Set a parameter to a value of its own type; the node checks the bounds."""
        client = self._client(node)

        def described(kind: int) -> None:
            if kind not in KINDS:
                done({'done': False, 'words': f'{node} has no parameter {name[:80]} that can be set here'})
                return
            try:  # a page knows one kind of number
                number = float(value) if KINDS[kind] == Parameter.Type.DOUBLE else value
                parameter = Parameter(name, KINDS[kind], number)
            except (ValueError, TypeError, OverflowError) as error:
                done({'done': False, 'words': f'{name}: {error}'})
                return
            client.set_parameters([parameter]).add_done_callback(lambda future: done(_result(future.result().results[0])))

        client.describe_parameters([name]).add_done_callback(lambda future: described(
            future.result().descriptors[0].type if future.result().descriptors else 0))


def _result(result: Any) -> dict[str, Any]:
    return {'done': bool(result.successful), 'words': result.reason or 'set'}


def _entry(name: str, descriptor: ParameterDescriptor, value: Any) -> dict[str, Any]:
    """A parameter for a page: value, bounds and description."""
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    bounds = [ranges[0].from_value, ranges[0].to_value] if ranges else None
    return {'name': name, 'value': value, 'bounds': bounds, 'words': descriptor.description,
            'constraints': descriptor.additional_constraints}
