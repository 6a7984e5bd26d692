"""Buttons that act while they are held: every 50 ms a held one says so, and says when it is let go."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from nicegui.element import Element

from canopen_control.view.teleop import HOLD_HZ

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["HoldButton", "HoldButtons"]


@dataclass(frozen=True, slots=True)
class HoldButton:
    """A button: its name to us and to the user, its sign, and the key of the keyboard that holds it too."""

    key: str
    label: str
    sign: str = ""
    keyboard: str = ""


class HoldButtons(Element, component="hold_buttons.js"):
    """A group of which one is held at a time; `held(key)` and `let_go()` are called."""

    def __init__(
        self, buttons: Sequence[HoldButton], held: Callable[[str], None], let_go: Callable[[], None], kind: str = ""
    ) -> None:
        super().__init__()
        self._props["buttons"] = [asdict(button) for button in buttons]
        self._props["period"] = round(1000 / HOLD_HZ)
        self.classes(f"cc-hold {kind}")
        known = {button.key for button in buttons}

        def on_hold(event: Any) -> None:  # noqa: ANN401 - what a browser sends
            if event.args in known:
                held(event.args)

        self.on("hold", on_hold)
        self.on("release", lambda _event: let_go(), [])
