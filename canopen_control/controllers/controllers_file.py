"""Reader of ros2_controllers.yaml files in all layouts of ROS 1 and ROS 2.

A controller's type is in the controller_manager's block or in the controller's own block, with `ros__parameters` (ROS
2) or without (ROS 1). Blocks may be named `/name`, `/ns/name` or `/**`, or be nested in namespaces, each with the
wildcards of rcl: `*` is one namespace or name, `**` any number of them. `params` reads the parameters themselves.
"""

from __future__ import annotations

import dataclasses
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from canopen_control.controllers.params import CommonParams, Params, flattened, like, scalar_node, warn_ineffective
from canopen_control.errors import RobotConfigError, closest, nearest
from canopen_control.yamlfile.convert import convert, keys_of, setting
from canopen_control.yamlfile.node import LINE_END, Node, Problems, raise_all
from canopen_control.yamlfile.reader import read as read_tree
from canopen_control.yamlfile.reader import read_text, tree

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence


PARAMETERS: Final = "ros__parameters"
MANAGER_SECTION: Final = "controller_manager"
EVERYWHERE: Final = "/**"
_WILDCARDS: Final = ("*", "**")


@dataclass(frozen=True)
class ControllerConfig:
    """Configuration of one controller in the file; `type` is "" if missing.

    `line` is the line of the type. `fallbacks` are the controllers that replace this controller when it fails,
    `node_options` the arguments of its ROS node. `namespace` and `block_line` are those of the parameter block; `ros1`
    means that the block is written as in ROS 1, without `ros__parameters`.
    """

    name: str
    type: str
    params: Params
    line: int = 0
    path: str = ""
    fallbacks: tuple[str, ...] = ()
    namespace: str = ""
    ros1: bool = False
    block_line: int = 0
    node_options: tuple[str, ...] = ()


@dataclass(frozen=True)
class ControllersFile:
    """Contents of ros2_controllers.yaml: controllers in the order of the file, manager parameters, and warnings.

    `update_rate` is in Hz. `line` and `namespace` are those of the manager's block, `manager_keys` the nodes of its
    parameters' keys. `shared` are the keys of a block for all nodes (`/**`).
    """

    update_rate: int = 100
    controllers: dict[str, ControllerConfig] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    manager: ManagerParams = field(default_factory=lambda: ManagerParams())
    path: str = ""
    line: int = 0
    namespace: str = ""
    manager_keys: dict[str, Node] = field(default_factory=dict, repr=False)
    shared: dict[str, Node] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True)
class ParameterSource:
    """Parameters that a launch file gives to the controller manager or, by a spawner, to some `controllers`.

    They are in the file `path`, or else are `values` in the launch file `path` itself: name, text and line.
    """

    path: Path
    controllers: tuple[str, ...] = ()
    values: tuple[tuple[str, str, int], ...] = ()


@dataclass(frozen=True)
class ManagerParams:
    """Parameters of the controller_manager, including those that have no effect in this package.

    Parameters that do not apply to one process with one thread are accepted, without effect.
    """

    INEFFECTIVE: ClassVar[dict[str, str]] = {
        "handle_exceptions": "an exception of a controller never ends the cycle",
        "lock_memory": "run --realtime locks the memory",
        "thread_priority": "run --realtime sets the priority",
        "cpu_affinity": "run --cpu sets the CPU",
    }

    update_rate: int = setting(
        100, low=1, high=10_000, help="update rate of the controllers in Hz, at most the rate of the cycle"
    )
    use_sim_time: bool = setting(
        False, help="only for simulated robots; on a real robot it has no effect, with a warning"
    )
    enforce_command_limits: bool = setting(False, help="whether to keep commands within the limits of the description")
    handle_exceptions: bool = setting(True, help="has no effect: an exception in a controller never ends the cycle")
    lock_memory: bool = setting(False, help="has no effect: `run --realtime` locks the memory")
    thread_priority: int = setting(50, help="has no effect: `run --realtime` sets the priority of the cycle")
    cpu_affinity: Any = setting(None, help="has no effect: `run --cpu` sets the CPU")
    robot_description: str = setting("", help="has no effect: the description comes from the robot folder")
    unconfigured: tuple[str, ...] = setting(
        (),
        key="hardware_components_initial_state.unconfigured",
        help="hardware components that stay unconfigured at the start",
    )
    inactive: tuple[str, ...] = setting(
        (),
        key="hardware_components_initial_state.inactive",
        help="hardware components that are configured at the start, but not activated",
    )


