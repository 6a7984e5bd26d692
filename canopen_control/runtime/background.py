"""Robot on a thread of this process, for use as a library.

The robot is accessed only on its own thread; other code is a client of its API, as in another process. If the
process is killed, the drives stop by their heartbeat consumers, as after the loss of any NMT master.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.run_session import RunOptions, RunSession

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.master.event_log import Event
    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.setup import RobotSetup


START_S = 30.0
_START_COMPLETE = ("running", "stop_latched")  # after a latched stop only a release continues


class _StartObserver(RobotObserver):
    """Observer that sets the event `start_complete` when the robot runs or STOP is latched."""

    def __init__(self, start_complete: threading.Event) -> None:
        self._start_complete = start_complete

    def event(self, event: Event) -> None:
        if event.kind in _START_COMPLETE:
            self._start_complete.set()


class BackgroundRobot:
    """Robot on its own thread, from `start` to `shutdown`.

    `prepare` is called with the `RobotCore`, on the robot's thread, before the nodes boot.
    """

    def __init__(
        self,
        setup: RobotSetup,
        options: RunOptions | None = None,
        prepare: Callable[[RobotCore], object] | None = None,
    ) -> None:
        self.name = setup.name
        self._setup, self._options, self._prepare = setup, options or RunOptions(), prepare
        self._session: RunSession | None = None
        self._thread: threading.Thread | None = None
        self._start_complete = threading.Event()  # the robot runs or has failed
        self._failure: CanopenError | None = None
        self._ended = False  # before the robot exists, `shutdown` can only set this

    @property
    def running(self) -> bool:
        """Whether the robot has been started and has not ended."""
        return self._session is not None and self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Boot the nodes and activate the controllers; return once the robot runs.

        Raise CanopenError if the start fails. If STOP is latched, even from an earlier run, the method returns early:
        nothing moves before a release.
        """
        if self._thread is not None:
            return
        self._ended, self._failure, self._session = False, None, None
        self._start_complete.clear()
        self._thread = threading.Thread(target=self._run, name=f"robot {self.name}", daemon=True)
        self._thread.start()
        in_time = self._start_complete.wait(START_S)
        if self._failure is not None:
            self._thread.join()
            raise self._failure
        if not in_time:
            self.shutdown()
            raise CanopenError(f"robot {self.name} did not run within {START_S:g} s of its start")

    def shutdown(self) -> None:
        """Ramp the drives to a standstill and disable them, leave the buses and join the thread.

        A first Ctrl-C during this is raised at its end, because the end of the process would interrupt the ramp.
        """
        self._ended = True  # before the session is read: see `_run`
        thread, session = self._thread, self._session
        if thread is None:
            return
        if session is not None and thread.is_alive():
            session.reactor.call_threadsafe(lambda: session.robot.shutdown("the program ends it"))
        try:
            thread.join(START_S)
        except KeyboardInterrupt:
            thread.join(START_S)
            raise
        finally:
            self._thread = None

    def _run(self) -> None:
        try:
            self._session = session = RunSession(self._setup, self._options)
            try:
                if self._ended:
                    return
                session.robot.observers.append(_StartObserver(self._start_complete))
                if self._prepare is not None:
                    self._prepare(session.robot)
                session.start()
                session.reactor.run()
                if session.robot.failure is not None:
                    self._failure = CanopenError(session.robot.failure)
            finally:
                session.close()
        except CanopenError as error:
            self._failure = error
        finally:
            self._start_complete.set()
