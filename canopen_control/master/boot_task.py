"""Runs one boot: hands the requests of `boot.boot` to the SDO client and to NMT, and the answers back.

The law of this file: nothing here waits. `advance` goes on as far as it can; the node calls it again when an SDO
transfer ended, a boot-up or heartbeat came, or time passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import NmtState
from canopen_control.errors import CanopenError
from canopen_control.master.boot import boot
from canopen_control.master.requests import AwaitBootUp, AwaitHeartbeat, AwaitState, Command, Read, Step, Write

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.cia301.sdo_client import SdoClient, SdoRequest
    from canopen_control.master.boot import BootResult
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.requests import Answer, Request

__all__ = ["BootStep", "BootTask"]


_WAITS = (AwaitBootUp, AwaitState, AwaitHeartbeat)


@dataclass(frozen=True, slots=True)
class BootStep:
    """One finished step of a boot and how long it took."""

    name: str
    seconds: float
    error: str = ""


class BootTask:
    """One boot of one node under way; `done` when it has a `result` or an `error`.

    `count_tpdos` returns how many TPDOs of the node have come: one more says OPERATIONAL as a heartbeat does.
    """

    def __init__(
        self,
        plan: NodePlan,
        sdo: SdoClient,
        send_nmt: Callable[[NmtCommand], None],
        *,
        reset: bool,
        now: int,
        count_tpdos: Callable[[], int] = lambda: 0,
    ) -> None:
        self.result: BootResult | None = None
        self.error: CanopenError | None = None
        self.steps: list[BootStep] = []
        self.started = now
        self._generator: Generator[Request, Answer, BootResult] = boot(plan, reset=reset)
        self._sdo, self._send_nmt, self._count_tpdos = sdo, send_nmt, count_tpdos
        self._sdo_timeout = plan.sdo_timeout_ns
        self._tpdos = 0
        self._step, self._step_since = "", now
        self._waiting: Request | None = None
        self._deadline = 0
        self._resume(now, lambda: next(self._generator))

    @property
    def done(self) -> bool:
        """Whether the boot ended, well or badly."""
        return self.result is not None or self.error is not None

    @property
    def step(self) -> str:
        """What the boot is doing."""
        return self._step

    @property
    def awaits_boot_up(self) -> bool:
        """Whether a boot-up is what comes next, not a surprise."""
        return isinstance(self._waiting, AwaitBootUp)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do; 0 means at once: a TPDO may have come."""
        if self._hears_tpdos:
            return 0
        return self._deadline if isinstance(self._waiting, _WAITS) else None

    def boot_up(self, now: int) -> None:
        """Take the node's boot-up message."""
        if self.awaits_boot_up:
            self._answer(True, now)

    def heartbeat(self, state: NmtState | None, now: int) -> None:
        """Take a heartbeat of the node."""
        waiting = self._waiting
        if isinstance(waiting, AwaitHeartbeat) and state is not None:
            self._answer(state, now)
        elif isinstance(waiting, AwaitState) and waiting.state in (None, state):
            self._answer(True, now)

    def tick(self, now: int) -> None:
        """End a wait whose time is over, or that a TPDO has ended."""
        if self._hears_tpdos and self._count_tpdos() > self._tpdos:
            self._answer(True, now)
        elif isinstance(self._waiting, _WAITS) and now >= self._deadline:
            self._answer(None if isinstance(self._waiting, AwaitHeartbeat) else False, now)

    def transfer_ended(self, request: SdoRequest, now: int) -> None:
        """Take the end of the SDO transfer that was asked for."""
        if self.done or request is not self._transfer:
            return
        if request.error is not None:
            error = request.error
            self._resume(now, lambda: self._generator.throw(error))
        else:
            self._answer(None if request.is_write else request.data, now)

    def cancel(self) -> None:
        """Drop the boot; whatever is under way is not answered any more."""
        self._generator.close()
        self._waiting = None
        self._transfer = None

    _transfer: SdoRequest | None = None

    @property
    def _hears_tpdos(self) -> bool:
        return isinstance(self._waiting, AwaitState) and self._waiting.state is NmtState.OPERATIONAL

    def _answer(self, value: Answer, now: int) -> None:
        self._resume(now, lambda: self._generator.send(value))

    def _resume(self, now: int, go_on: Callable[[], Request]) -> None:
        """Let the generator run up to its next wait."""
        self._waiting = None
        try:
            request = go_on()
            while isinstance(request, Step | Command):
                self._do(request, now)
                request = self._generator.send(None)
        except StopIteration as end:
            self._enter("", now)
            self.result = end.value
        except CanopenError as error:
            self._enter("", now, str(error))
            self.error = error
        else:
            self._wait_for(request, now)

    def _do(self, request: Step | Command, now: int) -> None:
        if isinstance(request, Step):
            self._enter(request.name, now)
        else:
            self._send_nmt(request.command)

    def _wait_for(self, request: Request, now: int) -> None:
        self._waiting = request
        if isinstance(request, Read):
            self._transfer = self._sdo.read(request.index, request.subindex, timeout_ns=self._sdo_timeout, now=now)
        elif isinstance(request, Write):
            timeout = request.timeout_ns or self._sdo_timeout
            self._transfer = self._sdo.write(request.index, request.subindex, request.data, timeout_ns=timeout, now=now)
        elif isinstance(request, _WAITS):
            self._deadline, self._tpdos = now + request.timeout_ns, self._count_tpdos()

    def _enter(self, name: str, now: int, error: str = "") -> None:
        if self._step:
            self.steps.append(BootStep(self._step, (now - self._step_since) / 1e9, error))
        self._step, self._step_since = name, now