MANAGER_PARAMETERS: Final = frozenset(keys_of(ManagerParams)) - {"robot_description"}
"""Names of the controller manager's parameters; the description comes from the robot's file."""

_IGNORED: Final = (
    "defaults.",
    "diagnostics.",
    "overruns.",
    "hardware_synchronization.",
    "hardware_components_initial_state.",
)
"""Groups of controller_manager parameters that are accepted but not read."""

_INITIAL_STATES: Final = frozenset(
    {"hardware_components_initial_state.unconfigured", "hardware_components_initial_state.inactive"}
)
_MANAGERS_OWN: Final = frozenset({"type", "params_file", "fallback_controllers", "node_options_args"})
FOREIGN: Final = {
    "gazebo_ros_control": "the simulated motors have their own control loops",
    "hardware_interface": "the joints are taken from the description",
    "generic_hw_control_loop": "bus.yml and update_rate determine the cycle",
}
"""Blocks of ROS 1 files that do not belong to a controller, with the reason why they have no effect."""


@dataclass(frozen=True)
class _Block:
    """Block of parameters under one node name, with its namespace."""

    key: Node
    value: Node
    namespace: str = ""
    ros1: bool = False


@dataclass(frozen=True)
class _Everywhere:
    """Block for all nodes (`/**`): its values, and the names of the blocks that begin before it."""

    values: Node
    before: frozenset[str]

    def merged(self, name: str, values: Node) -> Node:
        """Return the values of the block `name` and of this block: of two, the later block's applies (rclcpp)."""
        return self.values.merged_over(values) if name in self.before else values.merged_over(self.values)


@dataclass(frozen=True)
class _Declared:
    """Controller declared in the controller_manager block.

    Besides its type, the block may contain `further` parameters, parameter files, fallbacks and node options.
    """

    key: Node
    type: str
    further: Node
    files: tuple[tuple[Node, str], ...]
    fallbacks: tuple[str, ...]
    node_options: tuple[str, ...]


def read_controllers(
    path: str | os.PathLike[str],
    *,
    strict: bool = False,
    variables: Mapping[str, str] | None = None,
    sources: Sequence[ParameterSource] = (),
) -> ControllersFile:
    """Read a ros2_controllers.yaml like `inspect_controllers`; raise RobotConfigError with all errors."""
    control, files = inspect_controllers(path, strict=strict, variables=variables, sources=sources)
    raise_all(files, RobotConfigError)
    return control


