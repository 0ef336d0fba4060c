"""A node whose parameters are checked, each and together, at its start and whenever they are set."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, ClassVar

from lifecycle_msgs.msg import State
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.time_source import USE_SIM_TIME_NAME

from av_common.guarded_node import GuardedNode

__all__ = ('WHEN_CONFIGURED', 'ParameterNode')

# What additional_constraints of a parameter say that has no effect at run time.
WHEN_CONFIGURED = 'takes effect when the node is configured'
LONGEST_TEXT, LONGEST_LIST = 4096, 1024  # characters of a text (the longest path), elements of a list


def check_value(name: str, value: Any) -> None:
    """Raise ValueError for numbers that are not finite, and for texts and lists without measure.

    Parameters:
        name: the parameter.
        value: its value; of any type that parameters have.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f'{name} is {value}, expected a finite number')
    if isinstance(value, str):
        if len(value) > LONGEST_TEXT:
            raise ValueError(f'{name} has {len(value)} characters, expected at most {LONGEST_TEXT}')
    elif hasattr(value, '__len__'):
        if len(value) > LONGEST_LIST:
            raise ValueError(f'{name} has {len(value)} elements, expected at most {LONGEST_LIST}')
        for element in value:
            check_value(name, element)


class ParameterNode(GuardedNode):
    """A guarded node with the parameters of a YAML description.

    Parameters:
        name: the node's name.
        parameters: the class that generate_parameter_library made of the description, or None.
        kwargs: passed to `rclpy.lifecycle.LifecycleNode`.

    Raises rclpy's InvalidParameterTypeException or InvalidParameterValueException.
    """

    # Parameters that `apply_parameters` applies at run time. All others take effect when the node is configured.
    RUNTIME_PARAMETERS: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, name: str, parameters: Any = None, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._parameter_listener: Any = parameters.ParamListener(self) if parameters else None

    @property
    def settings(self) -> Any:
        """The current parameters, as the generated struct."""
        return self._parameter_listener.get_params()

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Raise ValueError that names the parameter, its value and what is expected, when parameters contradict each other.

        Parameters:
            settings: the generated struct; each parameter is within its own bounds.
        """

    def check_change(self, settings: Any) -> None:
        """As `check_parameters`, for a change at run time and by what the node has learnt from its inputs.

        Parameters:
            settings: the generated struct; it has passed `check_parameters`.
        """

    def apply_parameters(self) -> None:
        """Apply the `settings`, which changed at run time; called in the states inactive and active."""

    def guard_parameters(self, fixed: Iterable[str] = ()) -> None:
        """Check all parameters now, raising ValueError, and from now on before each change.

        Parameters:
            fixed: parameters that a library declared, and that have no effect after the start: they become read-only, as
                does `use_sim_time`, since ages and rates do not survive a change of the clock.
        """
        for name in (USE_SIM_TIME_NAME, *fixed):
            self.describe_parameter(name).read_only = True
        for parameter in self.get_parameters_by_prefix('').values():
            check_value(parameter.name, parameter.value)
            if parameter.name not in self.RUNTIME_PARAMETERS:
                self.describe_parameter(parameter.name).additional_constraints = WHEN_CONFIGURED
        if self._parameter_listener is not None:
            self.check_parameters(self.settings)
            self.remove_on_set_parameters_callback(self._parameter_listener.update)
        self.add_on_set_parameters_callback(self._on_set_parameters)

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        listener = self._parameter_listener
        before = listener and listener.params_
        try:
            for change in changes:
                check_value(change.name, change.value)
                if change.name not in self.RUNTIME_PARAMETERS and self._is_configured:
                    raise ValueError(f'{change.name} {WHEN_CONFIGURED}: deactivate it and clean it up before')
            if listener is not None:
                result = listener.update(changes)
                if not result.successful:
                    return result
                self.check_parameters(self.settings)
                if self._is_configured:
                    self.check_change(self.settings)
            if self._is_configured:
                self.apply_parameters()
        except ValueError as error:
            if listener is not None:
                listener.params_ = before
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    @property
    def _is_configured(self) -> bool:
        return self._state_machine.current_state[0] in (State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE)
