"""Which files make a robot: a folder, a bundled name, or the three files one by one.

A robot without drives on a bus, simulated or mocked, needs no bus.yml. A bus without controllers needs nothing
else: its folder has neither a ros2_controllers.yaml nor a description.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.data_files import data_names, data_path
from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

__all__ = ["MAIN_BUS", "RobotFiles", "find_buses", "find_robot"]

MAIN_BUS = "can"  # the name of the bus of bus.yml; that of bus_NAME.yml is NAME
BUS, CONTROLLERS = "bus.yml", "ros2_controllers.yaml"
_BUS_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
_DESCRIPTIONS = ("*.urdf.xacro", "*.urdf")


@dataclass(frozen=True, slots=True)
class RobotFiles:
    """The three files of a robot and its name; `bus` may be absent, `more_buses` are its bus_NAME.yml by NAME.

    Of a bus without controllers the other two are its bus.yml, which is where their mistakes stand.
    """

    name: str
    bus: Path | None
    controllers: Path
    description: Path
    more_buses: dict[str, Path] = field(default_factory=dict)

    @property
    def bus_alone(self) -> bool:
        """Whether this is a bus without controllers, whose nodes are all that there is."""
        return self.controllers == self.description == self.bus

    @property
    def buses(self) -> dict[str, Path]:
        """The files of all buses by the names of the buses."""
        return ({MAIN_BUS: self.bus} if self.bus is not None else {}) | self.more_buses


def find_robot(
    config: str | None, *, bus: str | None = None, controllers: str | None = None, description: str | None = None
) -> RobotFiles:
    """Find the files; those given one by one win over the folder's. RobotConfigError names all that is missing."""
    if config == "" or (config is None and bus is None and controllers is None and description is None):
        names = ", ".join(data_names("config"))
        raise RobotConfigError(f"no robot given: name a folder or a bundled robot ({names}), or its three files")
    folder = _folder(config) if config is not None else None
    no_bus: list[str] = []
    missing: list[str] = []
    main = _one(bus, folder, BUS, "--bus", no_bus)
    alone = controllers is None and description is None and not no_bus and _is_alone(folder)
    control = main if alone else _one(controllers, folder, CONTROLLERS, "--controllers", missing)
    described = main if alone else _one(description, folder, _DESCRIPTIONS, "--description", missing)
    more = _more_buses(folder, missing) if folder is not None and bus is None else {}
    missing += _irregular((main, control, described, *more.values()))
    if missing or (no_bus and (more or bus is not None)):
        raise RobotConfigError("; ".join(no_bus + missing))
    name = (folder or (described if no_bus else main).resolve().parent).resolve().name
    return RobotFiles(_safe(name), None if no_bus else main, control, described, more)


def find_buses(config: str | None) -> dict[str, Path]:
    """Return the bus files of a folder or bundled robot by the names of the buses; nothing else need be there."""
    if not config:
        raise RobotConfigError(f"no robot given: name a folder or a bundled robot ({', '.join(data_names('config'))})")
    missing: list[str] = []
    folder = _folder(config)
    main = _one(None, folder, BUS, "--bus", missing)
    more = _more_buses(folder, missing)
    missing += _irregular((main, *more.values()))
    if missing:
        raise RobotConfigError("; ".join(missing))
    return {MAIN_BUS: main, **more}


def _folder(config: str) -> Path:
    """Return the folder a user means: a path, else a bundled robot."""
    path = Path(config).expanduser()
    if path.is_dir():
        return path
    if path.exists():
        raise RobotConfigError(f"no robot {config!r}: it is a file; give its folder: {path.parent}")
    bundled = data_path("config", config)
    if "/" not in config and bundled.is_dir():
        return bundled
    names = ", ".join(data_names("config"))
    raise RobotConfigError(f"no robot {config!r}: neither a folder nor one of the bundled ones ({names})")


def _one(given: str | None, folder: Path | None, names: str | Sequence[str], option: str, missing: list[str]) -> Path:
    if given is not None:
        path = Path(given).expanduser()
        if not path.exists():
            missing.append(f"{option}: no file {given}")
        return path
    if folder is None:
        missing.append(f"give a robot folder or {option}")
        return Path()
    patterns = [names] if isinstance(names, str) else names
    matches = sorted({path for pattern in patterns for path in folder.glob(pattern)})
    if len(matches) == 1:
        return matches[0]
    wanted = " or ".join(patterns)
    missing.append(
        f"{folder} has no {wanted}" if not matches else f"{folder} has several of {wanted}: name one with {option}"
    )
    return Path()


def _is_alone(folder: Path | None) -> bool:
    """Whether nothing says what the nodes of a bus are for: the folder has no controllers, and no description."""
    return folder is None or not any(next(folder.glob(each), None) for each in (CONTROLLERS, *_DESCRIPTIONS))


def _irregular(paths: Iterable[Path]) -> Iterator[str]:
    """Yield what is there and is no file: a pipe or a device may not even be opened, or it is waited for."""
    for path in paths:
        if path != Path() and path.exists() and not path.is_file():
            yield f"{path} is {'a folder' if path.is_dir() else 'a pipe or a device'}, no file"


def _more_buses(folder: Path, missing: list[str]) -> dict[str, Path]:
    """Find the files of further buses."""
    found = {path.stem.removeprefix("bus_"): path for path in sorted(folder.glob("bus_*.yml"))}
    for name, path in found.items():
        if not _BUS_NAME.fullmatch(name) or name == MAIN_BUS:
            missing.append(f"{path}: {name!r} is no name for a further bus: letters, digits, _ and -, not {MAIN_BUS!r}")
    return found


def _safe(name: str) -> str:
    """Make a name that a socket may have."""
    cleaned = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in name if letter.isascii())
    return cleaned[:32] or "robot"
