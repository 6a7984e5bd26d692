"""Boot of a node by the NMT master (CiA 302-2, boot slave): a generator that yields requests.

`boot` yields requests (`requests.py`) and receives their results, or `SdoAbort` and `SdoTimeout` as exceptions;
`BootTask` executes the requests without blocking. A failure is a `BootError` with the letter of the standard
(`LETTERS`). `NextStep` marks the steps for timing.

The communication of a node is reset first, so that no configuration of an earlier run remains and no PDO is mapped
while the node is OPERATIONAL. Exceptions are a node that has just sent its boot-up, and an OPERATIONAL node with
`reset_communication: false`, whose configuration is only compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402.objects import (
    CONTROLWORD,
    MODES_OF_OPERATION,
    STATUSWORD,
    SUPPORTED_DRIVE_MODES,
    TARGET_VELOCITY,
)
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.errors import BootError, CanopenError, SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.master.boot_config import (
    STORE_NS,
    check_expected,
    compare_only,
    configure,
    read_outputs,
    read_signals,
    store,
    watch_running,
)
from canopen_control.master.requests import (
    LETTERS,
    AwaitBootUp,
    AwaitHeartbeat,
    AwaitState,
    BootTransfers,
    NextStep,
    Read,
    Request,
    SendNmt,
    WriteObject,
    boot_error,
    reason_of,
)
from canopen_control.od.indices import DEVICE_TYPE, IDENTITY, PROGRAM_ID, RESTORE

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from canopen_control.cia301.sdo_client import SdoClient
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.master.requests import Answer
    from canopen_control.od.model import Value


_MILLISECOND = 1_000_000
STATE_NS = 500 * _MILLISECOND  # wait for confirmation of an NMT command, in addition to the heartbeat timeout
NMT_TRIES = 3  # NMT commands are unconfirmed: repeated while no heartbeat shows the state
LOAD = b"load"
_COMMUNICATION_PARAMETERS = 2  # subindex of 0x1011 whose restored values are effective after reset communication
_OPERATION_ENABLED_BIT = 0x04
_SHUTDOWN, _DISABLE_VOLTAGE = 0x0006, 0x0000
_POWER_CHECK_NS = 100 * _MILLISECOND
_LONGEST_RESTART_NS = 10_000 * _MILLISECOND  # an absent node must not use up the time of the whole stop
_POWER_CHECKS, _CHECKS_PER_COMMAND, _REFUSALS = 50, 10, 2
_QUICK_STOP_CHECKS = 20  # of these, for the ramp of a quick stop
#: target object -> object with the actual value, which RPDOs contain until the first command
_PRESETS = {(0x607A, 0): 0x6064, (0x60C1, 1): 0x6064, (0x6060, 0): 0x6061}


@dataclass(frozen=True, slots=True)
class BootResult:
    """Result of a successful boot: identity of the node (-1 if unknown), PDOs and initial values.

    `supported_modes` is 0x6502 or None. `reads` and `writes` are the numbers of SDO transfers, `adopted` the PDOs that
    keep the node's own configuration, `presets` the initial values of process data by (index, subindex).
    """

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int
    supported_modes: int | None
    writes: int
    warnings: tuple[str, ...]
    reads: int = 0
    adopted: tuple[tuple[str, PlannedPdo], ...] = ()
    presets: dict[tuple[int, int], Value] = field(default_factory=dict)


def boot(plan: NodePlan, *, reset: bool) -> Generator[Request, Answer, BootResult]:
    """Boot a node from any NMT state to OPERATIONAL; raise BootError if a step fails.

    With `reset`, NMT reset communication is sent first, so that the node loses the configuration of an earlier run; a
    node that has just sent its boot-up needs no reset. A node with `reset_communication: false` is reset only if it is
    not OPERATIONAL. If the boot fails, a drive that an earlier master left enabled is disabled nevertheless: no later
    step stops it, and the heartbeat of this master would keep it running.
    """
    transfers = BootTransfers(plan.motors)
    try:
        return (yield from _boot(plan, transfers, reset=reset))
    except BootError as error:
        refusal = error
    if refusal.letter not in ("B", "C"):  # it does not answer, or is another device
        yield from _disable_refused(plan, transfers)
    raise refusal


def _boot(plan: NodePlan, transfers: BootTransfers, *, reset: bool) -> Generator[Request, Answer, BootResult]:
    keep = plan.keep_alive and reset
    alive = False
    if reset and not keep:
        alive = yield from _reset(plan, NmtCommand.RESET_COMMUNICATION)
    yield NextStep("identify")
    identity = yield from _identify(plan, transfers, alive=alive)
    running = keep and (yield from _is_running(plan))
    if keep and not running:
        yield from _reset(plan, NmtCommand.RESET_COMMUNICATION)
    yield from _check_software(plan, transfers)
    modes = yield from _prepare_drive(plan, transfers, running)
    if running:
        yield from _leave_running(plan, transfers)
    else:
        yield from _configure(plan, transfers)
    yield from read_outputs(plan, transfers)
    yield from read_signals(plan, transfers)
    if not running:
        yield from _start(plan)
    warnings = tuple(transfers.warnings)
    adopted = tuple(transfers.adopted)
    return BootResult(*identity, modes, transfers.writes, warnings, transfers.reads, adopted, transfers.presets)


def _reset(plan: NodePlan, command: NmtCommand) -> Generator[Request, Answer, bool]:
    yield NextStep("reset")
    # CiA 301, 7.3.2: a reset ends with the boot-up message
    yield SendNmt(command)
    # Some nodes send no boot-up; the next step detects a missing node.
    return bool((yield AwaitBootUp(plan.boot_up_ns)))


def _identify(
    plan: NodePlan, transfers: BootTransfers, *, alive: bool
) -> Generator[Request, Answer, tuple[int, int, int, int]]:
    """Read and compare device type and identity (CiA 302-2, steps 3 to 8); `alive` if a boot-up was received."""
    try:
        device_type = int.from_bytes((yield from transfers.read(DEVICE_TYPE)), "little")
    except (SdoTimeout, SdoAbort, SdoLengthError) as error:
        late = "; its boot-up message was received: if the node answers SDO later, increase `boot_time` of the master"
        end = late if alive and isinstance(error, SdoTimeout) else ""
        # CiA 302-2, error status B: no answer to the request of 0x1000
        raise boot_error(plan, "B", f"device type 0x1000:00 not read: {reason_of(error)}{end}") from error
    expected = plan.identity
    if expected.device_type and device_type != expected.device_type:
        # CiA 302-2, error status C: 0x1000 differs from 0x1F84
        raise _mismatch(plan, "C", "device type 0x1000:00", device_type, expected.device_type)
    numbers = []
    for subindex, letter, title, required in (
        (1, "D", "vendor id", expected.vendor_id),
        (2, "M", "product code", expected.product_code),
        (3, "N", "revision number", expected.revision_number),
        (4, "O", "serial number", expected.serial_number),
    ):
        value = yield from _read_optional(plan, "B", transfers, IDENTITY, subindex)
        numbers.append(-1 if value is None else value)
        if required and value != required:
            # CiA 302-2, error status D, M, N, O: 0x1018 differs from 0x1F85 to 0x1F88
            raise _mismatch(plan, letter, f"{title} 0x1018:{subindex:02X}", numbers[-1], required)
    if expected.eds_revision and numbers[2] != expected.eds_revision:
        transfers.warnings.append(
            f"revision number 0x{numbers[2] & 0xFFFFFFFF:08X}, the EDS was written for 0x{expected.eds_revision:08X}; "
            "set revision_number in bus.yml to require a revision"
        )
    return numbers[0], numbers[1], numbers[2], numbers[3]


def _is_running(plan: NodePlan) -> Generator[Request, Answer, bool]:
    """Whether a node that must not be reset is OPERATIONAL (CiA 302-2, "check node state").

    Raise BootError E or F if its state is not received.
    """
    yield NextStep("keep alive")
    timeout = plan.supervision_ns or STATE_NS
    state = yield AwaitHeartbeat(timeout)
    # CiA 302-2, error status E and F: no heartbeat, or no guarding answer, of a node to be kept alive
    if state is None:
        letter, monitoring = ("F", "guarding") if plan.guard else ("E", "heartbeat")
        raise boot_error(
            plan,
            letter,
            f"no {monitoring} within {timeout / 1e9:g} s; power-cycle the node, or set `reset_communication: true`",
        )
    return state == NmtState.OPERATIONAL


def _check_software(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Compare the firmware version with `software_version` (CiA 302-2, "check and update software version")."""
    if not plan.software_version:
        return
    version = yield from _read_optional(plan, "G", transfers, PROGRAM_ID, 1)
    # CiA 302-2, error status G: the software version could not be verified
    if version is None:
        raise boot_error(plan, "G", f"the node has no 0x1F56:01, and software_version is 0x{plan.software_version:08X}")
    # CiA 302-2, error status H and I: another version than 0x1F55, without a firmware download
    if version != plan.software_version:
        letter, hint = "H", ""
        if plan.software_file:
            letter, hint = "I", f"; load {plan.software_file} with its manufacturer's tool"
        raise boot_error(
            plan, letter, f"0x1F56:01 is 0x{version:08X}, software_version is 0x{plan.software_version:08X}{hint}"
        )


