"""Use topics, services and parameters of ROS 2 without ros2cli; also starts the bridge of a running robot.

It uses the domain of other ROS programs, and discovers programs of this host only, unless ROS_AUTOMATIC_DISCOVERY_RANGE
is set otherwise. Data is YAML, as for ros2. `bridge` passes --ros-args on to rclpy.

Exit codes: 0 success; 1 no publisher, subscriber or answer; 2 wrong usage, or no ROS 2 in this Python.
"""

from __future__ import annotations

import collections
import itertools
import os
import statistics
import sys
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from canopen_control.cli.support.arguments import number, seconds
from canopen_control.cli.support.output import json_alone, json_text, print_result
from canopen_control.commissioning.quantity import LONGEST_S
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.environment import MODULE, clean_environment
from canopen_control.host.signals import block_for_exec
from canopen_control.rpc.messages.parameters import SCALARS
from canopen_control.yamlfile.reader import read

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from canopen_control.ros.graph import Graph


# `ros param` lists, reads and sets the parameters of a ROS node by its services, as `ros2 param` does.
#
# A value is YAML; an integer is accepted for a parameter of type double. A refusal is printed with the node's reason.


def list_parameters(graph: Graph, args: argparse.Namespace) -> int:
    """Print the names of a node's parameters, one per line or as a JSON list."""
    names = list(_call_service(graph, args, "list_parameters", "ListParameters", {}).result.names)
    print(json_text(names) if args.json else "\n".join(names))
    return 0


def get_parameter(graph: Graph, args: argparse.Namespace) -> int:
    """Print the value of a parameter; raise CanopenError if the node does not have it."""
    from canopen_control.ros.controller_nodes import requested_value

    values = _call_service(graph, args, "get_parameters", "GetParameters", {"names": [args.name]}).values
    if not values:
        raise _absent(args)
    value = requested_value(SimpleNamespace(name=args.name, value=values[0])).value
    print(json_text(value) if args.json else value)
    return 0


def set_parameter(graph: Graph, args: argparse.Namespace) -> int:
    """Set a parameter to a YAML value; raise CanopenError with the node's reason if refused."""
    from canopen_control.ros.controller_nodes import TYPES

    node = read(args.value, "<value>", error=ConfigError)
    node.problems.raise_if_any(ConfigError)
    types = _call_service(graph, args, "get_parameter_types", "GetParameterTypes", {"names": [args.name]}).types
    if not types:
        raise _absent(args)
    declared = next((kind for kind, number in TYPES.items() if number == types[0]), "not_set")
    kind, value = typed(node.value, declared)
    message = {"type": TYPES[kind], f"{kind}_value": value}
    request = {"parameters": [{"name": args.name, "value": message}]}
    (result,) = _call_service(graph, args, "set_parameters", "SetParameters", request).results
    if not result.successful:
        raise CanopenError(f"{args.node} did not set {args.name}: {result.reason}")
    print_result(args, {"node": args.node, "name": args.name, "type": kind, "value": value})
    return 0


def typed(value: object, declared: str) -> tuple[str, Any]:
    """Return the ROS type and the value for a YAML value; `declared` is the type of the parameter.

    Raise ConfigError if no type of a parameter fits the value.
    """
    if isinstance(value, list):
        element = declared.removesuffix("_array")
        elements = [typed(item, element) for item in value]
        kinds = {kind for kind, _ in elements} or {element}
        if len(kinds) == 1 and kinds <= set(SCALARS.values()):
            return f"{kinds.pop()}_array", [item for _, item in elements]
    elif type(value) is int and declared == "double":
        return declared, float(value)
    elif type(value) in SCALARS:
        return SCALARS[type(value)], value
    raise ConfigError(f"a parameter cannot be {value!r}: give true, false, a number, a text, or a list of one of these")


def _absent(args: argparse.Namespace) -> CanopenError:
    return CanopenError(f"{args.node} has no parameter {args.name}; see: canopen-control ros param list {args.node}")


def _call_service(graph: Graph, args: argparse.Namespace, service: str, kind: str, data: object) -> Any:  # noqa: ANN401 - ROS's
    path = f"/{args.node.strip('/')}/{service}"
    return graph.call(path, f"rcl_interfaces/srv/{kind}", data, args.timeout)


EXAMPLE = """canopen-control ros topic list
         canopen-control ros topic echo /joint_states
         canopen-control ros topic hz /joint_states --for 2
         canopen-control ros topic pub /robby_forward_controller/commands std_msgs/msg/Float64MultiArray '{data: [5,5]}'
         canopen-control ros service list
         canopen-control ros service call /left_drive/halt std_srvs/srv/Trigger
         canopen-control ros param list /robby_forward_controller
         canopen-control ros param get /robby_forward_controller joints
         canopen-control ros param set /robby_base_controller linear.x.max_velocity 0.5
         canopen-control ros bridge --name robby"""