def inspect_controllers(
    path: str | os.PathLike[str],
    *,
    strict: bool = False,
    variables: Mapping[str, str] | None = None,
    sources: Sequence[ParameterSource] = (),
) -> tuple[ControllersFile, list[Problems]]:
    """Read a ros2_controllers.yaml; return the readable part, and the problems of all files, each with its place.

    Raise RobotConfigError with the errors of files that are not YAML. The parameters of a controller are checked when
    it is configured. With `strict`, warnings are errors. `variables`
    are the arguments of a launch file: they replace `$(var NAME)` and `<namespace>`, as in launch_ros's ParameterFile
    and nav2's ReplaceString; a name that is not an identifier is replaced wherever it occurs. An undefined variable
    stays unchanged, with a warning. `sources` are all parameters of a launch file that names `path`, in its order: of
    two values of a parameter the later applies (rcl), and those of a spawner have precedence for its controllers.
    """
    sources = sources or (ParameterSource(Path(path)),)
    roots = _roots(sources, str(path), variables or {}, strict)
    root = roots[str(path)]
    blocks: dict[str, _Block] = {}
    for source in sources:
        if source.values:
            _add_inline(blocks, source)
        elif not source.controllers:
            _collect(roots[str(source.path)], blocks)
    empty = _Block(root, like(root))
    _warn_of_layouts(blocks)
    everywhere = _everywhere(blocks, root)
    blocks.pop(EVERYWHERE, empty)
    manager_block = blocks.pop(MANAGER_SECTION, empty)
    common = dataclasses.replace(everywhere, values=_common(everywhere.values))
    flat = common.merged(MANAGER_SECTION, manager_block.value)
    declared, untyped, manager = _manager(flat, root)
    spawned = _of_spawners([source for source in sources if source.controllers], roots)
    blocks = {name: block for name, block in blocks.items() if name not in untyped or block.value.get("type")}
    _rename_misspelt(blocks, declared, spawned)
    controllers = _controllers(declared, blocks, everywhere, manager_block.namespace, spawned)
    if not controllers and not any(node.problems.errors for node in roots.values()):
        _report_no_types(blocks, manager_block)
    files = {id(node.problems): node.problems for node in (*roots.values(), *flat.keys().values())}
    own = list(files.values())
    files |= {id(problems): problems for config in controllers.values() for problems in config.params.files}
    warnings = [str(warning) for problems in files.values() for warning in problems.warnings]
    keys = {} if manager is None else flat.keys()  # after an error, rules do not judge the defaults instead
    place = str(path), manager_block.key.line, manager_block.namespace, keys
    manager = manager or ManagerParams()
    shared = everywhere.values.keys()
    return ControllersFile(manager.update_rate, controllers, warnings, manager, *place, shared), own


def _report_no_types(blocks: Mapping[str, _Block], manager_block: _Block) -> None:
    """Add the error that no controller has a type, or that the block of the manager is misspelt."""
    hint = closest(MANAGER_SECTION, blocks) if MANAGER_SECTION not in blocks else ""
    text = f"unknown block {hint!r} (did you mean {MANAGER_SECTION!r}?)" if hint else _NO_TYPES
    (blocks[hint] if hint else manager_block).key.error(text)


_NO_TYPES: Final = "no controller has a type; give types under controller_manager: <name>: type: ..."
_VARIABLE: Final = re.compile(r"\$\(var +([\w.-]+)\)|<((?:robot_)?namespace)>")


def _with_variables(text: str, variables: Mapping[str, str]) -> str:
    def value(match: re.Match[str]) -> str:
        name = match[1] or "namespace"
        replacement = variables.get(name)
        return match[0] if replacement is None else replacement.strip("/") if match[2] else replacement

    text = _VARIABLE.sub(value, text)
    for name, configured in variables.items():
        if not name.isidentifier() and not _VARIABLE.fullmatch(name):
            text = text.replace(name, configured)
    return text


def _variables_in(text: str) -> list[tuple[str, int]]:
    """Return the variables that remain in a text, without duplicates, as pairs of a name and its first line."""
    lines = enumerate(LINE_END.split(text), 1)
    uses = [(match[0], number) for number, line in lines for match in _VARIABLE.finditer(line.partition("#")[0])]
    return list({name: (name, number) for name, number in reversed(uses)}.values())[::-1]


