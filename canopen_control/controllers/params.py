"""Parameters of a controller: dotted names with their positions in files, and the common parameters.

As rcl reads them, `a.b: 1` and `a: {b: 1}` are the same parameter, and the last of two values is used. Unlike rcl, a
repeated or unknown key is a warning with its line and the nearest valid name, or an error with `strict`.
"""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

from canopen_control.controllers.pid import AntiWindup, Gains
from canopen_control.errors import RobotConfigError, closest, nearest
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY
from canopen_control.yamlfile.convert import convert, derived, keys_of, section, setting
from canopen_control.yamlfile.node import Node, Problems, raising

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from canopen_control.rpc.messages.parameters import PlainValue


T = TypeVar("T")


class Params:
    """Parameters of one controller, by dotted name, with their positions in files.

    `Params.of({...})` makes them from nested or dotted Python values. `source` is the dataclass instance of the last
    `read`, None before. `shared` are the keys of a block for all nodes (`/**`), some of which are for other
    controllers; `known` are the names that the controller accepts.
    """

    def __init__(self, flat: Node, name: str = "", shared: Collection[str] = ()) -> None:
        self.flat, self.name, self.shared = flat, name, shared
        self.source: object = None
        self.known: set[str] = set()

    @classmethod
    def of(cls, values: Mapping[str, Any], name: str = "parameters") -> Params:
        """Return parameters from a nested or dotted mapping of Python values."""
        problems = Problems(name, strict=False)
        return cls(flattened(_plain_node(values, "", problems)), name)

    def read(
        self,
        cls: type[T],
        renames: Mapping[str, str] | None = None,
        judge: Callable[[T], Iterable[tuple[str, str]]] = lambda _: (),
    ) -> T:
        """Convert the parameters to the dataclass `cls`; raise RobotConfigError with all errors.

        `renames` maps the keys of other distributions to those of this package ("" for one without effect), with one
        warning each. Keys that the class does not declare are warnings (errors if the file was read strictly), except
        those of `shared`. `INEFFECTIVE` keys of the class are accepted without effect; a value other than the default
        is a warning with the reason. `judge` returns contradictions as pairs of parameter and text; the name of the
        parameter is removed from the beginning of the text.
        """
        self.known = {*keys_of(cls), *(renames or {})}
        with raising(self.files, RobotConfigError):
            value = convert(_gathered(self._renamed(renames or {}), cls), cls, None, ignored=self.shared)
            warn_ineffective(self.flat, value)
            for name, text in () if value is None else judge(value):
                if (wrong := self.misspelt(text)) is not None:
                    wrong[0].error(wrong[1])
                else:
                    (self.flat.get(name) or self.flat).error(text.removeprefix(f"{name}: "))
        self.source = value
        return typing.cast("T", value)

    def read_each(
        self,
        cls: type[T],
        names: Sequence[str],
        sections: Mapping[str, tuple[str, type]],
        renames: Mapping[str, str] | None = None,
        judge: Callable[[T], Iterable[tuple[str, str]]] = lambda _: (),
    ) -> T:
        """Convert parameters as `read` does, with sections for each of `names`, such as `gains.JOINT`.

        `sections` maps a field of `cls` to the key of its sections and to their class; the field gets a tuple of
        sections, in the order of `names`.
        """
        fields: list[tuple[str, Any, Any]] = [
            (f"{field}_{number}", kind, section(key.format(name), kind()))
            for field, (key, kind) in sections.items()
            for number, name in enumerate(names)
        ]
        made = dataclasses.make_dataclass(cls.__name__, fields, bases=(cls,), frozen=True)
        known = self._of_known(names, [key for key, _ in sections.values()])
        value: Any = known.read(made, renames, judge)
        self.source, self.known = known.source, known.known
        gathered = {
            field: tuple(getattr(value, f"{field}_{number}") for number in range(len(names))) for field in sections
        }
        return typing.cast("T", dataclasses.replace(value, **gathered))

    def _of_known(self, names: Collection[str], keys: Sequence[str]) -> Params:
        """Return a copy without the sections of other names, such as `gains.OTHER`; warn once for each such name.

        Without any name, because their list has an error, nothing is warned of.
        """
        pairs = {key.text: (key, value) for key, value in self.flat.pairs()}
        for above in [key.removesuffix("{}") for key in keys if len(key) > len("{}")]:
            strangers = dict[str, Node]()
            for dotted in [dotted for dotted in pairs if dotted.startswith(above)]:
                name, inner, _ = dotted.removeprefix(above).rpartition(".")
                if inner and name not in names:
                    strangers.setdefault(name, pairs.pop(dotted)[0])
            for name, key in strangers.items() if names else ():
                key.warning(
                    f"no effect, since {name!r} is not one of {', '.join(names)}{nearest(name, names, listed=False)}"
                )
        return Params(Node.mapping(like(self.flat), pairs), self.name, self.shared)

    def names(self, *keys: str) -> tuple[str, ...]:
        """Return the distinct texts in the list parameters `keys`, before they are read."""
        nodes = [node for key in keys if (node := self.flat.get(key)) is not None]
        return tuple(dict.fromkeys(element.text for node in nodes for element in node.elements()))

    def changed(self, values: Mapping[str, PlainValue]) -> Params:
        """Return a copy with other values for some parameters, by dotted name; the file is unchanged."""
        changes = Params.of(values, self.name)
        return Params(changes.flat.merged_over(self.flat), self.name, self.shared)

    def misspelt(self, text: str) -> tuple[Node, str] | None:
        """Return the misspelt key in the file that explains an error text about a missing key, and a text, or None."""
        keys = self.flat.keys()
        sections = tuple(f"{name}." for name in self.known)
        known = {*self.known, *self.shared}
        unknown = [key for key in keys if key not in known and not key.startswith(sections)]
        for name in re.findall(r"[A-Za-z_][\w.]*\w", text) if unknown else ():
            if name in self.known and name not in keys and (key := closest(name, unknown)):
                return keys[key], f"unknown key {key!r} (did you mean {name!r}?)"
        return None

    @property
    def warnings(self) -> list[str]:
        """Texts of all warnings in the files."""
        return [str(warning) for problems in self.files for warning in problems.warnings]

    def line(self, name: str) -> int:
        """Return the line of a parameter by its dotted name; 0 if missing."""
        key = self.flat.keys().get(name)
        return 0 if key is None else key.line

    @property
    def files(self) -> list[Problems]:
        """Problem lists of all files with these parameters, including every `params_file`."""
        files = {id(self.flat.problems): self.flat.problems}
        files.update((id(key.problems), key.problems) for key, _ in self.flat.pairs())
        return list(files.values())

    def _renamed(self, renames: Mapping[str, str]) -> Node:
        pairs: dict[str, tuple[Node, Node]] = {}
        for key, value in self.flat.pairs():
            name = renames.get(key.text, key.text)
            if name != key.text:
                key.warning(
                    f"{key.text!r} is read as {name!r}" if name else f"{key.text!r} has no effect and can be removed"
                )
            if name and not (name != key.text and self.flat.get(name)):
                pairs[name] = (scalar_node(name, key), value)
        return Node.mapping(like(self.flat), pairs)


