"""Reader of ROS launch files: finds a robot's files, arguments and controllers without running the launch file.

Texts have the notation of XML launch files: `$(var NAME)` is an argument, `$(find PACKAGE)` the folder of a package.
A value that is only computed at run time is unknown here, and reported as such.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.controllers_file import MANAGER_PARAMETERS, ParameterSource
from canopen_control.data_files import read_utf8
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.runtime.launch_python import LaunchCondition, LaunchInclude, LaunchNode, LaunchText, read_python
from canopen_control.urdf.document import Element, ElementPlace, read_document
from canopen_control.urdf.package_search import installed_file, package_folders
from canopen_control.yamlfile.reader import read

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from canopen_control.yamlfile.node import Node


_VARIABLE: Final = re.compile(r"\$\((?:var|arg) +([\w.-]+)\)")
_PACKAGE: Final = re.compile(r"\$\((?:find|find-pkg-share) +([\w.-]+)\)")
_EXECUTABLE: Final = re.compile(r"\$\((?:find-exec|find) +xacro\)(?:/xacro)?")
_COMMAND: Final = re.compile(r"\$\(command +(['\"])(.*?)\1")
_COMPUTED_ENDING: Final = re.compile(r"ends in '([^']*)'")
_SUBSTITUTION: Final = re.compile(r"\$\([^()]*\)")
_PROTECTED: Final = str.maketrans(" ()", "\0\1\2")  # characters at which a shell would split a substitution
_RESTORED: Final = str.maketrans("\0\1\2", " ()")
_NAMED_FILE: Final = re.compile(r"/[^\s'\"]+")
_TRUE: Final = ("true", "1")  # launch.conditions.IfCondition
_DEEPEST: Final = 8  # maximum nesting of included launch files
_SPAWNERS: Final = ("spawner", "spawner.py")
_MANAGER: Final = "ros2_control_node"
#: Options of the spawner of controller_manager (Jazzy) that are followed by a value.
SPAWNER_VALUES: Final = frozenset(
    {"-c", "--controller-manager", "-p", "--param-file", "-n", "--namespace", "-t", "--controller-type",
     "--controller-manager-timeout", "--switch-timeout", "--service-call-timeout", "--controller-ros-args", "--timeout"}
)  # fmt: skip
_FILE_OPTIONS: Final = ("-p", "--param-file")
TYPE_OPTIONS: Final = ("-t", "--controller-type")
_NOT_ACTIVE: Final = frozenset({"--inactive", "--load-only", "--stopped"})
_TYPE: Final = re.compile(r"\btype['\"]?\s*:")
_PAIR: Final = re.compile(r"([A-Za-z_]\w*):=(.*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class LaunchFile:
    """Contents of one launch file; `values` are the values passed to the arguments.

    `arguments` maps names to defaults (None: required), `texts` are file names and commands. `computed` has pairs of a
    line number and an expression whose value is unknown; `nodes` are the started nodes, `includes` the included launch
    files.
    """

    path: Path
    arguments: dict[str, str | None]
    texts: tuple[LaunchText, ...] = ()
    values: Mapping[str, str] = field(default_factory=dict)
    computed: tuple[tuple[int, str], ...] = ()
    nodes: tuple[LaunchNode, ...] = ()
    includes: tuple[LaunchInclude, ...] = ()
    replaced: Mapping[str, str] = field(default_factory=dict)  # in parameter files, by nav2's ReplaceString

    def resolved(self, text: str) -> str | None:
        """Substitute arguments and package paths in a text; None if an argument or package is unknown."""
        for _ in range(5):  # a default may contain another argument
            text = _VARIABLE.sub(self._value, text)
        while (match := _PACKAGE.search(text)) is not None:
            folder = next(package_folders(match[1], self.path), None)
            if folder is None:
                return None
            text = text.replace(match[0], str(folder))
            text = _NAMED_FILE.sub(partial(_as_installed, folder), text)
        return None if "$(" in text else text

    def happens(self, condition: LaunchCondition | None) -> bool:
        """Whether a launch action with this condition is executed; a computed condition, or None, counts as true."""
        text = None if condition is None or condition.text is None else self.resolved(condition.text)
        if condition is None or text is None:
            return True
        return (text.strip().lower() in _TRUE) is not condition.negated

    def arguments_in(self, text: str) -> set[str]:
        """Return the launch arguments that a text uses, directly or through the values of other arguments."""
        names, new = set[str](), set(_VARIABLE.findall(text))
        while new:
            names |= new
            values = [self.values.get(name) or self.arguments.get(name) or "" for name in new]
            new = {name for value in values for name in _VARIABLE.findall(value)} - names
        return names

    def absent_packages(self, text: str) -> list[str]:
        """Return the packages that a text names but that cannot be found."""
        return [name for name in _PACKAGE.findall(text) if next(package_folders(name, self.path), None) is None]

    def _value(self, match: re.Match[str]) -> str:
        value = self.values.get(match[1], self.arguments.get(match[1]))
        return match[0] if value is None else value


def read_launch(path: Path) -> LaunchFile:
    """Read a launch file in XML, YAML or Python; raise RobotConfigError if it cannot be read or is invalid."""
    try:
        source = read_utf8(path)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise RobotConfigError(f"{path}: cannot be read: {reason}") from error
    if path.suffix == ".py":
        content = read_python(source, str(path))
        return LaunchFile(
            path,
            content.arguments,
            tuple(content.texts),
            computed=tuple(content.computed),
            replaced=content.replaced,
            nodes=tuple(content.nodes),
            includes=tuple(content.includes),
        )
    return _read_xml(launch_elements(source, path), path)


def launch_elements(source: str, path: Path) -> Element:
    """Parse a launch file as YAML or XML, by the suffix of `path`, and return the root element.

    Raise RobotConfigError if it is invalid.
    """
    if path.suffix in (".yaml", ".yml"):
        return read_yaml_launch(source, str(path))
    return read_document(source, str(path)).root


@dataclass(slots=True)
class Launched:
    """Robot described by a launch file: files (keys bus, controllers, description) and xacro `arguments`.

    `spawned` are the controllers that the spawners activate, in order; `variables` are the values of all launch
    arguments; `parameters` are those of the controller manager and of the spawners. `uncertainties` are the reasons why
    something may be missing. `known` are the arguments that the launch file declares, `idle` the user's NAME:=VALUE
    that no evaluated text uses.
    """

    arguments: dict[str, str] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)
    uncertainties: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    spawned: tuple[str, ...] = ()
    variables: dict[str, str] = field(default_factory=dict)
    parameters: tuple[ParameterSource, ...] = ()


def launched_robot(path: Path, words: Mapping[str, str], obeyed: Collection[str] = ()) -> Launched:
    """Return the robot described by a launch file, including included launch files.

    `words` are the user's NAME:=VALUE, for the launch file if the name is declared there, else for xacro. The names in
    `obeyed` select hardware, and may be unknown to both.
    """
    own_arguments = read_launch(path).arguments
    declared = {name: value for name, value in words.items() if name in own_arguments}
    further = {f"{name}?" if name in obeyed else name: value for name, value in words.items() if name not in declared}
    reading = _Reading(path)
    used = reading.read(path, declared, 0)
    launched = reading.launched
    launched.parameters = (*reading.of_manager, *reading.of_types, *reading.of_spawners)
    if main := _main_file(launched.parameters):
        launched.files["controllers"] = main
    if not launched.files and not reading.uncertainties:
        reading.uncertainties.append(f"{path}: it names no file of a robot")
    launched.arguments |= further
    launched.known = tuple(own_arguments)
    launched.idle = tuple(f"{name}:={value}" for name, value in declared.items() if name not in used | set(obeyed))
    launched.spawned = tuple(dict.fromkeys(launched.spawned))
    launched.uncertainties = tuple(dict.fromkeys(reading.uncertainties))
    return launched


def _main_file(parameters: Iterable[ParameterSource]) -> Path | None:
    """Return the first parameter file that gives a controller its type; else the first, or None without a file."""
    files = [source.path for source in parameters if not source.values]
    typed = (path for path in files if _TYPE.search(path.read_text(encoding="utf-8", errors="replace")))
    return next(typed, files[0] if files else None)


@dataclass(slots=True)
class _Reading:
    """Reader of a launch file and the files it includes; `launched` is the robot."""

    path: Path
    launched: Launched = field(default_factory=Launched)
    of_manager: list[ParameterSource] = field(default_factory=list)
    of_types: list[ParameterSource] = field(default_factory=list)
    of_spawners: list[ParameterSource] = field(default_factory=list)
    uncertainties: list[str] = field(default_factory=list)

    def read(self, path: Path, passed: Mapping[str, str], depth: int) -> set[str]:
        """Read the launch file `path` with the arguments `passed`; return the names of all used arguments."""
        launch = replace(read_launch(path), values=dict(passed))
        used = self._read_nodes(launch)
        values = {name: launch.resolved(f"$(var {name})") for name in (*launch.arguments, *passed)}
        values |= {text: launch.resolved(value) for text, value in launch.replaced.items()}
        self.launched.variables |= {name: _unquoted(value) for name, value in values.items() if value is not None}
        for text in launch.texts:
            if text.text is not None:
                _add_files(launch, text.text, self.launched.arguments, self.launched.files)
                used |= _used(launch, text.text)
        self._report_unread(launch)
        for include in launch.includes if depth < _DEEPEST else ():
            if launch.happens(include.condition):
                used |= self._include(launch, include, depth)
        return used

    def _include(self, launch: LaunchFile, include: LaunchInclude, depth: int) -> set[str]:
        """Read an included launch file; return the arguments of the including file that it uses or receives."""
        name = None if include.file is None else launch.resolved(include.file)
        place = f"{launch.path}:{include.line}"
        path = None if name is None else launch.path.parent / name
        if include.file is not None and launch.absent_packages(include.file):
            return set()  # a program such as a simulator; missing robot files are reported elsewhere
        if path is None or not path.is_file():
            problem = include.file if name is None else f"{path} does not exist"
            self.uncertainties.append(
                f"{place}: an included launch file is not read: {problem or 'its name is computed'}"
            )
            return set()
        texts = {key: launch.resolved(value) for key, value in include.arguments.items()}
        scope = {key: value for key, value in launch.arguments.items() if value is not None} | dict(launch.values)
        arguments = scope | {key: value for key, value in texts.items() if value is not None}
        try:
            inner = self.read(path, arguments, depth + 1)
        except RobotConfigError as error:
            self.uncertainties.append(f"{place}: {error}")
            return set()
        passed = {name for value in include.arguments.values() for name in launch.arguments_in(value)}
        return (inner & launch.arguments.keys()) | passed

    def _read_nodes(self, launch: LaunchFile) -> set[str]:
        """Collect the parameters and controllers of the controller manager and spawners; return the arguments used."""
        used = set[str]()
        for node in launch.nodes:
            if node.package != "controller_manager" or not launch.happens(node.condition):
                continue
            if node.executable == _MANAGER:
                for parameter in node.parameters:
                    used |= self._add_parameter(launch, parameter, self.of_manager)
            elif node.executable in _SPAWNERS:
                words = [argument.text for argument in node.arguments if argument.text]
                used |= {name for word in words for name in launch.arguments_in(word)}
                words = _split(words)
                names = tuple(name for word in _controllers_in(words) if (name := launch.resolved(word)))
                self.launched.spawned += () if _NOT_ACTIVE & set(words) else names
                for text in option_values(words, _FILE_OPTIONS):
                    self._add_parameter(launch, LaunchText(text, node.line), self.of_spawners, names)
                for text in option_values(words, TYPE_OPTIONS):
                    self._add_type(launch, LaunchText(text, node.line), names)
        return used

    def _add_parameter(
        self, launch: LaunchFile, parameter: LaunchText, sources: list[ParameterSource], names: tuple[str, ...] = ()
    ) -> set[str]:
        """Add a file of parameters, or a parameter of the manager in the launch file; return the arguments used."""
        value = None if parameter.text is None else launch.resolved(parameter.text)
        if parameter.text is None or value is None:
            return set()
        if not parameter.name and (launch.path.parent / value).is_file():
            source = ParameterSource(launch.path.parent / value, names)
        elif parameter.name in MANAGER_PARAMETERS:
            source = ParameterSource(launch.path, values=((parameter.name, value, parameter.line),))
        else:
            return set()
        if source not in sources:
            sources.append(source)
        return launch.arguments_in(parameter.text)

    def _add_type(self, launch: LaunchFile, type_name: LaunchText, names: tuple[str, ...]) -> None:
        """Add the controller type in a spawner's arguments, which the spawner sets as a parameter of the manager."""
        value = None if type_name.text is None else launch.resolved(type_name.text)
        if value and names:
            pairs = tuple((f"{name}.type", value, type_name.line) for name in names)
            self.of_types.append(ParameterSource(launch.path, values=pairs))

    def _report_unread(self, launch: LaunchFile) -> None:
        """Report computed values and missing packages that affect the robot's files."""
        named = [word for text in launch.texts if text.text for word in words_of(text.text) if _kind(word)]
        absent = [package for word in named for package in launch.absent_packages(word)]
        computed = [(line, expression) for line, expression in launch.computed if _concerns_robot(expression)]
        for line, expression in computed:
            self.uncertainties.append(f"{launch.path}:{line}: {expression} is computed at run time, and unknown here")
        for name in dict.fromkeys(absent):
            self.uncertainties.append(
                f"{launch.path}: package {name!r} was not found; source its workspace, or add its parent folder to "
                "ROS_PACKAGE_PATH"
            )


