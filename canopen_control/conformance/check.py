"""Definition of conformance checks: ids, clauses, levels, and effects on the device."""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import abort_text
from canopen_control.cia301.sdo_codec import ABORT
from canopen_control.conformance.checked_node import CheckFailed
from canopen_control.errors import SdoAbort

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from canopen_control.conformance.checked_node import CheckedNode


class CheckLevel(enum.Enum):
    """Level of a clause: mandatory (MUST) or recommended (SHOULD)."""

    MUST = "must"
    SHOULD = "should"


class CheckTouch(enum.Enum):
    """Effect of a check on the device; the value is the option that permits the check, or "" if none is needed."""

    READ = ""
    CONFIGURE = "--configure"
    STORE = "--store"
    MOTION = "--motion"


@dataclass(frozen=True, slots=True)
class Check:
    """Conformance check of the document `group`, such as "301"; `run` raises CheckFailed or NotApplicable."""

    id: str
    group: str
    clause: str
    title: str
    level: CheckLevel
    touch: CheckTouch
    run: Callable[[CheckedNode], None]


class CheckList(list[Check]):
    """Checks of one document, in the order of their declaration."""

    def __init__(self, group: str) -> None:
        self.group = group
        super().__init__()

    def add(
        self,
        check_id: str,
        clause: str,
        title: str,
        level: CheckLevel = CheckLevel.MUST,
        touch: CheckTouch = CheckTouch.READ,
    ) -> Callable[[Callable[[CheckedNode], None]], Callable[[CheckedNode], None]]:
        """Return a decorator that appends a function to the list as a check."""

        def append(run: Callable[[CheckedNode], None]) -> Callable[[CheckedNode], None]:
            self.append(Check(check_id, self.group, clause, title, level, touch, run))
            return run

        return append


_DOCUMENT = re.compile(r"^(CiA )?(301|302|305|306|402)(-[123])?, ")
_NAMED = re.compile(r"0x[0-9A-F]{4}|\d+(?:\.\d+)*")


def clause_names(text: str) -> frozenset[str]:
    """Return the sections and objects in a clause: 7.5.2.19 and 0x1016 for "CiA 301, 7.5.2.19 (0x1016)"."""
    return frozenset(_NAMED.findall(_DOCUMENT.sub("", text)))


GENERAL_ERROR = 0x08000000  # abort code that a device may always use (CiA 301, 7.2.4.3.17)


def expect(good: bool, actual: str, expected: str) -> None:
    """Raise CheckFailed unless `good`."""
    if not good:
        raise CheckFailed(actual, expected)


def expect_abort(node: CheckedNode, request: bytes, *codes: int) -> None:
    """Send a raw SDO request; raise CheckFailed unless the device aborts with one of `codes` or the general error."""
    answer = node.ask(request)
    expected = "abort " + " or ".join(f"0x{code:08X}" for code in codes)
    if answer is None:
        raise CheckFailed("no answer", expected)
    if answer[0] != ABORT or len(answer) != 8:
        node.ask(bytes((ABORT, *request[1:4], 0, 0, 0, 8)))  # ends a transfer that the request may have started
        raise CheckFailed(f"answer {answer.hex(' ').upper()}", expected)
    code = int.from_bytes(answer[4:], "little")
    expect(code in (*codes, GENERAL_ERROR), f"abort 0x{code:08X} ({abort_text(code)})", expected)


def aborts(request: bytes, *codes: int) -> Callable[[CheckedNode], None]:
    """Return a check of which `expect_abort` of a request is all."""
    return lambda node: expect_abort(node, request, *codes)


def expect_refused(node: CheckedNode, index: int, subindex: int, data: bytes, *codes: int) -> None:
    """Download a value; raise CheckFailed unless the device aborts with one of `codes` or the general error."""
    expected = "abort " + " or ".join(f"0x{code:08X}" for code in codes)
    try:
        node.write(index, subindex, data)
    except SdoAbort as error:
        actual = f"abort 0x{error.code:08X} ({abort_text(error.code)})"
        expect(error.code in (*codes, GENERAL_ERROR), actual, expected)
    else:
        raise CheckFailed(f"{data.hex(' ').upper()} was accepted by 0x{index:04X}:{subindex:02X}", expected)


def upload_request(index: int, subindex: int = 0) -> bytes:
    """Return the SDO request that initiates an upload."""
    return bytes((0x40, *mux(index, subindex), 0, 0, 0, 0))


def client_abort(index: int) -> bytes:
    """Return the SDO request with which a client aborts the transfer of an object, with code `GENERAL_ERROR`."""
    return bytes((ABORT, *mux(index), 0, 0, 0, 8))


def answer_text(answer: bytes | None) -> str:
    """Return a response in hexadecimal, or "no answer"."""
    return "no answer" if answer is None else answer.hex(" ").upper()


def expect_silence(answer: bytes | None, expected: str = "silence") -> None:
    """Raise CheckFailed if a response was received."""
    expect(answer is None, answer_text(answer), expected)


def expect_emergency(codes: Collection[int], expected: int) -> None:
    """Raise CheckFailed unless one of the EMCY messages with `codes` has the expected error code."""
    observed = ", ".join(f"0x{code:04X}" for code in codes) or "no EMCY"
    expect(expected in codes, observed, f"EMCY 0x{expected:04X}")


def mux(index: int, subindex: int = 0) -> bytes:
    """Return the multiplexer of an SDO request: index and subindex in three bytes."""
    return bytes((index & 0xFF, index >> 8, subindex))