def _roots(
    sources: Iterable[ParameterSource], path: str, variables: Mapping[str, str], strict: bool
) -> dict[str, Node]:
    """Read the files of all sources, and `path`; raise RobotConfigError with the errors of all that are not YAML."""
    roots: dict[str, Node] = {}
    errors: list[str] = []
    for name in dict.fromkeys([path, *(str(source.path) for source in sources if not source.values)]):
        try:
            text = _with_variables(read_text(name, RobotConfigError), variables)
            roots[name] = root = read_tree(text, name, error=RobotConfigError, strict=strict)
        except RobotConfigError as error:
            errors.append(str(error))
            continue
        for variable, line in _variables_in(text):
            at = Node("scalar", line, 1, "", root.problems)
            root.problems.warning(at, f"{variable} has no value; give it with --launch FILE NAME:=VALUE")
        if root.kind != "mapping":
            errors.append(str(root.problems.at(root.line, root.column, "", "expected a mapping of controllers")))
    if errors:
        raise RobotConfigError("\n".join(errors))
    return roots


def _add_inline(blocks: dict[str, _Block], source: ParameterSource) -> None:
    """Add parameters of the controller manager that are in the launch file itself (launch_ros: as in YAML)."""
    problems = Problems(str(source.path), read_text(source.path, RobotConfigError))
    pairs: dict[str, tuple[Node, Node]] = {}
    for name, text, line in source.values:
        value = read_tree(text, str(source.path), error=RobotConfigError)
        place = Node("scalar", line, 1, name, problems)
        node = Node.scalar(Node(value.kind, line, 1, name, problems), text, value.value, quoted=False)
        pairs[name] = (scalar_node(name, place), node)
    key = next(key for key, _ in pairs.values())
    values = Node.mapping(like(key), pairs)
    previous = blocks.get(MANAGER_SECTION)
    _add(blocks, MANAGER_SECTION, dataclasses.replace(previous, value=values) if previous else _Block(key, values))


def _of_spawners(sources: Iterable[ParameterSource], roots: Mapping[str, Node]) -> dict[str, Node]:
    """Return the parameters in the files of spawners (`--param-file`), by controller; a later file has precedence."""
    spawned: dict[str, Node] = {}
    for source in sources:
        blocks: dict[str, _Block] = {}
        _collect(roots[str(source.path)], blocks)
        for name in source.controllers:
            if (values := _block_of(blocks, name)) is not None:
                spawned[name] = values.merged_over(spawned.get(name, like(values)))
    return spawned


def _block_of(blocks: Mapping[str, _Block], name: str) -> Node | None:
    """Return the parameters of a controller in a file, including those for all nodes; None if it has none."""
    block, everywhere = blocks.get(name), blocks.get(EVERYWHERE)
    if block is None:
        return None if everywhere is None else everywhere.value
    return _everywhere(blocks, block.key).merged(name, block.value)


def _everywhere(blocks: Mapping[str, _Block], place: Node) -> _Everywhere:
    names = list(blocks)
    if EVERYWHERE not in blocks:
        return _Everywhere(like(place), frozenset())
    return _Everywhere(blocks[EVERYWHERE].value, frozenset(names[: names.index(EVERYWHERE)]))


def _common(everywhere: Node) -> Node:
    """Return the keys of a `/**` block that are also parameters of the controller manager, such as NAME.type."""
    pairs = _pairs(everywhere)
    typed = {name for name in pairs if name.endswith(".type") and "/" in pairs[name][1].text}
    names = {f"{name.removesuffix('.type')}.{key}" for name in typed for key in _MANAGERS_OWN}
    return Node.mapping(like(everywhere), {name: pairs[name] for name in pairs if name in MANAGER_PARAMETERS | names})


def _pairs(node: Node) -> dict[str, tuple[Node, Node]]:
    return {key.text: (key, value) for key, value in node.pairs()}


