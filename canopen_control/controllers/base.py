"""What every controller is: its lifecycle, its interfaces, its command.

The law of the file: a controller reads and writes `value` of the interfaces it was given at activation, nothing else;
it reads no clock, sends nothing, blocks nowhere. A command that is not finite or has the wrong size is refused with a
ControlError and counted: it is never applied and does not refresh a timeout. On every deactivation the velocity, effort
and acceleration targets become 0.0 (upstream leaves them; a wheel would turn on), position targets stay where they are.

A new controller is one class here or in any package: derive from `Controller`, and name it in the entry point group
`canopen_control.controllers` with its type as the name: `"my_robot/Dance" = "my_robot.dance:Dance"`.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from mypy_extensions import mypyc_attr

from canopen_control.controllers.common_params import CommonParams
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, OK, VELOCITY, ReturnType

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface

__all__ = ["ALL_STATES", "Controller", "ControllerEvent", "ControllerState", "Geometry", "zero_targets"]

ALL_STATES: Final = "*"
"""As the only state interface name: every state interface of the robot."""

_ZEROED: Final = frozenset({VELOCITY, EFFORT, ACCELERATION})


class Geometry(Protocol):
    """What the robot's description knows of its wheels, in m; None for what it does not say."""

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the distance of the wheels of both sides, by their joints."""
        ...

    def radius(self, wheels: Sequence[str]) -> float | None:
        """Return the radius of these wheels, by their joints."""
        ...


class ControllerState(enum.Enum):
    """The states of a controller (REP 2007's managed nodes)."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


def zero_targets(commands: Sequence[CommandInterface]) -> None:
    """Write 0.0 to every target that would keep something moving; a position target holds by itself."""
    for each in commands:
        if each.interface in _ZEROED:
            each.value = 0.0


@dataclass(frozen=True, slots=True)
class ControllerEvent:
    """Something that happened: `kind` is activated, deactivated, error, fallback, limited, or a controller's word."""

    kind: str
    controller: str
    text: str


@mypyc_attr(allow_interpreted_subclasses=True)
class Controller:
    """A controller with no interfaces that does nothing; the hooks are what a real one overrides.

    `commands` and `states` are its interfaces while it is active, in the order it named them. `rejected` counts the
    commands it refused. `topic` is where ROS sends commands, None if it takes none. `publishes` are the topics of joint
    states that ROS gets of it, relative to the robot's namespace, and `frame_id` is the frame of their headers. `tells`
    is what stands in them: by joint and name, the state interface that a value is read from, None for a constant 0.0.
    """

    is_broadcaster: ClassVar[bool] = False
    topic: ClassVar[str | None] = None

    def __init__(self, name: str, type_name: str = "") -> None:
        self.name, self.type = name, type_name
        self.state = ControllerState.UNCONFIGURED
        self.update_rate = 0
        self.rejected = 0
        self.publishes: tuple[str, ...] = ()
        self.frame_id = ""
        self.joints: tuple[str, ...] = ()
        self.interface: str | None = None
        self.tells: dict[str, dict[str, str | None]] = {}
        self.commands: list[CommandInterface] = []
        self.states: list[StateInterface] = []
        self.description_joints: tuple[str, ...] | None = None
        """The movable joints of the robot's description, set by the manager; None if there is no description."""
        self.geometry: Geometry | None = None
        """The wheels of the robot's description, set by the manager; None if there is no description."""
        self.notices: list[ControllerEvent] = []
        """What it has told; once it is loaded it is the manager's list, in which all tell."""

    # ----------------------------------------------------------------------------------------------------- hooks

    def on_configure(self, params: Params) -> None:
        """Read the parameters; raise ConfigError with every mistake in them."""
        self.update_rate = params.read(CommonParams).update_rate

    def command_interface_names(self) -> list[str]:
        """Return what it claims when active, as "joint/interface"."""
        return []

    def state_interface_names(self) -> list[str]:
        """Return what it reads, as "joint/interface"; `[ALL_STATES]` is everything."""
        return []

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        """Return what another controller may command instead of a topic (chaining); the same objects every time."""
        return ()

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Take the interfaces; `now` in ns. An override calls this first."""
        del now
        self.commands, self.states = commands, states

    def on_deactivate(self, now: int) -> None:
        """Stop: every velocity, effort and acceleration target becomes 0.0."""
        del now
        zero_targets(self.commands)

    def on_cleanup(self) -> None:
        """Forget the configuration."""

    def update(self, now: int, period: float) -> ReturnType:
        """Do one step in the cycle; `now` in ns, `period` since its last step in s."""
        del now, period
        return OK

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Take a command; `stamp` is when it was made, `now` when it came, both in ns. ControlError if refused."""
        del values, now, stamp
        raise self.refusal("takes no commands; it only reads states")

    # ------------------------------------------------------------------------------------------------ for overrides

    def refusal(self, reason: str) -> ControlError:
        """Count a refused command and return the error to raise."""
        self.rejected += 1
        return ControlError(f"{self.name} {reason}")

    def checked(self, values: Sequence[object], names: Sequence[str]) -> None:
        """Refuse a command that is no finite number for each name, or that comes while not active."""
        if self.state is not ControllerState.ACTIVE:
            raise self.refusal(f"is {self.state.value}; activate it before commanding it")
        if len(values) != len(names):
            raise self.refusal(
                f"wants {len(names)} values ({', '.join(names)}), got {len(values)}; nothing was applied"
            )
        for name, value in zip(names, values, strict=True):
            if not _finite(value):
                raise self.refusal(f"wants finite numbers, got {value!r} for {name}; nothing was applied")

    def tell(self, kind: str, text: str) -> None:
        """Report something that happened; it comes out of the manager's events()."""
        self.notices.append(ControllerEvent(kind, self.name, f"{self.name}: {text}"))


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
