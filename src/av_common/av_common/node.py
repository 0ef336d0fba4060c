"""Base of all nodes of the rig: lifecycle, automatic start, diagnostics, and a clean end."""

from __future__ import annotations

import math
import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from lifecycle_msgs.msg import State
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from tf2_msgs.msg import TFMessage

from av_common.body_odometry import TF_WAIT_S, BodyOdometry, FixedFrames
from av_common.frames import BASE_FRAME
from av_common.launched import BEAT_PERIOD_S, HUNG, beat, report_started, restarts
from av_common.parameter_node import ParameterNode
from av_common.publishers import PERIOD_S, Publishers
from av_common.qos import FRAMES, STREAM
from av_common.refused_inputs import STRICT_VARIABLE

try:  # uses a third of the processor time of SingleThreadedExecutor at the rates of the rig
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as Executor

__all__ = ('EXPECTED_ERRORS', 'Executor', 'RigNode', 'TfOdometry', 'run')
RETRY_S = 2.0  # between attempts to configure and activate
FAREWELL_S = 0.2  # between the answer to a request to shut down and the end of the process
MINIMAL_PERIOD_S = 0.01  # of diagnostics
TOLD_S = 60.0  # after its start for which a process warns that it replaces one that hung
PAUSE_S = 0.01  # between errors of the middleware, so that a lasting one leaves the processor to others
# Errors at start-up that may disappear until the next attempt: wrong values, missing files, absent devices.
EXPECTED_ERRORS = (ValueError, OSError, RuntimeError, ImportError)


class TfOdometry(BodyOdometry):
    """By the `tf_static` of a node; odometry of a frame that is not known there is refused for TF_WAIT_S.

    Parameters:
        node: subscribes.
    """

    def __init__(self, node: Node) -> None:
        self._frames = FixedFrames()
        super().__init__(self._frames.rotation, TF_WAIT_S)
        node.create_subscription(TFMessage, 'tf_static', self._learn, FRAMES)

    def _learn(self, message: TFMessage) -> None:
        self._frames.learn(message.transforms)
        self.forget()


