"""Declaring parameters with a description, unit, range and choices."""

from collections.abc import Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.node import Node

from sl_common.errors import InvalidInputError

T = TypeVar("T", bool, int, float, str, list[str], list[float])


def declare(
    node: Node,
    name: str,
    default: T,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    fixed: bool = True,
) -> T:
    """Declare a parameter and return its value, of the type of ``default``; a float parameter takes an integer too.

    Args:
        node: The node that owns it.
        name: Its name.
        default: Its default, which also sets the type: bool, int, float, str, list of str or list of float.
        description: One line for ``ros2 param describe``.
        unit: Unit, appended to the description.
        minimum: Least value of a number, or of each element of a list.
        maximum: Greatest value.
        choices: Allowed strings.
        fixed: True when a change after start-up has no effect and is refused.

    Raises:
        InvalidInputError: A value from the command line or a file has the wrong type or is out of range.
    """
    constraint = _constraint(minimum, maximum, unit, choices)
    descriptor = ParameterDescriptor(
        description=f"{description} [{unit}]" if unit and unit != "1" else description,
        additional_constraints=constraint,
        dynamic_typing=True,
        read_only=fixed,
    )
    if isinstance(default, list) and not default:
        descriptor.type = ParameterType.PARAMETER_STRING_ARRAY
    value = node.declare_parameter(name, default, descriptor).value
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if isinstance(default, list):
        value = [float(v) if isinstance(v, int) and not isinstance(v, bool) else v for v in value or []]
    _check(name, value, default, minimum, maximum, choices, unit)
    return value


def _constraint(minimum: float | None, maximum: float | None, unit: str, choices: Sequence[str]) -> str:
    if choices:
        return f"one of {', '.join(choices)}"
    low = f"at least {minimum:g}" if minimum is not None else ""
    high = f"at most {maximum:g}" if maximum is not None else ""
    text = " and ".join(t for t in (low, high) if t)
    symbol = unit if unit != "1" and " " not in unit else ""  # a number has none, and a remark is not a unit
    return f"{text} {symbol}".strip() if text else ""


def _check(
    name: str,
    value: Any,
    default: Any,
    minimum: float | None,
    maximum: float | None,
    choices: Sequence[str],
    unit: str,
) -> None:
    if type(value) is not type(default):
        raise InvalidInputError(
            f"parameter {name} is {value!r} ({type(value).__name__}), "
            f"expected {type(default).__name__} such as {default!r}"
        )
    if choices and value not in choices:
        raise InvalidInputError(f"parameter {name} is '{value}', expected one of {', '.join(choices)}")
    for number in value if isinstance(value, list) else [value]:
        if isinstance(number, int | float) and not isinstance(number, bool):
            below = minimum is not None and not number >= minimum
            above = maximum is not None and not number <= maximum
            if below or above or number != number:
                raise InvalidInputError(
                    f"parameter {name} is {number:g}, expected {_constraint(minimum, maximum, unit, ()) or 'a number'}"
                )
