"""Search for a robot's files: in a folder, bundled robot, ROS package or launch file, or by single options.

A simulated or mocked robot without drives on a bus needs no bus.yml. A bus without controllers needs only a bus.yml:
its folder has neither a ros2_controllers.yaml nor a description. In a ROS package the files are in `config` or
`config/x`, and the description is in the package's `urdf` or `urdf/x`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

from canopen_control.bus.channel import name_and_channel
from canopen_control.controllers.controllers_file import ParameterSource, inspect_controllers, read_controllers
from canopen_control.data_files import data_names, data_path
from canopen_control.errors import CanopenError, RobotConfigError, nearest
from canopen_control.physics import SDF_SUFFIXES
from canopen_control.urdf.package_search import installed_packages

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.runtime.launch_file import Launched
    from canopen_control.yamlfile.node import Problems


MAIN_BUS = "can"  # name of the bus in bus.yml; the bus in bus_NAME.yml is NAME
BUS, CONTROLLERS = "bus.yml", "ros2_controllers.yaml"
_SAMPLE_SIZE: Final = 100_000  # characters of a file that may be a bus.yml
_BUS_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
_COPIES: Final = frozenset({"template", "example", "sample", "backup", "bak", "copy", "orig", "old"})
_ARGUMENT = re.compile(r"[A-Za-z_]\w*")
_DESCRIPTIONS = ("*.urdf.xacro", "*.urdf", "*.system.xacro")
_CHANNEL_VALUE: Final = re.compile(r"(v|vx|sl)?can\d+|(local|memory|virtual|socketcan):\S+")
_CHANNEL_WORDS: Final = frozenset({"interface", "name", "channel", "device", "dev", "port", "bus", "if", "iface"})
_CAN_WORDS: Final = frozenset({"can", "canbus", "socketcan"})
_FAKE_WORDS: Final = frozenset({"mock", "fake", "sim", "simulation", "simulated", "virtual", "gazebo"})
_HARDWARE_WORDS: Final = frozenset({"use", "hardware", "robot", "drive", "drives", "motor", "motors", "physical"})
_YES, _NO = frozenset({"true", "1", "yes", "on"}), frozenset({"false", "0", "no", "off"})


@dataclass(frozen=True, slots=True)
class AskedHardware:
    """Hardware options among the user's NAME:=VALUE arguments, as in ros2_canopen's launch files.

    `channel` is the value of an argument such as can_interface_name:=can0, `real` of use_real_hardware:=true, `world`
    is the file in world:=hall.sdf; "" or None without such an argument. `channel_word`, `real_word` and `world_word`
    are the complete arguments, `names` the names of all such arguments.
    """

    channel: str = ""
    channel_word: str = ""
    real: bool | None = None
    real_word: str = ""
    names: frozenset[str] = frozenset()
    world: str = ""
    world_word: str = ""

    def channels(self, can: Sequence[str], buses: Collection[str]) -> list[str]:
        """Return the `--can` options, or the channel in the argument.

        Raise RobotConfigError for contradictory values.
        """
        if not self.channel:
            return list(can)
        if can:
            if self.channel in {name_and_channel(text)[1] for text in can}:
                return list(can)
            raise RobotConfigError(f"{self.channel_word} contradicts --can {can[0]}; omit one of them")
        if len(buses) > 1:
            names = " ".join(f"--can {name}=" for name in buses)
            raise RobotConfigError(
                f"{self.channel_word} is one channel for {len(buses)} buses; give each its own: {names}"
            )
        return [self.channel]

    def is_real(self, *, option: bool) -> bool:
        """Whether `--real` or an argument requests real drives.

        Raise RobotConfigError if they contradict each other.
        """
        if option and self.real is False:
            raise RobotConfigError(f"{self.real_word} contradicts --real; omit one of them")
        return option or bool(self.real)


def asked_hardware(words: Mapping[str, str]) -> AskedHardware:
    """Return the hardware options in a user's arguments; raise RobotConfigError for contradictory or invalid values."""
    channels = {name: value for name, value in words.items() if _names_channel(name, value)}
    real_values = {
        name: is_real for name, value in words.items() if (is_real := _requests_real(name, value)) is not None
    }
    worlds = {name: file for name, value in words.items() if (file := _sdf_file(value))}
    for values in (channels, real_values, worlds):
        if len(set(values.values())) > 1:
            arguments = ", ".join(f"{name}:={words[name]}" for name in values)
            advice = "give one of them, or --can BUS=CHANNEL for each bus" if values is channels else "give one of them"
            raise RobotConfigError(f"{arguments}: these arguments contradict each other; {advice}")
    channel, real, world = (next(iter(values), "") for values in (channels, real_values, worlds))
    return AskedHardware(
        channels.get(channel, ""),
        f"{channel}:={channels[channel]}" if channel and channels[channel] else "",
        real_values.get(real),
        f"{real}:={words[real]}" if real else "",
        frozenset(channels) | frozenset(real_values) | frozenset(worlds),
        worlds.get(world, ""),
        f"{world}:={words[world]}" if world else "",
    )


