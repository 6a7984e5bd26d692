"""Everything that the panels show, made once for all pages: no browser, no toolkit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.view.sampling import commanded_interfaces
from canopen_control.view.words import banner, lost_banner

if TYPE_CHECKING:
    from canopen_control.rpc.messages.state import ControllerReading, StateSample
    from canopen_control.view.events import EventLog
    from canopen_control.view.faults import FaultBoard
    from canopen_control.view.words import Banner

__all__ = ["Picture"]


@dataclass(frozen=True, slots=True)
class Picture:
    """What is known now. `state` is the newest one; `lost` says why nobody knows whether it is still so, else empty."""

    state: StateSample
    events: EventLog
    controllers: tuple[ControllerReading, ...] = ()
    faults: FaultBoard | None = None
    lost: str = ""
    commanded: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "commanded", commanded_interfaces(self.controllers))

    @property
    def banner(self) -> Banner:
        """The robot in one line."""
        return lost_banner(self.lost) if self.lost else banner(self.state)