def _concerns_robot(what: str) -> bool:
    """Whether a computed value may name a file of the robot or be an argument of the robot description."""
    if match := _COMPUTED_ENDING.search(what):
        return bool(_kind(match[1])) or match[1] in (".yaml", ".yml")
    # master.bin is used only by the master of ros2_canopen
    return ("command" in what or "file" in what) and "master_bin" not in what


def spawned_names(words: Sequence[str]) -> list[str]:
    """Return the names of the controllers that a spawner with these command-line arguments activates."""
    words = _split(words)
    return [] if _NOT_ACTIVE & set(words) else _controllers_in(words)


def option_values(words: Sequence[str], options: Collection[str]) -> list[str]:
    """Return the values of the options of these names in a command line, as in `-p FILE` or `--param-file=FILE`."""
    values = [value for option, value in pairwise(words) if option in options]
    return values + [word.partition("=")[2] for word in words if word.partition("=")[0] in options and "=" in word]


def _split(words: Iterable[str]) -> list[str]:
    """Return the words of a command line, of which a text may contain several; the value of an option is one word."""
    parts = list[str]()
    for word in words:
        several = " " in word and "$(" not in word and not (parts and parts[-1] in SPAWNER_VALUES)
        parts += words_of(word) if several else [word]
    return parts


