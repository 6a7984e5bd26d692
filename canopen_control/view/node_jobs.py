"""Jobs at one node, shared by all pages, without NiceGUI.

Short requests run on threads, and one long job at a time. A request has its own connection, so that STOP and the state
samples never wait behind the request. A long job continues when the page that started it is closed; every page shows
the progress, and any page can end the job.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from canopen_control.client import RobotClient
from canopen_control.commissioning.live_reader import NodeObjects
from canopen_control.commissioning.object_rows import EditHistory
from canopen_control.errors import CanopenError, DriveError
from canopen_control.view.robot_connection import SOURCE, in_thread

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.commissioning.jobs import JobRun
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.object_rows import Edit
    from canopen_control.commissioning.scope_run import ScopeRun
    from canopen_control.commissioning.tune_job import TuneFound
    from canopen_control.od.model import Entry
    from canopen_control.rpc.messages.robot import NodePlace


T = TypeVar("T")


class NodeJobs(NodeObjects):
    """Jobs and object edits at one node of a running robot; `history` has the edits of all pages."""

    def __init__(
        self, robot: str, place: NodePlace, connect: Callable[[str, float], RobotClient] = RobotClient.connect
    ) -> None:
        super().__init__(robot, place, SOURCE, connect)
        self.work: JobRun | None = None
        self.scope: ScopeRun | None = None
        self.tuned: TuneFound | None = None
        self.history = EditHistory()
        self._editing = threading.Lock()

    async def ask(self, work: Callable[[NodeSession], T]) -> T:
        """Run `work` with a session of the node on a thread and return its result or raise its error."""
        return await in_thread(partial(self.with_session, work))

    def with_session(self, work: Callable[[NodeSession], T]) -> T:
        """Run `work` with a session of the node and return the result; blocks, so call it on a thread."""
        with self.session() as session:
            return work(session)

    # ------------------------------------------------------------------------------------ single objects

    async def write(self, entry: Entry, text: str) -> Edit:
        """Write an object from the user's text; CanopenError with the reason if the write is refused."""
        return await in_thread(partial(self._edit, lambda session: self.history.write(session, entry, text)))

    async def undo(self) -> Edit:
        """Undo the latest edit; CanopenError with the reason if it cannot be undone."""
        return await in_thread(partial(self._edit, self.history.undo))

    def _edit(self, change: Callable[[NodeSession], Edit]) -> Edit:
        if self.work is not None and self.busy:
            raise DriveError(f"{self.place.name} is busy: {self.work.title}; nothing was written")
        with self._editing:
            return self.with_session(change)

    # ------------------------------------------------------------------------------------ long jobs

    @property
    def busy(self) -> bool:
        return self.work is not None and not self.work.over

    def begin(self, work: JobRun, function: Callable[[NodeSession, JobRun], str]) -> str | None:
        """Start a job on a thread, where `function` returns the final sentence; return the reason if refused."""
        if self.work is not None and self.busy:
            return f"{self.place.name} is busy: {self.work.title}; wait until this has ended"
        self.work = work
        threading.Thread(target=self._run, args=(work, function), name=f"page {work.job.name}", daemon=True).start()
        return None

    def _run(self, work: JobRun, function: Callable[[NodeSession, JobRun], str]) -> None:
        good = False
        try:
            with self._editing:
                work.sentence = self.with_session(lambda session: function(session, work))
            good = not work.failed
        except CanopenError as error:
            work.sentence = str(error)
        except Exception as error:  # noqa: BLE001 - the page shows it and continues
            work.sentence = f"{work.title} ended with {type(error).__name__}: {error}"
        finally:
            work.good = good
