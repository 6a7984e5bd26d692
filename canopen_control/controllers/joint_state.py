"""The joint state broadcaster: what all joints measure, as arrays of one length.

The law of the file (ros2_controllers jazzy): `names`, `positions`, `velocities` and `efforts` have the same length, a
missing interface is nan; with a description only its movable joints are named, in alphabetical order, without one the
joints come in the order of their interfaces. `joints` and `interfaces` restrict only when both are given. An extra
joint is 0.0, unless a state interface of it is read. `tells` is this layout for who publishes it. Arrays are
made at activation and overwritten in place by every update. Its topics are `joint_states` and, unless
`publish_dynamic_joint_states` is false, `dynamic_joint_states`, below its own name with `use_local_topics`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ALL_STATES, Controller
from canopen_control.controllers.joint_state_params import RENAMES, BroadcasterParams
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import EFFORT, OK, POSITION, VELOCITY, ReturnType

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface

__all__ = ["JointStateBroadcaster"]

_KINDS: Final = (POSITION, VELOCITY, EFFORT)


class JointStateBroadcaster(Controller):
    """Gathers the states of the joints.

    `names` and the three arrays are what a JointState message holds; `stamp` is the time of the last update in ns.
    """

    is_broadcaster: ClassVar[bool] = True

    def __init__(self, name: str, type_name: str = "joint_state_broadcaster/JointStateBroadcaster") -> None:
        super().__init__(name, type_name)
        self.params = BroadcasterParams()
        self.stamp = 0
        self.names: list[str] = []
        self.positions: list[float] = []
        self.velocities: list[float] = []
        self.efforts: list[float] = []
        self._copies: list[tuple[list[float], int, StateInterface]] = []

    def on_configure(self, params: Params) -> None:
        """Read the parameters."""
        self.params = params.read(BroadcasterParams, RENAMES)
        self.update_rate = self.params.update_rate
        self.publishes, self.frame_id = self._topics(), self.params.frame_id

    def _topics(self) -> tuple[str, ...]:
        prefix = f"{self.name}/" if self.params.use_local_topics else ""
        dynamic = ("dynamic_joint_states",) if self.params.publish_dynamic_joint_states else ()
        return tuple(f"{prefix}{each}" for each in ("joint_states", *dynamic))

    def state_interface_names(self) -> list[str]:
        """Return joints times interfaces if both are given, else everything."""
        if self.params.joints and self.params.interfaces:
            return [f"{joint}/{interface}" for joint in self.params.joints for interface in self.params.interfaces]
        return [ALL_STATES]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Lay out the arrays; without any state interface there is nothing to tell, a ControlError."""
        super().on_activate(commands, states, now)
        if not states:
            raise ControlError(f"{self.name}: no state interface exists; give the joints <state_interface> tags")
        columns = {self.params.position: POSITION, self.params.velocity: VELOCITY, self.params.effort: EFFORT}
        self.tells = self._layout(states, columns)
        self.names = self._order(states, columns)
        arrays = {kind: [0.0 if self._is_extra(each) else math.nan for each in self.names] for kind in _KINDS}
        self.positions, self.velocities, self.efforts = arrays[POSITION], arrays[VELOCITY], arrays[EFFORT]
        self.joints = tuple(self.names)
        self._copies = [
            (arrays[columns[each.interface]], self.names.index(each.joint), each)
            for each in states
            if each.interface in columns and each.joint in self.names
        ]
        self.update(now, 0.0)

    def _layout(self, states: list[StateInterface], columns: dict[str, str]) -> dict[str, dict[str, str | None]]:
        layout: dict[str, dict[str, str | None]] = {}
        for each in states:
            names = layout.setdefault(each.joint, {})
            if each.interface in columns or each.interface not in _KINDS:  # else another one is told by this name
                names[columns.get(each.interface, each.interface)] = each.interface
        for extra in self.params.extra_joints:
            layout.setdefault(extra, dict.fromkeys(_KINDS))
        return layout

    def _is_extra(self, joint: str) -> bool:
        return None in self.tells[joint].values()

    def _order(self, states: list[StateInterface], columns: dict[str, str]) -> list[str]:
        joints = list(dict.fromkeys(each.joint for each in states if each.interface in columns))
        if self.params.use_urdf_to_filter and self.description_joints is not None:
            joints = sorted(set(joints) & set(self.description_joints))
        return [*joints, *filter(self._is_extra, dict.fromkeys(self.params.extra_joints))]

    def update(self, now: int, period: float) -> ReturnType:
        """Copy the states into the arrays."""
        del period
        for array, index, state in self._copies:
            array[index] = state.value
        self.stamp = now
        return OK

    def dynamic_joint_states(self) -> dict[str, dict[str, float]]:
        """Return every state by joint and name, the ones that are no position, velocity or effort too."""
        values = {(each.joint, each.interface): each.value for each in self.states}
        return {
            joint: {name: 0.0 if source is None else values[joint, source] for name, source in names.items()}
            for joint, names in self.tells.items()
        }