def _sdf_file(value: str) -> str:
    """Return the Gazebo world file in an argument's value (hall.sdf, "-r hall.sdf"), or ""."""
    return next((word for word in value.split() if word.lower().endswith(SDF_SUFFIXES)), "")


def _names_channel(name: str, value: str) -> bool:
    """Whether an argument selects the channel of a bus, by name (can_interface_name) or by value (can0)."""
    parts = set(name.lower().split("_"))
    named = bool(parts & _CAN_WORDS) and parts <= _CAN_WORDS | _CHANNEL_WORDS
    return bool(_CHANNEL_VALUE.fullmatch(value)) or (named and value.lower() not in _YES | _NO)


def _requests_real(name: str, value: str) -> bool | None:
    """Whether an argument such as use_real_hardware:=true requests real drives; None for other arguments."""
    parts, word = set(name.lower().split("_")), value.strip().lower()
    if word == "real":
        return True
    if "real" in parts and not parts & {"time", "rate"}:
        if word not in _YES | _NO:
            raise RobotConfigError(f"{name}:={value}: write {name}:=true for real drives, or false")
        return word in _YES
    # a misspelt use_mok_hardware must not request real drives
    if {"use", "hardware"} <= parts <= _HARDWARE_WORDS and word in _YES | _NO:
        return word in _YES
    return None


