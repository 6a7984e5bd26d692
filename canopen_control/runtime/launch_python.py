"""Reader of Python launch files: finds arguments, nodes and files in the syntax tree without running the file.

Nothing is imported or executed. Texts are evaluated through constants, names that are assigned once, `+`, `/`,
f-strings, os.path.join and launch substitutions; any other expression is only known at run time, and is reported with
its line instead of guessed.
"""

from __future__ import annotations

import ast
import shlex
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


_LISTS: Final = frozenset({"arguments", "ros_arguments", "parameters", "cmd"})
_SUFFIXES: Final = (".yaml", ".yml", ".urdf", ".xacro", ".eds", ".dcf", ".rviz", ".launch.py", ".launch.xml", ".launch")
_NODES: Final = ("Node", "LifecycleNode", "ComposableNodeContainer")
_SPAWNER_CALLS: Final = (
    "generate_controllers_spawner_launch_description",
    "generate_load_controller_launch_description",
)
_ACTIONS: Final = frozenset(
    (*_NODES, *_SPAWNER_CALLS, "IncludeLaunchDescription", "GroupAction", "TimerAction", "RegisterEventHandler")
)
_PACKAGE_CALLS: Final = ("FindPackageShare", "FindPackage", "get_package_share_directory", "get_package_share_path")
_THROUGH: Final = ("ParameterValue", "TextSubstitution", "str", "Path", "PythonLaunchDescriptionSource", "Command",
                   "AnyLaunchDescriptionSource", "XMLLaunchDescriptionSource", "FrontendLaunchDescriptionSource",
                   "ParameterFile", "PathSubstitution", "ReplaceString", "RewrittenYaml")  # fmt: skip
_DEEPEST: Final = 40  # nesting of expressions
_LONGEST: Final = 20_000  # maximum length of a text in characters


@dataclass(frozen=True, slots=True)
class LaunchText:
    """Text in a launch file, with its line number; `text` is None if computed at run time.

    `name` is that of a parameter with this value, "" for other texts.
    """

    text: str | None
    line: int
    name: str = ""


@dataclass(frozen=True, slots=True)
class LaunchCondition:
    """Condition of a launch action: `text` must be true, or false if `negated`; None if computed at run time."""

    text: str | None
    negated: bool = False


@dataclass(frozen=True, slots=True)
class LaunchInclude:
    """Included launch file with arguments; `file` is None if the name is computed at run time."""

    file: str | None
    arguments: dict[str, str]
    line: int
    condition: LaunchCondition | None = None


@dataclass(frozen=True, slots=True)
class LaunchNode:
    """Node that a launch file starts; the name is None if computed at run time, "" if not given.

    `plugin` is the plugin of a composable node, `parameters` are the node's parameter files and, with a name, the
    parameters in the launch file itself.
    """

    package: str | None
    executable: str | None
    name: str | None
    namespace: str | None
    arguments: tuple[LaunchText, ...]
    line: int
    plugin: str | None = ""
    parameters: tuple[LaunchText, ...] = ()
    condition: LaunchCondition | None = None


@dataclass(slots=True)
class PythonLaunch:
    """Contents of a Python launch file; `generates` is True if it defines generate_launch_description."""

    arguments: dict[str, str | None] = field(default_factory=dict)
    argument_lines: dict[str, int] = field(default_factory=dict)
    nodes: list[LaunchNode] = field(default_factory=list)
    includes: list[LaunchInclude] = field(default_factory=list)
    texts: list[LaunchText] = field(default_factory=list)
    """File names and commands."""
    computed: list[tuple[int, str]] = field(default_factory=list)
    generates: bool = False
    replaced: dict[str, str] = field(default_factory=dict)
    """Replacements that nav2's ReplaceString makes in a parameter file."""
    pushed: list[str] = field(default_factory=list)
    """Namespaces of PushRosNamespace (PushROSNamespace since Jazzy), "$(computed)" for a computed namespace."""


def read_python(source: str, path: str) -> PythonLaunch:
    """Read the source of a Python launch file.

    Raise RobotConfigError if it is not valid Python or too deeply nested.
    """
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", None) or 1
        raise RobotConfigError(f"{path}:{line}: not valid Python: {getattr(error, 'msg', None) or error}") from error
    reader = _Reader(tree)
    try:
        reader.read()
    except RecursionError as error:
        raise RobotConfigError(f"{path}: its expressions are nested too deeply") from error
    return reader.launch