class RigNode(ParameterNode):
    """A lifecycle node that activates itself and reports its state in /diagnostics.

    A subclass overrides `configure` (build the algorithm, open publishers), `activate` (open the source, subscribe),
    `deactivate` and `cleanup` (the reverse), `diagnose`, `check_parameters` and `apply_parameters`. When `configure` or
    `activate` raises one of EXPECTED_ERRORS the node stays alive, reports the message and, with `autostart`, tries again
    every two seconds.

    Publishers, subscriptions, timers, services and clients have an owner: those made in `configure` are destroyed after
    `cleanup`, those made from `activate` on after `deactivate`. No message and no request can end the node: see `GuardedNode`.

    Attributes:
        contested: publishers of each input that has several, of those that `refuse_second_publishers` was told.

    Parameters:
        name: the node's name.
        parameters: the class that generate_parameter_library made of the node's YAML description; None for a node
            without specific parameters.
        kwargs: passed to `rclpy.lifecycle.LifecycleNode`.

    Raises ValueError, or rclpy's InvalidParameterTypeException or InvalidParameterValueException, for parameters that
    are of a wrong type, out of bounds, or contradict each other.
    """

    def __init__(self, name: str, parameters: Any = None, **kwargs: Any) -> None:
        super().__init__(name, parameters, **kwargs)
        self._born = time.monotonic()
        self.done = Future()  # the process of the node ends when it is done
        self._problem = ''
        self._active = False
        self.contested: Mapping[str, list[str]] = {}
        self._odometry: BodyOdometry | None = None
        self._unowned: set[Any] = set()  # entities that exist while unconfigured
        self._configured: set[Any] = set()  # and those while inactive
        autostart = self.declare_parameter('autostart', True, ParameterDescriptor(
            description='Configure and activate without a lifecycle manager, and try again when that fails.',
            read_only=True)).value
        self._updater = self._make_updater()
        self.guard_parameters((self._updater.period_parameter, self._updater.use_fqn_parameter))
        if autostart:
            self._autostart_timer = self.create_steady_timer(0.0, self._autostart)

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
        """Close what `configure` opened, except for publishers and subscriptions; `configure` may follow."""

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Add values to the diagnostics of an active node; problems by `status.mergeSummary`."""

    def refuse_second_publishers(self, *topics: str, tell: Callable[[Mapping[str, list[str]]], None] = lambda _: None,
                                 besides: Mapping[str, str] | None = None) -> None:
        """While the node is active, note in `contested` which of its inputs have several publishers, and report them.

        Parameters:
            topics: names of the inputs, relative to the node's namespace.
            tell: takes what is noted, each time.
            besides: see `Publishers`.
        """
        publishers = Publishers(self, topics, besides)

        def look_for_publishers() -> None:
            self.contested = publishers.contested(time.monotonic())
            tell(self.contested)

        look_for_publishers()
        self.create_steady_timer(PERIOD_S, look_for_publishers)

    def subscribe_odometry(self, take: Callable[[Odometry], Any]) -> None:
        """While the node is active, take `odometry`; that of a sensor becomes the body's by `tf_static`.

        Odometry of a frame that is not known there is taken as it is, with a warning in /diagnostics.

        Parameters:
            take: takes the body's odometry.
        """
        odometry = self._odometry = TfOdometry(self)
        self.create_subscription(Odometry, 'odometry', lambda message: take(odometry.of_body(message)), STREAM)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self._unowned = set(self.entities())
        result = self._attempt(self.configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self._destroy_all_but(self._unowned)
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self._configured = set(self.entities())
        result = self._attempt(self.activate)
        self._active = result == TransitionCallbackReturn.SUCCESS
        if not self._active:
            self._destroy_all_but(self._configured)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self._attempt(self.cleanup)
        self._destroy_all_but(self._unowned)
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; then the process ends, since a finalized node can do nothing any more."""
        self.close()
        if state.state_id != State.PRIMARY_STATE_UNCONFIGURED:
            self.on_cleanup(state)
        self.create_steady_timer(FAREWELL_S, self.finish)
        return TransitionCallbackReturn.SUCCESS

    def finish(self) -> None:
        """End the node's process because its work is done; callable from any thread."""
        self.done.set_result(None)

    def close(self) -> None:
        """Deactivate, in any state; also before the process ends."""
        if self._active:
            self._active = False
            publishers = set(self.publishers)  # which `deactivate` may still need
            self._destroy_all_but(self._configured | publishers)
            self._attempt(self.deactivate)
            self._destroy_all_but(self._configured)

    def _make_updater(self) -> Updater:
        updater = Updater(self)
        updater.node_name = self.get_fully_qualified_name().lstrip('/')  # distinguishes rigs in several namespaces
        updater.setHardwareID('none')
        updater.add('status', self._diagnose)
        period = self.get_parameter(updater.period_parameter).value
        if not MINIMAL_PERIOD_S <= period < math.inf:
            raise ValueError(f'{updater.period_parameter} is {period}, expected at least {MINIMAL_PERIOD_S} (s)')
        self.destroy_timer(updater.timer)  # stands still with simulated time
        updater.timer = self.create_steady_timer(period, updater.update)
        return updater

    @property
    def _lifecycle_state(self) -> int:
        """Identifier of the lifecycle state, of lifecycle_msgs/State."""
        return int(self._state_machine.current_state[0])

    def _destroy_all_but(self, kept: set[Any]) -> None:
        self.destroy_entities(entity for entity in self.entities() if entity not in kept)

    def begin_heartbeat(self) -> None:
        """Tell the launch from now on that the executor of this node goes on."""
        self.create_steady_timer(BEAT_PERIOD_S, beat)

    def _attempt(self, step: Callable[[], None]) -> TransitionCallbackReturn:
        beat(busy=True)
        try:
            step()
        except Exception as error:  # noqa: BLE001  rclpy would discard it
            problem = f'{step.__name__} failed: {error}'
            expected = isinstance(error, EXPECTED_ERRORS)
            if problem != self._problem:
                self.get_logger().error(problem if expected else ''.join(traceback.format_exception(error)))
            self._problem = problem
            if not expected and os.environ.get(STRICT_VARIABLE):
                self.done.set_exception(error)
            return TransitionCallbackReturn.FAILURE
        self._problem = ''
        return TransitionCallbackReturn.SUCCESS

    def _autostart(self) -> None:
        """Continue from the state that the node is in, to active; requests for transitions may have come in between."""
        self.destroy_timer(self._autostart_timer)
        if self._lifecycle_state == State.PRIMARY_STATE_UNCONFIGURED:
            self.trigger_configure()
        if (self._lifecycle_state == State.PRIMARY_STATE_INACTIVE
                and self.trigger_activate() != TransitionCallbackReturn.SUCCESS):
            problem = self._problem
            self.trigger_cleanup()  # so that the next attempt reads the parameters again
            self._problem = problem
        if self._lifecycle_state == State.PRIMARY_STATE_UNCONFIGURED:
            self._autostart_timer = self.create_steady_timer(RETRY_S, self._autostart)

    def _diagnose(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        if self._problem:
            status.summary(DiagnosticStatus.ERROR, self._problem)
        elif not self._active:
            status.summary(DiagnosticStatus.WARN, 'not active')
        else:
            status.summary(DiagnosticStatus.OK, 'active')
            for topic, names in self.contested.items():
                status.mergeSummary(
                    DiagnosticStatus.ERROR, f'{topic} has {len(names)} publishers ({", ".join(names)}) and is not used: stop '
                    'all but one, or give each rig a namespace; on an open network SROS 2 keeps others out')
            for frame in sorted(self._odometry.assumed if self._odometry else ()):
                status.mergeSummary(DiagnosticStatus.WARN, f'odometry is of {frame!r}, of which tf_static has no rotation to '
                                    f"{BASE_FRAME!r}: it counts as the body's")
            try:
                self.diagnose(status)
            except Exception as error:  # noqa: BLE001  the status of a node is published whatever it contains
                self.refused.refuse('diagnostics', error)
        self.refused.report(status)
        if restarts(HUNG) and time.monotonic() - self._born < TOLD_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'replaces a process that hung')
        status.add('restarts', str(restarts()))
        status.add('of them hung', str(restarts(HUNG)))
        return status