@dataclass(frozen=True, slots=True)
class RobotFiles:
    """Name and files of a robot; `bus` is None without bus.yml, `more_buses` are bus_NAME.yml by NAME.

    `arguments` are the xacro arguments, `hardware` the hardware options in the user's arguments, `idle` the arguments
    without an effect on this robot. `spawned` are the controllers that the launch file starts, `variables` the values
    of the launch file's arguments. `world` is the Gazebo world file that an argument names. `not_launched` are the
    files of the folder that are used although the launch file names another one, by option, as (used, named).
    `parameters` are all parameters of a launch file that names `controllers`, empty otherwise. For a bus without
    controllers, `controllers` and `description` are the path of bus.yml, so that error messages refer to it.
    """

    name: str
    bus: Path | None
    controllers: Path
    description: Path
    more_buses: dict[str, Path] = field(default_factory=dict)
    arguments: dict[str, str] = field(default_factory=dict)
    hardware: AskedHardware = AskedHardware()
    idle: tuple[str, ...] = ()
    spawned: tuple[str, ...] = ()
    variables: dict[str, str] = field(default_factory=dict)
    world: Path | None = None
    not_launched: dict[str, tuple[Path, Path]] = field(default_factory=dict)
    parameters: tuple[ParameterSource, ...] = ()

    def refuse_hardware(self, why: str) -> None:
        """Raise RobotConfigError if an argument requests a channel or real drives; `why` is the reason."""
        word = self.hardware.channel_word or (self.hardware.real_word if self.hardware.real else "")
        if word:
            raise RobotConfigError(f"{word}: {why}; omit the argument")

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths of the bus files, the controllers file, further parameter files, and the description."""
        more = (source.path for source in self.parameters)
        return tuple(dict.fromkeys((*self.buses.values(), self.controllers, *more, self.description)))

    def read_controllers(self, *, strict: bool = False) -> ControllersFile:
        """Read the controllers file, and all parameters of the launch file; RobotConfigError with all errors."""
        return read_controllers(self.controllers, strict=strict, variables=self.variables, sources=self.parameters)

    def inspect_controllers(self) -> tuple[ControllersFile, list[Problems]]:
        """Read the controllers file like `read_controllers`; return the readable part, and the problems."""
        return inspect_controllers(self.controllers, variables=self.variables, sources=self.parameters)

    def mappings(self, *, mock: bool = False) -> dict[str, str]:
        """Return the xacro mappings; `mock` adds use_mock_hardware for descriptions that declare this argument."""
        return {"use_mock_hardware?": "true"} | self.arguments if mock else self.arguments

    @property
    def bus_alone(self) -> bool:
        """Whether the robot is a bus without controllers and description."""
        return self.controllers == self.description == self.bus

    @property
    def buses(self) -> dict[str, Path]:
        """Paths of all bus files, by bus name."""
        return ({MAIN_BUS: self.bus} if self.bus is not None else {}) | self.more_buses


def find_robot(
    config: str | None,
    *,
    bus: str | None = None,
    controllers: str | None = None,
    description: str | None = None,
    arguments: Iterable[str] = (),
    launch: str | None = None,
) -> RobotFiles:
    """Find the files of a robot; options override the folder. RobotConfigError lists all missing files.

    `arguments` are NAME:=VALUE for xacro. A ROS launch file adds arguments, and the files that neither an option nor
    the folder provides.
    """
    if config == "" or all(option is None for option in (config, bus, controllers, description, launch)):
        raise _not_given(", or its three files")
    folder = _folder(config) if config is not None else None
    words = xacro_arguments(arguments)
    hardware = asked_hardware(words)
    launched = _launched(launch, words, hardware.names)
    files = launched.files if launched is not None else {}
    no_bus: list[str] = []
    missing: list[str] = []
    main = _find_file(bus, folder, BUS, "--bus", no_bus, files.get("bus"))
    alone = _is_default(controllers, description, launched) and not no_bus and _is_alone(folder)
    if no_bus and folder is not None and _is_default(controllers, description, launched) and _is_alone(folder):
        _refuse_misnamed_bus(no_bus)
    control, described = (main, main) if alone else _moving_files(controllers, description, folder, files, missing)
    bus_folder = folder if main == Path() else main.parent
    more = _more_buses(bus_folder, missing) if bus_folder is not None and bus is None else {}
    world = _world(hardware, launch, missing)
    missing += _irregular((main, control, described, *more.values()))
    if alone and launched is None:
        missing += _foreign_arguments(main, words, hardware)
    if missing or (no_bus and (more or bus is not None)):
        needed = control == described == Path() or bool(more) or bus is not None
        _refuse_missing(launch if folder is None else None, launched, no_bus, missing, needed=needed)
    words = {} if alone else _description_arguments(words, launched, hardware, described)
    if named := _buses_of_description(described, words) if no_bus else {}:
        main = named.pop(MAIN_BUS)
        more |= named
        no_bus.clear()
    if launched is not None:
        _refuse_ineffective(launched.idle)
    name = _safe(_name((folder or (described if no_bus else main).resolve().parent).resolve()))
    robot = RobotFiles(name, None if no_bus else main, control, described, more, words, hardware, world=world)
    if launched is None:
        return robot
    options = {"bus": bus, "controllers": controllers, "description": description}
    return _with_launch(robot, launched, {kind for kind, path in options.items() if path is None})


def _with_launch(robot: RobotFiles, launched: Launched, unasked: Collection[str]) -> RobotFiles:
    """Return the files of a robot with all else that its launch file gives; `unasked` are files without an option."""
    control, bus = robot.controllers, robot.bus or Path()
    files = {kind: path for kind, path in launched.files.items() if kind in unasked}
    if any(source.path.resolve() == control.resolve() for source in launched.parameters):
        files.pop("controllers", None)
    return replace(
        robot,
        idle=launched.idle,
        spawned=() if robot.bus_alone else launched.spawned,
        variables=launched.variables,
        not_launched=_used_instead({"bus": bus, "controllers": control, "description": robot.description}, files),
        parameters=() if robot.bus_alone else _parameters_with(control, launched),
    )


def _parameters_with(control: Path, launched: Launched) -> tuple[ParameterSource, ...]:
    """Return the parameters of the launch file; empty if its files do not include `control`.

    A file that only a spawner reads then counts for the manager too.
    """
    sources = [
        replace(source, path=control) if source.path.resolve() == control.resolve() else source
        for source in launched.parameters
    ]
    files = [source for source in sources if not source.values]
    if files and not any(source.path == control for source in files):
        return ()
    if sources and all(source.controllers for source in files):
        sources.insert(0, ParameterSource(control))
    return tuple(sources)


def _foreign_arguments(bus: Path, words: Iterable[str], hardware: AskedHardware) -> list[str]:
    """Return an error if an argument of a bus without a description does not select hardware."""
    foreign = next((word for word in words if word not in hardware.names), None)
    return [f"{bus} is a bus without a description and accepts no arguments; omit {foreign}:="] if foreign else []


def _used_instead(used: Mapping[str, Path], named: Mapping[str, Path]) -> dict[str, tuple[Path, Path]]:
    """Return the files in use although the launch file names other existing ones, by option, as (used, named)."""
    return {
        f"--{kind}": (used[kind], path)
        for kind, path in named.items()
        if path.is_file() and used[kind] != Path() and path.resolve() != used[kind].resolve()
    }


def _refuse_misnamed_bus(no_bus: Sequence[str]) -> None:
    """Raise RobotConfigError if a folder without other files of a robot has a bus file under another name."""
    if any("; name the file by --bus" in text for text in no_bus):
        raise RobotConfigError("; ".join(no_bus))


def _moving_files(
    controllers: str | None, description: str | None, folder: Path | None, files: Mapping[str, Path], missing: list[str]
) -> tuple[Path, Path]:
    """Find the files that a bus alone does not have: controllers and description."""
    control = _find_file(controllers, folder, CONTROLLERS, "--controllers", missing, files.get("controllers"))
    return control, _find_file(description, folder, _DESCRIPTIONS, "--description", missing, files.get("description"))


def _buses_of_description(described: Path, words: Mapping[str, str]) -> dict[str, Path]:
    """Return the bus files that the hardware plugins name (`bus_config` of ros2_canopen), by bus name.

    The first is the main bus. Errors in the description are ignored here, and reported when the robot is read.
    """
    from canopen_control.urdf.description import DescriptionReader  # only for a robot without a bus.yml

    try:
        text = described.read_text(encoding="utf-8")
        if "canopen_ros2_control" not in text and ".xacro" not in described.name:
            return {}
        with DescriptionReader(described, mappings=words) as reader:
            tags = reader.result().hardware
    except (CanopenError, OSError, UnicodeDecodeError):
        return {}
    named = (Path(tag.parameters.get("bus_config", "").strip().strip("\"'")) for tag in tags)
    paths = list(dict.fromkeys(path.resolve() for path in named if path.is_file()))
    buses = dict[str, Path]()
    for number, path in enumerate(paths, 1):
        name = _safe(path.parent.name if path.stem == "bus" else path.stem.removeprefix("bus_")) if buses else MAIN_BUS
        buses[f"{name[:28]}_{number}" if name in buses else name] = path
    return buses


def _world(hardware: AskedHardware, launch: str | None, missing: list[str]) -> Path | None:
    """Find the world file in an argument: relative to the working directory, else in the launch file's package."""
    if not hardware.world:
        return None
    path = Path(hardware.world).expanduser()
    package = None if launch is None else find_launch(launch).resolve().parent.parent
    places = [path] if package is None else [path, package / path, package / "worlds" / path]
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        missing.append(f"{hardware.world_word}: file {path} does not exist")
    return None if file is None else file.resolve()


