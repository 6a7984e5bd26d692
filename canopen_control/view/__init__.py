"""The browser view: the robot, its wheels, plots, events and a STOP, on a page of this computer.

A process of its own and a client of the runtime. Only this subpackage imports NiceGUI.
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["require_view"]


def require_view() -> None:
    """Raise ConfigError with what to type when NiceGUI is not there; does not import it."""
    if importlib.util.find_spec("nicegui") is None:
        raise ConfigError("the browser view needs NiceGUI: pip install 'canopen-control[view]'")
