"""Reader that polls the objects shown on screens, node by node, at a rate that does not delay a robot.

One thread works for all screens of a process: an object on two screens is read once, and the rate is that of a single
command. The object whose last reading is the oldest is next. The thread ends when no screen shows objects.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.commissioning.node_session import dictionary_of, session_with
from canopen_control.commissioning.object_rows import READS_PER_S, EditHistory, LiveObject, is_scanned
from canopen_control.commissioning.parameter_set import read_values
from canopen_control.errors import CanopenError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.rpc.messages.robot import NodePlace


# Objects of one node of a running robot, for all screens of a process: the EDS, sessions, and the last values.


_TIMEOUT_S: Final = 2.0  # for the connection


class NodeObjects:
    """Node of a running robot with its edits and the last values of its objects.

    `source` names the writer in the robot's events; `history` contains the edits, one of which is made at a time.
    `live` contains the last readings by address, with a number that increases with every change. `lost` is the reason
    why objects cannot be read at present, else "". `connect` can be replaced in tests.
    """

    def __init__(
        self,
        robot: str,
        place: NodePlace,
        source: str,
        connect: Callable[[str, float], RobotClient] = RobotClient.connect,
    ) -> None:
        self.robot, self.place = robot, place
        self.live: dict[Address, tuple[int, LiveObject]] = {}
        self.lost = ""
        self.history = EditHistory()
        self.editing = threading.Lock()  # several edits may be requested before the node answers
        self._source, self._connect = source, connect
        self._od: ObjectDictionary | None = None
        self._has_read, self._reading = False, threading.Lock()
        self._news = 0

    def dictionary(self) -> ObjectDictionary | None:
        """Return the EDS of the node, or None without one; raise EdsError if the file cannot be read.

        Blocks at the first call.
        """
        with self._reading:
            if not self._has_read:
                self._od, self._has_read = dictionary_of(self.place), True
            return self._od

    @contextlib.contextmanager
    def session(self) -> Iterator[NodeSession]:
        """Open a session with the node on a separate connection; blocks, so call it on a separate thread."""
        od = self.dictionary()
        with (
            self._connect(self.robot, _TIMEOUT_S) as client,
            session_with(client, self.place, od, source=self._source) as session,
        ):
            yield session

    def keep(self, live: LiveObject) -> None:
        """Store the reading of an object, and count a change if the reading differs."""
        before = self.live.get(live.entry.address)
        if before is None or before[1] != live:
            self._news += 1
            self.live[live.entry.address] = self._news, live


_LATER_S: Final = 10.0  # interval for objects that the node refuses
_LOST_S: Final = 2.0  # pause after a missing answer, or without a robot
_IDLE_S: Final = 0.2  # pause while no object is due


class LiveReader:
    """Reader that polls objects on a thread while a screen shows them; `clock` and `sleep` are in s."""

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self._lock = threading.Lock()
        self._requests: dict[str, tuple[NodeObjects, tuple[Entry, ...]]] = {}
        self._thread: threading.Thread | None = None
        self._next_reads: dict[tuple[str, Address], float] = {}

    def watch(self, screen: str, node: NodeObjects, entries: Collection[Entry]) -> None:
        """Set the objects of a node that a screen shows; an empty collection ends the screen's polling."""
        with self._lock:
            scanned = tuple(entry for entry in entries if is_scanned(entry))
            if scanned:
                self._requests[screen] = node, scanned
            else:
                self._requests.pop(screen, None)
            if self._requests and self._thread is None:
                self._thread = threading.Thread(target=self.run, name="live objects", daemon=True)
                self._thread.start()

    def soon(self, node: NodeObjects, entry: Entry) -> None:
        """Make an object due for reading at once, for instance because it was written."""
        self._next_reads.pop((node.place.name, entry.address), None)

    def run(self) -> None:
        """Poll until no screen shows objects; runs on the reader's thread."""
        try:
            self._read_all()
        except BaseException:  # the next call of `watch` starts a new thread
            with self._lock:
                self._thread = None
            raise

    def _read_all(self) -> None:
        gap, next_read = 1.0 / READS_PER_S, self._clock()
        with contextlib.ExitStack() as sessions:
            opened: dict[str, NodeSession] = {}
            while (request := self._next()) is not None:
                node, entry = request
                if entry is None:
                    self._sleep(_IDLE_S)
                    continue
                if (wait := next_read - self._clock()) > 0:
                    self._sleep(wait)
                next_read = self._clock() + gap
                self._read(node, entry, opened, sessions)

    def _next(self) -> tuple[NodeObjects, Entry | None] | None:
        """Return the next node and entry to read (entry None if none is due), or None if no screen shows objects."""
        with self._lock:
            if not self._requests:
                self._thread = None
                return None
            choices = [(node, entry) for node, entries in self._requests.values() for entry in entries]
        node, entry = min(
            choices, key=lambda choice: self._next_reads.get((choice[0].place.name, choice[1].address), 0.0)
        )
        is_due = self._next_reads.get((node.place.name, entry.address), 0.0) <= self._clock()
        return node, entry if is_due else None

    def _read(
        self, node: NodeObjects, entry: Entry, opened: dict[str, NodeSession], sessions: contextlib.ExitStack
    ) -> None:
        name = node.place.name
        try:
            if name not in opened:
                opened[name] = sessions.enter_context(node.session())
            values, refused = read_values(opened[name], [entry])
        except CanopenError as error:
            opened.pop(name, None)
            node.lost = str(error)
            again = self._clock() + _LOST_S
            with self._lock:
                watched = [
                    watched_entry
                    for other_node, entries in self._requests.values()
                    if other_node is node
                    for watched_entry in entries
                ]
            self._next_reads |= {(name, entry.address): again for entry in watched}
            return
        why = refused[0].why if refused else ""
        node.lost = ""
        node.keep(LiveObject(entry, values.get(entry.address), why))
        self._next_reads[name, entry.address] = self._clock() + (_LATER_S if why else 0.0)
