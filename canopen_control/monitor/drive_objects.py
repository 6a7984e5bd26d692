"""Objects of the drive that the monitor shows, with search and edits, and the commands that the monitor starts.

Drawing never blocks. The EDS is read on a thread; objects are read while they are visible, by the reader shared by all
screens of the process, at the rate of the command `objects`. `write` and `undo` block; call them on a thread.
"""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import threading
from collections import deque
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_control.commissioning.jobs import JOBS
from canopen_control.commissioning.live_reader import LiveReader, NodeObjects
from canopen_control.commissioning.object_rows import LiveObject, rows_of, select_objects
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.environment import clean_environment
from canopen_control.monitor.monitor_content import Cell, Tone, plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.commissioning.object_rows import ObjectRow
    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.rpc.messages.robot import NodePlace


# Actions on the drive selected in the monitor are commands of the command line, whose arguments the user edits.
#
# A command runs in a separate process, as if the user had typed it: it sends requests to the running robot, obeys STOP,
# is the source named in events, and does not block the monitor. If the monitor ends, also by a crash, the command gets
# a SIGINT, at which it stops an axis that it moves.


_KEPT_LINES: Final = 1000
_PR_SET_PDEATHSIG: Final = 1
_GRACE_S: Final = 3.0  # for the end of a command after SIGINT: it ramps down and disables the drive


Words: TypeAlias = "Callable[[str, Sequence[str]], list[str]]"
"""Function that returns the arguments of a command for a node and the parts of the input line."""


def _jog(node: str, parts: Sequence[str]) -> list[str]:
    option = "--velocity" if parts[0].endswith(("rpm", "rad/s", "pps")) else "--position"
    duration = [f"--for={parts[1].removesuffix('s')}"] if len(parts) > 1 and not parts[1].startswith("-") else []
    return ["jog", node, f"{option}={parts[0]}", *duration, *parts[1 + len(duration) :]]


def _tune(node: str, parts: Sequence[str]) -> list[str]:
    return ["tune", node, f"--{parts[0].lstrip('-')}", *parts[1:]]


def _scope(node: str, parts: Sequence[str]) -> list[str]:
    signals = [part if ":" in part else f"{node}:{part}" for part in parts if not part.startswith("-")]
    return ["scope", *signals, *(part for part in parts if part.startswith("-"))]


def _on_node(verb: str) -> Words:
    return lambda node, parts: [verb, node, *parts]


def _with_node(verb: str) -> Words:
    """Return a function that puts the node after the first part of the input."""
    return lambda node, parts: [verb, parts[0], node, *parts[1:]]


_WORDS: Final[dict[str, Words]] = {
    "jog": _jog,
    "scope": _scope,
    "tune": _tune,
    "backup": lambda node, parts: ["backup", node, "-o", *parts],
    "diff": _with_node("diff"),
    "restore": _with_node("restore"),
    "clone": _with_node("clone"),
    "firmware": _on_node("firmware"),
    "dump": lambda node, parts: ["dump", node, "--format", *parts],
    "nmt": _with_node("nmt"),
}
"""Arguments of the commands by job name."""