def _collect(node: Node, blocks: dict[str, _Block], namespace: str = "") -> None:
    """Collect the parameter blocks of all layouts by controller name; warn about blocks without a controller."""
    for key, value in node.pairs():
        above, _, name = key.text.rstrip("/").rpartition("/")
        inner = value.get(PARAMETERS) or _misspelt_parameters(value)
        space = f"{namespace}/{above.strip('/')}".rstrip("/")
        if inner is not None and inner.kind not in ("mapping", "null"):
            inner.error("expected the parameters of a node")
        elif inner is not None:
            _add(blocks, EVERYWHERE if name in _WILDCARDS else name, _Block(key, inner, space))
            _collect(_nested(value), blocks, f"{space}/{name}")
        elif key.text in FOREIGN:
            key.warning(f"{key.text} has no effect: {FOREIGN[key.text]}")
        elif _is_namespace(name, value):
            _collect(value, blocks, f"{space}/{name}")
        elif value.kind in ("mapping", "null"):
            _add(blocks, name, _Block(key, value, space, ros1=True))
        else:
            key.problems.deviation(key, f"{key.text!r} does not belong to a controller; indent it under a controller")


def _misspelt_parameters(block: Node) -> Node | None:
    """Return the parameters below a misspelt `ros__parameters`, with an error at the key; None if there are none."""
    for key, value in block.pairs():
        name = key.text.lower()
        if name.startswith("ros") and (hint := nearest(name, [PARAMETERS], listed=False)):
            key.error(f"unknown key {key.text!r}{hint}")
            return value
    return None


def _warn_of_layouts(blocks: Mapping[str, _Block]) -> None:
    """Warn about blocks without `ros__parameters` in a file that also has blocks with it: rcl refuses such a file."""
    of_ros2 = {id(block.key.problems) for block in blocks.values() if not block.ros1}
    for block in blocks.values():
        if block.ros1 and id(block.key.problems) in of_ros2:
            block.key.warning(f"no {PARAMETERS} (ROS 1), so ROS 2 refuses the file; indent its keys below {PARAMETERS}")


def _nested(node: Node) -> Node:
    """Return the blocks next to `ros__parameters` in a block such as `/**`, which is also a namespace."""
    pairs = {key.text: (key, value) for key, value in node.pairs() if value.get(PARAMETERS) is not None}
    return Node.mapping(like(node), pairs)


def is_within(pattern: str, namespace: str) -> bool:
    """Whether a parameter block in the namespace `pattern` applies to a node in `namespace`.

    The pattern may contain the wildcards of rcl; a namespace with `*` matches every pattern.
    """
    if "*" in namespace:
        return True  # a manager in any namespace
    text = re.escape(pattern).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(text, namespace) is not None


def _is_namespace(name: str, value: Node) -> bool:
    """Whether a block has only mappings and no type, so that its name is a namespace."""
    below = {node.kind for _, node in value.items()}
    return value.kind == "mapping" and value.get("type") is None and below == {"mapping"} and name != MANAGER_SECTION


def _add(blocks: dict[str, _Block], name: str, block: _Block) -> None:
    previous, values = blocks.get(name), flattened(block.value)
    for key, value in () if block.ros1 else values.pairs():
        known = name != MANAGER_SECTION or key.text in MANAGER_PARAMETERS
        if value.kind == "null" and known:
            key.warning(
                "no value, so the default applies, while ROS 2 refuses the file; give a value or remove the key"
            )
    blocks[name] = dataclasses.replace(block, value=values.merged_over(previous.value) if previous else values)


def _manager(flat: Node, root: Node) -> tuple[dict[str, _Declared], frozenset[str], ManagerParams | None]:
    """Return the controllers declared in the manager's block, those without a type, and the manager's parameters.

    The parameters are None after an error in them.
    """
    parameters: dict[str, tuple[Node, Node]] = {}
    pairs = _pairs(flat)
    declared: dict[str, _Declared] = {}
    for dotted, (key, value) in pairs.items():
        name, _, last = dotted.rpartition(".")
        if name and last == "type":
            files, fallbacks = _texts(pairs, f"{name}.params_file"), _texts(pairs, f"{name}.fallback_controllers")
            further = _below(flat, pairs, name)
            fallback_names = tuple(text for _, text in fallbacks)
            options = _node_options(_texts(pairs, f"{name}.node_options_args"))
            declared[name] = _Declared(key, convert(value, str, ""), further, files, fallback_names, options)
    for dotted, pair in pairs.items():
        foreign = dotted.startswith((*_IGNORED, *(f"{name}." for name in declared)))
        if dotted in _INITIAL_STATES or not foreign:
            parameters[dotted] = pair
    untyped = _untyped(parameters)
    params = Node.mapping(like(root), parameters)
    manager = convert(params, ManagerParams, None)
    if manager is not None:
        warn_ineffective(params, manager)
    return declared, frozenset(untyped), manager


