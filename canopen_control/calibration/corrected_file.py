"""Copy of a ros2_controllers.yaml with other values for parameters of one controller.

Only the texts of the values are replaced, so that comments and layout remain; missing parameters are inserted before
the wheel parameters. The copy is read back and compared; it is deleted if it differs in anything but the changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.errors import ConfigError, nearest
from canopen_control.host.files import write_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.yamlfile.node import Node


_ANCHORS: Final = ("wheel_separation", "wheel_radius", "left_wheel_names", "right_wheel_names")


@dataclass(frozen=True, slots=True)
class Change:
    """Parameter that was changed in the copy, with its line; `before` is None if it was added."""

    name: str
    before: float | None
    after: float
    line: int

    def __str__(self) -> str:
        before = "not given" if self.before is None else f"{self.before:.9g}"
        return f"line {self.line}: {self.name}: {before} -> {self.after:.9g}"


@dataclass(frozen=True, slots=True)
class _Edit:
    """Replacement of `length` characters at a position in the file; line and column count from 0."""

    line: int
    column: int
    length: int
    text: str


def given_in(path: Path, controller: str, names: Sequence[str]) -> dict[str, float | None]:
    """Return the values of the parameters `names` of a controller in a file, by name (None: missing).

    Raise ConfigError if the controller is missing, or if a value is not a number.
    """
    flat = _flat(read_controllers(path), controller)
    return {name: _number(flat, name) for name in names}


def write_corrected(path: Path, copy: Path, controller: str, values: Mapping[str, float]) -> list[Change]:
    """Write a copy with other parameter values, and return the changes.

    Raise ConfigError, or DiskFull, without leaving a copy, if that is not possible.
    """
    if copy.exists() and copy.samefile(path):
        raise ConfigError(
            f"{copy} is the robot's own file; the values are written to a copy; give another name with --output"
        )
    file = read_controllers(path)
    flat = _flat(file, controller)
    before = {name: _number(flat, name) for name in values}
    with path.open(encoding="utf-8", newline="") as opened:
        lines = opened.read().splitlines(keepends=True)
    text = "".join(_applied(lines, [_edit(path, lines, flat, name, value) for name, value in values.items()]))
    try:
        write_whole(copy, text.encode())
    except ConfigError as error:
        raise ConfigError(f"{error}; give another name with --output") from error
    _check(file, copy, controller, values)
    written = _flat(read_controllers(copy), controller).keys()
    return [Change(name, before[name], value, written[name].line) for name, value in values.items()]


def _flat(file: ControllersFile, controller: str) -> Node:
    config = file.controllers.get(controller)
    if config is None:
        raise ConfigError(f"{file.path} has no controller {controller!r}{nearest(controller, file.controllers)}")
    return config.params.flat


def _number(flat: Node, name: str) -> float | None:
    node = flat.get(name)
    if node is None:
        return None
    if isinstance(node.value, bool) or not isinstance(node.value, int | float):
        raise ConfigError(f"{node.path}:{node.line}:{node.column}: {name} is not a number")
    return float(node.value)


def _edit(path: Path, lines: Sequence[str], flat: Node, name: str, value: float) -> _Edit:
    """Return the edit that sets a parameter: a replacement, or an insertion before another key of the same block."""
    node = flat.get(name)
    if node is not None:
        _require_same(path, node, name)
        return _Edit(node.line - 1, node.column - 1, len(node.text), f"{value:.9g}")
    anchor = next((key for anchor_key in _ANCHORS if (key := flat.keys().get(anchor_key)) is not None), None)
    if anchor is None:
        raise ConfigError(f"{path}: no wheel parameters were found; write {name}: {value:.9g} by hand")
    _require_same(path, anchor, name)
    indent = lines[anchor.line - 1][: anchor.column - 1]
    if indent.strip():  # flow style
        return _Edit(anchor.line - 1, anchor.column - 1, 0, f"{name}: {value:.9g}, ")
    end = "\r\n" if lines[anchor.line - 1].endswith("\r\n") else "\n"
    return _Edit(anchor.line - 1, 0, 0, f"{indent}{name}: {value:.9g}{end}")


def _require_same(path: Path, node: Node, name: str) -> None:
    if Path(node.path) != path:
        raise ConfigError(f"{name} is set in {node.path}:{node.line}, a params_file of {path}; edit that file by hand")


def _applied(lines: Sequence[str], edits: Sequence[_Edit]) -> list[str]:
    """Return the lines of the file after all edits, which are applied from the last to the first."""
    changed = list(lines)
    for later in sorted(edits, key=lambda edit: (edit.line, edit.column))[::-1]:
        old = changed[later.line]
        changed[later.line] = old[: later.column] + later.text + old[later.column + later.length :]
    return changed


def _check(file: ControllersFile, copy: Path, controller: str, values: Mapping[str, float]) -> None:
    """Delete the copy and raise ConfigError if anything but `values` differs between file and copy."""
    expected = _values(file)
    expected[controller] |= {name: float(f"{value:.9g}") for name, value in values.items()}
    try:
        actual = _values(read_controllers(copy))
    except ConfigError as error:
        copy.unlink()
        raise ConfigError(f"the copy could not be read and was deleted: {error}") from error
    if actual != expected:
        copy.unlink()
        text = ", ".join(f"{name}: {value:.9g}" for name, value in values.items())
        raise ConfigError(f"{file.path} has a layout that cannot be copied; set by hand: {text}")


def _values(file: ControllersFile) -> dict[str, dict[str, object]]:
    """Return the values of all parameters, by controller and parameter name."""
    return {
        name: {key: node.value for key, node in controller.params.flat.items()}
        for name, controller in file.controllers.items()
    }
