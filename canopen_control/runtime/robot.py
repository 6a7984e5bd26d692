"""`Robot`: the same reactor on a background thread, for scripts and notebooks.

    with Robot.from_config("robby", can="local:robby") as robot:
        robot.command("robby_forward_controller", [10.0, 10.0])

The law of this file: everything that touches the robot runs on its own thread; the methods here hand over and wait. A
script that dies leaves the drives to their heartbeat consumers, like any master that dies.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, TypeVar

from canopen_control.errors import BusClosed, CanopenError, ControlError
from canopen_control.hardware.joint import Action
from canopen_control.runtime.files import find_robot
from canopen_control.runtime.session import RunOptions, Session
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.status import status_dict

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

    from canopen_control.runtime.setup import RobotSetup

__all__ = ["Robot"]

T = TypeVar("T")
START_S = 30.0
CALL_S = 20.0


class Robot:
    """A robot that runs while the `with` block does. Methods raise CanopenError and may be called from any thread."""

    def __init__(self, setup: RobotSetup, options: RunOptions | None = None) -> None:
        self._setup, self._options = setup, options or RunOptions()
        self._session: Session | None = None
        self._thread: threading.Thread | None = None
        self._settled = threading.Event()  # runs, or has failed
        self._failure: CanopenError | None = None

    @classmethod
    def from_config(
        cls,
        config: str,
        *,
        can: str | Sequence[str] = (),
        controllers: Sequence[str] = (),
        name: str | None = None,
        mock: bool = False,
        drives: bool = True,
    ) -> Robot:
        """Read a robot's files; `can` as the `--can` option, `drives` False starts no virtual ones."""
        channels = [can] if isinstance(can, str) else list(can)
        setup = read_robot(find_robot(config), name=name, can=channels, controllers=controllers, mock=mock)
        return cls(setup, RunOptions(drives=drives and not mock))

    def __enter__(self) -> Robot:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.shutdown()

    def start(self) -> None:
        """Boot, activate the controllers, and return when the robot runs; raises what kept it from it."""
        if self._thread is not None:
            return
        self._thread = threading.Thread(target=self._run, name=f"robot {self._setup.name}", daemon=True)
        self._thread.start()
        in_time = self._settled.wait(START_S)
        if self._failure is not None:
            self._thread.join()
            raise self._failure
        if not in_time:
            self.shutdown()
            raise CanopenError(f"robot {self._setup.name} did not run within {START_S:g} s of its start")

    def shutdown(self) -> None:
        """Stop along the ramp, disable, and leave the bus; a second call does nothing."""
        thread, session = self._thread, self._session
        if thread is None:
            return
        if session is not None and thread.is_alive():
            session.reactor.call_threadsafe(lambda: session.robot.shutdown("the program ends it"))
        thread.join(START_S)
        self._thread = None

    def command(self, controller: str, values: Sequence[float]) -> None:
        """Command a controller; SI units, one value for each joint."""
        self._call(lambda session: session.robot.command(controller, list(values), "program"))

    def status(self) -> dict[str, Any]:
        """Return what `status --json` prints."""
        return self._call(lambda session: status_dict(session.robot))

    def stop(self) -> None:
        """Ramp to zero and disable; returns when no drive moves under power any more."""
        self._await(lambda session, done: session.robot.stop(done))

    def axis(self, action: str, node: str = "all") -> None:
        """Do what `canopen-control axis` does: enable, disable, halt, quick-stop or fault-reset."""
        self._await(lambda session, done: session.robot.axis(Action(action), node, done))

    def _run(self) -> None:
        try:
            self._session = session = Session(self._setup, self._options)
            try:
                session.robot.on_event = lambda event: self._settled.set() if event.kind == "running" else None
                session.start()
                session.reactor.run()
                if session.robot.failure is not None:
                    self._failure = CanopenError(session.robot.failure)
            finally:
                session.close()
        except CanopenError as error:
            self._failure = error
        finally:
            self._settled.set()

    def _call(self, work: Callable[[Session], T]) -> T:
        """Run `work` on the robot's thread and return its result."""
        results: list[T] = []

        def keep(session: Session, done: Callable[[str | None], None]) -> None:
            results.append(work(session))
            done(None)

        self._hand_over(keep)
        return results[0]

    def _await(self, work: Callable[[Session, Callable[[str | None], None]], object]) -> None:
        self._hand_over(work)

    def _hand_over(self, work: Callable[[Session, Callable[[str | None], None]], object]) -> None:
        session, ended, failures = self._alive(), threading.Event(), list[CanopenError]()

        def done(error: str | None) -> None:
            if error is not None:
                failures.append(ControlError(error))
            ended.set()

        def run() -> None:
            try:
                work(session, done)
            except CanopenError as error:
                failures.append(error)
                ended.set()

        session.reactor.call_threadsafe(run)
        if not ended.wait(CALL_S):
            raise ControlError(f"robot {self._setup.name} has not answered within {CALL_S:g} s")
        if failures:
            raise failures[0]

    def _alive(self) -> Session:
        if self._session is None or self._thread is None or not self._thread.is_alive():
            raise BusClosed(self._setup.name, "the robot does not run")
        return self._session