class _Reader:
    """Reader of one Python launch file, which collects the contents in `launch`."""

    def __init__(self, tree: ast.Module) -> None:
        self._tree, self._depth = tree, 0
        self._names = _assigned_once(tree)
        self._texts: dict[str, str | None] = {}
        self.launch = PythonLaunch()

    def read(self) -> None:
        """Collect declared arguments, started nodes, includes, file names and commands."""
        unused = _unused_actions(self._tree)
        for node in ast.walk(self._tree):
            if isinstance(node, ast.FunctionDef) and node.name == "generate_launch_description":
                self.launch.generates = True
            if isinstance(node, ast.Call) and id(node) not in unused:
                self._call(node)
        self._files(self._tree)

    def _call(self, call: ast.Call) -> None:
        name = _called(call)
        if name == "DeclareLaunchArgument":
            self._argument(call)
        elif name in _NODES or name == "ComposableNode":
            self._node(call)
        elif name in _SPAWNER_CALLS:
            self._spawner(call)
        elif name == "IncludeLaunchDescription":
            self._include(call)
        elif name.lower() == "pushrosnamespace":
            self.launch.pushed.append((self.text(call.args[0]) if call.args else None) or "$(computed)")
        elif name == "ReplaceString":
            self._replaced(_keyword(call, "replacements"))

    def _argument(self, call: ast.Call) -> None:
        name_node = call.args[0] if call.args else _keyword(call, "name")
        name = None if name_node is None else self.text(name_node)
        if name is None:
            self.launch.computed.append((call.lineno, "the name of an argument"))
            return
        default = _keyword(call, "default_value")
        value = None if default is None else self.text(default)
        if default is not None and value is None:
            self.launch.computed.append((call.lineno, f"the default of the argument {name!r}"))
        self.launch.arguments[name] = value
        self.launch.argument_lines[name] = call.lineno

    def _replaced(self, node: ast.expr | None) -> None:
        for key, value in zip(node.keys, node.values, strict=True) if isinstance(node, ast.Dict) else ():
            name, text = None if key is None else self.text(key), self.text(value)
            if name and text is not None:
                self.launch.replaced[name] = text

    def _node(self, call: ast.Call) -> None:
        def text_of(key: str) -> str | None:
            place = _keyword(call, key)
            value = "" if place is None else self.text(place)
            if value is None:
                self.launch.computed.append((call.lineno, f"the {key} of a node"))
            return value

        arguments = self._list(_keyword(call, "arguments"))
        words = tuple(LaunchText(self.text(argument), argument.lineno) for argument in arguments)
        self.launch.computed += [(word.line, "an argument of a node") for word in words if word.text is None]
        self.launch.nodes.append(
            LaunchNode(
                text_of("package"),
                text_of("executable"),
                text_of("name"),
                text_of("namespace"),
                words,
                call.lineno,
                text_of("plugin"),
                tuple(self._node_parameters(_keyword(call, "parameters"))),
                self._condition(call),
            )
        )

    def _node_parameters(self, node: ast.expr | None) -> Iterator[LaunchText]:
        for item in self._list(node):
            named = self._names.get(item.id) if isinstance(item, ast.Name) else item
            if isinstance(named, ast.Dict):
                yield from self._parameters(named)
            else:
                yield LaunchText(self.text(item), item.lineno)

    def _parameters(self, values: ast.Dict, above: str = "") -> Iterator[LaunchText]:
        """Yield the parameters in a dict of launch_ros, with dotted names; lists are omitted."""
        for key, value in zip(values.keys, values.values, strict=True):
            name = None if key is None else self.text(key)
            if name and isinstance(value, ast.Dict):
                yield from self._parameters(value, f"{above}{name}.")
            elif name and not isinstance(value, ast.List | ast.Tuple):
                yield LaunchText(self.text(value), value.lineno, f"{above}{name}")

    def _condition(self, call: ast.Call) -> LaunchCondition | None:
        node = _keyword(call, "condition")
        if node is None:
            return None
        name = _called(node) if isinstance(node, ast.Call) else ""
        if not isinstance(node, ast.Call) or name not in ("IfCondition", "UnlessCondition") or not node.args:
            return LaunchCondition(None)
        return LaunchCondition(self.text(node.args[0]), negated=name == "UnlessCondition")

    def _spawner(self, call: ast.Call) -> None:
        """Read a call of controller_manager.launch_utils as the spawner node that it creates."""
        names = call.args[0] if call.args else _keyword(call, "controller_names") or _keyword(call, "controller_name")
        files = _keyword(call, "controller_params_files") or _keyword(call, "controller_params_file")
        more = self._list(_keyword(call, "extra_spawner_args"))
        words = [LaunchText(self.text(item), item.lineno) for item in (*self._list(names), *more)]
        for item in self._list(files):
            words += [LaunchText("--param-file", item.lineno), LaunchText(self.text(item), item.lineno)]
        self.launch.nodes.append(
            LaunchNode(
                "controller_manager", "spawner", "", "", tuple(words), call.lineno, condition=self._condition(call)
            )
        )

    def _include(self, call: ast.Call) -> None:
        source = call.args[0] if call.args else _keyword(call, "launch_description_source")
        arguments = dict[str, str]()
        for key, value in self._pairs(_keyword(call, "launch_arguments")):
            name, text = self.text(key), self.text(value)
            if name is None or text is None:
                self.launch.computed.append((value.lineno, f"the value of {name or 'an argument'} of an included file"))
            else:
                arguments[name] = text
        file = None if source is None else self.text(source)
        self.launch.includes.append(LaunchInclude(file, arguments, call.lineno, self._condition(call)))

    def _pairs(self, node: ast.expr | None) -> Iterator[tuple[ast.expr, ast.expr]]:
        """Yield the key and value expressions of a dict, its items(), or a list of pairs."""
        if isinstance(node, ast.Call) and _called(node) == "items" and isinstance(node.func, ast.Attribute):
            node = node.func.value
        if isinstance(node, ast.Call) and _called(node) == "dict":
            yield from ((ast.Constant(keyword.arg), keyword.value) for keyword in node.keywords if keyword.arg)
        if isinstance(node, ast.Name):
            node = self._names.get(node.id)
        if isinstance(node, ast.Dict):
            yield from ((key, value) for key, value in zip(node.keys, node.values, strict=True) if key is not None)
        for item in node.elts if isinstance(node, ast.List | ast.Tuple) else ():
            if isinstance(item, ast.Tuple) and len(item.elts) == 2:
                yield item.elts[0], item.elts[1]

    def _list(self, node: ast.expr | None) -> list[ast.expr]:
        """Return the elements of a list, tuple, variable or sum of lists; any other expression is a single element."""
        if isinstance(node, ast.Name) and node.id in self._names:
            return self._list(self._names[node.id])
        if isinstance(node, ast.List | ast.Tuple):
            return list(node.elts)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return [*self._list(node.left), *self._list(node.right)]
        return [] if node is None else [node]

    def _files(self, node: ast.AST) -> None:
        """Collect the file names and commands in a syntax tree, as complete texts."""
        if isinstance(node, ast.Call):
            if _called(node) == "process_file" and (text := self._processed(node)):
                self.launch.texts.append(LaunchText(text, node.lineno))
                return
            if builder := _moveit_builder(node):
                self._moveit(node, builder)
                return
            if _called(node) == "generate_demo_launch" and (package := self._moveit_package(node)):
                self.launch.texts.append(LaunchText(f"{package}/config/ros2_controllers.yaml", node.lineno))
        if isinstance(node, ast.expr) and not isinstance(node, ast.Name):
            text = self.text(node)
            if text is not None and (text.endswith(_SUFFIXES) or _is_command(node)):
                self.launch.texts.append(LaunchText(text, node.lineno))
                return
            if text is None and _is_command(node):
                self.launch.computed.append((node.lineno, "a command"))
            elif text is None and (ending := self._ending(node)):
                self.launch.computed.append((node.lineno, f"the name of a file that ends in {ending!r}"))
                return
        for child in self._parts(node):
            self._files(child)

    def _parts(self, node: ast.AST) -> Iterable[ast.AST]:
        """Return the children of a syntax tree; those of a list of words, while other lists are parts of one text."""
        if isinstance(node, ast.keyword) and node.arg in _LISTS:
            return self._list(node.value)
        return ast.iter_child_nodes(node)

    def _ending(self, node: ast.expr) -> str:
        """Return the last part of a composed file name if it is known and has a relevant suffix, else ""."""
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Div):
            last: ast.expr | None = node.right
        elif isinstance(node, ast.JoinedStr):
            last = node.values[-1] if node.values else None
        elif isinstance(node, ast.Call) and _called(node) == "join" and node.args:
            last = node.args[-1]
        else:
            return ""
        text = None if last is None else self.text(last)
        if text is None and last is not None:
            return self._ending(last)
        return text.rpartition("/")[2] if text and text.endswith(_SUFFIXES) else ""

    def _processed(self, call: ast.Call) -> str | None:
        """Return the xacro command for xacro.process_file(FILE, mappings={NAME: VALUE}); None if FILE is computed."""
        return self._xacro(self.text(call.args[0]) if call.args else None, _keyword(call, "mappings"))

    def _xacro(self, file: str | None, mappings: ast.expr | None) -> str | None:
        """Return the xacro command for a file, without mappings computed at run time; None if the file is computed."""
        mappings = self._names.get(mappings.id) if isinstance(mappings, ast.Name) else mappings
        words = ["xacro", file]
        for key, value in zip(mappings.keys, mappings.values, strict=True) if isinstance(mappings, ast.Dict) else ():
            name, text = None if key is None else self.text(key), self.text(value)
            if name is None or text is None:
                self.launch.computed.append((value.lineno, "an argument of xacro"))
            else:
                words.append(f"{name}:={shlex.quote(text) if ' ' in text and '$(' not in text else text}")
        resolved = [word for word in words if word is not None]
        return " ".join(resolved) if len(resolved) == len(words) else None

    # --- MoveIt ---

    def _moveit(self, chain: ast.Call, builder: ast.Call) -> None:
        """Read MoveItConfigsBuilder(ROBOT, package_name=...).robot_description(...) as an equivalent xacro command.

        Without a file the builder uses config/ROBOT.urdf.xacro in its package (moveit_configs_utils).
        """
        robot, package = self._moveit_names(builder)
        described = _link(chain, "robot_description")
        argument = None
        if described is not None:
            argument = described.args[0] if described.args else _keyword(described, "file_path")
        relative = self.text(argument) if argument is not None else robot and f"config/{robot}.urdf.xacro"
        if package is None or relative is None:
            self.launch.computed.append((builder.lineno, "the description of MoveItConfigsBuilder"))
            return
        file = relative if relative.startswith(("/", "$(find ")) else f"{package}/{relative}"
        mappings = None if described is None else _keyword(described, "mappings")
        if described is not None and mappings is None and len(described.args) > 1:
            mappings = described.args[1]
        if (text := self._xacro(file, mappings)) is not None:
            self.launch.texts.append(LaunchText(text, builder.lineno))

    def _moveit_names(self, builder: ast.Call) -> tuple[str | None, str | None]:
        """Return the robot name and $(find PACKAGE) of a MoveItConfigsBuilder call; None for a computed part."""
        name = builder.args[0] if builder.args else _keyword(builder, "robot_name")
        robot = None if name is None else self.text(name)
        package = builder.args[2] if len(builder.args) > 2 else _keyword(builder, "package_name")
        package_name = self.text(package) if package is not None else robot and f"{robot}_moveit_config"
        return robot, None if package_name is None else f"$(find {package_name})"

    def _moveit_package(self, launch: ast.Call) -> str | None:
        """Return $(find PACKAGE) of the configuration passed to a function of moveit_configs_utils.launches."""
        config = launch.args[0] if launch.args else _keyword(launch, "moveit_config")
        config = self._names.get(config.id) if isinstance(config, ast.Name) else config
        builder = _moveit_builder(config) if isinstance(config, ast.Call) else None
        return None if builder is None else self._moveit_names(builder)[1]

    # --- texts ---

    def text(self, node: ast.expr) -> str | None:
        """Return the text of an expression, or None if computed at run time."""
        if self._depth > _DEEPEST:
            return None
        self._depth += 1
        try:
            return next((read(self, node) for kind, read in _TEXTS.items() if isinstance(node, kind)), None)
        finally:
            self._depth -= 1

    def joined(self, nodes: list[ast.expr], between: str = "") -> str | None:
        """Return the concatenated texts of expressions; None if one is unknown or the result is too long."""
        texts = [self.text(node) for node in nodes]
        resolved = [text for text in texts if text is not None]
        if len(resolved) < len(texts) or sum(map(len, resolved)) > _LONGEST:
            return None
        return between.join(resolved)

    def name(self, node: ast.expr) -> str | None:
        """Return the text of a variable that is assigned exactly once; None for other expressions."""
        if not isinstance(node, ast.Name) or node.id not in self._names:
            return None
        if node.id not in self._texts:  # evaluated once: repeated references would take exponential time
            self._texts[node.id] = None  # a name that refers to itself has no value
            self._texts[node.id] = self.text(self._names[node.id])
        return self._texts[node.id]

    def call(self, node: ast.expr) -> str | None:
        """Return the text of a launch substitution or a path function, or None if unknown."""
        assert isinstance(node, ast.Call)
        name = _called(node)
        if name == "perform" and isinstance(node.func, ast.Attribute):  # in an OpaqueFunction
            return self.text(node.func.value)
        values = [*node.args, *(keyword.value for keyword in node.keywords)]
        first = _keyword(node, "source_file") or (values[0] if values else None)
        if name == "join" and node.args:
            return self.joined(node.args, "/")
        if first is None:
            return None
        if name == "PathJoinSubstitution":
            return self.joined(self._list(first), "/")
        inner = self.text(first)
        if inner is None:
            return None
        if name == "LaunchConfiguration":
            return f"$(var {inner})"
        if name in _PACKAGE_CALLS:
            return f"$(find {inner})"
        if name == "FindExecutable":
            return inner
        return inner if name in _THROUGH else None


