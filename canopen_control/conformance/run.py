"""Run of the checks on one node, and the results.

All parameters are read before the first check and compared after the last. Differences are written back if the checks
of the run may write, and are only reported otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.cia301.sdo_codec import ANSWER_BASE, REQUEST_BASE
from canopen_control.conformance.check import Check, CheckLevel, CheckTouch, upload_request
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.conformance.drive_checks import DRIVE_CHECKS
from canopen_control.conformance.message_checks import MESSAGE_CHECKS
from canopen_control.conformance.motion_checks import MOTION_CHECKS
from canopen_control.conformance.nmt_checks import LSS_CHECKS, MANAGER_CHECKS, NMT_CHECKS
from canopen_control.conformance.pdo_checks import PDO_CHECKS
from canopen_control.conformance.sdo_block_checks import BLOCK_CHECKS
from canopen_control.conformance.sdo_checks import EDS_CHECKS, SDO_CHECKS
from canopen_control.errors import BusError, CanopenError, ConfigError, RemoteProtocolError, SdoTimeout

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.od.model import Address


CHECKS: tuple[Check, ...] = (
    *EDS_CHECKS,
    *SDO_CHECKS,
    *BLOCK_CHECKS,
    *NMT_CHECKS,
    *MESSAGE_CHECKS,
    *PDO_CHECKS,
    *LSS_CHECKS,
    *MANAGER_CHECKS,
    *DRIVE_CHECKS,
    *MOTION_CHECKS,
)
ORDER = tuple(CheckTouch)  # checks that read run first, those that move the drive last
PASSED, FAILED, SKIPPED, ERROR = "passed", "failed", "skipped", "error"
# Commands, histories and objects that move a drive are never written back, whether the EDS maps them or not.
_MOVING = (0x6040, 0x6042, 0x6060, 0x6071, 0x607A, 0x60FF)
_NOT_PARAMETERS = frozenset((0x1001, 0x1003, 0x1010, 0x1011, *range(0x1F50, 0x1F60), *_MOVING))
_OF_TIMES = ("7.5.2.37", "7.2.8.2", "7.2.5.2")  # clauses of PDOs, heartbeats and SYNC, whose checks measure times
_REPETITIONS = 2
_IDENTITY = (
    ("device type", 0x1000, 0),
    ("vendor", 0x1018, 1),
    ("product", 0x1018, 2),
    ("revision", 0x1018, 3),
    ("serial", 0x1018, 4),
)
_SILENCES = 3  # consecutive checks without an answer, after which the device counts as gone


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of one check; `observed` and `expected` describe a failure, `frames` are the last frames before it."""

    id: str
    group: str
    clause: str
    title: str
    level: str
    verdict: str
    observed: str = ""
    expected: str = ""
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    frames: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class ConformanceReport:
    """Results of a run; `subject` is "device" or "master", `node_id` is the device's in both cases."""

    node_id: int
    identity: dict[str, str]
    results: list[CheckResult]
    subject: str = "device"

    @property
    def name(self) -> str:
        """Name of the subject in reports: "node 5" or "the master of node 5"."""
        return f"node {self.node_id}" if self.subject == "device" else f"the {self.subject} of node {self.node_id}"

    @property
    def failed(self) -> bool:
        """Whether a mandatory check failed or ended with an error."""
        return any(
            result.level == CheckLevel.MUST.value and result.verdict in (FAILED, ERROR) for result in self.results
        )

    def count(self, verdict: str) -> int:
        return sum(result.verdict == verdict for result in self.results)


def choose(level: str, allowed: Collection[CheckTouch]) -> list[Check]:
    """Return the checks of a document (`level`; "all": every document) that `allowed` permits, in running order."""
    chosen = [check for check in CHECKS if level in ("all", check.group) and check.touch in allowed]
    return sorted(chosen, key=lambda check: ORDER.index(check.touch))