_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_BEGUN = "CANOPEN_CONTROL_ROS_BEGUN"
_WINDOW = 1000
_REPORT_S = 1.0


_positive = number("number above 0", lambda value: 0 < value < LONGEST_S)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    groups = parser.add_subparsers(dest="group", metavar="topic|service|param|bridge", required=True)
    topic = groups.add_parser("topic", help="list, echo, hz, pub").add_subparsers(
        dest="action", metavar="ACTION", required=True
    )
    _add_list(topic, "topics")
    echo = topic.add_parser("echo", help="print messages")
    hz = topic.add_parser("hz", help="measure the rate of messages")
    for action, unit in ((echo, "message"), (hz, "second: rate in Hz, times in s")):
        action.add_argument("topic", metavar="TOPIC")
        action.add_argument("type", nargs="?", metavar="TYPE", help="message type (default: the published type)")
        action.add_argument("--json", action="store_true", help=f"print JSON, a line for each {unit}")
        action.add_argument("--for", type=seconds, metavar="S", dest="seconds", help="end after S seconds")
        _add_timeout(action)
    echo.add_argument("--once", action="store_true", help="end after the first message")
    pub = topic.add_parser("pub", help="publish a message, repeatedly")
    _add_data(pub, "topic")
    pub.add_argument("--rate", type=_positive, default=1.0, metavar="HZ", help="messages per second (default: 1)")
    pub.add_argument("--once", action="store_true", help="publish once, as soon as there is a subscriber")
    pub.add_argument("--for", type=seconds, metavar="S", dest="seconds", help="end after S seconds")
    service = groups.add_parser("service", help="list, call").add_subparsers(
        dest="action", metavar="ACTION", required=True
    )
    _add_list(service, "services")
    call = service.add_parser("call", help="call a service and print its answer")
    _add_data(call, "service")
    call.add_argument("--json", action="store_true", help="print the answer as JSON")
    param = groups.add_parser("param", help="list, get, set").add_subparsers(
        dest="action", metavar="ACTION", required=True
    )
    for name, text, operands in (
        ("list", "list the names of a node's parameters", ()),
        ("get", "print the value of a parameter", ("name",)),
        ("set", "set a parameter while the node runs", ("name", "value")),
    ):
        action = param.add_parser(name, help=text)
        for operand in ("node", *operands):
            action.add_argument(
                operand, metavar=operand.upper(), help="value in YAML, such as 0.5" if operand == "value" else None
            )
        if name != "set":
            action.add_argument("--json", action="store_true", help="print JSON")
        _add_timeout(action)
    # with another prefix argparse leaves all options to the bridge
    bridge = groups.add_parser(
        "bridge", help="connect a running robot to ROS; --help lists the options", add_help=False, prefix_chars="+"
    )
    bridge.add_argument("arguments", nargs="*", metavar="OPTIONS")


def _add_list(actions: Any, title: str) -> None:  # noqa: ANN401 - argparse's private class
    listing = actions.add_parser("list", help=f"names of all {title}")
    listing.add_argument("-t", "--types", action="store_true", help="print the types too")
    listing.add_argument("--json", action="store_true", help="print JSON: the types by name")


def _add_data(action: argparse.ArgumentParser, title: str) -> None:
    action.add_argument(title, metavar=title.upper())
    action.add_argument(
        "type", metavar="TYPE", help="such as std_msgs/msg/Float64MultiArray" if title == "topic" else None
    )
    action.add_argument(
        "data",
        nargs="?",
        metavar="DATA",
        default="{}",
        help="message or request in YAML, such as '{data: [10.0, 10.0]}'",
    )
    _add_timeout(action)


