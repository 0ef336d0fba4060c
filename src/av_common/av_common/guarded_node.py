"""A lifecycle node that no message can end, and that leaves nothing behind when it is cleaned up."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import deserialize_message
from rclpy.time_source import USE_SIM_TIME_NAME
from rosgraph_msgs.msg import Clock as ClockMessage

from av_common.refused_inputs import RefusedInputs
from av_common.stamps import to_seconds

__all__ = ('GuardedNode', 'check_size', 'decode')

# Largest serialised message in bytes. A message that claims more elements than it holds makes the middleware allocate
# a multiple of its size before it fails.
LARGEST_MESSAGE, LARGEST_BULK_MESSAGE = 1_000_000, 256_000_000
SMALLEST_MESSAGE = 4  # of the encapsulation; rmw_cyclonedds_cpp reads beyond the end of shorter ones
CLOCK_TOPIC = '/clock'


class Reader:
    """Takes the messages of a subscription that no executor waits for; until then they wait in the middleware.

    For those who look at a topic now and then: messages that newer ones replace (by the depth of the queue) cost little.

    Attributes:
        subscription: of the node.

    Parameters:
        subscription: see `GuardedNode.create_reader`.
    """

    def __init__(self, subscription: Any) -> None:
        self.subscription = subscription

    def take(self) -> list[tuple[bytes, float]]:
        """The messages that wait, serialised, the oldest first, each with the time (s, Unix) at which it was published."""
        handle, found = self.subscription.handle, []
        with handle:
            while (taken := handle.take_message(self.subscription.msg_type, True)) is not None:
                data, info = taken
                found.append((data, 1e-9 * (info['source_timestamp'] or time.time_ns())))
        return found


class GuardedNode(LifecycleNode):
    """A lifecycle node whose callbacks cannot raise into the executor.

    Every callback of a subscription, service or timer is guarded: what it raises is counted in `refused` under the name
    of the topic, service or timer, and the node goes on. Messages arrive serialised and are decoded inside of the guard,
    since the executor either ends on malformed ones or delivers them as zeros. A refused service request is answered
    by `success: false` or, for parameters, by the reason. Callbacks that were queued when their subscription or timer was
    destroyed are not called.

    Attributes:
        refused: counts of inputs that could not be used.

    Parameters:
        name: the node's name.
        kwargs: passed to `rclpy.lifecycle.LifecycleNode`.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.refused = RefusedInputs(self.get_logger)
        self._read: set[Any] = set()  # subscriptions of readers
        super().__init__(name, **kwargs)
        for service in self.services:
            if service.callback.__module__ != __name__:  # those of rclpy that were made without create_service
                service.callback = _guarded_service(self.refused, service.srv_type, service.srv_name, service.callback)

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[[Any], Any], qos_profile: Any, *,
                            raw: bool = False, **kwargs: Any) -> Any:
        """As in rclpy, guarded. The callback takes the message only.

        Parameters:
            msg_type: type of the messages.
            topic: name of the topic.
            callback: function that is called with each message.
            qos_profile: quality of service, or depth of the queue.
            raw: pass serialised messages to the callback.
            kwargs: passed to rclpy.
        """
        decoded = bytes if raw else functools.partial(decode, msg_type)

        def take(data: bytes) -> None:
            if subscription in self.subscriptions:
                self._call(topic, lambda: callback(decoded(data)))

        subscription = super().create_subscription(msg_type, topic, take, qos_profile, raw=True, **kwargs)
        return subscription

    def create_reader(self, msg_type: Any, topic: str, qos_profile: Any) -> Reader:
        """A subscription that the executor does not wait for: see `Reader`.

        Parameters:
            msg_type: type of the messages.
            topic: name of the topic.
            qos_profile: quality of service; its depth is the number of messages that wait.
        """
        subscription = super().create_subscription(msg_type, topic, lambda _: None, qos_profile, raw=True)
        self._read.add(subscription)
        return Reader(subscription)

    @property
    def subscriptions(self) -> Iterator[Any]:
        """The subscriptions that executors wait for."""
        return (subscription for subscription in super().subscriptions if subscription not in self._read)

    def destroy_subscription(self, subscription: Any) -> bool:
        """As in rclpy."""
        self._read.discard(subscription)
        return bool(super().destroy_subscription(subscription))

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **kwargs: Any) -> Any:
        """As in rclpy, guarded.

        Parameters:
            srv_type: type of the service.
            srv_name: its name.
            callback: function from request and empty response to the response.
            kwargs: passed to rclpy.
        """
        serve = _guarded_service(self.refused, srv_type, srv_name, callback)
        return super().create_service(srv_type, srv_name, serve, **kwargs)

    def create_timer(self, timer_period_sec: float, callback: Callable[[], Any], clock: Clock | None = None,
                     **kwargs: Any) -> Any:
        """As in rclpy, guarded, and without simulated time by the steady clock: one that is set back by an hour rests as long.

        Parameters:
            timer_period_sec (s): the period.
            callback: function that is called at each period.
            clock: by which the period is measured; None as above.
            kwargs: passed to rclpy.
        """
        if clock is None and not self.get_parameter(USE_SIM_TIME_NAME).value:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
        name = f'timer {getattr(callback, "__name__", callback)}'

        def tick() -> None:
            if timer in self.timers:
                self._call(name, callback)

        timer = super().create_timer(timer_period_sec, tick, clock=clock, **kwargs)
        return timer

    def create_steady_timer(self, period: float, callback: Callable[[], Any]) -> Any:
        """A guarded timer that simulated time does not stop, either.

        Parameters:
            period (s): the period.
            callback: function that is called at each period.
        """
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _call(self, name: str, callback: Callable[[], Any]) -> None:
        try:
            callback()
        except Exception as error:  # noqa: BLE001  the guard of all subscriptions and timers
            self.refused.refuse(name, error)

    def entities(self) -> list[Any]:
        """Publishers, subscriptions, services, clients and timers of the node, except for the subscription to /clock."""
        subscriptions = (entity for entity in super().subscriptions if entity.topic != CLOCK_TOPIC)
        return [*subscriptions, *self.timers, *self.services, *self.clients, *self.publishers]

    def destroy_entities(self, entities: Iterable[Any]) -> None:
        """Destroy entities of any kind.

        Parameters:
            entities: some of those that `entities` returns; others are ignored.
        """
        for entity in entities:
            for destroy in (self.destroy_subscription, self.destroy_timer, self.destroy_service, self.destroy_client,
                            self.destroy_publisher):
                if destroy(entity):
                    break


