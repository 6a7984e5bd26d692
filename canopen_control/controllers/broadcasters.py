"""Broadcasters of everything that is no joint state: inputs and outputs, and how the drives are.

The law of the file: a broadcaster claims nothing and copies states into arrays made at activation. The inputs and
outputs are the states of the interfaces it is told (`digital_inputs` and `digital_outputs` of every drive by itself,
everything of a <gpio> when that is named under `joints`). The diagnostics judge each joint by what its drive says, in
this order: no news for `stale_after` is STALE, an error code or a fault in the statusword is ERROR, an NMT state that
is not OPERATIONAL is WARN, else OK (the levels of diagnostic_msgs).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

from canopen_control.controllers.base import ALL_STATES, Controller
from canopen_control.controllers.common_params import CommonParams
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import ReturnType
from canopen_control.yamltree import setting

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface

__all__ = ["DiagnosticsBroadcaster", "GpioBroadcaster", "JointStatus"]

OK, WARN, ERROR, STALE = 0, 1, 2, 3
OPERATIONAL: Final = 5
FAULT_BIT: Final = 0x08
NMT_STATES: Final = {0: "initialising", 4: "stopped", 5: "operational", 127: "pre-operational"}


@dataclass(frozen=True)
class StateParams(CommonParams):
    """Parameters of both: empty `joints` or `interfaces` are all there are; `stale_after` in s."""

    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    stale_after: float = setting(0.5, low=1e-3)


class _StateBroadcaster(Controller):
    """Copies chosen states; `names` are "joint/interface", `values` what they are (nan: not known), `stamp` in ns."""

    is_broadcaster: ClassVar[bool] = True
    chosen: tuple[str, ...] = ()

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = StateParams()
        self.stamp = 0
        self.names: list[str] = []
        self.values: list[float] = []
        self._sources: list[StateInterface] = []

    def on_configure(self, params: Params) -> None:
        """Read the parameters."""
        self.params = params.read(StateParams)
        self.update_rate = self.params.update_rate

    def state_interface_names(self) -> list[str]:
        """Return joints times interfaces if both are given, else everything, to choose from at activation."""
        if self.params.joints and self.params.interfaces:
            return [f"{joint}/{each}" for joint in self.params.joints for each in self.params.interfaces]
        return [ALL_STATES]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Lay out the arrays; nothing to tell is a ControlError."""
        super().on_activate(commands, states, now)
        self._sources = [each for each in states if self._wanted(each)]
        if not self._sources:
            wanted = ", ".join(self.params.interfaces or self.chosen) or "any interface"
            raise ControlError(f"{self.name}: no joint has a state of {wanted}; name others under `interfaces`")
        self.names = [each.name for each in self._sources]
        self.values = [each.value for each in self._sources]
        self.joints = tuple(dict.fromkeys(each.joint for each in self._sources))
        self.stamp = now

    def _wanted(self, state: StateInterface) -> bool:
        joints, interfaces = self.params.joints, self.params.interfaces
        if joints and state.joint not in joints:
            return False
        return state.interface in (interfaces or self.chosen) or bool(joints and not interfaces)

    def update(self, now: int, period: float) -> ReturnType:
        """Copy the states into the array."""
        del period
        index = 0
        for each in self._sources:
            self.values[index] = each.value
            index += 1  # noqa: SIM113 - enumerate makes a tuple per state in the cycle
        self.stamp = now
        return ReturnType.OK

    def by_joint(self) -> dict[str, dict[str, float]]:
        """Return the values by joint and interface."""
        found: dict[str, dict[str, float]] = {}
        for source, value in zip(self._sources, self.values, strict=True):
            found.setdefault(source.joint, {})[source.interface] = value
        return found


class GpioBroadcaster(_StateBroadcaster):
    """Tells the inputs and outputs of the drives and of <gpio> parts."""

    chosen = ("digital_inputs", "digital_outputs")


@dataclass(frozen=True, slots=True)
class JointStatus:
    """How a joint is: `level` 0 OK, 1 WARN, 2 ERROR, 3 STALE; `values` what it was judged by, by interface."""

    name: str
    level: int
    message: str
    values: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return the fields for JSON, None for what is not known."""
        known = {key: value if math.isfinite(value) else None for key, value in self.values.items()}
        return {"name": self.name, "level": self.level, "message": self.message, "values": known}


class DiagnosticsBroadcaster(_StateBroadcaster):
    """Tells how the drives behind the joints are."""

    chosen = ("nmt_state", "statusword", "error_code", "age")

    def statuses(self) -> list[JointStatus]:
        """Judge every joint by its last values."""
        return [JointStatus(joint, *self._judged(values), values) for joint, values in self.by_joint().items()]

    def _judged(self, values: dict[str, float]) -> tuple[int, str]:
        age, code, nmt = (values.get(key, math.nan) for key in ("age", "error_code", "nmt_state"))
        word = values.get("statusword", math.nan)
        if all(math.isnan(value) for value in values.values()) or age > self.params.stale_after:
            return STALE, "nothing is heard of it" if math.isnan(age) else f"no news for {age:.2f} s"
        if code > 0:
            return ERROR, f"error code 0x{int(code):04X}"
        if math.isfinite(word) and int(word) & FAULT_BIT:
            return ERROR, "in fault"
        if math.isfinite(nmt) and nmt != OPERATIONAL:
            return WARN, f"NMT state {NMT_STATES.get(int(nmt), int(nmt))}"
        return OK, "operational"