def _description_arguments(
    words: dict[str, str], launched: Launched | None, hardware: AskedHardware, described: Path
) -> dict[str, str]:
    """Return the xacro arguments of the user or the launch file; raise RobotConfigError for a mistyped name."""
    if launched is None:  # the description need not declare the hardware arguments
        return {f"{name}?" if name in hardware.names else name: value for name, value in words.items()}
    from canopen_control.runtime.launch_file import refuse_mistyped

    refuse_mistyped(launched, words, described)
    return launched.arguments


def _refuse_missing(
    launch: str | None, launched: Launched | None, no_bus: Sequence[str], missing: Sequence[str], *, needed: bool
) -> NoReturn:
    """Raise RobotConfigError that lists the missing files; the wording depends on `launch`.

    If a bus is not `needed`, because other files of the robot were found, a missing bus.yml is not listed.
    """
    texts = [*(no_bus if needed else ()), *missing]
    if launched is not None and launch is not None:
        texts = list(_not_launched(launch, launched.files, no_bus, missing))
    raise RobotConfigError("; ".join([*texts, *(launched.uncertainties if launched is not None else ())]))


def _not_launched(
    launch: str, files: Mapping[str, Path], no_bus: Sequence[str], missing: Sequence[str]
) -> Iterator[str]:
    """Yield texts about robot files that a launch file does not name, and about other missing files."""
    for option, kind in (("--bus", "bus"), ("--controllers", "controllers"), ("--description", "description")):
        if any(text.endswith(f" or {option}") for text in (*no_bus, *missing)):
            problem = f"names {files[kind]}, which is not a file" if kind in files else f"names no {kind} file"
            if kind != "bus" or kind in files:
                yield f"{launch} {problem}; give it by {option}"
    yield from (text for text in missing if not text.startswith("give a robot folder or "))