def _constant(_reader: _Reader, node: ast.expr) -> str | None:
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, str | int | float) else None


def _formatted(reader: _Reader, node: ast.expr) -> str | None:
    assert isinstance(node, ast.JoinedStr)
    parts = [value.value if isinstance(value, ast.FormattedValue) else value for value in node.values]
    return reader.joined(parts)


def _sum(reader: _Reader, node: ast.expr) -> str | None:
    assert isinstance(node, ast.BinOp)
    between = "/" if isinstance(node.op, ast.Div) else "" if isinstance(node.op, ast.Add) else None
    return None if between is None else reader.joined([node.left, node.right], between)


def _listed(reader: _Reader, node: ast.expr) -> str | None:
    assert isinstance(node, ast.List | ast.Tuple)
    return reader.joined(node.elts) if node.elts else None


_TEXTS: Final[dict[type[ast.expr] | tuple[type[ast.expr], ...], Callable[[_Reader, ast.expr], str | None]]] = {
    ast.Constant: _constant,
    ast.JoinedStr: _formatted,
    ast.BinOp: _sum,
    (ast.List, ast.Tuple): _listed,
    ast.Name: _Reader.name,
    ast.Call: _Reader.call,
}
"""Functions that return the text of an expression, by the kind of expression."""


def _assigned_once(tree: ast.Module) -> dict[str, ast.expr]:
    """Return the variables that are assigned exactly once in a file, with their value expressions."""
    values, counts = dict[str, ast.expr](), dict[str, int]()
    for name, value in _assignments(tree):
        if isinstance(value, ast.Call) and _is_name(_keyword(value, "source_file"), name):
            continue  # ReplaceString and RewrittenYaml of nav2: the same file, edited
        counts[name] = counts.get(name, 0) + 1
        if value is not None:
            values[name] = value
    return {name: value for name, value in values.items() if counts[name] == 1}