def _disable_refused(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Disable the axes of a node whose boot has failed, as far as it answers."""
    try:
        for offset in plan.axes:
            yield from _disable(transfers, offset, (yield from transfers.number(STATUSWORD + offset, 0)) or 0)
    except (SdoAbort, SdoTimeout, SdoLengthError):
        return


def _disable(transfers: BootTransfers, offset: int, statusword: int) -> Generator[Request, Answer, None]:
    # CiA 402-2, table 30: bit 2, operation enabled
    if statusword & _OPERATION_ENABLED_BIT:
        yield from _write_optional(transfers, CONTROLWORD + offset, _SHUTDOWN.to_bytes(2, "little"))


def disable_axes(plan: NodePlan, *, restarting: bool) -> Generator[Request, Answer, None]:
    """Disable the axes of a node that is not booted, because the run ends; raise CanopenError without a confirmation.

    An earlier master may have left them enabled, and the reset at the beginning of a boot ends their monitoring of a
    master's heartbeat. A node that is `restarting` answers SDO only after its boot-up.
    """
    yield NextStep("disable")
    if restarting:
        yield AwaitBootUp(min(plan.boot_up_ns, _LONGEST_RESTART_NS))
    transfers = BootTransfers(plan.motors)
    axes = [_PoweredAxis(offset) for offset in plan.axes]
    for check in range(_POWER_CHECKS):
        for axis in tuple(axes):  # an axis that does not obey must not delay the others
            if (yield from _is_disabled(plan, transfers, axis, check)):
                axes.remove(axis)
        if not axes:
            return
        if (check + 1) % _CHECKS_PER_COMMAND == 0 and all(axis.refusals >= _REFUSALS for axis in axes):
            break
        yield AwaitBootUp(_POWER_CHECK_NS)  # unlike a heartbeat, a boot-up is a reason to check at once
    stuck = axes[0]
    state = "unknown" if stuck.statusword is None else f"0x{stuck.statusword:04X}"
    refusal = f"; {transfers.warnings[-1]}" if transfers.warnings else ""
    name = f"0x{STATUSWORD + stuck.offset:04X}"
    raise boot_error(plan, "J", f"it was commanded to disable, and its statusword {name} is {state}{refusal}")


class _PoweredAxis:
    """Axis that has not confirmed that it has no power; `refusals` is the number of aborted commands."""

    def __init__(self, offset: int) -> None:
        self.offset, self.refusals = offset, 0
        self.statusword: int | None = None


def _is_disabled(
    plan: NodePlan, transfers: BootTransfers, axis: _PoweredAxis, check: int
) -> Generator[Request, Answer, bool]:
    """Return whether the statusword of an axis shows no power; if it does not, command it again once a second."""
    axis.statusword = statusword = yield from _read_optional(plan, "B", transfers, STATUSWORD + axis.offset, 0)
    if statusword is not None and not statusword & _OPERATION_ENABLED_BIT:
        return True
    if check % _CHECKS_PER_COMMAND == 0:
        # CiA 402-2, table 22, transition 12: only disable voltage ends a quick stop in which the axis stays
        stays = statusword is not None and decode_statusword(statusword) is State.QUICK_STOP_ACTIVE
        word = _DISABLE_VOLTAGE if stays and check >= _QUICK_STOP_CHECKS else _SHUTDOWN
        before = len(transfers.warnings)
        yield from _write_optional(transfers, CONTROLWORD + axis.offset, word.to_bytes(2, "little"))
        axis.refusals += len(transfers.warnings) - before
    return False


def _prepare_drive(plan: NodePlan, transfers: BootTransfers, running: bool) -> Generator[Request, Answer, int | None]:
    """Read modes and actual values of a drive; unless `running`, disable it and clear its target velocity."""
    modes: int | None = None
    sent = {(mapped.index, mapped.subindex) for layout in plan.rpdos for mapped in layout.objects}
    for offset in plan.axes:
        modes = yield from _read_optional(plan, "J", transfers, SUPPORTED_DRIVE_MODES + offset, 0)
        statusword = (yield from _read_optional(plan, "J", transfers, STATUSWORD + offset, 0)) or 0
        if not running:
            yield from _disable(transfers, offset, statusword)
        for (target, subindex), actual in _PRESETS.items():
            if (target + offset, subindex) in sent:
                value = yield from _read_optional(plan, "J", transfers, actual + offset, 0, signed=True)
                if value is not None:
                    transfers.presets[target + offset, subindex] = transfers.presets[actual + offset, 0] = value
        if (MODES_OF_OPERATION + offset, 0) in transfers.presets:  # unless bus.yml writes a mode
            for write in plan.writes:
                if write.address == (MODES_OF_OPERATION + offset, 0):
                    transfers.presets[write.address] = int.from_bytes(write.data, "little", signed=True)
        has_velocity = (TARGET_VELOCITY + offset, 0) in plan.entry_names and not running
        if has_velocity and (yield from _read_optional(plan, "J", transfers, TARGET_VELOCITY + offset, 0)):
            yield from _write_optional(transfers, TARGET_VELOCITY + offset, bytes(4))
    return modes


def _leave_running(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Compare the configuration of a running node; warn about differences (letter L of CiA 302-2).

    Missing supervision parameters are written nevertheless; a difference in a used PDO is a BootError.
    """
    yield NextStep("compare")
    yield from check_expected(plan, transfers)
    written = transfers.writes
    missing = yield from watch_running(plan, (yield from compare_only(plan, transfers)), transfers)
    done = "only its supervision was written" if transfers.writes > written else "nothing was written"
    differs = ", ".join(f"0x{write.index:04X}:{write.subindex:02X}" for write in missing)
    remark = f"; it differs from bus.yml in {differs}: reset the node to write these objects" if missing else ""
    transfers.warnings.append(f"boot status L: {LETTERS['L']} and must be kept alive, so {done}{remark}")
    yield from _await_heartbeat(plan)


def _configure(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    if plan.restore:
        yield NextStep("restore")
        try:
            # CiA 301, 7.5.2.14: the signature "load"; the defaults are active after a reset
            yield from transfers.write(RESTORE, plan.restore, LOAD, STORE_NS)
        except (SdoAbort, SdoTimeout) as error:
            raise boot_error(plan, "J", f"restoring with 0x1011:{plan.restore:02X}: {reason_of(error)}") from error
        communication = plan.restore == _COMMUNICATION_PARAMETERS
        command = NmtCommand.RESET_COMMUNICATION if communication else NmtCommand.RESET_NODE
        # CiA 301, 7.5.2.14: restored values are valid after reset node or reset communication
        if not (yield from _reset(plan, command)):
            raise boot_error(plan, "J", f"no boot-up within {plan.boot_up_ns / 1e9:g} s after restoring the defaults")
    yield NextStep("configure")
    transfers.begin_configuration()
    yield from configure(plan, transfers)
    yield from store(plan, transfers)
    yield from _await_heartbeat(plan)


def _await_heartbeat(plan: NodePlan) -> Generator[Request, Answer, None]:
    """Wait for a heartbeat or guarding response before the node is started; raise BootError K if none arrives."""
    yield NextStep("heartbeat")
    # CiA 302-2, error status K: error control did not start
    if plan.supervision_ns and not (yield AwaitState(plan.supervision_ns)):
        message = "answer to guarding" if plan.guard else "heartbeat"
        raise boot_error(plan, "K", f"no {message} within {plan.supervision_ns / 1e9:g} s")


def _start(plan: NodePlan) -> Generator[Request, Answer, None]:
    """Send NMT start, at most `NMT_TRIES` times, until a heartbeat or TPDO confirms OPERATIONAL.

    Raise BootError T if none does; if nothing can confirm the state, send NMT start once.
    """
    yield NextStep("start")
    if not plan.supervision_ns and not plan.tpdos:
        yield SendNmt(NmtCommand.START)  # nothing could confirm the state
        return
    for _ in range(NMT_TRIES):
        yield SendNmt(NmtCommand.START)
        if (yield AwaitState(STATE_NS + plan.supervision_ns, NmtState.OPERATIONAL)):
            return
    raise boot_error(plan, "T", f"NMT start was sent {NMT_TRIES} times, but no heartbeat or TPDO confirmed OPERATIONAL")


def _read_optional(
    plan: NodePlan, letter: str, transfers: BootTransfers, index: int, subindex: int, *, signed: bool = False
) -> Generator[Request, Answer, int | None]:
    """Read an optional number; return None if the node refuses.

    Raise BootError with `letter` if there is no answer, or one of the wrong length.
    """
    try:
        return (yield from transfers.number(index, subindex, signed=signed))
    except (SdoTimeout, SdoLengthError) as error:
        raise boot_error(plan, letter, f"reading 0x{index:04X}:{subindex:02X}: {reason_of(error)}") from error


def _write_optional(transfers: BootTransfers, index: int, data: bytes) -> Generator[Request, Answer, None]:
    try:
        yield from transfers.write(index, 0, data)
    except SdoAbort as error:
        transfers.warnings.append(f"it refuses 0x{index:04X}:00 = 0x{data[::-1].hex()}: {reason_of(error)}")


def _mismatch(plan: NodePlan, letter: str, title: str, actual: int, expected: int) -> BootError:
    actual_text = f"0x{actual:08X}" if actual >= 0 else "missing"
    hint = "check the device with this node-ID, and its EDS"
    if letter == "C" and not actual:  # device type without a profile, as boot-loaders show it (CiA 302-3)
        hint = "it may be in its boot-loader without a program, which `firmware` loads; else check device and EDS"
    return boot_error(plan, letter, f"{title} is {actual_text}, expected 0x{expected:08X} (from {plan.source}); {hint}")


# Execution of a boot: passes the requests of `boot` to the SDO client and to NMT, and the answers back.
#
# No call blocks. The generator is resumed when an SDO transfer has ended, a boot-up or heartbeat was received, or a
# timeout has expired.


_WAITS = (AwaitBootUp, AwaitState, AwaitHeartbeat)


@dataclass(frozen=True, slots=True)
class FinishedStep:
    """Completed step of a boot, with its duration and error."""

    name: str
    seconds: float
    error: str = ""


class BootTask:
    """Running boot of a node, or another task of boot requests, which ends with a `result` or an `error`.

    A `disabling` task is `disable_axes`, not `boot`; its result is None. `count_tpdos` returns the number of TPDOs
    received from the node: a new TPDO proves OPERATIONAL like a heartbeat.
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
        disabling: bool = False,
    ) -> None:
        self.result: BootResult | None = None
        self.error: CanopenError | None = None
        self.done = False
        """Whether the task has ended, successfully or not."""
        self.steps: list[FinishedStep] = []
        self.started = now
        self._generator: Generator[Request, Answer, BootResult | None] = (
            disable_axes(plan, restarting=reset) if disabling else boot(plan, reset=reset)
        )
        self._sdo, self._send_nmt, self._count_tpdos = sdo, send_nmt, count_tpdos
        self._sdo_timeout = plan.sdo_timeout_ns
        self._tpdos = 0
        self._step, self._step_since = "", now
        self._waiting: Request | None = None
        self._deadline = 0
        self._resume(now, lambda: next(self._generator))

    @property
    def step(self) -> str:
        return self._step

    @property
    def awaits_boot_up(self) -> bool:
        return isinstance(self._waiting, AwaitBootUp)

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick`, 0 to check for a TPDO at once, or None if no tick is needed."""
        if self._accepts_tpdos:
            return 0
        return self._deadline if isinstance(self._waiting, _WAITS) else None

    def boot_up(self, now: int) -> None:
        """Handle a boot-up message of the node; no effect unless the boot waits for the message."""
        if self.awaits_boot_up:
            self._answer(True, now)

    def heartbeat(self, state: NmtState | None, now: int) -> None:
        """Handle a heartbeat or guarding response, which may end the current wait."""
        waiting = self._waiting
        if isinstance(waiting, AwaitHeartbeat) and state is not None:
            self._answer(state, now)
        elif isinstance(waiting, AwaitState) and waiting.state in (None, state):
            self._answer(True, now)

    def tick(self, now: int) -> None:
        """End the current wait if its timeout has expired or a TPDO was received."""
        if self._accepts_tpdos and self._count_tpdos() > self._tpdos:
            self._answer(True, now)
        elif isinstance(self._waiting, _WAITS) and now >= self._deadline:
            self._answer(None if isinstance(self._waiting, AwaitHeartbeat) else False, now)

    def transfer_ended(self, request: SdoRequest, now: int) -> None:
        """Resume the boot after its SDO transfer has ended; other transfers are ignored."""
        if self.done or request is not self._transfer:
            return
        if request.error is not None:
            error = request.error
            self._resume(now, lambda: self._generator.throw(error))
        else:
            self._answer(None if request.is_write else request.data, now)

    def cancel(self) -> None:
        """Cancel the boot; responses to pending SDO requests are ignored."""
        self._generator.close()
        self._waiting = None
        self._transfer = None

    _transfer: SdoRequest | None = None

    @property
    def _accepts_tpdos(self) -> bool:
        return isinstance(self._waiting, AwaitState) and self._waiting.state is NmtState.OPERATIONAL

    def _answer(self, value: Answer, now: int) -> None:
        self._resume(now, lambda: self._generator.send(value))

    def _resume(self, now: int, advance: Callable[[], Request]) -> None:
        """Resume the generator with `advance`, and continue until the next wait or the end of the generator."""
        self._waiting = None
        try:
            request = advance()
            while isinstance(request, NextStep | SendNmt):
                self._do(request, now)
                request = self._generator.send(None)
        except StopIteration as end:
            self._enter("", now)
            self.result, self.done = end.value, True
        except CanopenError as error:
            self._enter("", now, str(error))
            self.error, self.done = error, True
        else:
            self._wait_for(request, now)

    def _do(self, request: NextStep | SendNmt, now: int) -> None:
        if isinstance(request, NextStep):
            self._enter(request.name, now)
        else:
            self._send_nmt(request.command)

    def _wait_for(self, request: Request, now: int) -> None:
        self._waiting = request
        if isinstance(request, Read):
            self._transfer = self._sdo.read(request.index, request.subindex, timeout_ns=self._sdo_timeout, now=now)
        elif isinstance(request, WriteObject):
            timeout = request.timeout_ns or self._sdo_timeout
            self._transfer = self._sdo.write(request.index, request.subindex, request.data, timeout_ns=timeout, now=now)
        elif isinstance(request, _WAITS):
            self._deadline, self._tpdos = now + request.timeout_ns, self._count_tpdos()

    def _enter(self, name: str, now: int, error: str = "") -> None:
        if self._step:
            self.steps.append(FinishedStep(self._step, (now - self._step_since) / 1e9, error))
        self._step, self._step_since = name, now