def _refuse_ineffective(idle: Iterable[str]) -> None:
    """Raise RobotConfigError for an ineffective argument that appears to select real or virtual drives."""
    for word in idle:
        if set(word.partition(":=")[0].lower().split("_")) & (_FAKE_WORDS | {"hardware"}):
            raise RobotConfigError(
                f"{word} is used neither by the description nor by a file of this robot, so it has no effect; omit "
                "it and give --mock, or --real with --can CHANNEL, or none of these for virtual drives"
            )


def xacro_arguments(words: Iterable[str]) -> dict[str, str]:
    """Split arguments NAME:=VALUE; the last value of a name applies. Raise RobotConfigError for any other form."""
    arguments = {}
    for word in words:
        name, is_pair, value = word.partition(":=")
        if not is_pair or not _ARGUMENT.fullmatch(name):
            raise RobotConfigError(f"{word!r} is not an argument of the form NAME:=VALUE")
        arguments[name] = value
    return arguments


def find_buses(config: str | None) -> dict[str, Path]:
    """Return the bus files in a robot's folder, by bus name; raise RobotConfigError if one is missing or invalid."""
    if not config:
        raise _not_given()
    missing: list[str] = []
    folder = _folder(config)
    main = _find_file(None, folder, BUS, "--bus", missing)
    more = _more_buses(main.parent if main != Path() else folder, missing)
    missing += _irregular((main, *more.values()))
    if missing:
        raise RobotConfigError("; ".join(missing))
    return {MAIN_BUS: main, **more}


def _not_given(or_else: str = "") -> RobotConfigError:
    names = ", ".join(data_names("config"))
    return RobotConfigError(f"no robot given: name a folder or a bundled robot ({names}){or_else}")


def _folder(config: str) -> Path:
    """Find a robot's folder: a path, a bundled robot, a ROS package, or a folder in one; RobotConfigError if none."""
    path = Path(config).expanduser()
    if path.is_dir():
        return path
    if path.exists():
        as_bus = f", or the file by --bus {path}" if path.name != BUS and _is_bus(path) else ""
        raise RobotConfigError(f"no robot {config!r}: it is a file; give its folder: {path.parent}{as_bus}")
    bundled = data_path("config", config)
    if "/" not in config and bundled.is_dir():
        return bundled
    package, _, rest = config.partition("/")
    for package_folder in installed_packages(package):
        if (package_folder / rest).is_dir():
            return package_folder / rest
    names = ", ".join(data_names("config"))
    raise RobotConfigError(
        f"no robot {config!r}: it is neither a folder nor a bundled robot ({names}) nor a ROS package that is "
        f"sourced or in ROS_PACKAGE_PATH{_similar_robot(path, data_names('config') if path.name == config else ())}"
    )


