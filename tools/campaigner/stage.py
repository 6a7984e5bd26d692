"""The robot of a campaign: starts it with all it needs, kills parts of it and restores it.

Tells the observer what it did; what comes of that is read from the bus.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from typing import TYPE_CHECKING, Final

from campaigner.health import watch_orphans
from campaigner.observer import Breach, Enable, Reason
from campaigner.processes import Program, Run
from campaigner.sources import ask, enable
from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control.rpc.messages.robot import AxisRequest, Release

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable
    from pathlib import Path

    from campaigner.listen import Listener


NAME: Final = "campaign"
START_S: Final = 30.0
RECOVER_S: Final = 20.0
_END_S: Final = 15.0


class Stage:
    """One robot on one channel; `report` receives breaches, `say` lines for people.

    Every other runtime is started without a word of its YAML on how long a command lives: that changes nothing.
    """

    def __init__(
        self,
        folder: Path,
        config: Path,
        listener: Listener,
        report: Callable[[Breach], None],
        say: Callable[[str], None],
        *,
        ros: bool = False,
    ) -> None:
        self.folder, self.listener, self.report, self.say = folder, listener, report, say
        self._configs = (config, _without_timeout(config, folder / "config"))
        self.ros = ros
        self.run: Run | None = None
        self.ran_since = 0.0
        self.starts = 0
        self.programs: list[Program] = []
        self.run_fact = Enable(0.0, 0.0)
        self.latched = False  # True from a latched STOP to its release: an enable of any client has no effect
        self._drives: dict[int, Program] = {}
        self._orphans: threading.Thread | None = None  # thread that watches the children of the killed run
        self._count = 0
        self._wire = listener.observer.wire

    @property
    def channel(self) -> str:
        """The channel of the robot."""
        return self.listener.channel

    @property
    def hub(self) -> str | None:
        """The name of the embedded bus, or None on a bus of the kernel."""
        return self.channel.removeprefix("local:") if self.channel.startswith("local:") else None

    def program(self, *words: str) -> Program:
        """Start a verb as a process."""
        self._count += 1
        program = Program(self.folder, f"{self._count:03}-{words[0]}", words, f"{os.getpid()}-others")
        self.programs.append(program)
        return program

    # -- start

    def begin_run(self) -> Run:
        """Start a runtime, with its own drives unless they are running, without waiting."""
        self._count += 1
        config = self._configs[self.starts % len(self._configs)]
        words = ["run", str(config), "--name", NAME, "--can", self.channel]
        self.starts += 1
        words += ["--ros"] if self.ros else []
        words += ["--no-drives"] if self._drives else []
        fact = Enable(time.monotonic())  # activating its controllers enables the drives
        if not self.latched:
            self.listener.add(fact)
        self.run = Run(self.folder, f"{self._count:03}-run", words, f"{os.getpid()}-{self._count}")
        self.run_fact = fact
        return self.run

    def start(self) -> bool:
        """Start a runtime and wait until it is running; return whether it is."""
        run = self.begin_run()
        ready = run.wait_for(self._is_ready, START_S)
        self.run_fact.done = self.ran_since = time.monotonic()
        for node in self._wire.nodes:
            self.listener.forget(node)
        errors = [line for line in run.output().partition(f"{NAME} runs")[0].splitlines() if "boot error" in line]
        if errors and not self._drives:
            self.report(Breach(time.monotonic(), "start", f"it did not wait for its own drives: {errors[0]}"))
        if not ready:
            code = run.code
            last = " | ".join(run.output().splitlines()[-4:])
            how = f"ended with {code}" if code is not None else f"was not ready within {START_S:g} s"
            self.report(Breach(time.monotonic(), "start", f"run {how}: {last}"))
        return ready

    def _is_ready(self, output: str) -> bool:
        """Whether a runtime reports that it is running; one that is latched has booted its nodes and waits."""
        booted = output.count("operational after") >= len(self._wire.nodes)
        return f"{NAME} runs" in output or (self.latched and booted)

    def start_drive(self, node: int) -> None:
        """Start a drive outside the run, to replace one that has ended."""
        eds = "TMCM-1270.eds"
        drive = self.program("drive", "--node-id", str(node), "--eds", eds, "--can", self.channel)
        self.listener.forget(node)
        if drive.wait_for(lambda output: "ready on" in output, START_S):
            self._drives[node] = drive
        else:
            self.say(f"      drive {node} did not start: {drive.output().strip()[-200:]}")

    # -- failures

    def kill_run(self) -> None:
        """Kill the runtime like the out-of-memory killer; its children have ten seconds to end."""
        if self.run is None or self.run.code is not None:
            return
        reason = Reason("the runtime was killed", time.monotonic(), detect=self._wire.limits.consumer)
        self.listener.add(reason)
        self.run.send(signal.SIGKILL)
        self.run.process.wait()
        reason.known = time.monotonic()
        self.run_fact.done = min(self.run_fact.done, reason.known)
        self._orphans = watch_orphans(self.run, self.report)

    def kill_drive(self, node: int) -> None:
        """Kill a drive, whichever process started it."""
        pid = self.pid_of("drive", node)
        if pid is None:
            return
        reason = Reason(f"drive {node} was killed", time.monotonic(), detect=self._wire.limits.consumer)
        self.listener.add(reason)
        _kill(pid)
        reason.known = time.monotonic()
        apart = self._drives.pop(node, None)
        if apart is not None:
            apart.process.wait()

    def kill_hub(self) -> None:
        """Kill the process that relays the frames."""
        if self.hub is None:
            return
        with contextlib.suppress(CanopenError):
            pid = ask_hub(self.hub, GetHubStatus()).pid
            reason = Reason("the hub was killed", time.monotonic(), detect=self._wire.limits.consumer)
            self.listener.add(reason)
            _kill(pid)
            reason.known = time.monotonic()

    def pid_of(self, role: str, node: int = 0) -> int | None:
        """Return the process id of runtime, drive, recorder or bridge."""
        if role == "drive" and node in self._drives:
            return self._drives[node].pid
        if self.run is None or self.run.code is not None:
            return None
        return self.run.pid if role == "runtime" else self.run.find(role, node)

    # -- recovery

    def recover(self, mend: Callable[[], None]) -> bool:
        """Restore the robot to running and enabled; `mend` clears disturbances. Return whether that worked."""
        mend()
        if not self.have_run():
            return False
        end = time.monotonic() + RECOVER_S
        while time.monotonic() < end and self.run is not None and self.run.code is None:
            if self._enable():
                return True
            time.sleep(0.5)
        return self._give_up()

    def have_run(self) -> bool:
        """Start a runtime if none is running, and missing drives; return whether everything is running."""
        gone = self.run is None or self.run.code is not None
        if gone and self.run is not None:
            self.wait_for_orphans(self.run)
        self._revive_drives()
        return self.start() if gone else True

    def _enable(self) -> bool:
        self.latched = False
        with contextlib.suppress(CanopenError):
            ask(NAME, Release(source="campaign"))
        with contextlib.suppress(CanopenError):
            ask(NAME, AxisRequest(action="fault-reset", node="all"), 10.0)
        if not enable(self.listener, NAME):
            return False
        end = time.monotonic() + 2.0  # the observer evaluates events one second late
        while time.monotonic() < end:
            if self.listener.powered():
                return True
            time.sleep(0.1)
        return False

    def _give_up(self) -> bool:
        """Report that it does not recover, and restart everything, drives included."""
        now = time.monotonic()
        if self.run is not None and self.run.code is not None:
            last = " | ".join(self.run.output().splitlines()[-2:])
            self.report(Breach(now, "recovery", f"the run ended by itself with {self.run.code}: {last}"))
        else:
            last = self._last_error()
            self.report(Breach(now, "recovery", f"not enabled {RECOVER_S:g} s after all was mended: {last}"))
            self.end_run()
        for node in list(self._drives):
            self._drives.pop(node).end()
        self.start()
        return False

    def _last_error(self) -> str:
        try:
            ask(NAME, AxisRequest(action="enable", node="all"), 10.0)
        except CanopenError as error:
            return str(error)
        return "enable says that it is done"

    def wait_for_orphans(self, run: Run) -> None:
        """Wait until all processes of an ended run are gone; report and end those that stay too long."""
        watcher, self._orphans = self._orphans or watch_orphans(run, self.report), None
        watcher.join()
        for pid in run.survivors():
            _kill(pid)

    def _revive_drives(self) -> None:
        """Make sure that each drive is running, in the run or outside it."""
        for node, drive in list(self._drives.items()):
            if drive.code is not None:
                del self._drives[node]
        runs = self.run is not None and self.run.code is None
        if runs or self._drives:
            for node in self._wire.nodes:
                if self.pid_of("drive", node) is None:
                    self.start_drive(node)

    def end_run(self) -> None:
        """End the runtime like a user; it has several seconds for that."""
        run = self.run
        if run is None:
            return
        run.send(signal.SIGCONT)
        run.send(signal.SIGTERM)
        if run.wait(_END_S) is None:
            self.report(Breach(time.monotonic(), "end", f"run did not end within {_END_S:g} s after SIGTERM"))
            self.kill_run()
        self.run_fact.done = min(self.run_fact.done, time.monotonic())
        now = time.monotonic()
        self.listener.add(Reason("the run was ended", now, now))
        self.wait_for_orphans(run)

    def close(self) -> None:
        """End everything that was started here."""
        self.end_run()
        for program in self.programs:
            program.end()
        self._drives.clear()


def _without_timeout(config: Path, folder: Path) -> Path:
    """Copy a robot without the command_timeout lines."""
    shutil.copytree(config, folder)
    controllers = folder / "ros2_controllers.yaml"
    lines = controllers.read_text().splitlines(keepends=True)
    controllers.write_text("".join(line for line in lines if "command_timeout" not in line))
    return folder


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