def warn_ineffective(params: Node, value: object) -> None:
    """Add a warning for each parameter in the file that has no effect, unless it has its default value."""
    keys, cls = params.keys(), type(value)
    for name, why in getattr(cls, "INEFFECTIVE", {}).items():
        if name in keys and getattr(value, name) != getattr(cls, name):
            keys[name].warning(f"{name} has no effect: {why}")


def _gathered(flat: Node, cls: type[Any]) -> Node:
    """Return the parameters with the keys of each section of `cls` nested below the section's name."""
    names = [str(field.metadata["key"]) for field in dataclasses.fields(cls) if field.metadata.get("section")]
    pairs = {key.text: (key, value) for key, value in flat.pairs()}
    for name in names:
        inner = {key[len(name) + 1 :]: pairs.pop(key) for key in list(pairs) if key.startswith(f"{name}.")}
        named = {short: (scalar_node(short, key), value) for short, (key, value) in inner.items()}
        if named:
            place = scalar_node(name, next(iter(named.values()))[0])
            pairs[name] = (place, Node.mapping(like(place), named))
    return Node.mapping(like(flat), pairs)


def like(node: Node) -> Node:
    """Return an empty mapping node at the position of another node."""
    return Node("mapping", node.line, node.column, node.where, node.problems)


def scalar_node(text: str, place: Node) -> Node:
    """Return a scalar node with a name, at the position of another node."""
    return Node.scalar(Node("scalar", place.line, place.column, place.where, place.problems), text, text, quoted=False)


