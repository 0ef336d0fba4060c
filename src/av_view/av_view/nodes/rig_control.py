"""What viewers with the token may ask of a rig: each action is a service, a parameter or a topic of the rig itself."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Log, ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from std_srvs.srv import SetBool, Trigger

from av_common.qos import RESULT
from av_interfaces.srv import SelectTarget
from av_view.feed import LONGEST_TEXT

TIMEOUT_S = 5.0  # after which a person is told that no answer came
# Parameters that people tune while they look, by nodes of the rig; all are real numbers.
TUNABLE = {'fusion_node': ['tau', 'confirm_threshold'], 'pointing_node': ['yaw_rate_deg']}
T = TypeVar('T')
FILES = ('.mcap', '.db3')
MOST_BAGS = 500  # names in one list


class BagFolder:
    """A folder whose bags may be opened, and nothing else.

    Parameters:
        folder: the folder; empty for none.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder).expanduser().resolve() if folder else None

    def names(self) -> list[str]:
        """Names of the bags, the newest first: files by their ending, folders by their metadata. Raises OSError.

        Entries that cannot be read are left out.
        """
        if self._folder is None:
            return []
        found: list[tuple[float, str]] = []
        for entry in self._folder.iterdir():
            with suppress(OSError):
                if _is_bag(entry) and entry.resolve().parent == self._folder:
                    found.append((entry.stat().st_mtime, entry.name))
        return [name for _, name in sorted(found, key=lambda pair: -pair[0])[:MOST_BAGS]]

    def path(self, name: object) -> str:
        """The path of a bag. Raises ValueError for what is not one of `names`."""
        if self._folder is None or name not in self.names():
            raise ValueError(f'{str(name)[:80]!r} is no bag of the folder {self._folder or "(none is set: bags:=FOLDER)"}')
        return str(self._folder / str(name))


def _is_bag(entry: Path) -> bool:
    return (entry.suffix in FILES and entry.is_file()) or (entry / 'metadata.yaml').is_file()


def _flag(values: dict[str, Any]) -> bool:
    if not isinstance(values['value'], bool):
        raise ValueError(f'value is {values["value"]!r}, expected true or false')
    return values['value']


def _identifier(values: dict[str, Any]) -> int:
    number = values['value']
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**32:
        raise ValueError(f'value is {str(number)[:40]}, expected the id of a target, or 0')
    return number


def _transition(values: dict[str, Any]) -> ChangeState.Request:
    change = Transition.TRANSITION_ACTIVATE if _flag(values) else Transition.TRANSITION_DEACTIVATE
    return ChangeState.Request(transition=Transition(id=change))


CONFIGURE = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))


# Services of the rig: name in the rig's namespace, type, and what makes a request of the values of a viewer's.
SERVICES: dict[str, tuple[str, Any, Callable[[dict[str, Any]], Any]]] = {
    'enable': ('pointing_node/enable', SetBool, lambda values: SetBool.Request(data=_flag(values))),
    'select': ('fusion_node/select', SelectTarget, lambda values: SelectTarget.Request(id=_identifier(values))),
    'turn': ('fusion_node/request_rotation', Trigger, lambda _: Trigger.Request()),
    'record': ('recorder_node/change_state', ChangeState, _transition),
    'pause': ('player_node/pause', SetBool, lambda values: SetBool.Request(data=_flag(values)))}


