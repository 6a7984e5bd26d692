"""Where an axis' statusword and mode come from: a TPDO, else SDO, and not for longer than they are true.

The law of this file: a statusword has an age. While its TPDO comes, it is the TPDO's; when that fails, the last one
holds for `GRACE_NS`, is asked for by SDO meanwhile, and after that is unknown; one that never came is asked for too. A
mode that no PDO carries is written to 0x6060 when it is wanted and asked for at 0x6061 until it shows. A drive whose
statusword is gone is told to quick stop, since nobody can see what else it would do, and after a while to take its
power away, unless it holds a load.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.drive_goal import Goal
from canopen_control.errors import SdoAbort

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import Axis

__all__ = ["BLIND_STOP_NS", "GRACE_NS", "AxisStatus", "ModeBySdo", "StatuswordBySdo"]

GRACE_NS: Final = 300_000_000
POLL_NS: Final = 50_000_000
BLIND_STOP_NS: Final = 2_000_000_000  # for a ramp that nobody can watch
_QUICK_STOP_WORD: Final = 0x0002


class AxisStatus:
    """The statusword and the mode of an axis, whatever brings them; None for one that is not known.

    `machine` says which mode is wanted, where no PDO carries it. The power of an axis that holds a load is left on.
    """

    def __init__(self, axis: Axis, machine: DriveMachine, *, holds_load: bool = False) -> None:
        self.word: int | None = None
        self.display: int | None = None
        self._axis, self._machine = axis, machine
        self._pdo, self._statusword, self._place = axis.statusword.pdo, axis.statusword, axis.statusword.position
        self._node = axis.node
        self._shown = axis.display
        self._by_sdo = StatuswordBySdo(axis)
        self._mode = ModeBySdo(axis) if None in (axis.mode, axis.display) else None
        self._blind_since: int | None = None
        self._holds_load = holds_load

    def update(self, now: int) -> None:
        """Take what is new."""
        pdo, shown = self._pdo, self._shown
        if not self._node.ready:
            self.word = self.display = None
            return
        word: object = None
        if pdo.stamp < 0:
            word = self._unseen(now)
        elif pdo.overdue:
            word = self._by_sdo.word(self._statusword.value, now)
        else:
            word = pdo.values[self._place]
        self.word = word  # type: ignore[assignment]  # a statusword is an integer
        display: object = None
        if shown is not None and (showing := shown.pdo).stamp >= 0:
            display = showing.values[shown.position]
        if self._mode is not None and word is not None:
            self._mode.step(self._machine.mode, now)
            display = self._mode.display if shown is None else display
        self.display = display  # type: ignore[assignment]  # and so is a mode

    def _unseen(self, now: int) -> int | None:
        """Return the statusword of a drive whose TPDO has not come since its boot; a stop must see what becomes of it.

        Without SYNCs nothing says when the first one is due: it is asked for then by who waits for an end alone.
        """
        if self._pdo.overdue or self._machine.goal is not Goal.ENABLED:
            return self._by_sdo.word(None, now)
        return None

    def blind_word(self, now: int) -> int:
        """Return the controlword for a drive that nobody sees: a quick stop, then no power."""
        if self._blind_since is None:
            if self._pdo.stamp < 0:
                return 0  # never seen: not started yet
            self._blind_since = now
        stopping = self._holds_load or now - self._blind_since < BLIND_STOP_NS
        return _QUICK_STOP_WORD if stopping else 0

    @property
    def invisible(self) -> bool:
        """Whether nothing shows the statusword: no TPDO, and the node refuses to tell it by SDO."""
        return self.word is None and self._by_sdo.refused

    def came(self) -> None:
        """Say that the node is operational, or its TPDO is back."""
        self._by_sdo.end()
        self._blind_since = None

    def went(self, now: int) -> None:
        """Say that the node is gone."""
        self._by_sdo.end()
        self._blind_since = now
        if self._mode is not None:
            self._mode.forget()


class StatuswordBySdo:
    """The statusword of an axis whose TPDO does not come any more."""

    def __init__(self, axis: Axis) -> None:
        self.refused = False
        """Whether the node has answered by an abort, which another request will not change."""
        self._axis = axis
        self._value: int | None = None
        self._stamp = 0
        self._asking = False
        self._next = 0
        self._since: int | None = None

    def end(self) -> None:
        """Say that the TPDO is back, or the node gone."""
        self._since = self._value = None
        self.refused = False

    def word(self, last: int | None, now: int) -> int | None:
        """Return the statusword; `last` is the one that the TPDO brought before it failed, None: it never came."""
        if self._since is None:
            self._since, self._next = now, now
        if not self._asking and now >= self._next:
            self._asking, self._next = True, now + POLL_NS
            self._axis.node.read(self._axis.index(objects.STATUSWORD), 0, lambda request: self._answered(request, now))
        if self._value is not None and now - self._stamp <= GRACE_NS:
            return self._value
        return last if now - self._since <= GRACE_NS else None

    def _answered(self, request: SdoRequest, asked: int) -> None:
        self._asking = False
        self.refused = self._since is not None and isinstance(request.error, SdoAbort)
        if request.error is None and self._since is not None:
            self._value, self._stamp = int.from_bytes(request.data[:2], "little"), asked


class ModeBySdo:
    """0x6060 and 0x6061 of an axis where a PDO carries only one of them, or none."""

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self.display: int | None = None
        self._written: int | None = None
        self._asking = False
        self._next = 0

    def forget(self) -> None:
        """Say that the drive has restarted, or is gone."""
        self.display = self._written = None

    def step(self, mode: int | None, now: int) -> None:
        """Bring `mode` to the drive and its display here; nothing to do once it shows."""
        node, axis = self._axis.node, self._axis
        if mode is not None and axis.mode is None and mode != self._written:
            self._written = mode
            node.write(axis.index(objects.MODES_OF_OPERATION), 0, mode.to_bytes(1, "little", signed=True))
        settled = mode is None or self.display == mode
        if axis.display is not None or settled or self._asking or now < self._next:
            return
        self._asking, self._next = True, now + POLL_NS
        node.read(axis.index(objects.MODES_OF_OPERATION_DISPLAY), 0, self._answered)

    def _answered(self, request: SdoRequest) -> None:
        self._asking = False
        if request.error is None:
            self.display = int.from_bytes(request.data[:1], "little", signed=True)