def _controllers_in(words: Iterable[str]) -> list[str]:
    """Return the names of the controllers in the words of a spawner's command line."""
    names = list[str]()
    remaining = iter(words)
    for word in remaining:
        if word in SPAWNER_VALUES:
            next(remaining, None)
        elif not word.startswith("-"):
            names.append(word)
    return names


def refuse_mistyped(launched: Launched, words: Mapping[str, str], description: Path) -> None:
    """Raise RobotConfigError for an unknown user argument that resembles an argument of the launch file."""
    unknown = [name for name in words if name in launched.arguments]  # not declared in the launch file
    source = description.read_text(encoding="utf-8", errors="replace") if unknown else ""
    for name in unknown:
        hint = nearest(name, launched.known)
        if "did you mean" in hint and not re.search(rf"\b{re.escape(name)}\b", source):
            raise RobotConfigError(f"no argument {name!r} of the launch file or of {description.name}{hint}")


def _add_files(launch: LaunchFile, text: str, arguments: dict[str, str], files: dict[str, Path]) -> None:
    """Store the files and the xacro arguments that a command or a file name contains."""
    words = words_of(text)
    pairs = [match for word in words if (match := _PAIR.fullmatch(word))]
    for word in words:
        pair = _PAIR.fullmatch(word)
        name = launch.resolved(pair[2] if pair else word)
        kind = "" if name is None else _kind(name)
        if kind and (pair is None or kind == "bus"):  # the bus may be an argument of the description
            path = launch.path.parent / str(name)
            if kind not in files or (path.is_file() and not files[kind].is_file()):
                files[kind] = path
    if any(_names_description(launch, word) for word in words):
        for pair in pairs:
            if (value := launch.resolved(pair[2])) is not None:
                arguments[f"{pair[1]}?"] = _unquoted(value)


