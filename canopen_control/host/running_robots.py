"""Search for this user's running robots, by the names of their sockets."""

from __future__ import annotations

from canopen_control.errors import ConfigError
from canopen_control.host.sockets import check_name, list_sockets


def find_robots() -> list[str]:
    """Return the names of this user's running robots, sorted."""
    return list_sockets("robot")


def select_robot(name: str | None = None) -> str:
    """Return `name` if that robot is running; without `name`, the only running robot; else raise ConfigError."""
    running = find_robots()
    if name is not None:
        if check_name(name) in running:
            return name
        raise ConfigError(f"no robot {name!r} is running" + (f"; running: {', '.join(running)}" if running else ""))
    if not running:
        raise ConfigError("no robot is running; start one: canopen-control run robby")
    if len(running) > 1:
        raise ConfigError(f"several robots are running: {', '.join(running)}; choose one with --name")
    return running[0]
