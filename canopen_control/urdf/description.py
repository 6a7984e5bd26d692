"""Reader of robot descriptions from URDF or xacro files: links, joints, and the hardware that moves the joints.

Xacro itself is used, but only for files that need it. All errors are reported at once, with file and line (for a xacro
file the probable line, because its result has no line numbers). A description that ros2_control refuses is refused here
too, so that a description accepted here is accepted there. Without a <ros2_control> tag, ROS 1's <transmission> tags
assign drives to joints.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.data_files import read_utf8
from canopen_control.errors import RobotConfigError
from canopen_control.host.fork import can_fork, fork
from canopen_control.urdf import xacro_child
from canopen_control.urdf.document import read_document
from canopen_control.urdf.robot_model import RobotModel, model_of
from canopen_control.urdf.ros2_control import (
    Ros2ControlSystem,
    check_owners,
    check_ranges,
    read_system,
    read_transmissions,
    system_of_ros1,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import TracebackType
    from typing import TypeAlias

    from canopen_control.host.fork import ForkedProcess
    from canopen_control.urdf.document import Element
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.robot_model import UrdfLink

    _Process: TypeAlias = ForkedProcess | subprocess.Popen[bytes]


# Xacro runs in a separate process: an expression may be endless or need too much memory by mistake, and the kernel ends
# the process at its limits of time and memory. It is a fork where that is possible, else an interpreter that does not
# import this package. It starts early (`XacroRun`), so that other files can be read meanwhile.


_HINT: Final = "look for an endless power, range or macro"


@dataclass(frozen=True, slots=True)
class XacroLimits:
    """Limits of one xacro process: processor time and elapsed time in s, memory in bytes."""

    processor_s: int = 10
    wall_s: int = 30
    memory: int = 1 << 30


class XacroRun:
    """Xacro process for the file `path`, which starts at once and is ended by `close`.

    `mappings` are the xacro arguments. An argument that the file does not use is refused, unless its name ends in `?`.
    """

    def __init__(self, path: Path, mappings: Mapping[str, str], limits: XacroLimits | None = None) -> None:
        self._path, self._limits = path, limits or XacroLimits()
        lifeline, self._lifeline = os.pipe()  # closed when this process ends, in whatever way
        self._answer, answer = os.pipe()
        try:
            self._process = self._start(lifeline, answer, mappings)
        except (OSError, ValueError) as error:
            os.close(self._lifeline)
            os.close(self._answer)
            reason = error.strerror if isinstance(error, OSError) else error
            raise RobotConfigError(f"{path}: xacro cannot be started: {reason}") from error
        finally:
            os.close(lifeline)
            os.close(answer)

    def _start(
        self, lifeline: int, answer: int, mappings: Mapping[str, str]
    ) -> ForkedProcess | subprocess.Popen[bytes]:
        numbers = (self._limits.processor_s, self._limits.wall_s, self._limits.memory)
        settings = [os.fspath(self._path), *map(str, numbers), *(f"{key}:={mappings[key]}" for key in mappings)]
        if can_fork():  # a third of the processor time: most of what xacro imports is imported already
            main = ("canopen_control.urdf.xacro_child", [str(lifeline), "", *settings])
            title = ["xacro", os.fspath(self._path)]
            return fork(main, title, os.environ, output=answer, keep=(lifeline,))
        # Isolated and without site it starts in a third of the time; it imports modules from our paths.
        folders = "\n".join(folder for folder in sys.path if os.path.isabs(folder))
        command = [sys.executable, "-I", "-S", xacro_child.__file__, "0", folders, *settings]
        return subprocess.Popen(command, stdin=lifeline, stdout=answer, stderr=subprocess.DEVNULL)

    def __enter__(self) -> XacroRun:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Kill the process if it is still running."""
        if self._lifeline < 0:
            return
        os.close(self._lifeline)
        self._lifeline = -1
        if self._process.poll() is None:
            os.kill(self._process.pid, signal.SIGKILL)
            self._process.wait()
        os.close(self._answer)

    def result(self) -> str:
        """Wait for the end of the process and return the URDF text; raise RobotConfigError if xacro failed."""
        answer = self._read()
        if answer[:1] == xacro_child.URDF:
            return answer[1:].decode("utf-8")
        reason = answer[1:].decode("utf-8", "replace")
        raise RobotConfigError(f"{self._path}: xacro: {reason}" if reason else self._ended(self._process.wait() or 0))

    def _read(self) -> bytes:
        """Return the whole output of the process, which the kernel ends when it reaches a limit."""
        answer = bytearray()
        while part := os.read(self._answer, 1 << 20):
            answer += part
        return bytes(answer)

    def _ended(self, code: int) -> str:
        """Return the error text for a process that ended with exit code `code` and without a result."""
        if code in (-signal.SIGXCPU, -signal.SIGKILL):  # the kernel sends the second if both limits are equal
            return f"{self._path}: xacro took more than {self._limits.processor_s} s of processor time; {_HINT}"
        if code == -signal.SIGALRM:
            return f"{self._path}: xacro took more than {self._limits.wall_s} s; {_HINT}"
        return f"{self._path}: xacro ended without an answer (exit code {code}), possibly for lack of memory; {_HINT}"