def run_checks(
    node: CheckedNode, checks: Sequence[Check], progress: Callable[[int, int], object] = lambda _done, _total: None
) -> ConformanceReport:
    """Run `checks` and return the report; raise ConfigError if the node is silent, not unique, or not that of its EDS.

    Raise BusError if the bus is lost. `progress` is called with the number of completed checks and the total.
    """
    identity = _identity(node)
    _refuse_confusion(node)
    before = _parameters(node)
    results: list[CheckResult] = []
    silences, reason = 0, ""
    for number, check in enumerate(checks):
        progress(number, len(checks))
        if silences >= _SILENCES:
            reason = reason or _reason_of_silence(node, identity)
            results.append(_result(check, ERROR, actual=f"not run: {reason}"))
            continue
        result, silent = _run(node, check)
        results.append(result)
        silences = silences + 1 if silent else 0
    writes = any(check.touch is not CheckTouch.READ for check in checks)
    results += _flood(node), _compare(node, before, restore=writes)
    return ConformanceReport(node.node_id, identity, results)


def _identity(node: CheckedNode) -> dict[str, str]:
    try:
        device_type = node.read(0x1000)
    except SdoTimeout:
        raise ConfigError(
            f"node {node.node_id} on {node.port.channel} does not answer; list the nodes with "
            f"`canopen-control scan --can {node.port.channel}`"
        ) from None
    except CanopenError as error:
        if isinstance(error, BusError):
            raise
        device_type = b""
    identity = {"device type": device_type[::-1].hex().upper()}
    for name, index, subindex in _IDENTITY[1:]:
        try:
            identity[name] = node.read(index, subindex)[::-1].hex().upper()
        except RemoteProtocolError:
            continue
    return identity


def _refuse_confusion(node: CheckedNode) -> None:
    """Raise ConfigError if two nodes respond with the same id, or if the EDS describes another device."""
    request = upload_request(0x1000)
    if all(len(node.answers(request, 0.05)) > 1 for _ in range(3)):  # a bus can deliver a single frame twice
        raise ConfigError(
            f"two nodes on {node.port.channel} answer as node {node.node_id}; disconnect one of them, and give it "
            "another node-ID"
        )
    if node.eds is None:
        return
    for name, subindex in (("vendor", 1), ("product", 2)):
        entry = node.described(0x1018, subindex)
        default = 0 if entry is None or not isinstance(entry.default, int) else entry.default
        try:
            shown = int.from_bytes(node.read(0x1018, subindex), "little")
        except RemoteProtocolError:
            continue
        if default and shown and shown != default:
            raise ConfigError(
                f"{node.eds.path} describes another device: its {name} is 0x{default:08X}, node {node.node_id} has "
                f"0x{shown:08X}; give the EDS of this device with --eds"
            )


_FLOOD = 2000  # frames of one identifier per second; the limit of 1 Mbit/s is about 8000
_LATE_S = 5.0  # timeout for a device that answers late


def _reason_of_silence(node: CheckedNode, identity: Mapping[str, str]) -> str:
    """Return why the device does not respond: late answers, another node-ID, absence, or a flooded bus."""
    node.listen(1.0)  # discard answers to earlier requests
    begin = node.reactor.now()
    if (
        node.exchange(REQUEST_BASE + node.node_id, upload_request(0x1000), ANSWER_BASE + node.node_id, _LATE_S)
        is not None
    ):
        seconds = (node.reactor.now() - begin) / 1e9
        if seconds > node.timeout_s:
            more = f"give --timeout {2 * seconds:.1f}"
            return f"the device answers after {seconds:.1f} s, later than {node.timeout_s:g} s; {more}"
        return "the device did not answer for some time; run the checks again"
    flood = _floods(node)
    for other in sorted(set(node.last_seen_ns) - {node.node_id}):
        if _identity_of(node, other) == identity:
            return f"the device changed its node-ID: node {other} has its identity now"
    return f"the device stopped answering; {flood}" if flood else "the device stopped answering"


def _identity_of(node: CheckedNode, other: int) -> dict[str, str]:
    """Return the identity that the node `other` reports, in hexadecimal by field; unanswered fields are omitted."""
    identity = {}
    for name, index, subindex in _IDENTITY:
        data = node.exchange(REQUEST_BASE + other, upload_request(index, subindex), ANSWER_BASE + other)
        if data is not None and data[0] & 0xE2 == 0x42:
            identity[name] = data[4:8][::-1].hex().upper()
    return identity