def _unquoted(value: str) -> str:
    """Remove the quotes of a value, as launch does when it splits a substituted command like a shell."""
    try:
        return " ".join(shlex.split(value))
    except ValueError:
        return value


def _names_description(launch: LaunchFile, word: str) -> bool:
    return _kind(launch.resolved(word) or word) == "description"


def _used(launch: LaunchFile, text: str) -> set[str]:
    """Return the launch arguments that a text uses in names of robot files or in the description's xacro command."""
    words = words_of(text)
    described = any(_names_description(launch, word) for word in words)
    used = [word for word in words if _kind(launch.resolved(word) or word) or (described and _PAIR.fullmatch(word))]
    return {name for word in used for name in launch.arguments_in(word)}


def words_of(text: str) -> list[str]:
    """Split a command into words as a shell does, but keep launch substitutions whole."""
    joined, count = _EXECUTABLE.sub("xacro", text), 1
    while count:  # the innermost substitution first
        joined, count = _SUBSTITUTION.subn(lambda match: match[0].translate(_PROTECTED), joined)
    try:
        words = shlex.split(joined)
    except ValueError:
        words = joined.split()
    return [word.translate(_RESTORED) for word in words]


def _kind(word: str) -> str:
    """Return the kind of robot file that a word names (description, bus or controllers), or ""."""
    if ":=" in word:
        return ""
    name = word.rpartition("/")[2]
    if name.endswith((".urdf", ".xacro")):
        return "description"
    if name.endswith((".yaml", ".yml")):
        return "bus" if name.startswith("bus") else "controllers" if "controller" in name else ""
    return ""


