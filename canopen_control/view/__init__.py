"""Browser view of a robot: 3D scene, plots, events and STOP on a page served by this computer.

It is a process of its own and a client of the runtime. Only this subpackage imports NiceGUI.
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["require_view"]


def require_view() -> None:
    """Raise ConfigError with the command to type if NiceGUI is missing; does not import it."""
    if importlib.util.find_spec("nicegui") is None:
        raise ConfigError("the browser view needs NiceGUI: pip install 'canopen-control[view]'")
