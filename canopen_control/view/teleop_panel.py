"""Buttons that drive while they are held, on the page; only with `--teleop`.

The law of this file: what may be driven is what the active controllers take: a base by its twist, joints by values. The
callbacks only hand over to `DeadMan`, on the thread that owns it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Protocol

from canopen_control.view.controls import tell
from canopen_control.view.style import ICONS
from canopen_control.view.target_sliders import TargetSliders
from canopen_control.view.teleop import HOLD_HZ, Motion, joint_motion, twist_motion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import viser

    from canopen_control.view.model import Model

__all__ = ["Driver", "TeleopPanel"]

#: button, and what it makes of the speeds: linear and angular factor
_PAD: Final = {"forward": (1, 0), "left": (0, 1), "back": (-1, 0), "right": (0, -1)}
_LINEAR: Final = (0.0, 1.0, 0.2)  # m/s: lowest, highest, at first
_ANGULAR: Final = (0.0, 3.0, 0.8)  # rad/s
_LARGEST: Final = {"velocity": 10.0, "position": math.pi, "effort": 1.0}
_NOTHING: Final = "<div class='cc-box'><p class='cc-note'>No active controller takes commands.</p></div>"


class Driver(Protocol):
    """Who takes what is driven; see `app.ViewApp`."""

    def hold(self, page: int, motion: Motion, told: Callable[[str], None]) -> None:
        """Take note that a page holds a button; `told` gets a sentence if it may not drive. From any thread."""
        ...

    def ask(self, method: str, params: dict[str, Any]) -> str | None:
        """Ask the robot and wait."""
        ...


class TeleopPanel:
    """A folder that follows the controllers; `show` builds it anew when they have changed."""

    def __init__(self, gui: viser.GuiApi, driver: Driver, model: Model) -> None:
        self._gui, self._driver = gui, driver
        self._joints = {joint.name: joint for joint in model.joints}
        self._positions: Mapping[str, float | None] = {}
        self._folder = gui.add_folder("Drive: hold a button")
        self._parts: list[Any] = []
        self._targets: TargetSliders | None = None
        self._shown: object = None

    def show(self, controllers: Sequence[Mapping[str, Any]]) -> None:
        """Build what fits the controllers that take commands: a choice of them, and the active one's buttons."""
        takers = [each for each in controllers if each["topic"] in ("commands", "cmd_vel")]
        key = [(each["name"], each["state"]) for each in takers]
        if key == self._shown:
            return
        self._shown = key
        for part in self._parts:
            part.remove()
        self._parts.clear()
        self._targets = None
        with self._folder:
            active = [each for each in takers if each["state"] == "active"]
            if not active:
                self._parts.append(self._gui.add_html(_NOTHING))
            if len(takers) > 1:
                self._choice(takers, active)
            for each in active[:1]:
                self._pad(each) if each["topic"] == "cmd_vel" else self._sliders(each)

    def follow(self, positions: Mapping[str, float | None]) -> None:
        """Take note where the joints are, so that position targets can rest there."""
        self._positions = positions
        if self._targets is not None:
            self._targets.follow(positions)

    def _choice(self, takers: Sequence[Mapping[str, Any]], active: Sequence[Mapping[str, Any]]) -> None:
        names = [str(each["name"]) for each in takers]
        first = str(active[0]["name"]) if active else "none"
        choice = self._gui.add_dropdown(
            "controller", tuple(names if active else ["none", *names]), initial_value=first, hint="who moves the joints"
        )

        @choice.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            others = [str(each["name"]) for each in active if each["name"] != event.target.value]
            refused = self._driver.ask("switch", {"activate": [event.target.value], "deactivate": others})
            if refused is not None:
                tell(event.client, f"{event.target.value} is not active", refused)

        self._parts.append(choice)

    def _pad(self, controller: Mapping[str, Any]) -> None:
        """Four buttons as on a cross, and how fast they are."""
        gui, name = self._gui, str(controller["name"])
        pad = gui.add_folder("Pad")
        with pad:
            for label, factors in _PAD.items():
                button = gui.add_button(label.capitalize(), icon=ICONS[label])

                def motion(factors: tuple[int, int] = factors) -> Motion:
                    return twist_motion(name, factors[0] * linear.value, factors[1] * angular.value)

                self._hold(button, motion)
        linear = gui.add_slider("speed m/s", min=_LINEAR[0], max=_LINEAR[1], step=0.05, initial_value=_LINEAR[2])
        angular = gui.add_slider("turn rad/s", min=_ANGULAR[0], max=_ANGULAR[1], step=0.1, initial_value=_ANGULAR[2])
        self._parts += [pad, linear, angular]

    def _sliders(self, controller: Mapping[str, Any]) -> None:
        """Make a slider for each value of the controller, and one button that sends them while it is held."""
        gui, name, interface = self._gui, str(controller["name"]), str(controller["interface"])
        sliders = {}
        for joint in controller["joints"]:
            low, high = self._range(joint, interface)
            at = self._positions.get(joint) if interface == "position" else 0.0
            start = min(max(at or 0.0, low), high)
            sliders[joint] = gui.add_slider(joint, min=low, max=high, step=(high - low) / 200, initial_value=start)
        button = gui.add_button("Hold to drive", icon=ICONS["drive"])
        targets = self._targets = TargetSliders(sliders) if interface == "position" else None

        def motion() -> Motion:
            if targets is None:
                return joint_motion(name, [slider.value for slider in sliders.values()], [0.0] * len(sliders))
            return joint_motion(name, targets.targets(self._positions), targets.rest(self._positions))

        self._hold(button, motion)
        self._parts += [*sliders.values(), button]

    def _range(self, joint: str, interface: str) -> tuple[float, float]:
        """Return what a slider may be set to, by the description's limits as far as it has any."""
        urdf = self._joints.get(joint)
        if urdf is not None and interface == "position" and urdf.lower is not None and urdf.upper is not None:
            return (urdf.lower, urdf.upper) if urdf.lower < urdf.upper else (urdf.lower, urdf.lower + 1.0)
        limits = {"velocity": urdf.velocity, "effort": urdf.effort} if urdf is not None else {}
        largest = _LARGEST.get(interface, 1.0)
        limit = min(limits.get(interface) or largest, largest)
        return -limit, limit

    def _hold(self, button: viser.GuiButtonHandle, motion: Callable[[], Motion]) -> None:
        @button.on_hold(callback_hz=HOLD_HZ)
        async def _(event: viser.GuiEvent[Any]) -> None:
            client = event.client
            if client is not None:
                self._driver.hold(client.client_id, motion(), lambda why: tell(client, "Not driven", why))