def _similar_robot(path: Path, bundled: Iterable[str]) -> str:
    """Return a suggestion for the path of a robot that does not exist: a folder beside it or a bundled robot, or ""."""
    parent = path.parent
    if parent.resolve().name == path.name and _holds_robot(parent):
        return f"; the folder {parent.resolve()} has this name: give {parent}"
    try:
        beside = sorted(folder.name for folder in parent.iterdir() if _holds_robot(folder))
    except OSError:
        beside = []
    return nearest(path.name, (*beside, *bundled), listed=False)


def _holds_robot(folder: Path) -> bool:
    return any((folder / place / name).is_file() for place in ("", "config") for name in (BUS, CONTROLLERS))


def find_launch(text: str) -> Path:
    """Return the launch file for an existing path or PACKAGE/FILE in a ROS package; other paths are unchanged."""
    path = Path(text).expanduser()
    package, _, rest = text.partition("/")
    inside = () if path.is_file() else (package_folder / rest for package_folder in installed_packages(package))
    return next((candidate for candidate in inside if candidate.is_file()), path)


def _launched(launch: str | None, words: dict[str, str], obeyed: AbstractSet[str]) -> Launched | None:
    """Read a launch file with the user's arguments; None if the robot has no launch file."""
    if launch is None:
        return None
    from canopen_control.runtime.launch_file import launched_robot  # most robots are run without

    return launched_robot(find_launch(launch), words, obeyed)


def _find_file(
    path: str | None,
    folder: Path | None,
    names: str | Sequence[str],
    option: str,
    missing: list[str],
    launched: Path | None = None,
) -> Path:
    """Return a file from the option, the folder or the launch file, or add a text to `missing`."""
    count = len(missing)
    file = _find_own_file(path, folder, names, option, missing)
    if file == Path() and launched is not None and launched.is_file():
        del missing[count:]
        return launched
    return file


def _find_own_file(
    argument: str | None, folder: Path | None, names: str | Sequence[str], option: str, missing: list[str]
) -> Path:
    if argument is not None:
        path = Path(argument).expanduser()
        if not path.exists():
            missing.append(f"{option}: no file {argument}")
        return path
    if folder is None:
        missing.append(f"give a robot folder or {option}")
        return Path()
    patterns = [names] if isinstance(names, str) else names
    expected = " or ".join(patterns)
    for place in _places(folder, described=names is _DESCRIPTIONS):
        matches = sorted({path for pattern in patterns for path in place.glob(pattern)})
        if len(matches) == 1:
            return matches[0]
        if matches:
            several = ", ".join(str(path.relative_to(place)) for path in matches)
            missing.append(f"{place} has several of {expected}: name one with {option} ({several})")
            return Path()
    found = _elsewhere(folder, names)
    missing.append(f"{folder} has no {expected}{found or f'; write one, or give a file by {option} FILE'}")
    return Path()


def _is_default(controllers: str | None, description: str | None, launched: Launched | None) -> bool:
    """Whether it is certain that neither the user nor a launch file selects controllers or a description."""
    if launched is not None and (launched.uncertainties or launched.files.keys() - {"bus"}):
        return False
    return controllers is None and description is None


def _is_alone(folder: Path | None) -> bool:
    """Whether a folder has neither controllers nor a description; True if `folder` is None.

    For a folder below `config` of a package, a description directly in the package's `urdf` does not count.
    """
    if folder is None:
        return True
    descriptions = _places(folder, described=True)
    if folder.resolve().parent.name == "config":
        descriptions = descriptions[:-1]
    sought = [(place, CONTROLLERS) for place in _places(folder, described=False)]
    sought += [(place, pattern) for place in descriptions for pattern in _DESCRIPTIONS]
    return not any(next(place.glob(pattern), None) for place, pattern in sought)


