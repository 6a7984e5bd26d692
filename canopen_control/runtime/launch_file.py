"""What a ROS launch file says without being run: its arguments, nodes, files, plugins, and what it gives to xacro.

Texts are as launch files write them: `$(var NAME)` is an argument, `$(find PACKAGE)` the folder of a package. A name
that the file computes is not known here, and told as such.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError, nearest
from canopen_control.runtime.launch_python import LaunchText, read_python
from canopen_control.urdf.document import read_document
from canopen_control.urdf.package_search import package_folders

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from canopen_control.urdf.document import Element

__all__ = ["LaunchFile", "Launched", "launched_robot", "read_launch", "refuse_mistyped", "words_of"]

_VARIABLE: Final = re.compile(r"\$\((?:var|arg) +([\w.-]+)\)")
_PACKAGE: Final = re.compile(r"\$\((?:find|find-pkg-share) +([\w.-]+)\)")
_EXECUTABLE: Final = re.compile(r"\$\((?:find-exec|find) +xacro\)(?:/xacro)?")
_COMMAND: Final = re.compile(r"\$\(command +(['\"])(.*?)\1")
_PAIR: Final = re.compile(r"([A-Za-z_]\w*):=(.*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class LaunchFile:
    """A launch file: `arguments` with their defaults (None: must be given), `texts` are its files and commands.

    `computed` are lines, and what they compute.
    """

    path: Path
    arguments: dict[str, str | None]
    texts: tuple[LaunchText, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)
    computed: tuple[tuple[int, str], ...] = ()

    def resolved(self, text: str) -> str | None:
        """Return a text with arguments and packages put in, None where one of them is not known."""
        for _ in range(5):  # a default may name another argument
            text = _VARIABLE.sub(self._value, text)
        while (found := _PACKAGE.search(text)) is not None:
            folder = next(package_folders(found[1], self.path), None)
            if folder is None:
                return None
            text = text.replace(found[0], str(folder))
        return None if "$(" in text else text

    def arguments_in(self, text: str) -> set[str]:
        """Return the arguments that a text is made of, those in the defaults of others included."""
        found, new = set[str](), set(_VARIABLE.findall(text))
        while new:
            found |= new
            values = [self.given.get(name) or self.arguments.get(name) or "" for name in new]
            new = {name for value in values for name in _VARIABLE.findall(value)} - found
        return found

    def absent_packages(self, text: str) -> list[str]:
        """Return the packages in a text that are nowhere to be found."""
        return [name for name in _PACKAGE.findall(text) if next(package_folders(name, self.path), None) is None]

    def _value(self, found: re.Match[str]) -> str:
        value = self.given.get(found[1], self.arguments.get(found[1]))
        return found[0] if value is None else value


def read_launch(path: Path) -> LaunchFile:
    """Read a launch file in XML or Python; RobotConfigError for one that is neither, or that cannot be read."""
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise RobotConfigError(f"{path}: cannot be read: {reason}") from error
    if path.suffix == ".py":
        found = read_python(source, str(path))
        return LaunchFile(path, found.arguments, found.texts, computed=tuple(found.computed))
    return _read_xml(read_document(source, str(path)).root, path)


@dataclass(frozen=True, slots=True)
class Launched:
    """What a launch file gives a robot: xacro's arguments, and its files by `bus`, `controllers`, `description`.

    `doubts` is why there may be less than the file means; `known` are its own arguments, `idle` those NAME:=VALUE of
    the user that are in no text which is read.
    """

    arguments: dict[str, str]
    files: dict[str, Path]
    doubts: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()


def launched_robot(path: Path, words: Mapping[str, str], obeyed: Collection[str] = ()) -> Launched:
    """Return xacro's arguments and the files that a launch file gives.

    `words` are NAME:=VALUE of the user: for the launch file where it has such an argument, else for xacro. Those that
    are `obeyed` by others need not be known to either.
    """
    launch = read_launch(path)
    own = {name: value for name, value in words.items() if name in launch.arguments}
    rest = {f"{name}?" if name in obeyed else name: value for name, value in words.items() if name not in own}
    launch = replace(launch, given=own)
    arguments, files = dict[str, str](), dict[str, Path]()
    for each in launch.texts:
        if each.text is not None:
            _take(launch, each.text, arguments, files)
    named = [word for each in launch.texts if each.text for word in words_of(each.text) if _kind(word)]
    absent = [package for word in named for package in launch.absent_packages(word)]
    told = [(line, what) for line, what in launch.computed if "command" in what or "file" in what]
    doubts = [f"{path}:{line}: {what} is computed, which only running it would tell" for line, what in told]
    doubts += [
        f"{path}: package {name!r} is nowhere to be found; source its workspace, or add the folder that holds it to "
        "ROS_PACKAGE_PATH"
        for name in dict.fromkeys(absent)
    ]
    if not files and not doubts:
        doubts.append(f"{path}: no file of a robot is named in it")
    used = {name for each in launch.texts if each.text for name in _used(launch, each.text)}
    idle = tuple(f"{name}:={value}" for name, value in own.items() if name not in used and name not in obeyed)
    return Launched(arguments | rest, files, tuple(doubts), tuple(launch.arguments), idle)


def refuse_mistyped(launched: Launched, words: Mapping[str, str], description: Path) -> None:
    """Raise RobotConfigError for a word that is near an argument of the launch file, and that nothing else knows."""
    strange = [name for name in words if name in launched.arguments]  # those of the launch file itself are used up
    source = description.read_text(encoding="utf-8", errors="replace") if strange else ""
    for name in strange:
        hint = nearest(name, launched.known)
        if "did you mean" in hint and not re.search(rf"\b{re.escape(name)}\b", source):
            raise RobotConfigError(f"no argument {name!r} of the launch file or of {description.name}{hint}")


def _take(launch: LaunchFile, text: str, arguments: dict[str, str], files: dict[str, Path]) -> None:
    """Take what a command of xacro, or the name of a file, says."""
    words = words_of(text)
    pairs = [found for word in words if (found := _PAIR.fullmatch(word))]
    for word in words:
        kind = _kind(word)
        if kind and (name := launch.resolved(word)) is not None:
            files.setdefault(kind, launch.path.parent / name)
    if any(_kind(word) == "description" for word in words):
        for pair in pairs:
            if (value := launch.resolved(pair[2])) is not None:
                arguments[f"{pair[1]}?"] = value


def _used(launch: LaunchFile, text: str) -> set[str]:
    """Return the arguments in what is taken of a text: the names of files, and what a description is given."""
    words = words_of(text)
    described = any(_kind(word) == "description" for word in words)
    taken = [word for word in words if _kind(word) or (described and _PAIR.fullmatch(word))]
    return {name for word in taken for name in launch.arguments_in(word)}


def words_of(text: str) -> list[str]:
    """Split a command as a shell does, its substitutions whole."""
    whole = _EXECUTABLE.sub("xacro", text)
    held = re.sub(r"\$\([^()]*\)", lambda found: found[0].replace(" ", "\0"), whole)
    try:
        words = shlex.split(held)
    except ValueError:
        words = held.split()
    return [word.replace("\0", " ") for word in words]


def _kind(word: str) -> str:
    """Return which file of a robot a word names, "" for none."""
    if ":=" in word:
        return ""
    name = word.rpartition("/")[2]
    if name.endswith((".urdf", ".xacro")):
        return "description"
    if name.endswith((".yaml", ".yml")):
        return "bus" if name.startswith("bus") else "controllers" if "controller" in name else ""
    return ""


def _read_xml(root: Element, path: Path) -> LaunchFile:
    arguments, texts = dict[str, str | None](), list[LaunchText]()
    for element in _all(root):
        attributes = element.attributes
        if element.tag == "arg":
            arguments[attributes.get("name", "")] = attributes.get("value", attributes.get("default"))
        for name, value in attributes.items():
            command = _COMMAND.search(value)
            if name == "command" and "xacro" in value:
                texts.append(LaunchText(value, element.place.line))
            elif command is not None:
                texts.append(LaunchText(command[2], element.place.line))
            elif _kind(value):
                texts.append(LaunchText(value, element.place.line))
    return LaunchFile(path, arguments, tuple(texts))


def _all(element: Element) -> Iterator[Element]:
    for child in element.children:
        yield child
        yield from _all(child)
