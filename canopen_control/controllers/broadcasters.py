"""Broadcasters of everything that is no joint state: inputs and outputs, and how the drives are.

The law of the file: a broadcaster claims nothing and publishes, once per update, what the states are. The inputs and
outputs are the states of the interfaces it is told (`digital_inputs` and `digital_outputs` of every drive by itself,
everything of a <gpio> when that is named under `joints`). The diagnostics judge each joint by what its drive says:
no news for `stale_after` is STALE, an error code is a fault, all else as everywhere (`rpc/messages/health.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from canopen_control.cia301.nmt import NmtState, state_of_byte
from canopen_control.cia402.state import decode_statusword
from canopen_control.controllers.base import ALL_STATES, Controller
from canopen_control.controllers.params import CommonParams
from canopen_control.controllers.state_copy import StateCopy
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, ReturnType
from canopen_control.rpc.messages.health import judge, stale
from canopen_control.rpc.messages.samples import DiagnosticsSample, GpioSample, JointDiagnosis
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.health import Verdict
    from canopen_control.rpc.messages.samples import Sample, Values

__all__ = ["DiagnosticsBroadcaster", "GpioBroadcaster"]


@dataclass(frozen=True)
class StateParams(CommonParams):
    """Parameters of both: empty `joints` or `interfaces` are all there are; `stale_after` in s."""

    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    stale_after: float = setting(0.5, low=1e-3)


class _StateBroadcaster(Controller):
    """Copies chosen states; those of a kind by themselves."""

    is_broadcaster: ClassVar[bool] = True
    moves_joints: ClassVar[bool] = False
    chosen: tuple[str, ...] = ()

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = StateParams()
        self._copy = StateCopy({})

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
        """Lay out what it tells; nothing to tell is a ControlError."""
        super().on_activate(commands, states, now)
        layout: dict[str, dict[str, StateInterface | None]] = {}
        for each in filter(self._wanted, states):
            layout.setdefault(each.joint, {})[each.interface] = each
        if not layout:
            wanted = ", ".join(self.params.interfaces or self.chosen) or "any interface"
            raise ControlError(f"{self.name}: no joint has a state of {wanted}; name others under `interfaces`")
        self._copy, self.joints = StateCopy(layout), tuple(layout)
        self.stamp = now

    def _wanted(self, state: StateInterface) -> bool:
        joints, interfaces = self.params.joints, self.params.interfaces
        if joints and state.joint not in joints:
            return False
        return state.interface in (interfaces or self.chosen) or bool(joints and not interfaces)

    def update(self, now: int, period: float) -> ReturnType:
        """Copy the states: a publication."""
        del period
        self._copy.take()
        self.stamp = now
        return ReturnType.OK


class GpioBroadcaster(_StateBroadcaster):
    """Tells the inputs and outputs of the drives and of <gpio> parts."""

    chosen = ("digital_inputs", DIGITAL_OUTPUTS)
    tells: ClassVar[type[Sample] | None] = GpioSample

    def sample(self, wall_offset_ns: int) -> GpioSample:
        """Return what they were at the last update."""
        return GpioSample(time=self.published(wall_offset_ns), parts=self._copy.by_joint())


class DiagnosticsBroadcaster(_StateBroadcaster):
    """Tells how the drives behind the joints are."""

    chosen = ("nmt_state", "statusword", "error_code", "age")

    tells: ClassVar[type[Sample] | None] = DiagnosticsSample

    def sample(self, wall_offset_ns: int) -> DiagnosticsSample:
        """Judge every joint by its values at the last update."""
        judged = [JointDiagnosis(joint, *self._judged(each), each) for joint, each in self._copy.by_joint().items()]
        return DiagnosticsSample(time=self.published(wall_offset_ns), joints=judged)

    def _judged(self, values: Values) -> Verdict:
        age, code, nmt, word = (values.get(key) for key in ("age", "error_code", "nmt_state", "statusword"))
        known = any(value is not None for value in values.values())
        if (verdict := stale(age, self.params.stale_after, known=known)) is not None:
            return verdict
        state = None if word is None else decode_statusword(int(word))
        name = "FAULT" if code else "" if state is None else state.name
        nmt_state = NmtState.OPERATIONAL if nmt is None else state_of_byte(int(nmt))
        return judge(
            [name] if name else [],
            ready=nmt_state is NmtState.OPERATIONAL,
            nmt=f"{nmt:g}" if nmt_state is None else nmt_state.text,
            error=f"error code 0x{int(code):04X}" if code else None,
        )
