"""The objects of one node of a running robot, for all screens of a process: its EDS, sessions, what was read last."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.service.robot_transfers import dictionary_of, session_with

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.object_rows import LiveObject

__all__ = ["NodeObjects"]

_TIMEOUT_S: Final = 2.0  # for the connection


class NodeObjects:
    """The node at `place` of the running robot `robot`; `source` is by whose name it writes, `connect` for tests.

    `live` is what its objects held when they were read last, each with a number that grows with every news; `lost` says
    why they cannot be read.
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
        self._source, self._connect = source, connect
        self._od: ObjectDictionary | None = None
        self._has_read, self._reading = False, threading.Lock()
        self._news = 0

    def dictionary(self) -> ObjectDictionary | None:
        """Return the EDS of the node, read once; EdsError for one that cannot be read. Waits."""
        with self._reading:
            if not self._has_read:
                self._od, self._has_read = dictionary_of(self.place), True
            return self._od

    @contextlib.contextmanager
    def session(self) -> Iterator[NodeSession]:
        """Open a session with the node on a connection of its own; waits. From a thread that may."""
        od = self.dictionary()
        with (
            self._connect(self.robot, _TIMEOUT_S) as client,
            session_with(client, self.place, od, source=self._source) as session,
        ):
            yield session

    def keep(self, live: LiveObject) -> None:
        """Keep what an object was read as, with a number that tells whether it is news."""
        before = self.live.get(live.entry.address)
        if before is None or before[1] != live:
            self._news += 1
            self.live[live.entry.address] = self._news, live