def work_words(name: str, text: str, node: str, robot: str) -> list[str]:
    """Return the command line arguments of a job; raise ConfigError without input or without a selected drive."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not node:
        raise ConfigError(f"{name}: no drive is selected")
    if not parts:
        raise ConfigError(f"{name}: enter {JOBS[name].asks}")
    return [*_WORDS[name](node, parts), f"--name={robot}"]


class WorkRun:
    """Process of a command; `title` is the command line, `code` the exit code (None while it runs).

    Raise CanopenError if the process cannot be started.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self.title = " ".join(["canopen-control", *words])
        self._lines: deque[str] = deque(maxlen=_KEPT_LINES)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "canopen_control", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                env=clean_environment(ros=False),
                start_new_session=True,  # Ctrl-C must reach the monitor only
                preexec_fn=_interrupt_with_thread(),
            )
        except OSError as error:
            raise CanopenError(f"{words[0]} cannot be started: {error.strerror}") from error
        threading.Thread(target=self._read, name=words[0], daemon=True).start()

    @property
    def code(self) -> int | None:
        return self._process.poll()

    def fresh(self) -> list[str]:
        """Return the output lines since the last call."""
        lines = []
        while self._lines:
            lines.append(self._lines.popleft())
        return lines

    def end(self) -> None:
        """Interrupt the command as Ctrl-C does; no effect once the command has ended."""
        if self.code is None:
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Interrupt the command and wait until it has stopped the drive; kill it if it still runs after `_GRACE_S`."""
        self.end()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def _read(self) -> None:
        output = self._process.stdout
        if output is not None:
            with output:
                self._lines.extend(line.rstrip() for line in output)


def _interrupt_with_thread() -> Callable[[], object] | None:
    """Return a preexec function that makes Linux send SIGINT to the child when this thread ends, or None."""
    if not sys.platform.startswith("linux"):
        return None
    prctl = ctypes.CDLL(None).prctl
    return lambda: prctl(_PR_SET_PDEATHSIG, int(signal.SIGINT))


OBJECT_COLUMNS: Final = ("address", "name", "value", "unit", "meaning", "default", "type", "access")
_SCREEN: Final = "monitor"
_WIDEST: Final = 40


class DriveObjects:
    """Objects of the selected node; `title` names the node, and the reason if its objects cannot be read."""

    def __init__(self, source: str) -> None:
        self._source, self._reader = source, LiveReader()
        self._nodes: dict[tuple[str, str], NodeObjects] = {}
        self._node: NodeObjects | None = None
        self._od: ObjectDictionary | None = None
        self._why = "no drive is selected"
        self._words = ""
        self._entries: dict[str, Entry] = {}
        self._cells: dict[str, tuple[Cell, ...]] = {}
        self._sent = 0

    def choose(self, robot: str, place: NodePlace | None) -> None:
        """Select the node at `place`; None selects no node."""
        if place is None:
            self.leave()
            self._node, self._why = None, "no drive is selected"
            return
        node = self._nodes.setdefault((robot, place.name), NodeObjects(robot, place, self._source))
        if node is not self._node:
            self.leave()
            self._node, self._od, self._why = node, None, "reading the EDS"
            self._entries, self._cells, self._sent = {}, {}, 0
            threading.Thread(target=self._read_eds, args=(node,), name="eds", daemon=True).start()

    def _read_eds(self, node: NodeObjects) -> None:
        try:
            od, why = node.dictionary(), ""
        except CanopenError as error:
            od, why = None, str(error)
        if node is self._node:
            self._why = why or ("" if od is not None else "the node has no EDS in bus.yml")
            self._od = od

    def search(self, words: str) -> None:
        """Show the objects that match `words`, like the command `objects`; raise ConfigError if one matches none."""
        if self._od is not None and words:
            select_objects(self._od, words.split(","))
        self._words, self._entries, self._cells, self._sent = words, {}, {}, 0

    def write(self, text: str) -> str:
        """Write an object, as in 0x6081=1000, and return the change as text; raise CanopenError on failure. Blocks."""
        node, od = self._node, self._od
        address, equals, value = text.partition("=")
        if node is None or od is None:
            raise ConfigError(f"set: {self._why}")
        if not (equals and address.strip() and value.strip()):
            raise ConfigError(f"set {text}: write an object and its value, as in 0x6081=1000")
        entry, *further = select_objects(od, [address.strip()])
        if further:
            raise ConfigError(
                f"set {text}: {address} matches {1 + len(further)} objects; give one, as {_address(entry.address)}"
            )
        with node.editing, node.session() as session:
            return node.history.write(session, entry, value).words

    def undo(self) -> str:
        """Undo the latest write at this node and return the change as text.

        Raise CanopenError if this is impossible. Blocks.
        """
        if (node := self._node) is None:
            raise ConfigError(f"undo: {self._why}")
        with node.editing, node.session() as session:
            return node.history.undo(session).words

    @property
    def title(self) -> str:
        """Name of the node, with the search, and the reason if its objects cannot be read."""
        if self._node is None:
            return self._why
        place = self._node.place
        notes = [self._why, self._node.lost, f"search: {self._words}" if self._words else ""]
        return "  ·  ".join([f"{place.name}, node {place.node_id}", *filter(None, notes)])

    def rows(self) -> Mapping[str, tuple[Cell, ...]]:
        """Return the table rows by object address, with the values read so far."""
        node, od = self._node, self._od
        if node is None or od is None:
            return {}
        if not self._cells:
            self._list(od, node.place.node_id)
        values = [value for value in list(node.live.values()) if value[0] > self._sent]
        if values:
            self._sent = max(number for number, _ in values)
            self._show(od, node.place.node_id, [live for _, live in values])
        return self._cells

    def watch(self, addresses: Iterable[str]) -> None:
        """Read only the objects at these addresses from now on."""
        if self._node is not None:
            entries = [self._entries[address] for address in addresses if address in self._entries]
            self._reader.watch(_SCREEN, self._node, entries)

    def leave(self) -> None:
        """Stop reading objects."""
        if self._node is not None:
            self._reader.watch(_SCREEN, self._node, ())

    def _list(self, od: ObjectDictionary, node_id: int) -> None:
        try:
            entries = select_objects(od, self._words.split(",") if self._words else ())
        except ConfigError as error:
            self._why, entries = str(error), []
        self._entries = {_address(entry.address): entry for entry in entries}
        self._show(od, node_id, [LiveObject(entry) for entry in entries])

    def _show(self, od: ObjectDictionary, node_id: int, objects: list[LiveObject]) -> None:
        shown = [entry for entry in objects if _address(entry.entry.address) in self._entries]
        for item, row in zip(shown, rows_of(od, shown, node_id), strict=True):
            self._cells[_address(item.entry.address)] = _cells(row)


def _address(address: Address) -> str:
    return f"0x{address[0]:04X}:{address[1]:02X}"


def _cells(row: ObjectRow) -> tuple[Cell, ...]:
    """Return the cells of an object; values that differ from the default, and refused objects, are marked."""
    value = Cell(_cut(row.value or "-"), Tone.WARN if row.changed else Tone.PLAIN)
    if row.error:
        value = Cell("refused", Tone.BAD)
    texts = (row.unit if row.value else "", _cut(row.meaning or row.error or ""), _cut(row.default or "-"))
    return (
        plain(f"{row.index}:{row.subindex:02X}"),
        plain(_cut(row.name)),
        value,
        *map(plain, (*texts, row.type, row.access)),
    )


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
