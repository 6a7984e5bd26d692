"""Joint state broadcaster: publishes the measured states of all joints.

Rules (ros2_controllers jazzy): `names` are the joints of a JointState message, whose arrays have the same length; the
value of a missing interface is unknown. With a description only its movable joints are included, in alphabetical order;
without a description the joints are in the order of their interfaces. `joints` and `interfaces` restrict the states
only when both are given. An extra joint is 0.0, unless one of its state interfaces is read. The broadcaster publishes
the measured states once per update, so that `update_rate` is the rate of its topics. These are `joint_states` and,
unless `publish_dynamic_joint_states` is false, `dynamic_joint_states`, below the controller's name with
`use_local_topics`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ALL_STATES, Controller, StateCopy
from canopen_control.controllers.params import RENAMES, BroadcasterParams
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import JointStatesSample
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample

    Layout = dict[str, dict[str, StateInterface | None]]


_KINDS: Final = (POSITION, VELOCITY, EFFORT)


class JointStateBroadcaster(Controller):
    """Broadcaster of joint states; `names` are the joints in the order of a JointState message."""

    title: ClassVar[str] = "Joint states"
    reads: ClassVar[type[BroadcasterParams]] = BroadcasterParams
    is_broadcaster: ClassVar[bool] = True
    sample_type: ClassVar[type[Sample] | None] = JointStatesSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = BroadcasterParams()
        self.names: tuple[str, ...] = ()
        self._copy = StateCopy({})

    def on_configure(self, params: Params) -> None:
        self.params = params.read(BroadcasterParams, RENAMES)
        self.update_rate = self.params.update_rate
        self.publishes, self.frame_id = self._topics(), self.params.frame_id

    def _topics(self) -> tuple[str, ...]:
        prefix = f"{self.name}/" if self.params.use_local_topics else ""
        dynamic = ("dynamic_joint_states",) if self.params.publish_dynamic_joint_states else ()
        return tuple(f"{prefix}{topic}" for topic in ("joint_states", *dynamic))

    def state_interface_names(self) -> list[str]:
        if self.params.joints and self.params.interfaces:
            return [f"{joint}/{interface}" for joint in self.params.joints for interface in self.params.interfaces]
        return [ALL_STATES]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        if not states:
            raise ControlError(
                f"{self.name}: no state interface exists; give the joints <state_interface> tags, and map "
                "0x6064 or 0x606C into TPDOs of their drives"
            )
        columns = {self.params.position: POSITION, self.params.velocity: VELOCITY, self.params.effort: EFFORT}
        layout = self._layout(states, columns)
        self.names = self.joints = self._order(states, columns, layout)
        self._copy = StateCopy(layout)
        self.stamp = now

    def _layout(self, states: list[StateInterface], columns: dict[str, str]) -> Layout:
        layout: Layout = {}
        for state in states:
            names = layout.setdefault(state.joint, {})
            if state.interface in columns or state.interface not in _KINDS:  # the name belongs to another column
                names[columns.get(state.interface, state.interface)] = state
        for extra in self.params.extra_joints:
            layout.setdefault(extra, dict.fromkeys(_KINDS))
        return layout

    def _order(self, states: list[StateInterface], columns: dict[str, str], layout: Layout) -> tuple[str, ...]:
        joints = list(dict.fromkeys(state.joint for state in states if state.interface in columns))
        if self.params.use_urdf_to_filter and self.description_joints is not None:
            joints = sorted(set(joints) & set(self.description_joints))
        extras = [joint for joint in dict.fromkeys(self.params.extra_joints) if None in layout[joint].values()]
        return (*joints, *extras)

    def update(self, now: int, period: float) -> ReturnType:
        del period
        self._copy.refresh()
        self.stamp = now
        return OK

    def sample(self, wall_offset_ns: int) -> JointStatesSample:
        return JointStatesSample(time=self.published(wall_offset_ns), names=self.names, joints=self._copy.by_joint())
