"""Between the parameters of the actuator and those of the client library."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ema_record.errors import EmaError
from ema_ros.parameters import ParameterSpec, Value


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
