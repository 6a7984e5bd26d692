"""Whether the view can be shown from this Python, without importing what it needs."""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["require_view"]


def require_view() -> None:
    """Raise ConfigError with what to type when NiceGUI is not there."""
    if importlib.util.find_spec("nicegui") is None:
        raise ConfigError("the browser view needs NiceGUI: pip install 'canopen-control[view]'")
