"""`EmaNode`: the life of a node, and its parameters."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from ema_record.errors import EmaError, UsageError
from ema_record.kit import use_kit
from ema_ros.messages import monitors, refuse_wrong_transitions
from ema_ros.parameters import AUTOSTART, KIT, USE_SIM_TIME, ParameterSpec, Value, check_values
from ema_ros.process import StopSignal

LOOK_FOR_OTHERS = 0.6
"""How long a node looks for others on the graph (s): one of its kind before it offers its service,
an actuator before a bag is published."""
DIAGNOSTICS_PERIOD = 1.0
"""Between two messages on `/diagnostics` (s)."""


class EmaNode(LifecycleNode):
    """A lifecycle node that `process.run_node` can run, with all its parameters and its kit.

    A node reads its parameters when it is made, loads and compiles when it is configured, and
    listens and acts while it is active. Unless its parameter ``autostart`` is false it goes
    there by itself.

    Parameters
    ----------
    stop : tells that the process was asked to end.

    Raises
    ------
    UsageError
        A parameter was given without a value, the kit that `KIT` names is none, or ROS has no
        namespace of that name.
    """

    name = ""
    """Of the node, unless it is given another one."""

    def __init__(self, stop: StopSignal) -> None:
        """Appear on the graph, unconfigured."""
        try:
            super().__init__(self.name, automatically_declare_parameters_from_overrides=True)
        except ValueError:
            raise UsageError(
                "a parameter has no value, or an empty list for one: give NAME:=VALUE"
            ) from None
        except RuntimeError as error:  # of the library, with where it arose in its own sources
            raise UsageError(
                f"{str(error).partition(', at ')[0]}: a namespace is written /left_aileron, "
                "without a slash at its end"
            ) from None
        refuse_wrong_transitions(self)
        self.exit_status: int | None = None
        """Set: the process is to end with this status."""
        self.problem: Exception | None = None
        """Why the last transition failed."""
        self._stop = stop
        self.is_active = self._starting = False
        self._unconfigured = set(self.publishers)
        self._active_entities: list[tuple[Callable[[Any], object], Any]] = []
        use_kit(str(KIT.check(given_parameters(self).get(KIT.name, KIT.default))))

    def configure(self) -> None:
        """Load and compile what the node works with (EmaError: it cannot)."""

    def activate(self) -> None:
        """Begin to listen and to act; what is made here is handed to `while_active`."""

    def deactivate(self) -> None:
        """End what is going on."""

    def shut_down(self) -> None:
        """End what is going on, for the process is to end."""

    def while_active(self, *entities: Subscription | Timer | Service) -> None:
        """Destroy these when the node is deactivated."""
        for entity in entities:
            destroy = (
                self.destroy_timer if isinstance(entity, Timer)
                else self.destroy_service if isinstance(entity, Service)
                else self.destroy_subscription
            )
            self._active_entities.append((destroy, entity))

    @classmethod
    def started(cls, stop: StopSignal) -> EmaNode:
        """Return the node, active unless somebody else is to start it (EmaError: it cannot)."""
        node = cls(stop)
        node._starting = True
        if node.get_parameter(AUTOSTART.name).value:
            for step in (node.trigger_configure, node.trigger_activate):
                if step() != TransitionCallbackReturn.SUCCESS:
                    assert node.problem is not None
                    raise node.problem
        node._starting = False
        return node

    def refuse_another(self) -> None:
        """Raise UsageError where a monitor of these topics, looked for a while, is there."""
        end = time.monotonic() + LOOK_FOR_OTHERS
        while time.monotonic() < end and not self._stop:
            if others := monitors(self):
                raise UsageError(
                    f"another monitor offers {others[0]} on this domain: stop it, or set another "
                    "ROS_DOMAIN_ID"
                )
            time.sleep(0.02)

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Configure the node."""
        return self._carry_out(self.configure)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Destroy the publishers that `configure` made."""
        for publisher in set(self.publishers) - self._unconfigured:
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Activate the node."""
        result = self._carry_out(self.activate)
        self.is_active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate the node."""
        result = self._carry_out(self.deactivate)
        for destroy, entity in self._active_entities:
            destroy(entity)
        self._active_entities.clear()
        self.is_active = False
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End what is going on, from whatever state: the node acts no more."""
        result = self.on_deactivate(state) if self.is_active else TransitionCallbackReturn.SUCCESS
        self.on_cleanup(state)
        return result

    def _carry_out(self, change: Callable[[], None]) -> TransitionCallbackReturn:
        """Do what a transition asks for; say what is in the way, and keep it."""
        try:
            change()
        except EmaError as error:
            self.problem = error
            if not self._starting:  # then who starts it says so
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.problem = error
            raise
        return TransitionCallbackReturn.SUCCESS


def declare_parameters(node: Node, specs: Iterable[ParameterSpec]) -> dict[str, Value]:
    """Declare all parameters of a node with their bounds and return their values.

    Raises
    ------
    UsageError
        A name or a value given to the node is wrong.
    """
    specs = [*specs, AUTOSTART]
    given = given_parameters(node)
    values = check_values(specs, given)
    fixed = ParameterDescriptor(type=ParameterType.PARAMETER_BOOL, read_only=True)
    node.set_descriptor(USE_SIM_TIME, fixed)
    for spec in specs:
        if spec.name in given:  # declared by the node itself, without bounds
            node.undeclare_parameter(spec.name)
        node.declare_parameter(
            spec.name, values[spec.name], _descriptor(spec), ignore_override=True
        )
    return values


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the parameters that an `EmaNode` was given or has declared, known or not."""
    return {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}


def on_parameters(
    node: Node, specs: Iterable[ParameterSpec], apply: Callable[[dict[str, Value]], None]
) -> None:
    """Call `apply` with checked new values; an EmaError that it raises refuses them."""
    known = {spec.name: spec for spec in specs}

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        try:
            apply({p.name: known[p.name].check(p.value) for p in parameters if p.name in known})
        except EmaError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=spec.description, read_only=spec.read_only)
    descriptor.additional_constraints = (
        f"one of {', '.join(spec.options)}" if spec.options else ""
    )
    if spec.lower is None or spec.upper is None:
        return descriptor
    if isinstance(spec.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.lower), to_value=float(spec.upper))
        ]
    else:
        descriptor.integer_range = [
            IntegerRange(from_value=int(spec.lower), to_value=int(spec.upper), step=1)
        ]
    return descriptor