@dataclass(frozen=True)
class GazeboPlugin:
    """Tag `<plugin>` in a `<gazebo>` tag."""

    name: str
    filename: str
    line: int = 0


@dataclass(frozen=True)
class UrdfDescription:
    """Robot description: its URDF text (the output of xacro), links, joints and hardware components.

    `ros1` is True if the hardware was derived from ROS 1's <transmission> tags, because there is no <ros2_control> tag.
    """

    path: str
    urdf_xml: str
    model: RobotModel
    hardware: tuple[Ros2ControlSystem, ...] = ()
    gazebo: tuple[GazeboPlugin, ...] = ()
    ros1: bool = False
    notes: tuple[str, ...] = ()

    @property
    def links(self) -> Mapping[str, UrdfLink]:
        return self.model.links

    @property
    def joints(self) -> Mapping[str, Joint]:
        return self.model.joints

    @property
    def movable_joints(self) -> tuple[str, ...]:
        """Names of the joints that are not fixed, in the order of the file."""
        return tuple(joint.name for joint in self.joints.values() if not joint.fixed)


def read_description(path: str | os.PathLike[str], *, mappings: Mapping[str, str] | None = None) -> UrdfDescription:
    """Read a .urdf or .xacro file; raise RobotConfigError with all errors in it.

    `mappings` are the xacro arguments; the file need not use an argument whose name ends in `?`.
    """
    with DescriptionReader(path, mappings=mappings) as reader:
        return reader.result()


class DescriptionReader:
    """Reader of a .urdf or .xacro file; creating it starts xacro in a separate process if the file needs xacro.

    The end of the `with` block ends the process. The constructor and `result` raise RobotConfigError.
    """

    def __init__(self, path: str | os.PathLike[str], *, mappings: Mapping[str, str] | None = None) -> None:
        self._path, file = str(path), Path(path)
        try:
            self._source = read_utf8(file)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise RobotConfigError(f"{path}: cannot be read: {reason}") from error
        is_xacro = file.suffix == ".xacro" or "xmlns:xacro" in self._source
        required = [name for name in mappings or () if not name.endswith("?")]
        if required and not is_xacro:
            raise RobotConfigError(f"{path}: it is not a xacro, so it has no arguments; omit {required[0]}:=")
        self._xacro = XacroRun(file, mappings or {}) if is_xacro else None

    def __enter__(self) -> DescriptionReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self._xacro is not None:
            self._xacro.close()

    def result(self) -> UrdfDescription:
        """Return the description; raise RobotConfigError with all errors in it."""
        if self._xacro is None:
            return parse_description(self._source, self._path)
        return parse_description(self._xacro.result(), self._path, source=self._source)


def parse_description(urdf: str, path: str = "<urdf>", *, source: str | None = None) -> UrdfDescription:
    """Parse a URDF text; raise RobotConfigError with all errors in it.

    `source` is the xacro text from which the URDF was generated; it is used to find line numbers.
    """
    document = read_document(urdf, path, source)
    model = model_of(document)
    tags = [child for child in document.root.children if child.tag == "ros2_control"]
    old = [child for child in document.root.children if child.tag == "transmission"]
    gazebo = _gazebo_plugins(document.root)
    hardware = tuple(read_system(document, child, model.joints) for child in tags)
    if not tags and old:
        transmissions = read_transmissions(document, old, model.joints)
        simulated = any(child.filename.endswith("gazebo_ros_control.so") for child in gazebo)
        hardware = (system_of_ros1(model.name, transmissions, simulated=simulated),)
    check_owners(document, hardware)
    check_ranges(document, hardware, model.joints)
    document.raise_if_any()
    notes = (*document.notes, *_notes(path, hardware, old if tags else ()))
    return UrdfDescription(path, urdf, model, hardware, gazebo, bool(old and not tags), notes)


def _gazebo_plugins(root: Element) -> tuple[GazeboPlugin, ...]:
    return tuple(
        GazeboPlugin(plugin.attributes.get("name", ""), plugin.attributes.get("filename", ""), plugin.place.line)
        for gazebo in root.children
        if gazebo.tag == "gazebo"
        for plugin in gazebo.children
        if plugin.tag == "plugin"
    )


def _notes(path: str, hardware: Sequence[Ros2ControlSystem], ignored: Sequence[Element]) -> Iterator[str]:
    for element in ignored:
        name, line = element.attributes.get("name", ""), element.place.line
        yield f"{path}:{line}: <transmission> {name} is from ROS 1 and has no effect next to a <ros2_control> tag"
    for part in (
        transmission for system in hardware for transmission in system.transmissions if not transmission.trivial
    ):
        drive, offset = (
            part.actuator or "its drive",
            f", offset {part.offset:g}" if part.offset else "",
        )
        yield (
            f"{path}:{part.place.line}: {part.joint} turns once for {part.reduction:g} turns of {drive}{offset}; "
            "the scales of bus.yml apply to the motor shaft"
        )