def _add_timeout(action: argparse.ArgumentParser) -> None:
    action.add_argument(
        "--timeout",
        type=_positive,
        default=5.0,
        metavar="S",
        help="time to wait for the server and its answer in s (default: 5)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.group == "bridge" and {"-h", "--help"} & set(args.arguments):
        return _bridge(args.arguments)
    begin_ros()
    if args.group == "bridge":
        return _bridge(args.arguments)
    from canopen_control.ros.graph import open_graph

    with open_graph() as graph:
        return _ACTIONS[args.group, args.action](graph, args)


def _bridge(arguments: list[str]) -> int:
    from canopen_control.ros.bridge import main

    return main(arguments)


def begin_ros() -> None:
    """Raise ConfigError if ROS 2 is not installed; restart the process if libraries of the wheels are hidden."""
    from canopen_control.ros.installation import require_ros

    require_ros()
    if os.environ.get(_GUARD) and not os.environ.get("LD_LIBRARY_PATH") and not os.environ.get(_BEGUN):
        environment = {**clean_environment(ros=True), _BEGUN: "1"}
        block_for_exec()  # a starting Python would answer these signals with a traceback
        # -P: a file of the user's folder must not be taken for a module of Python
        os.execve(sys.executable, [*MODULE, "canopen_control", *sys.argv[1:]], environment)


def _list(names: Callable[[], list[tuple[str, list[str]]]], args: argparse.Namespace) -> int:
    listing = names()
    if args.json:
        print(json_text(dict(listing)))
        return 0
    for name, types in listing:
        print(f"{name} [{', '.join(types)}]" if args.types else name)
    return 0


def _echo(graph: Graph, args: argparse.Namespace) -> int:
    count = 0

    def show(message: Any) -> None:  # noqa: ANN401 - a generated class
        nonlocal count
        if args.once and count:
            return
        count += 1
        print(_text(message, args), *([] if args.json else ["---"]), sep="\n", flush=True)

    graph.subscribe(args.topic, graph.type_of(args.topic, args.timeout, args.type), show)
    graph.spin(args.seconds or LONGEST_S, lambda: args.once and count)
    if not count:
        raise CanopenError(f"no message arrived on {args.topic} within {args.seconds:g} s")
    return 0


def _hz(graph: Graph, args: argparse.Namespace) -> int:
    times: collections.deque[float] = collections.deque(maxlen=_WINDOW)
    kind = graph.type_of(args.topic, args.timeout, args.type)
    graph.subscribe(args.topic, kind, lambda _: times.append(time.monotonic()))
    end = time.monotonic() + (args.seconds or LONGEST_S)
    while (remaining := end - time.monotonic()) > 0:
        graph.spin(min(remaining, _REPORT_S))
        print(json_text(_rates(list(times)), indent=None) if args.json else _rate_of(list(times)), flush=True)
    return 0 if len(times) > 1 else 1


def _rates(times: list[float]) -> dict[str, float] | None:
    gaps = [after - before for before, after in itertools.pairwise(times)]
    if not gaps:
        return None
    rate, spread = 1 / statistics.fmean(gaps), statistics.pstdev(gaps)
    return {"rate": rate, "min": min(gaps), "max": max(gaps), "std_dev": spread, "window": len(times)}


def _rate_of(times: list[float]) -> str:
    rates = _rates(times)
    if rates is None:
        return "no new messages"
    spread = "min: {min:.4f}s max: {max:.4f}s std dev: {std_dev:.5f}s".format(**rates)
    return f"average rate: {rates['rate']:.3f}\n\t{spread} window: {rates['window']}"


def _text(message: Any, args: argparse.Namespace) -> str:  # noqa: ANN401 - a generated class
    from canopen_control.ros.graph import lines, plain

    return json_text(plain(message), indent=None) if args.json else "\n".join(lines(message))


def _pub(graph: Graph, args: argparse.Namespace) -> int:
    from canopen_control.ros.graph import full_name

    publication = graph.publisher(args.topic, full_name(args.type, "msg"), _data(args.data))
    if not graph.spin(args.timeout, lambda: publication.subscribers() > 0):
        raise CanopenError(f"{args.topic} has no subscriber of type {args.type}; does the robot run with --ros?")
    graph.spin(0.1)  # the subscriber needs time to match this publisher
    begin, count = time.monotonic(), 0
    with json_alone(args):
        print(f"publishing to {args.topic}" + ("" if args.once else f" at {args.rate:g} Hz"), flush=True)
    while args.seconds is None or time.monotonic() < begin + args.seconds:
        publication.publish()
        count += 1
        if args.once:
            graph.spin(0.2)  # the message is in transit until the subscriber has confirmed it
            break
        graph.spin(max(begin + count / args.rate - time.monotonic(), 0.0))
    print_result(args, {"topic": args.topic, "published": count})
    return 0


def _call(graph: Graph, args: argparse.Namespace) -> int:
    from canopen_control.ros.graph import full_name

    response = graph.call(args.service, full_name(args.type, "srv"), _data(args.data), args.timeout)
    print(_text(response, args))
    return 0


def _data(text: str) -> object:
    node = read(text, "<data>", error=ConfigError)
    value = node.value
    node.problems.raise_if_any(ConfigError)
    return value


_ACTIONS: dict[tuple[str, str], Callable[[Graph, argparse.Namespace], int]] = {
    ("topic", "list"): lambda graph, args: _list(graph.topics, args),
    ("topic", "echo"): _echo,
    ("topic", "hz"): _hz,
    ("topic", "pub"): _pub,
    ("service", "list"): lambda graph, args: _list(graph.services, args),
    ("service", "call"): _call,
    ("param", "list"): list_parameters,
    ("param", "get"): get_parameter,
    ("param", "set"): set_parameter,
}
