"""Browser view of a robot: a page served by this computer, with 3D scene, plots, events and STOP.

The view runs in a separate process and is a client of the runtime. Only this subpackage imports NiceGUI.
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["require_view"]


def require_view() -> None:
    """Raise ConfigError with the install command if NiceGUI is missing; NiceGUI itself is not imported."""
    if importlib.util.find_spec("nicegui") is None:
        raise ConfigError("the browser view needs NiceGUI: pip install 'canopen-control[view]'")
