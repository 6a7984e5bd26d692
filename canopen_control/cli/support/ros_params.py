"""`ros param`: the parameters of a ROS node listed, read and set, as `ros2 param` does, by its services.

A value is YAML; an integer is taken for a parameter that is a double. What the node refuses is told in its words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.cli.support.output import json_text
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.parameters import SCALARS
from canopen_control.yamlfile.reader import read

if TYPE_CHECKING:
    import argparse

    from canopen_control.ros.graph import Graph

__all__ = ["get_parameter", "list_parameters", "set_parameter", "typed"]


def list_parameters(graph: Graph, args: argparse.Namespace) -> int:
    """Print the names of a node's parameters, a line for each."""
    names = list(_call(graph, args, "list_parameters", "ListParameters", {}).result.names)
    print(json_text(names) if args.json else "\n".join(names))
    return 0


def get_parameter(graph: Graph, args: argparse.Namespace) -> int:
    """Print the value of a parameter; CanopenError if the node has none of that name."""
    from canopen_control.ros.parameter_values import wanted_by

    values = _call(graph, args, "get_parameters", "GetParameters", {"names": [args.name]}).values
    if not values:
        raise _absent(args)
    value = wanted_by(_Named(args.name, values[0])).value
    print(json_text(value) if args.json else value)
    return 0


def set_parameter(graph: Graph, args: argparse.Namespace) -> int:
    """Set a parameter to a value; CanopenError with the node's reason if it refuses."""
    from canopen_control.ros.parameter_values import TYPES

    node = read(args.value, "<value>", error=ConfigError)
    node.problems.raise_if_any(ConfigError)
    types = _call(graph, args, "get_parameter_types", "GetParameterTypes", {"names": [args.name]}).types
    if not types:
        raise _absent(args)
    declared = next((kind for kind, number in TYPES.items() if number == types[0]), "not_set")
    kind, value = typed(node.value, declared)
    message = {"type": TYPES[kind], f"{kind}_value": value}
    wanted = {"parameters": [{"name": args.name, "value": message}]}
    (result,) = _call(graph, args, "set_parameters", "SetParameters", wanted).results
    if not result.successful:
        raise CanopenError(f"{args.node} has not set {args.name}: {result.reason}")
    return 0


def typed(value: object, declared: str) -> tuple[str, Any]:
    """Return the type that a value has for ROS, and the value; `declared` is that of the parameter.

    ConfigError for what is no value of a parameter.
    """
    if isinstance(value, list):
        element = declared.removesuffix("_array")
        found = [typed(each, element) for each in value]
        kinds = {kind for kind, _ in found} or {element}
        if len(kinds) == 1 and kinds <= set(SCALARS.values()):
            return f"{kinds.pop()}_array", [each for _, each in found]
    elif type(value) is int and declared == "double":
        return declared, float(value)
    elif type(value) in SCALARS:
        return SCALARS[type(value)], value
    raise ConfigError(f"a parameter cannot be {value!r}: give true, false, a number, a text, or a list of one of these")


def _absent(args: argparse.Namespace) -> CanopenError:
    return CanopenError(f"{args.node} has no parameter {args.name}; see: canopen-control ros param list {args.node}")


def _call(graph: Graph, args: argparse.Namespace, service: str, kind: str, data: object) -> Any:  # noqa: ANN401 - ROS's
    path = f"/{args.node.strip('/')}/{service}"
    return graph.call(path, f"rcl_interfaces/srv/{kind}", data, args.timeout)


class _Named:
    """A value with its name, as rcl_interfaces/msg/Parameter has them."""

    def __init__(self, name: str, value: object) -> None:
        self.name, self.value = name, value
