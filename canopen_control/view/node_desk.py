"""The work at one node for all pages: questions on threads, and one long piece of work at a time. No toolkit.

Each question has a connection of its own, so that STOP and the stream of the state never wait behind it. Long work goes
on when the page that began it is closed; every page shows how far it is, and any may ask it to end.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, DriveError
from canopen_control.service.node_objects import NodeObjects
from canopen_control.service.object_edit import EditHistory
from canopen_control.view.dead_man import SOURCE
from canopen_control.view.robot_connection import in_thread

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import Entry
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.object_edit import Edit
    from canopen_control.view.scope_run import ScopeRun
    from canopen_control.view.tune_job import TuneFound

__all__ = ["NodeDesk", "NodeWork"]

T = TypeVar("T")


@dataclass(slots=True)
class NodeWork:
    """A long piece of work: how far it is, and what came of it. Written by its thread, read by the pages.

    `key` says which tab it is of, `doing` which part of it goes on. `told` is the sentence at its end, `good` whether
    it was done, None while it goes on; `lines`, `table` and `file` (name and bytes) are what came of it beside that.
    """

    key: str
    title: str
    unit: str = ""
    doing: str = ""
    done: int = 0
    total: int | None = None
    began: float = field(default_factory=time.monotonic)
    told: str = ""
    good: bool | None = None
    lines: list[str] = field(default_factory=list)
    table: list[tuple[str, ...]] = field(default_factory=list)
    file: tuple[str, bytes] | None = None
    _rated: tuple[str, float, int] = ("", 0.0, 0)
    _ending: threading.Event = field(default_factory=threading.Event)

    def at(self, done: int, total: int | None = None) -> None:
        """Tell how far it is; DriveError where somebody has asked for its end."""
        self.done, self.total = done, total
        if self._ending.is_set():
            raise DriveError("a page asked for its end")

    def pace(self, now: float) -> tuple[float, float] | None:
        """Return how much is over in a second and how many seconds are left; None while nobody knows."""
        part, since, before = self._rated
        if part != self.doing or self.done < before or not self.done:
            self._rated = self.doing, now, self.done
            return None
        gained, elapsed = self.done - before, now - since
        if gained <= 0 or elapsed <= 0.0 or self.total is None:
            return None
        return gained / elapsed, max(0.0, (self.total - self.done) * elapsed / gained)

    def end(self) -> None:
        """Ask for its end; it ends at its next step."""
        self._ending.set()

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self.good is not None


class NodeDesk(NodeObjects):
    """The node at `place` of the running robot `robot`; `history` are the writes of all pages."""

    def __init__(
        self, robot: str, place: NodePlace, connect: Callable[[str, float], RobotClient] = RobotClient.connect
    ) -> None:
        super().__init__(robot, place, SOURCE, connect)
        self.work: NodeWork | None = None
        self.scope: ScopeRun | None = None
        self.tuned: TuneFound | None = None
        self.history = EditHistory()
        self._editing = threading.Lock()

    async def ask(self, work: Callable[[NodeSession], T]) -> T:
        """Return what `work` returns of a session with the node, on a thread; raises what it raises."""
        return await in_thread(partial(self.with_session, work))

    def with_session(self, work: Callable[[NodeSession], T]) -> T:
        """Return the same; waits. From a thread that may."""
        with self.session() as session:
            return work(session)

    # ------------------------------------------------------------------------------------ single objects

    async def write(self, entry: Entry, text: str) -> Edit:
        """Write an object as a person has written its value; CanopenError with the sentence of the refusal."""
        return await in_thread(partial(self._edit, lambda session: self.history.write(session, entry, text)))

    async def undo(self) -> Edit:
        """Undo the newest write; CanopenError with the reason where that is not to be."""
        return await in_thread(partial(self._edit, self.history.undo))

    def _edit(self, change: Callable[[NodeSession], Edit]) -> Edit:
        if self.work is not None and not self.work.over:
            raise DriveError(f"{self.place.name} is busy: {self.work.title}; nothing was written")
        with self._editing:
            return self.with_session(change)

    # ------------------------------------------------------------------------------------ what takes long

    @property
    def busy(self) -> bool:
        """Whether a long piece of work goes on."""
        return self.work is not None and not self.work.over

    def begin(self, work: NodeWork, function: Callable[[NodeSession, NodeWork], str]) -> str | None:
        """Begin what takes long on a thread; `function` returns the sentence at its end. The reason if it may not."""
        if self.work is not None and not self.work.over:
            return f"{self.place.name} is busy: {self.work.title}; wait for its end"
        self.work = work
        threading.Thread(target=self._run, args=(work, function), name=f"page {work.key}", daemon=True).start()
        return None

    def _run(self, work: NodeWork, function: Callable[[NodeSession, NodeWork], str]) -> None:
        good = False
        try:
            with self._editing:
                work.told = self.with_session(lambda session: function(session, work))
            good = True
        except CanopenError as error:
            work.told = str(error)
        except Exception as error:  # noqa: BLE001 - the page says it, and goes on
            work.told = f"{work.title} ended with {type(error).__name__}: {error}"
        finally:
            work.good = good