def _places(folder: Path, *, described: bool) -> list[Path]:
    """Return the folders to search for a file or description: `folder`, then folders of the ROS package."""
    if not described:
        return [folder, folder / "config"]
    places = [folder, folder / "urdf"]
    path = folder.resolve()
    if path.parent.name == "config":
        package = path.parent.parent
        places += [package / "urdf" / path.name, package / "urdf"]
    elif path.name == "config":
        places += [path.parent / "urdf"]
    return places


def _elsewhere(folder: Path, names: str | Sequence[str]) -> str:
    """Return a hint about suitable files elsewhere in the package, or ""."""
    if names is _DESCRIPTIONS:
        roots = [place for place in _places(folder, described=True) if place.name == "urdf"]
        folders = [path for root in roots for pattern in _DESCRIPTIONS for path in root.glob(f"*/{pattern}")]
        return f"; name one with --description: {_listed(folders)}" if folders else ""
    if folders := [path.parent for path in folder.glob(f"config/*/{names}")]:
        return f"; name a folder that has one: {_listed(folders)}"
    option, is_meant = ("--bus", _is_bus) if names == BUS else ("--controllers", _is_controllers)
    files = [path for place in _places(folder, described=False) for path in place.glob("*.y*ml") if is_meant(path)]
    return f"; name the file by {option}: {_listed(files)}" if files else ""


def _is_bus(path: Path) -> bool:
    """Whether a file looks like a bus.yml, because one of its lines contains `node_id:`."""
    return _has_line(path, r"\s+node_id\s*:")


def _is_controllers(path: Path) -> bool:
    """Whether a file looks like a parameter file with the controllers of a controller manager."""
    return _has_line(path, r"\s*(/[\w/*]*)?controller_manager\s*:")


def _has_line(path: Path, begin: str) -> bool:
    try:
        return path.is_file() and bool(re.search(f"(?m)^{begin}", path.read_text(encoding="utf-8")[:_SAMPLE_SIZE]))
    except (OSError, UnicodeDecodeError):
        return False


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(str(path) for path in dict.fromkeys(sorted(paths)))


def _name(folder: Path) -> str:
    """Return the name of a robot: that of the folder, or of its parent if the folder is `config`."""
    return folder.parent.name if folder.name == "config" else folder.name


def _irregular(paths: Iterable[Path]) -> Iterator[str]:
    """Yield an error text for every path that is not a regular file: opening a pipe or a device could block."""
    for path in paths:
        if path != Path() and path.exists() and not path.is_file():
            yield f"{path} is {'a folder' if path.is_dir() else 'a pipe or a device'}, not a file"


def _more_buses(folder: Path, missing: list[str]) -> dict[str, Path]:
    """Find the files bus_NAME.yml of further buses by NAME, ignoring copies such as bus_template.yml."""
    files = {path.stem.removeprefix("bus_"): path for path in sorted(folder.glob("bus_*.yml"))}
    buses = {name: path for name, path in files.items() if name.lower().rpartition("_")[2] not in _COPIES}
    for name, path in buses.items():
        if not _BUS_NAME.fullmatch(name) or name == MAIN_BUS:
            missing.append(
                f"{path}: {name!r} is not a valid name of a bus: use letters, digits, _ and -, but not {MAIN_BUS!r}"
            )
    return buses


def unread_buses(files: RobotFiles) -> dict[Path, str]:
    """Return the files beside bus.yml that contain nodes but are not read, with a name under which they would be.

    Copies, such as bus_template.yml, and every file beside a bus file that an option names, are omitted.
    """
    if files.bus is None or files.bus.name != BUS:
        return {}
    paths = sorted({*files.bus.parent.glob("*.yml"), *files.bus.parent.glob("*.yaml")} - {*files.paths})
    names = {path: path.stem.removeprefix("bus").strip("_-.") for path in paths if _is_bus(path)}
    return {
        path: f"bus_{re.sub('[^A-Za-z0-9-]', '_', name) or '2'}.yml"
        for path, name in names.items()
        if re.split("[_.-]", path.stem.lower())[-1] not in _COPIES
    }


def _safe(name: str) -> str:
    """Replace characters that socket names do not allow, and limit the name to 32 characters."""
    cleaned = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in name if letter.isascii())
    return cleaned[:32] or "robot"