def _as_installed(package: Path, name: re.Match[str]) -> str:
    """Return the source path of a file that CMake installs elsewhere in the package; other paths are unchanged."""
    path = Path(name[0])
    return str(installed_file(package, path.relative_to(package))) if path.is_relative_to(package) else name[0]


def _read_xml(root: Element, path: Path) -> LaunchFile:
    arguments, texts = dict[str, str | None](), list[LaunchText]()
    nodes, includes = list[LaunchNode](), list[LaunchInclude]()
    for element, parent in _all(root):
        attributes = element.attributes
        if element.tag in ("arg", "let") and parent.tag != "include":
            arguments[attributes.get("name", "")] = attributes.get("value", attributes.get("default"))
        elif element.tag == "node":
            nodes.append(_xml_node(element))
        elif element.tag == "include":
            values = {child.attributes.get("name", ""): child.attributes.get("value", "") for child in element.children}
            condition = _xml_condition(element)
            includes.append(LaunchInclude(attributes.get("file"), values, element.place.line, condition))
        for name, value in attributes.items():
            command = _COMMAND.search(value)
            if name == "command" and "xacro" in value:
                texts.append(LaunchText(value, element.place.line))
            elif command is not None:
                texts.append(LaunchText(command[2], element.place.line))
            elif _kind(value):
                texts.append(LaunchText(value, element.place.line))
    return LaunchFile(path, arguments, tuple(texts), nodes=tuple(nodes), includes=tuple(includes))


def _xml_node(element: Element) -> LaunchNode:
    attributes, line = element.attributes, element.place.line
    return LaunchNode(
        attributes.get("pkg", ""),
        attributes.get("exec") or attributes.get("type", ""),
        attributes.get("name", ""),
        attributes.get("namespace") or attributes.get("ns", ""),
        tuple(LaunchText(word, line) for word in words_of(attributes.get("args", ""))),
        line,
        parameters=tuple(_xml_parameters(element)),
        condition=_xml_condition(element),
    )


def _xml_parameters(element: Element, above: str = "") -> Iterator[LaunchText]:
    """Yield the parameters of a node: files (`from`), values, and nested parameters with dotted names."""
    for child in element.children:
        if child.tag != "param":
            continue
        name, line = child.attributes.get("name", ""), child.place.line
        if file := child.attributes.get("from", ""):
            yield LaunchText(file, line)
        elif name and "value" in child.attributes:
            yield LaunchText(child.attributes["value"], line, f"{above}{name}")
        elif name:
            yield from _xml_parameters(child, f"{above}{name}.")


def _xml_condition(element: Element) -> LaunchCondition | None:
    for name in ("if", "unless"):
        if name in element.attributes:
            return LaunchCondition(element.attributes[name], negated=name == "unless")
    return None


def _all(element: Element) -> Iterator[tuple[Element, Element]]:
    """Yield all descendants of an element, with their parents."""
    for child in element.children:
        yield child, element
        yield from _all(child)


# Launch files in YAML are converted to the elements of the equivalent XML file (launch_yaml of ROS 2).
#
# An entity is a mapping with one key, the tag. Scalars are attributes; a list of mappings becomes one child for each
# mapping, with the key as the tag. The entities of a `group` are in a list, or below `children`.


def read_yaml_launch(source: str, path: str) -> Element:
    """Parse a YAML launch file and return the root element `launch`; RobotConfigError lists all errors."""
    document = read(source, path, error=RobotConfigError, strict=False)
    document.problems.raise_if_any(RobotConfigError)
    launch = document.get("launch")
    if launch is None or launch.kind != "sequence":
        raise RobotConfigError(f"{path}: not a launch file, since the key `launch` has no list")
    return _with_entities(Element("launch", {}, _element_place(launch)), launch)


def _element_place(node: Node) -> ElementPlace:
    return ElementPlace(node.line, node.column)


def _with_entities(parent: Element, entities: Node) -> Element:
    for entity in entities.elements():
        parent.children += [_element(tag, content) for tag, content in entity.items()]
    return parent


def _element(tag: str, content: Node) -> Element:
    """Return the XML element for a launch entity or for a child such as `param`."""
    element = Element(tag, {}, _element_place(content))
    if content.kind == "sequence":  # a group
        return _with_entities(element, content)
    for key, value in content.items():
        if key == "children":
            _with_entities(element, value)
        elif value.kind == "sequence":
            element.children += [_element(key, child) for child in value.elements()]
        elif value.kind == "mapping":
            element.children.append(_element(key, value))
        else:
            element.attributes[key] = value.text
    return element