def _plain_node(value: Any, where: str, problems: Problems) -> Node:  # noqa: ANN401 - plain Python values
    """Convert a Python value to a node without a position in a file."""
    if isinstance(value, dict):
        below = f"{where}." if where else ""
        keys = {str(key): (key, element) for key, element in value.items()}
        place = Node("mapping", 0, 0, where, problems)
        children = {name: _plain_node(element, below + name, problems) for name, (_, element) in keys.items()}
        return Node.mapping(place, {name: (scalar_node(name, child), child) for name, child in children.items()})
    if isinstance(value, list | tuple):
        place = Node("sequence", 0, 0, where, problems)
        return Node.sequence(
            place, [_plain_node(element, f"{where}[{at}]", problems) for at, element in enumerate(value)]
        )
    place = Node("null" if value is None else "scalar", 0, 0, where, problems)
    return Node.scalar(place, str(value), value, quoted=isinstance(value, str))


def flattened(node: Node) -> Node:
    """Return a mapping from dotted names to values; for duplicate names the last value applies, with a warning."""
    pairs: dict[str, tuple[Node, Node]] = {}

    def add(prefix: str, mapping: Node) -> None:
        for key, value in mapping.pairs():
            name = f"{prefix}{key.text}"
            elements = list(value.elements()) if value.kind == "sequence" else []
            if len(elements) == 1 and elements[0].kind == "mapping":  # as rcl_yaml_param_parser reads it
                value = elements[0]
            if value.kind == "mapping":
                add(f"{name}.", value)
                continue
            if name in pairs:
                key.problems.deviation(
                    key, f"{name!r} is given twice (first at line {pairs[name][0].line}); the last value is used"
                )
            pairs[name] = (scalar_node(name, key), value)

    add("", node)
    return Node.mapping(like(node), pairs)


@dataclass(frozen=True)
class CommonParams:
    """Parameters of every controller; `update_rate` is in Hz, and 0 selects the manager's rate."""

    INEFFECTIVE: ClassVar[dict[str, str]] = {
        "is_async": "all controllers run in the cycle, in one thread",
        "thread_priority": "all controllers run in the cycle; run --realtime sets the priority of its thread",
    }

    type: str = setting("", help="type of the controller; may be given in the controller manager's block instead")
    update_rate: int = setting(0, low=0, help="update rate in Hz; 0: the rate of the controller manager")
    use_sim_time: bool = setting(
        False,
        help="only for simulated robots, which publish /clock; on a real robot it has no effect, with a "
        "warning. To stamp messages with the time of `/clock`, set `use_sim_time` of the bridge",
    )
    is_async: bool = setting(False, help="has no effect: all controllers run in the control cycle")
    thread_priority: int = setting(50, help="has no effect: `run --realtime` sets the priority of the control cycle")


def refuse(params: Params | str, mistakes: Iterable[str], name: str = "") -> None:
    """Raise RobotConfigError with all error texts, each on a line, if there are any.

    A text that begins with the name of a parameter in the file gets its place, and a text about a missing parameter
    that of a misspelt one. `name` is the controller, by default that of `params`, which may also be the name alone.
    """
    owner = name or (params if isinstance(params, str) else params.name)
    places: list[tuple[str, Node | None]] = []
    for text in mistakes:
        if isinstance(params, str):
            places.append((text, None))
        elif (wrong := params.misspelt(text)) is not None:
            places.append((wrong[1], wrong[0]))
        else:
            places.append((text, params.flat.keys().get(text.split(maxsplit=1)[0].rstrip(":"))))
    if places:
        raise RobotConfigError(
            "\n".join(
                f"{key.path}:{key.line}:{key.column}: {owner}: {text}"
                if key is not None and key.line
                else f"{owner}: {text}"
                for text, key in places
            )
        )


def repeated(key: str, names: Sequence[str]) -> Iterator[str]:
    """Yield the error text for a parameter that contains a name twice, if it does."""
    if twice := dict.fromkeys(name for name in names if names.count(name) > 1):
        yield f"{key} contains a name twice: {', '.join(twice)}; list each name once"


# Parameters of the forward command controllers and the joint state broadcaster, and gains of PID loops.
#
# Keys, defaults and meaning are those of ros2_controllers.


_MAP: Final = "map_interface_to_joint_state."
COMMAND_TIMEOUT_HELP: Final = (
    "time in s after which a command expires; absent: 2 for velocities and efforts, never for positions; 0: never"
)


@dataclass(frozen=True)
class GroupParams(CommonParams):
    """Parameters of the group controllers; `command_timeout` is in s, see the module `command_timeout`."""

    joints: tuple[str, ...] = setting((), help="joints, in the order of the values of a command")
    command_timeout: float | None = setting(None, low=0.0, high=1e9, help=COMMAND_TIMEOUT_HELP)