def _assignments(tree: ast.Module) -> Iterator[tuple[str, ast.expr | None]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            yield node.targets[0].id, node.value
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, node.value
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            continue
        elif isinstance(node, ast.AugAssign | ast.For) and isinstance(node.target, ast.Name):
            yield node.target.id, None
            yield node.target.id, None  # a second entry: the variable has no single value
        elif isinstance(node, ast.arg):
            yield node.arg, None
            yield node.arg, None


def _unused_actions(tree: ast.Module) -> set[int]:
    """Return the ids of the syntax nodes of actions that are assigned to a name that nothing reads.

    Such an action never starts: ros2_canopen's robot_control_setup.launch.py has a spawner, whose name is commented out
    of the LaunchDescription.
    """
    actions = [
        (node.targets[0].id, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name)
        if isinstance(node.value, ast.Call) and _called(node.value) in _ACTIONS
    ]
    unused = set[int]()
    while True:
        read = {
            node.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and id(node) not in unused
        }
        more = {id(node) for name, call in actions if name not in read for node in ast.walk(call)}
        if more <= unused:
            return unused
        unused |= more


def _called(call: ast.Call) -> str:
    """Return the last part of a called function's name, such as `Node` for `actions.Node`."""
    func = call.func
    return func.attr if isinstance(func, ast.Attribute) else func.id if isinstance(func, ast.Name) else ""


def _links(call: ast.Call) -> Iterator[ast.Call]:
    """Yield the calls of a chain a(...).b(...).c(...), starting with the last."""
    node: ast.expr = call
    while isinstance(node, ast.Call):
        yield node
        node = node.func.value if isinstance(node.func, ast.Attribute) else node.func


def _link(chain: ast.Call, name: str) -> ast.Call | None:
    return next((call for call in _links(chain) if _called(call) == name), None)


def _moveit_builder(chain: ast.Call) -> ast.Call | None:
    return _link(chain, "MoveItConfigsBuilder")


def _keyword(call: ast.Call, name: str) -> ast.expr | None:
    return next((keyword.value for keyword in call.keywords if keyword.arg == name), None)


def _is_name(node: ast.expr | None, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _is_command(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and _called(node) == "Command"