class RigControl:
    """Carries out requests in the thread of a node, by `work`; `act` is called in another thread.

    Parameters:
        node: calls the services.
        bags: bags that may be opened.
    """

    def __init__(self, node: Node, bags: BagFolder) -> None:
        self._node, self._bags = node, bags
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._clients: dict[str, Any] = {}
        self._marks: dict[str, Publisher] = {}

    async def act(self, name: str, rig: str, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request. Raises ValueError, TypeError or KeyError for one that is none, TimeoutError without an answer.

        Parameters:
            name: of the action: one of SERVICES, `mark`, `bags`, `open`, `seek`, `tuning` or `set`.
            rig: namespace of the rig.
            request: values of the action.
        """
        try:
            return await asyncio.wait_for(self._act(name, rig, request), TIMEOUT_S)
        except OverflowError as error:  # of a number that no parameter can be
            raise ValueError(str(error)) from error

    def work(self) -> None:
        """Begin what viewers asked for since the last call."""
        while not self._work.empty():
            self._work.get()()

    def offers(self, rig: str) -> list[str]:
        """The actions for which a rig has the service."""
        present = {name for name, _ in self._node.get_service_names_and_types()}
        return [action for action, (service, _, _) in SERVICES.items() if f'{rig}/{service}' in present]

    def prepare(self, rig: str, offers: Iterable[str]) -> None:
        """Make clients and the topic of marks known before the first request, which is late otherwise, a stop among them.

        Parameters:
            rig: namespace of the rig.
            offers: see `offers`.
        """
        for service, kind, _ in map(SERVICES.__getitem__, offers):
            self._client(f'{rig}/{service}', kind)
        if rig not in self._marks:
            self._marks[rig] = self._node.create_publisher(Log, f'{rig}/marks', RESULT)

    async def _act(self, name: str, rig: str, request: dict[str, Any]) -> dict[str, Any]:
        if name in SERVICES:
            service, kind, wanted = SERVICES[name]
            return await self._call(f'{rig}/{service}', kind, wanted(request))
        if name == 'mark':
            return await self._begin(partial(self._mark, rig, str(request['value']).strip()[:LONGEST_TEXT]))
        if name == 'bags':
            return {'done': True, 'words': '', 'bags': await self._begin(self._bags.names)}
        if name == 'open':
            return await self._set(f'{rig}/player_node', 'bag', await self._begin(partial(self._bags.path, request['value'])))
        if name == 'tuning':
            return await self._describe(rig)
        if name == 'seek':
            return await self._set(f'{rig}/player_node', 'position', float(request['value']))
        if name == 'set':
            node, parameter, value = str(request['node']), str(request['name']), request['value']
            if parameter not in TUNABLE.get(node, ()):
                raise ValueError(f'{node[:80]}: {parameter[:80]} is not set here, only {TUNABLE}')
            return await self._set(f'{rig}/{node}', parameter, float(value))
        raise ValueError(f'do is {name[:40]!r}, expected {", ".join(SERVICES)}, mark, bags, open, seek, tuning or set')

    async def _begin(self, work: Callable[[], T]) -> T:
        """What is done in the thread of the node, unless nobody waits for it any more. Raises ValueError where that fails."""
        answer: Future[T] = Future()

        def begin() -> None:
            if not answer.set_running_or_notify_cancel():
                return  # whoever asked was told that no answer came
            try:
                answer.set_result(work())
            except Exception as error:  # noqa: BLE001  goes to the viewer, by the thread that waits
                answer.set_exception(ValueError(str(error)))

        self._work.put(begin)
        return await asyncio.wrap_future(answer)

    async def _ask(self, service: str, kind: Any, wanted: Any) -> Any:
        """The answer of a service. Raises ValueError where nobody offers it."""
        answer: Future[Any] = Future()
        answer.set_running_or_notify_cancel()  # it may come when nobody waits any more

        def call() -> None:
            client = self._client(service, kind)
            if not client.service_is_ready():
                raise ValueError(f'{service} is not offered at the moment: try again')
            client.call_async(wanted).add_done_callback(lambda future: answer.set_result(future.result()))

        await self._begin(call)
        return await asyncio.wrap_future(answer)

    async def _call(self, service: str, kind: Any, wanted: Any) -> dict[str, Any]:
        if kind is ChangeState:  # a recorder may wait unconfigured; one that does not refuses this and is left as it is
            await self._ask(service, kind, CONFIGURE)
        answer = await self._ask(service, kind, wanted)
        return {'done': bool(answer.success), 'words': getattr(answer, 'message', '')}

    def _client(self, service: str, kind: Any) -> Any:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        return self._clients[service]

    def _mark(self, rig: str, text: str) -> dict[str, Any]:
        """Publish a mark with the time of the rig's clock."""
        if rig not in self._marks:
            raise ValueError('nobody looks at this rig')
        self._marks[rig].publish(Log(stamp=self._node.get_clock().now().to_msg(), level=Log.INFO, name=self._node.get_name(),
                                     msg=text or 'mark'))
        return {'done': True, 'words': f'marked: {text or "mark"}'}

    async def _describe(self, rig: str) -> dict[str, Any]:
        """What can be tuned of the nodes of TUNABLE. Those that are not offered are left out."""
        found: list[dict[str, Any]] = []
        for node, names in TUNABLE.items():
            with suppress(ValueError):
                told = await self._ask(f'{rig}/{node}/describe_parameters', DescribeParameters,
                                       DescribeParameters.Request(names=names))
                values = (await self._ask(f'{rig}/{node}/get_parameters', GetParameters,
                                          GetParameters.Request(names=names))).values
                found += [_entry(node, descriptor, value.double_value)
                          for descriptor, value in zip(told.descriptors, values, strict=True) if not descriptor.read_only]
        if not found:
            return {'done': False, 'words': f'{" and ".join(TUNABLE)} do not answer at the moment'}
        return {'done': True, 'words': '', 'parameters': sorted(found, key=lambda one: one['name'])}

    async def _set(self, node: str, name: str, value: float | str) -> dict[str, Any]:
        """Set a parameter; the node checks the bounds."""
        (result,) = (await self._ask(f'{node}/set_parameters', SetParameters, SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]))).results
        return {'done': bool(result.successful), 'words': result.reason or 'set'}


def _entry(node: str, descriptor: ParameterDescriptor, value: float) -> dict[str, Any]:
    """A parameter for a page: value, bounds and description."""
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    bounds = [ranges[0].from_value, ranges[0].to_value] if ranges else None
    return {'node': node, 'name': descriptor.name, 'value': value, 'bounds': bounds, 'words': descriptor.description}