@dataclass(frozen=True)
class ForwardParams(GroupParams):
    """Parameters of forward_command_controller/ForwardCommandController."""

    interface_name: str = setting("", help="command interface: position, velocity or effort")


@dataclass(frozen=True)
class SingleParams(CommonParams):
    """Parameters of controllers of one joint; ROS 1's `pid` gains are ignored, because drives have their own loops."""

    joint: str = setting("", help="name of the joint")
    command_timeout: float | None = setting(None, low=0.0, high=1e9, help=COMMAND_TIMEOUT_HELP)


@dataclass(frozen=True)
class MultiParams(CommonParams):
    """Parameters of forward_command_controller/MultiInterfaceForwardCommandController."""

    joint: str = setting("", help="name of the joint")
    interface_names: tuple[str, ...] = setting(
        (), help="command interfaces of the joint, in the order of the values of a command"
    )
    command_timeout: float | None = setting(None, low=0.0, high=1e9, help=COMMAND_TIMEOUT_HELP)


@dataclass(frozen=True)
class BroadcasterParams(CommonParams):
    """Parameters of joint_state_broadcaster/JointStateBroadcaster."""

    joints: tuple[str, ...] = setting((), help="publish only these joints; needs `interfaces`")
    interfaces: tuple[str, ...] = setting((), help="publish only these interfaces; needs `joints`")
    extra_joints: tuple[str, ...] = setting((), help="joints without feedback, published as 0.0")
    position: str = setting(POSITION, key=_MAP + POSITION, help="state interface that is published as position")
    velocity: str = setting(VELOCITY, key=_MAP + VELOCITY, help="state interface that is published as velocity")
    effort: str = setting(EFFORT, key=_MAP + EFFORT, help="state interface that is published as effort")
    use_local_topics: bool = setting(False, help="whether to publish below the name of the broadcaster")
    use_urdf_to_filter: bool = setting(
        True, help="whether to publish only the movable joints of the description, in alphabetical order"
    )
    frame_id: str = setting("base_link", help="frame id of the message headers")
    publish_dynamic_joint_states: bool = setting(
        True, help="whether to publish every state interface on `dynamic_joint_states` too"
    )


@dataclass(frozen=True)
class LoopGains:
    """Gains of a PID loop, named as in control_toolbox; invalid gains raise ValueError.

    Gains are invalid if p, i or d is not finite, if limits exclude each other, or if the time constant of a back
    calculation is neither given nor follows from the gains (upstream then computes nan).
    """

    p: float = setting(0.0, help="proportional gain")
    i: float = setting(0.0, help="integral gain")
    d: float = setting(0.0, help="derivative gain")
    i_clamp_max: float = setting(math.inf, help="upper limit of the integral")
    i_clamp_min: float = setting(-math.inf, help="lower limit of the integral")
    u_clamp_max: float = setting(math.inf, help="upper limit of the output")
    u_clamp_min: float = setting(-math.inf, help="lower limit of the output")
    antiwindup_strategy: str = setting(
        "legacy",
        choices=tuple(strategy.value for strategy in AntiWindup),
        help="anti-windup strategy: what the integral does while the output is at a limit",
    )
    tracking_time_constant: float = setting(
        0.0, help="time constant of back_calculation in s; 0: derived from the gains"
    )
    error_deadband: float = setting(0.0, help="largest error that is not integrated")

    def __post_init__(self) -> None:
        for key, value in (("p", self.p), ("i", self.i), ("d", self.d)):
            if not math.isfinite(value):
                raise ValueError(f"{key} is {value}; give a finite number")
        gains = self.pid()
        if gains.anti_windup is AntiWindup.BACK_CALCULATION and gains.i and not gains.tracking_time_used > 0.0:
            raise ValueError(
                f"back_calculation has no time constant with p {self.p:g}, i {self.i:g}, d {self.d:g}; "
                f"give tracking_time_constant"
            )

    @property
    def integral_limits(self) -> tuple[float, float]:
        """Upper and lower limit of the integral."""
        return self.i_clamp_max, self.i_clamp_min

    @property
    def clamps_integral(self) -> bool:
        """Whether the integral itself is limited, as in ROS 1; False by default."""
        return False

    def pid(self) -> Gains:
        """Convert the parameters to the gains of a `Pid`."""
        return Gains(
            self.p,
            self.i,
            self.d,
            *self.integral_limits,
            self.u_clamp_max,
            self.u_clamp_min,
            AntiWindup(self.antiwindup_strategy),
            self.tracking_time_constant,
            self.error_deadband,
            self.clamps_integral,
        )