def _finish_on_signal(signals: socket.socket, node: RigNode) -> None:
    if signals.recv(1):
        node.finish()


def run(node_class: Callable[[], RigNode]) -> None:
    """Run a node until it is interrupted: the body of each node's `main`.

    Exits with 1 and one line in the log when parameters are out of bounds or of a wrong type.

    SIGINT, SIGTERM and SIGHUP (unless it is ignored, as under `nohup`) let the callback in progress finish and the node
    deactivate, with its publishers still alive.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # The executor waits in native code, where handlers in Python do not run: a thread reads the signal instead.
    signals, wakeup = socket.socketpair()
    wakeup.setblocking(False)
    signal.set_wakeup_fd(wakeup.fileno())
    caught = [number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
              if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN]
    for number in caught:
        signal.signal(number, lambda *_: None)
    try:
        node = node_class()
    except (ValueError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        rclpy.logging.get_logger(node_class.__name__).fatal(str(error))
        rclpy.try_shutdown()
        sys.exit(1)
    report_started()
    node.begin_heartbeat()
    threading.Thread(target=_finish_on_signal, args=(signals, node), daemon=True).start()
    try:
        _spin(node)
    finally:
        node.close()
        beat(busy=True)
        node.destroy_node()
        rclpy.try_shutdown()
        for number in caught:   # Python resets its handlers while it exits: a second Ctrl-C would look like a crash
            signal.signal(number, signal.SIG_IGN)
    if node.done.done():
        node.done.result()  # raises what ended the node, in tests


def _spin(node: RigNode) -> None:
    """Run the callbacks of a node until it is done, also past errors of the middleware before a callback is called."""
    while not node.done.done():
        executor = Executor()  # a new one counts again what waits in the queues
        executor.add_node(node)
        try:
            executor.spin_until_future_complete(node.done)  # a tenth cheaper than one event at a time
        except ExternalShutdownException:
            return
        except Exception as error:  # noqa: BLE001  such as a malformed request to a service
            node.refused.refuse('middleware', error)
            time.sleep(PAUSE_S)
        finally:
            executor.remove_node(node)
            executor.shutdown()