def _floods(node: CheckedNode) -> str:
    """Return a text about identifiers received too often (other than the device's SDO responses), or ""."""
    answers = ANSWER_BASE + node.node_id
    often = {can_id: rate for can_id, rate in node.rates.items() if rate >= _FLOOD and can_id != answers}
    return ", ".join(
        f"0x{can_id & 0x1FFFFFFF:03X} was received {rate} times in a second" for can_id, rate in often.items()
    )


def _flood(node: CheckedNode) -> CheckResult:
    check = Check("Z02", "301", "7.2.2", "no identifier floods the bus", CheckLevel.SHOULD, CheckTouch.READ, _nothing)
    text = _floods(node)
    if text:
        return _result(check, FAILED, text, f"fewer than {_FLOOD} per second")
    return _result(check, PASSED)


def _run(node: CheckedNode, check: Check) -> tuple[CheckResult, bool]:
    """Return the result of a check, and whether it ended because the device did not respond.

    A check that measures times is repeated before it counts as failed, because this computer or its adapter may have
    been late.
    """
    result, silent = _run_once(node, check)
    first = result
    for _ in range(_REPETITIONS if check.clause in _OF_TIMES else 0):
        if result.verdict != FAILED or silent:
            break
        result, silent = _run_once(node, check)
    if first.verdict == FAILED and result.verdict == PASSED:
        result.notes.append(f"failed at first and passed when repeated; first result: {first.observed}")
    return result, silent


def _run_once(node: CheckedNode, check: Check) -> tuple[CheckResult, bool]:
    node.begin()
    begin = node.reactor.now()
    verdict, actual, expected, silent = PASSED, "", "", False
    try:
        check.run(node)
    except NotApplicable as reason:
        verdict, actual = SKIPPED, str(reason)
    except CheckFailed as failure:
        verdict, actual, expected = FAILED, failure.observed, failure.expected
    except SdoTimeout as error:
        verdict, actual, expected, silent = FAILED, str(error), "an answer", True
    except RemoteProtocolError as error:
        verdict, actual, expected = FAILED, str(error), "a transfer without an abort"
    seconds = (node.reactor.now() - begin) / 1e9
    frames = list(node.log) if verdict == FAILED else []
    return _result(check, verdict, actual, expected, seconds, list(node.notes), frames), silent


def _result(
    check: Check,
    verdict: str,
    actual: str = "",
    expected: str = "",
    seconds: float = 0.0,
    notes: Sequence[str] = (),
    frames: Sequence[str] = (),
) -> CheckResult:
    level = check.level.value
    of_check = check.id, check.group, check.clause, check.title, level
    return CheckResult(*of_check, verdict, actual, expected, seconds, list(notes), list(frames))


# -- restoring the device


def _parameters(node: CheckedNode) -> dict[Address, bytes]:
    """Read everything that a check could change: all objects that are readable and writable, except process data."""
    if node.eds is None:
        return {}
    values: dict[Address, bytes] = {}
    for entry in node.eds.od:
        if entry.readable and entry.writable and not entry.pdo_mappable and entry.index not in _NOT_PARAMETERS:
            try:
                values[entry.address] = node.read(*entry.address)
            except RemoteProtocolError:
                continue
    return values


def _compare(node: CheckedNode, before: Mapping[Address, bytes], *, restore: bool) -> CheckResult:
    """Compare the parameters with their values before the run; with `restore`, write changed ones back."""
    node.begin()
    check = Check(
        "Z01", "301", "7.4", "the parameters of the device are unchanged", CheckLevel.MUST, CheckTouch.READ, _nothing
    )
    if node.eds is None:
        return _result(check, SKIPPED, "no EDS that lists the parameters; give one with --eds")
    try:
        node.read(0x1000)  # no further requests to a device that is gone
        after = _parameters(node)
        changed = [address for address, value in before.items() if after.get(address) != value]
        for address in changed if restore else ():
            node.write(address[0], address[1], before[address])
    except RemoteProtocolError as error:
        return _result(check, FAILED, f"a parameter could not be restored: {error}", "the value before the run")
    done = "was restored" if restore else "changed during the run, and was left so"
    notes = [f"0x{index:04X}:{subindex:02X} {done}" for index, subindex in changed]
    return _result(check, PASSED, notes=notes)


def _nothing(_session: CheckedNode) -> None: ...
