"""The tabs of the Drive view by their order; a new one is a class in this folder and a line here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.view.drive.firmware_tab import FirmwareTab
from canopen_control.view.drive.objects_tab import ObjectsTab
from canopen_control.view.drive.parameters_tab import ParametersTab
from canopen_control.view.drive.scope_tab import ScopeTab
from canopen_control.view.drive.status_tab import StatusTab
from canopen_control.view.drive.tune_tab import TuneTab

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.view.drive.drive_tab import DriveTab, DriveTabContext

__all__ = ["TABS", "TabSlot"]


@dataclass(frozen=True, slots=True)
class TabSlot:
    """A tab: its key, which stands in the page's address, what is written on it, and what makes it."""

    key: str
    title: str
    make: Callable[[DriveTabContext], DriveTab]


TABS: Final = (
    TabSlot("status", "Status", StatusTab),
    TabSlot("objects", "Objects", ObjectsTab),
    TabSlot("scope", "Scope", ScopeTab),
    TabSlot("tune", "Tune", TuneTab),
    TabSlot("parameters", "Parameters", ParametersTab),
    TabSlot("firmware", "Firmware", FirmwareTab),
)