def _untyped(parameters: dict[str, tuple[Node, Node]]) -> set[str]:
    """Remove the parameters of controllers without a type from those of the manager, with one warning for each."""
    names = dict[str, tuple[Node, str]]()
    for dotted, (key, value) in list(parameters.items()):
        name, _, rest = dotted.partition(".")
        is_controller = bool(rest) if value.kind != "null" else not nearest(dotted, MANAGER_PARAMETERS, listed=False)
        if is_controller and name not in MANAGER_PARAMETERS and dotted not in MANAGER_PARAMETERS:
            names.setdefault(name, (key, rest))
            del parameters[dotted]
    for name, (key, rest) in names.items():
        hint = nearest(rest.lower(), ["type"], listed=False) or f"; give {name}: type: PACKAGE/CLASS"
        key.problems.deviation(key, f"{name!r} has no type, so it is not loaded{hint}")
    return set(names)


def _texts(pairs: Mapping[str, tuple[Node, Node]], name: str) -> tuple[tuple[Node, str], ...]:
    """Return the texts of a parameter that is one text or a list, each with its node in the file."""
    if name not in pairs:
        return ()
    _, node = pairs[name]
    places = node.elements() if node.kind == "sequence" else [node]
    return tuple((place, text) for place in places if (text := convert(place, str, "")))


def _node_options(entries: tuple[tuple[Node, str], ...]) -> tuple[str, ...]:
    texts = tuple(text for _, text in entries)
    if (mistake := node_options_mistake(texts)) is not None:
        entries[0][0].error(f"node_options_args: {mistake}")
    return texts


def node_options_mistake(arguments: Sequence[str]) -> str | None:
    """Return an error text if the ROS arguments of a controller's node are not all remappings, else None."""
    words = [argument for argument in arguments if argument != "--ros-args"]
    for option, rule in zip(words[::2], [*words[1::2], ""], strict=False):
        if option not in ("-r", "--remap"):
            return f"{option!r} is not a remapping; give -r FROM:=TO here, and parameters in params_file"
        if ":=" not in rule:
            return f"{rule!r} after {option} is not a remapping; give FROM:=TO"
    return None


def _below(flat: Node, pairs: dict[str, tuple[Node, Node]], name: str) -> Node:
    """Return the parameters of a controller in the manager's block, without the keys that the manager uses."""
    inner: dict[str, tuple[Node, Node]] = {}
    for dotted, (key, value) in pairs.items():
        rest = dotted.removeprefix(f"{name}.")
        if rest != dotted and rest not in _MANAGERS_OWN:
            inner[rest] = (scalar_node(rest, key), value)
    return Node.mapping(like(flat), inner)