def _guarded_service(refused: RefusedInputs, srv_type: Any, name: str,
                     callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def serve(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:  # noqa: BLE001  the guard of all services
            refused.refuse(name, error)
            return _refusal(srv_type, request, str(error))

    return serve


@functools.cache
def _largest(msg_type: Any) -> int:
    """Bytes that a message may have: more for bulk data, which are arrays of numbers named data or samples."""
    fields = msg_type.get_fields_and_field_types()
    bulk = any(fields.get(name, '').startswith('sequence<') for name in ('data', 'samples'))
    return LARGEST_BULK_MESSAGE if bulk else LARGEST_MESSAGE


def check_size(msg_type: Any, data: bytes) -> None:
    """Raise ValueError for a serialised message that is too short or too long for its type.

    Parameters:
        msg_type: type of the message.
        data: as a subscription with `raw` gives it.
    """
    if not SMALLEST_MESSAGE <= len(data) <= _largest(msg_type):
        raise ValueError(f'a message of {len(data)} bytes, expected {SMALLEST_MESSAGE} to {_largest(msg_type)}')


def decode(msg_type: Any, data: bytes) -> Any:
    """The message of a serialised one. Raises ValueError for malformed ones, RMWError for truncated ones.

    Parameters:
        msg_type: type of the message.
        data: as a subscription with `raw` gives it.
    """
    check_size(msg_type, data)
    message = deserialize_message(data, msg_type)
    if msg_type is ClockMessage:
        to_seconds(message.clock)  # raises ValueError for times that no clock of a node can take
    return message


def _refusal(srv_type: Any, request: Any, reason: str) -> Any:
    """The response to a request that could not be used: that of an empty response, with the reason where it has a place."""
    response = srv_type.Response()
    result = SetParametersResult(successful=False, reason=reason)
    if srv_type is SetParameters:
        response.results = [result] * len(request.parameters)
    elif srv_type is SetParametersAtomically:
        response.result = result
    elif hasattr(response, 'message'):
        response.message = reason
    return response