RENAMES: Final = {"publish_rate": "update_rate"}
"""Renamed parameter of ROS 1's joint_state_controller, which had its own publication rate."""


# Parameters of pid_controller/PidController, by the names of jazzy.


@dataclass(frozen=True)
class DofGains(LoopGains):
    """Gains of one degree of freedom; the deprecated `antiwindup` makes `legacy` clamp the integral itself."""

    INEFFECTIVE: ClassVar[dict[str, str]] = {"activate_state_publisher": "~/controller_state contains the whole state"}

    antiwindup: bool = setting(False, help="whether the strategy `legacy` limits the integral itself (deprecated)")
    error_deadband: float = setting(1e-16, help="largest error that is not integrated")
    feedforward_gain: float = setting(0.0, help="factor of the feed-forward")
    angle_wraparound: bool = setting(False, help="whether the error of a continuous joint is the shortest angle")
    save_i_term: bool = setting(True, help="whether to keep the integral when the controller is deactivated")
    activate_state_publisher: bool = setting(False, help="has no effect: `~/controller_state` contains the whole state")

    @property
    def clamps_integral(self) -> bool:
        return self.antiwindup


@dataclass(frozen=True)
class PidParams(CommonParams):
    """Parameters of pid_controller/PidController; `gains` are in the order of `dof_names`.

    `command_timeout` in s ends velocity and effort references that are not renewed. With `use_external_measured_states`
    the states are received as messages, and are valid for `measured_state_timeout` in s.
    """

    dof_names: tuple[str, ...] = setting((), help="joints that receive the commands")
    reference_and_state_dof_names: tuple[str, ...] = setting(
        (), help="names of the joints in references and states, if they differ from `dof_names`"
    )
    command_interface: str = setting("", help="command interface of the loops: velocity, acceleration or effort")
    reference_and_state_interfaces: tuple[str, ...] = setting(
        (), help="controlled quantity and its derivative, as in [position, velocity]"
    )
    set_current_state_as_first_setpoint: bool = setting(
        True,
        help="first references: true: the current state, or 0 for velocities; false: none, so that the targets are 0",
    )
    use_external_measured_states: bool = setting(
        False, help="whether to receive the states on `~/measured_state` instead of from the state interfaces"
    )
    measured_state_timeout: float = setting(
        0.2,
        low=0.001,
        high=60.0,
        help="time in s without a measured state after which targets become 0 and references are discarded",
    )
    enable_feedforward: bool = setting(
        False,
        help="whether to add `feedforward_gain` times the derivative of the reference, or times the reference if "
        "no derivative is given",
    )
    command_timeout: float | None = setting(None, low=0.0, high=1e9, help=COMMAND_TIMEOUT_HELP)
    gains: tuple[DofGains, ...] = derived(())

    def immobile(self) -> Iterator[str]:
        """Yield the text of the event IMMOBILE for each degree of freedom whose loop always commands 0."""
        for dof, gains in zip(self.dof_names, self.gains, strict=True):
            if not any((gains.p, gains.i, gains.d, gains.feedforward_gain)):
                yield f"gains.{dof}.p, i and d are 0, so {dof} does not move; give a gain above 0"

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the degrees of freedom in references and states; by default `dof_names`."""
        return self.reference_and_state_dof_names or self.dof_names

    def mistakes(self) -> Iterator[str]:
        yield from repeated("dof_names", self.dof_names)
        yield from repeated("reference_and_state_dof_names", self.reference_and_state_dof_names)
        if not self.dof_names:
            yield "no 'dof_names'; give it under ros__parameters: dof_names: [joint_1, joint_2]"
        elif len(self.measured) != len(self.dof_names):
            count = f"{len(self.measured)} for {len(self.dof_names)} dof_names"
            yield f"reference_and_state_dof_names: {count}; give the same number"
        if not self.command_interface:
            yield "no 'command_interface'; give it: command_interface: effort"
        interfaces = self.reference_and_state_interfaces
        if len(interfaces) not in (1, 2):
            yield f"reference_and_state_interfaces has {len(interfaces)}; give one, or two as in [position, velocity]"
        elif len(set(interfaces)) != len(interfaces):
            twice = "reference_and_state_interfaces contains an interface twice"
            yield f"{twice}; give the derivative: [position, velocity]"


def read_pid_params(params: Params, name: str) -> PidParams:
    """Return the parameters of PID controller `name`; raise RobotConfigError if they are invalid."""
    settings = params.read_each(PidParams, params.names("dof_names"), {"gains": ("gains.{}", DofGains)})
    refuse(params, settings.mistakes(), name)
    return settings
