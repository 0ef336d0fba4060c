"""Base of all nodes of the rig: lifecycle, automatic start, diagnostics, and a clean end."""

from __future__ import annotations

import signal
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from av_common.launched import report_started, restarts

try:  # uses a third of the processor time of SingleThreadedExecutor at the rates of the rig
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as Executor

__all__ = ('EXPECTED_ERRORS', 'Executor', 'RenamedParameterError', 'RigNode', 'run')
RETRY_S = 2.0
# Errors at start-up that may disappear until the next attempt: wrong values, missing files, absent devices.
EXPECTED_ERRORS = (ValueError, OSError, RuntimeError, ImportError)


class RenamedParameterError(ValueError):
    """A parameter is given by a name that it no longer has; the message names the old and the new name."""

    def __init__(self, old: str, new: str) -> None:
        super().__init__(f'the parameter {old} is now named {new}')


class RigNode(LifecycleNode):
    """A lifecycle node that activates itself and reports its state in /diagnostics.

    A subclass overrides `configure` (build the algorithm, open publishers), `activate` (open the source, subscribe),
    `deactivate` and `cleanup` (the reverse), and `diagnose`. When `configure` or `activate` raises one of
    EXPECTED_ERRORS the node stays alive, reports the message and, with `autostart`, tries again every two seconds.
    Subscriptions and timers made through `while_active` live from activation to deactivation.

    Parameters:
        name: the node's name.
        parameters: the class that generate_parameter_library made of the node's YAML description; None for a node
            without specific parameters.
        kwargs: passed to `rclpy.lifecycle.LifecycleNode`.

    Raises RenamedParameterError when a parameter is given by one of the names in RENAMED_PARAMETERS, and rclpy's
    InvalidParameterTypeException or InvalidParameterValueException for values of a wrong type or out of bounds.
    """

    # Names that parameters had in earlier versions, and the names that they have now.
    RENAMED_PARAMETERS: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str, parameters: Any = None, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._refuse_renamed_parameters()
        self.done = Future()  # the process of the node ends when it is done
        self._problem = ''
        self._active = False
        self._entities: list[tuple[Callable[[Any], Any], Any]] = []
        self._parameter_listener: Any = parameters.ParamListener(self) if parameters else None
        autostart = self.declare_parameter('autostart', True, ParameterDescriptor(
            description='Configure and activate without a lifecycle manager, and try again when that fails.',
            read_only=True)).value
        self._updater = Updater(self)
        self._updater.node_name = self.get_fully_qualified_name().lstrip('/')  # distinguishes rigs in several namespaces
        self._updater.setHardwareID('none')
        self._updater.add('status', self._diagnose)
        if autostart:
            self._autostart_timer = self.create_timer(0.0, self._autostart, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def settings(self) -> Any:
        """The current parameters, as the generated struct."""
        return self._parameter_listener.get_params()

    def now(self) -> float:
        """Time of the node's clock (ROS time, simulated with `use_sim_time`) in s since its epoch."""
        return 1e-9 * self.get_clock().now().nanoseconds

    @property
    def is_active(self) -> bool:
        """Whether the node is in the active state."""
        return self._active

    def configure(self) -> None:
        """Build the algorithm and the publishers from the parameters."""

    def activate(self) -> None:
        """Open sources and subscribe."""

    def deactivate(self) -> None:
        """Close what `activate` opened; `activate` may follow."""

    def cleanup(self) -> None:
        """Destroy what `configure` built; `configure` may follow."""

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Add values to the diagnostics of an active node; problems by `status.mergeSummary`."""

    def while_active(self, create: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create an entity that is destroyed on deactivation.

        Parameters:
            create: `self.create_subscription`, `create_timer`, `create_service` or `create_publisher`.
            args, kwargs: passed to `create`.
        """
        entity = create(*args, **kwargs)
        destroy = {self.create_subscription: self.destroy_subscription, self.create_timer: self.destroy_timer,
                   self.create_service: self.destroy_service, self.create_publisher: self.destroy_publisher}[create]
        self._entities.append((destroy, entity))
        return entity

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        return self._attempt(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        result = self._attempt(self.activate)
        self._active = result == TransitionCallbackReturn.SUCCESS
        if not self._active:
            self._release()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self._active = False
        self._release()
        return self._attempt(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        return self._attempt(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def finish(self) -> None:
        """End the node's process because its work is done; callable from any thread."""
        self.done.set_result(None)

    def close(self) -> None:
        """Deactivate before the process ends, in any state."""
        if self._active:
            self._active = False
            self._release()
            self._attempt(self.deactivate)

    def _refuse_renamed_parameters(self) -> None:
        """Raise RenamedParameterError when a file, the launch or the command line uses an old name."""
        for old, new in self.RENAMED_PARAMETERS.items():
            given = self.declare_parameter(old, None, ParameterDescriptor(dynamic_typing=True)).value
            self.undeclare_parameter(old)
            if given is not None:
                raise RenamedParameterError(old, new)

    def _release(self) -> None:
        while self._entities:
            destroy, entity = self._entities.pop()
            destroy(entity)

    def _attempt(self, step: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            step()
        except EXPECTED_ERRORS as error:
            problem = f'{step.__name__} failed: {error}'
            if problem != self._problem:
                self.get_logger().error(problem)
            self._problem = problem
            return TransitionCallbackReturn.FAILURE
        self._problem = ''
        return TransitionCallbackReturn.SUCCESS

    def _autostart(self) -> None:
        self._autostart_timer.cancel()
        self.destroy_timer(self._autostart_timer)
        if (self.trigger_configure() == TransitionCallbackReturn.SUCCESS
                and self.trigger_activate() != TransitionCallbackReturn.SUCCESS):
            self.trigger_cleanup_keeping_problem()
        if not self._active:
            self._autostart_timer = self.create_timer(RETRY_S, self._autostart,
                                                      clock=Clock(clock_type=ClockType.STEADY_TIME))

    def trigger_cleanup_keeping_problem(self) -> None:
        """Return to unconfigured after a failed activation, so that the next attempt reads the parameters again."""
        problem = self._problem
        self.trigger_cleanup()
        self._problem = problem

    def _diagnose(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        if self._problem:
            status.summary(DiagnosticStatus.ERROR, self._problem)
        elif not self._active:
            status.summary(DiagnosticStatus.WARN, 'not active')
        else:
            status.summary(DiagnosticStatus.OK, 'active')
            self.diagnose(status)
        status.add('restarts', str(restarts()))
        return status


def _finish_on_signal(signals: socket.socket, node: RigNode) -> None:
    if signals.recv(1):
        node.finish()


def run(node_class: Callable[[], RigNode]) -> None:
    """Run a node until it is interrupted: the body of each node's `main`.

    Exits with 1 and one line in the log when parameters are out of bounds, of a wrong type, or given by an old name.

    SIGINT, SIGTERM and SIGHUP (unless it is ignored, as under `nohup`) let the callback in progress finish and the node
    deactivate, with its publishers still alive.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # The executor waits in native code, where handlers in Python do not run: a thread reads the signal instead.
    signals, wakeup = socket.socketpair()
    wakeup.setblocking(False)
    signal.set_wakeup_fd(wakeup.fileno())
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
    try:
        node = node_class()
    except (RenamedParameterError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        rclpy.logging.get_logger(node_class.__name__).fatal(str(error))
        rclpy.try_shutdown()
        sys.exit(1)
    report_started()
    threading.Thread(target=_finish_on_signal, args=(signals, node), daemon=True).start()
    executor = Executor()
    executor.add_node(node)
    with suppress(ExternalShutdownException):
        executor.spin_until_future_complete(node.done)  # a tenth cheaper than one event at a time
    node.close()
    node.destroy_node()
    rclpy.try_shutdown()
