"""Runs the actions of a script on time and reports them to the observer; there is one method per kind of action."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
import os
import signal
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final, TypeVar, get_args

from campaigner.health import Logs, Memory
from campaigner.observer import Breach, Command, Reason
from campaigner.processes import resident_mb, start_helper
from campaigner.script import FAULTS
from campaigner.sources import CONTROLLER, LIFE_S, ShellStream, SocketStream, ask, command_once, enable
from campaigner.stage import NAME
from canopen_control.bus.channel import open_port
from canopen_control.bus.local import ask_hub
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages.drive import SwitchFault
from canopen_control.rpc.messages.hub import (
    ClearFaults,
    Cut,
    DelayFrames,
    ErrorKind,
    GetHubStatus,
    SendErrorFrame,
    Uncut,
)
from canopen_control.rpc.messages.robot import Stop

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from campaigner.script import Action
    from campaigner.stage import Stage
    from canopen_control.rpc.messages.declare import Request


A = TypeVar("A")

STOP_ANSWER_S: Final = 2.0
_SLOW_STOP_S: Final = 12.0  # limit while a drive has a fault: its master waits ten seconds for it
_TICK_S: Final = 0.02
_SAMPLE_S: Final = 1.0
_NMT: Final = {"reset_node": 0x81, "reset_communication": 0x82, "pre_operational": 0x80, "stop_node": 0x02}
_TOPIC: Final = f"/{CONTROLLER}/commands"
_TYPE: Final = "std_msgs/msg/Float64MultiArray"


class Driver:
    """Plays a script on a stage; `say` receives lines for people, `report` receives breaches."""

    def __init__(self, stage: Stage, logs: Path, say: Callable[[str], None], report: Callable[[Breach], None]) -> None:
        self.stage, self.say, self.report = stage, say, report
        self.listener = stage.listener
        self.begin = time.monotonic()
        self.done: list[Action] = []  # completed actions with their completion times
        self.counts: dict[str, int] = {}
        self.stops_s: list[float] = []
        self._logs, self._log_folder = Logs(), logs
        self.memory = [Memory()]  # one per runtime
        self._remembered = 0
        self._later: list[tuple[float, int, Callable[[], object]]] = []
        self._order = itertools.count()
        self._streams: list[SocketStream | ShellStream] = []
        self._helpers: list[subprocess.Popen[bytes]] = []
        self._faults: set[tuple[int, str]] = set()
        self._frozen: set[int] = set()
        self._sampled = 0.0
        self._signs = dict.fromkeys(self.listener.observer.wire.nodes, 0.0)

    # ------------------------------------------------------------------------------------------- time

    def play(self, actions: Sequence[Action], seconds: float) -> None:
        """Run the actions on time; an action that takes too long delays all later ones."""
        begin, late = time.monotonic(), 0.0
        self.begin = begin
        for action in actions:
            late = max(late, time.monotonic() - begin - action.at)
            due = begin + late + action.at
            if due > begin + seconds:
                break
            self._pass(due)
            self.done.append(replace(action, at=time.monotonic() - begin))
            self.say(f"  {self.done[-1]}")
            self.counts[action.kind] = self.counts.get(action.kind, 0) + 1
            getattr(self, f"_do_{action.kind}")(action)
        self._pass(min(begin + seconds, time.monotonic() + 2.0))
        self._mend()
        self._pass(time.monotonic() + 2.0)

    def _pass(self, until: float) -> None:
        """Wait until a given time, and run deferred actions when they are due."""
        while True:
            now = time.monotonic()
            while self._later and self._later[0][0] <= now:
                heapq.heappop(self._later)[2]()
            if now - self._sampled > _SAMPLE_S:
                self._sampled = now
                self._sample(now)
            if now >= until:
                return
            time.sleep(min(_TICK_S, max(until - now, 0.0)))

    def _in(self, seconds: float, what: Callable[[], object]) -> None:
        heapq.heappush(self._later, (time.monotonic() + seconds, next(self._order), what))

    def _sample(self, now: float) -> None:
        stage = self.stage
        for breach in self._logs.look([*self._log_folder.rglob("*.log"), *stage.folder.glob("*.out")], now):
            self.report(breach)
        if stage.run is None:
            return
        if stage.run.pid != self._remembered:
            self._remembered = stage.run.pid
            self.memory.append(Memory())
        grown = self.memory[-1].look(now - stage.ran_since, resident_mb(stage.run.pid), now)
        if grown is not None:
            self.report(grown)

    # --------------------------------------------------------------------------------------------- commands

    def _do_stream(self, action: Action) -> None:
        values = [action.number("left"), action.number("right")]
        how, ends, seconds = action.params["how"], action.params["ends"], action.number("seconds")
        self._signs = {3: -values[0], 2: values[1]}  # the left motor is mounted in mirror image
        stream: SocketStream | ShellStream
        if how == "socket":
            stream = SocketStream(self.listener, NAME, values, seconds, ends)
        else:
            ros = how == "ros" and self.stage.ros
            words = self._publisher(values) if ros else ["command", CONTROLLER, *map(str, values), "--name", NAME]
            start = lambda: self.stage.program(*words)  # noqa: E731
            stream = ShellStream(self.listener, start, max(map(abs, values)), seconds, ends, ros=ros)
        self._streams.append(stream)
        stream.start()

    @staticmethod
    def _publisher(values: list[float]) -> list[str]:
        return ["ros", "topic", "pub", _TOPIC, _TYPE, f"{{data: {values}}}", "--rate", "10"]

    def _do_once(self, action: Action) -> None:
        values = [action.number("left"), action.number("right")]
        self._signs = {3: -values[0], 2: values[1]}
        if action.params["how"] == "socket":
            self._log(command_once(self.listener, NAME, values))
        else:
            threading.Thread(target=self._once_by_shell, args=(values,), daemon=True).start()

    def _once_by_shell(self, values: list[float]) -> None:
        fact = Command("command --once", max(map(abs, values)), time.monotonic(), LIFE_S)
        self.listener.add(fact)
        program = self.stage.program("command", CONTROLLER, *map(str, values), "--once", "--name", NAME)
        fact.refused = program.wait(20.0) != 0
        fact.done = time.monotonic()

    def _do_absurd(self, action: Action) -> None:
        value = action.number("value")
        self._log(command_once(self.listener, NAME, [value, value]))

    # ---------------------------------------------------------------------------------------------- stops

    def _do_stop(self, action: Action) -> None:
        """Send STOP and check that it is answered; skipped while the runtime is absent or frozen."""
        run = self.stage.run
        if run is None or run.code is not None or run.pid in self._frozen:
            return
        limit = _SLOW_STOP_S if self._faults or self._frozen else STOP_ANSWER_S
        latch = action.params.get("latch") == "yes"
        error, took = self._stop_once(latch, limit)
        if run.code is not None:
            return
        if error is None:
            self.stops_s.append(took)
            self.stage.latched |= latch
        else:
            self.report(Breach(time.monotonic(), "lost_stop", f"STOP, after {took:.2f} s: {error}"))
            self._stop_once(latch, _SLOW_STOP_S)

    def _stop_once(self, latch: bool, limit: float) -> tuple[str | None, float]:
        """Send STOP once; return the problem, if any, and the duration. A refused STOP stops nothing."""
        reason = Reason("STOP", time.monotonic())
        self.listener.add(reason)
        error = None
        try:
            ask(NAME, Stop(latch=latch, source="campaign"), limit)
        except CanopenError as failure:
            error = str(failure)
        took = time.monotonic() - reason.since
        if error is None or took >= STOP_ANSWER_S:
            reason.known = reason.since + min(took, STOP_ANSWER_S)
        if error is None and took > limit:
            error = f"answered only after {took:.2f} s"
        return error, took

    def _do_enable(self, _action: Action) -> None:
        """Send an enable; while STOP is latched it must be refused and must not permit motion."""
        self._log("done" if enable(self.listener, NAME, counts=not self.stage.latched) else "refused")

    def _do_start(self, _action: Action) -> None:
        """Start a runtime if none is running; it must not enable anything if STOP was latched."""
        self.stage.have_run()

    def _do_recover(self, _action: Action) -> None:
        begin = time.monotonic()
        there = self.stage.recover(self._mend)
        self._log(f"{'enabled' if there else 'not recovered'} after {time.monotonic() - begin:.1f} s")

    def _mend(self) -> None:
        """Clear all faults and end all sources of commands."""
        self._later, later = [], self._later
        for _, _, what in sorted(later, key=lambda action: action[:2]):
            what()
        for node, name in list(self._faults):
            self._switch(node, name, on=False)
        self.close()
        for stream in self._streams:
            stream.hurry()
        for stream in self._streams:
            stream.join(10.0)
        self._streams.clear()
        if self.stage.hub is not None:
            with contextlib.suppress(CanopenError):
                ask_hub(self.stage.hub, ClearFaults())

    def close(self) -> None:
        """End all attackers, and resume frozen processes."""
        for helper in self._helpers:
            helper.kill()
            helper.wait()
        self._helpers.clear()
        for pid in list(self._frozen):
            self._thaw(pid)

    # ------------------------------------------------------------------------------------------ faults of drives

    def _do_fault(self, action: Action) -> None:
        node, name = int(action.params["node"]), action.params["name"]
        reason = Reason(f"{name} of node {node}", time.monotonic(), detect=self._detection(node, name))
        if math.isfinite(reason.detect):
            self.listener.add(reason)
        if self._switch(node, name, on=True):
            reason.known = time.monotonic()
        self._in(action.number("seconds"), lambda: self._switch(node, name, on=False))

    def _detection(self, node: int, name: str) -> float:
        """Return how long a fault may remain undetected; inf for a fault that stops nothing."""
        limits = self.listener.observer.wire.limits
        if name == "limit_switch" and self._signs.get(node, 0.0) <= 0.0:
            return math.inf
        times = {
            "status": 2 * limits.sync,
            "heartbeat": limits.heartbeat + limits.sync,
            "feedback": limits.feedback + limits.sync,
            "consumer": limits.consumer + limits.sync,
        }
        return times.get(FAULTS.get(name, ""), math.inf)

    def _switch(self, node: int, name: str, *, on: bool) -> bool:
        """Switch a fault of a drive over the drive's own socket; return whether that worked."""
        (self._faults.add if on else self._faults.discard)((node, name))
        try:
            with DriveClient.connect(self.stage.channel, node, 2.0) as drive:
                drive.ask(SwitchFault(name=name, on=on))
        except CanopenError as error:
            self._log(str(error))
            return False
        return True

    # ---------------------------------------------------------------------------------------- failures of processes

    def _do_kill(self, action: Action) -> None:
        who, node = action.params["who"], int(action.params.get("node", 0))
        if who == "runtime":
            self.stage.kill_run()
        elif who == "drive":
            self.stage.kill_drive(node)
        elif who == "hub":
            self.stage.kill_hub()
        elif (pid := self.stage.pid_of(who)) is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            if who == "bridge":
                self._bridge_died(pid)

    def _bridge_died(self, pid: int) -> None:
        """Note that commands sent over the bridge ended with it; they resume over the next one."""
        for stream in [
            candidate for candidate in self._streams if isinstance(candidate, ShellStream) and candidate.ros
        ]:
            stream.interrupt(lambda: self.stage.pid_of("bridge") not in (None, pid))

    def _do_restart(self, action: Action) -> None:
        """Start a runtime and kill it during start-up; none of its processes may survive."""
        self._mend()
        self.stage.kill_run()
        if self.stage.run is not None:
            self.stage.wait_for_orphans(self.stage.run)
        self.stage.begin_run()
        time.sleep(action.number("after"))
        self.stage.kill_run()

    def _do_freeze(self, action: Action) -> None:
        who, node = action.params["who"], int(action.params.get("node", 0))
        pid, seconds = self.stage.pid_of(who, node), action.number("seconds")
        if pid is None:
            return
        limits = self.listener.observer.wire.limits
        begin = time.monotonic()
        if who != "recorder" and seconds > limits.consumer + limits.heartbeat:
            self.listener.add(Reason(f"the {who} was frozen", begin, begin, limits.consumer))
        if who == "runtime":
            self.listener.excuse(begin, begin + min(seconds, limits.consumer))
        elif who == "drive":
            self.listener.excuse(begin, begin + seconds + limits.consumer, node)
        self._signal(pid, signal.SIGSTOP)
        self._frozen.add(pid)
        self._in(seconds, lambda: self._thaw(pid))

    def _thaw(self, pid: int) -> None:
        self._signal(pid, signal.SIGCONT)
        self._frozen.discard(pid)

    @staticmethod
    def _signal(pid: int, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)

    # ---------------------------------------------------------------------------- foreign devices and clients

    def _do_hostile(self, action: Action) -> None:
        path = str(socket_path("robot", NAME))
        self._helpers.append(start_helper("hostile", action.params["name"], path, action.params["seconds"]))

    def _do_flood(self, action: Action) -> None:
        name, seconds = action.params["name"], action.params["seconds"]
        if name == "error_frames":
            threading.Thread(target=self._error_frames, args=(float(seconds),), daemon=True).start()
        elif name == "delay":
            self._hub(DelayFrames(ms=15))
            self._in(float(seconds), lambda: self._hub(DelayFrames(ms=0)))
        else:
            self._helpers.append(start_helper("flood", name, self.stage.channel, seconds))

    def _error_frames(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.stage.hub is not None:
            for kind in get_args(ErrorKind):
                self._hub(SendErrorFrame(kind=kind))
            time.sleep(0.005)

    def _do_foreign(self, action: Action) -> None:
        name, node = action.params["name"], int(action.params["node"])
        limits = self.listener.observer.wire.limits
        frame = CanFrame(0x700 + node, b"\0") if name == "boot_up" else CanFrame(0, bytes((_NMT[name], node)))
        reason = Reason(f"a foreign {name} of node {node}", time.monotonic())
        reason.detect = limits.sync if name == "boot_up" else limits.heartbeat + limits.sync
        self.listener.add(reason)
        with contextlib.suppress(CanopenError):
            port = open_port(self.stage.channel, label="foreigner")
            port.send(pack_records([frame]))
            port.flush()
            reason.known = time.monotonic()
            time.sleep(0.05)
            port.close()

    def _do_cut(self, action: Action) -> None:
        """Cut a cable of the embedded bus."""
        node = int(action.params["node"])
        label = self._label("drive", node) if action.params["who"] == "drive" else self._label("runtime")
        if label is None:
            return
        reason = Reason(f"the cable of {label} was cut", time.monotonic())
        reason.detect = self.listener.observer.wire.limits.consumer
        self.listener.add(reason)
        self._hub(Cut(label))
        reason.known = time.monotonic()
        self._in(action.number("seconds"), lambda: self._hub(Uncut(label)))

    def _label(self, role: str, node: int = 0) -> str | None:
        pid = self.stage.pid_of(role, node)
        status = self._hub(GetHubStatus()) if pid is not None else None
        return None if status is None else next((member.label for member in status.members if member.pid == pid), None)

    def _hub(self, request: Request[A]) -> A | None:
        if self.stage.hub is not None:
            with contextlib.suppress(CanopenError):
                return ask_hub(self.stage.hub, request)
        return None

    def _log(self, text: str) -> None:
        self.say(f"           {text}")