def _controllers(
    declared: dict[str, _Declared],
    blocks: dict[str, _Block],
    everywhere: _Everywhere,
    namespace: str,
    spawned: Mapping[str, Node],
) -> dict[str, ControllerConfig]:
    """Combine the type and parameters of each controller; without a block, it is in the manager's `namespace`.

    `spawned` are parameters in the files of spawners, which have precedence and may contain the type.
    """
    shared = set(everywhere.values.keys())
    controllers: dict[str, ControllerConfig] = {}
    for name, entry in declared.items():
        block = blocks.get(name, _Block(entry.key, like(entry.further), namespace))
        values = everywhere.merged(name, block.value.merged_over(entry.further))
        own = block.value.get("type")
        if own is not None and own.text != entry.type:
            own.warning(f"the type of {name} is {entry.type!r}, given at {entry.key.path}:{entry.key.line}")
        for place, text in entry.files:
            values = from_file(place, text, name).merged_over(values)
        values = spawned[name].merged_over(values) if name in spawned else values
        config = _config(name, entry.type, entry.key, Params(values, name, shared), block, entry.fallbacks)
        controllers[name] = dataclasses.replace(config, node_options=entry.node_options)
    for name in dict.fromkeys([*blocks, *spawned]):
        if name in controllers:
            continue
        own = spawned.get(name) or blocks[name].value
        block = blocks.get(name) or _Block(next((key for key, _ in own.pairs()), own), own, namespace)
        values = own.merged_over(block.value)
        type_node = values.get("type")
        if type_node is not None:
            params = Params(everywhere.merged(name, values), name, shared)
            controllers[name] = _config(name, convert(type_node, str, ""), block.key, params, block)
        else:
            hint = nearest(name, declared)
            block.key.problems.deviation(block.key, f"{name!r} has parameters but no type, so it is not loaded{hint}")
    _check_fallbacks(declared, controllers)
    return controllers


def _rename_misspelt(blocks: dict[str, _Block], declared: Mapping[str, _Declared], spawned: Collection[str]) -> None:
    """Report each block that is meant for a controller of another name, and give it that name.

    Such a controller has no parameters, and a similar name; or it is the only one whose type has keys of the block.
    """
    strange = [name for name, block in blocks.items() if name not in declared and block.value.get("type") is None]
    bare = {
        name: entry
        for name, entry in declared.items()
        if name not in blocks and name not in spawned and not entry.files and not entry.further.pairs()
    }
    for name in [name for name in strange if name not in spawned]:
        similar = closest(name, bare)
        fitting = (
            [similar]
            if similar
            else [other for other, entry in bare.items() if _has_keys_of(blocks[name].value, entry.type)]
        )
        if len(fitting) == 1:
            entry, block = bare.pop(fitting[0]), blocks.pop(name)
            block.key.error(
                f"no controller is called {name!r}, and {fitting[0]!r} (line {entry.key.line}) has no parameters; "
                f"give both the same name"
            )
            blocks[fitting[0]] = block


def _has_keys_of(block: Node, type_name: str) -> bool:
    """Whether a block has parameters that this type has, and not every controller."""
    from canopen_control.controllers.types import class_of  # needed only for a mistake

    reads = getattr(class_of(type_name), "reads", CommonParams)
    return not {*keys_of(reads)}.difference(keys_of(CommonParams)).isdisjoint(block.keys())


def _check_fallbacks(declared: dict[str, _Declared], controllers: dict[str, ControllerConfig]) -> None:
    for name, entry in declared.items():
        for fallback in entry.fallbacks:
            if fallback not in controllers or fallback == name:
                entry.key.error(
                    f"fallback_controllers of {name}: no controller {fallback!r}{nearest(fallback, controllers)}"
                )


def from_file(place: Node, text: str, name: str) -> Node:
    """Return the parameters of controller `name` from the `params_file` at path `text`; none after an error.

    A relative path starts from the folder of the file that names it. Errors are reported at `place`.
    """
    path = Path(place.path).parent / Path(os.path.expandvars(text)).expanduser()
    blocks: dict[str, _Block] = {}
    try:
        _collect(tree(path, error=RobotConfigError, strict=place.problems.strict), blocks)
    except RobotConfigError as error:
        place.error(f"params_file: {error}")
        return like(place)
    values = _block_of(blocks, name)
    if values is None:
        place.error(f"{path} has no parameters for {name}{nearest(name, blocks)}")
    return like(place) if values is None else values


def _config(
    name: str, type_name: str, place: Node, params: Params, block: _Block, fallbacks: tuple[str, ...] = ()
) -> ControllerConfig:
    where = block.namespace, block.ros1, block.key.line
    return ControllerConfig(name, type_name, params, place.line, place.path, fallbacks, *where)
