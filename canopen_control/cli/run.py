"""Boot a robot, run its controllers, and stop it properly.

The drives are virtual unless you select real drives with --real. Ctrl-C ramps all joints down to a standstill, disables
the drives and ends the run.

Exit codes: 0 success; 1 the boot or the run failed; 2 wrong usage or configuration.
"""

from __future__ import annotations

import argparse
import contextlib
import queue
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

from canopen_control.cli.support.arguments import Names, add_duration, add_new_name, whole_number
from canopen_control.cli.support.output import ENDS, is_printed, with_token
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.quick_start import quick_start
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.realtime import DEFAULT_PRIORITY, HIGHEST_PRIORITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.check.preflight_record import SlowReason
    from canopen_control.host.spawn import Child
    from canopen_control.master.event_log import Event
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.runtime.run_session import RunOptions, RunSession
    from canopen_control.runtime.setup import RobotSetup


# `run --world FILE` without a robot runs all robots that the world file names, each with the given options.
#
# Robot, bus and drives come from the file; the ROS names of each robot begin with its name.


_FLAGS: Final = ("ros", "view", "teleop", "strict", "peer_merge", "allow_unsupervised", "spawn")
_SINGLE_ROBOT: Final = ("name", "can", "controller", "namespace", "real", "mock", "no_drives", "like", "plant",
                       "kernel_sync", "realtime", "cpu", "full_speed", "ros_args")  # fmt: skip


def run_shared(args: argparse.Namespace) -> int:
    """Run all robots of a world file until they end; raise ConfigError for options of a single robot."""
    for name in _SINGLE_ROBOT:
        if getattr(args, name):
            option = name.replace("_", "-")
            raise ConfigError(f"--{option} is for a single robot; omit it, or give ROBOT")
    _require_shared_parts(args)
    from canopen_control.runtime.shared_world import SharedRun, read_shared

    world = Path(args.world)
    robots = read_shared(world)
    run = SharedRun(
        robots,
        world,
        partial(print, file=sys.stdout, flush=True),
        options=_options(args),
        of_each=_namespace_option(args),
    )
    run.run()
    return 0


def _require_shared_parts(args: argparse.Namespace) -> None:
    if args.ros:
        from canopen_control.ros.installation import require_ros

        require_ros()
    if args.view:
        from canopen_control.view import require_view

        require_view()
    elif args.teleop:
        raise ConfigError("--teleop requires the pages; add --view")


def _options(args: argparse.Namespace) -> list[str]:
    """Return the command line options that are passed on to the run of each robot."""
    options = [f"--{name.replace('_', '-')}" for name in _FLAGS if getattr(args, name)]
    if not args.flight_recorder:
        options.append("--no-flight-recorder")
    if args.duration is not None:
        options += ["--for", f"{args.duration:g}"]
    return options


def _namespace_option(args: argparse.Namespace) -> Callable[[str], list[str]]:
    return lambda name: ["--namespace", name] if args.ros else []


EXAMPLE = "canopen-control run robby --for 5"


_priority = whole_number(
    f"priority from 1 to {HIGHEST_PRIORITY}; write ROBOT before --realtime", range(1, HIGHEST_PRIORITY + 1)
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_robot_arguments(parser)
    parser.add_argument(
        "--ros", action=argparse.BooleanOptionalAction, default=False, help="start the ROS 2 bridge (default: off)"
    )
    parser.add_argument("--namespace", metavar="NS", help="with --ros: namespace of all ROS names and frames")
    parser.add_argument(
        "--physics",
        action="store_true",
        help="make the virtual drives move the robot on a floor, with weight, friction and slip (needs the "
        "extra [physics])",
    )
    parser.add_argument(
        "--world",
        metavar="FILE",
        help="with --physics: YAML file with the objects on the floor and timed events, or an SDF world with static "
        "shapes; without ROBOT: run the robots listed in the file",
    )
    parser.add_argument("--say-name", action="store_true", help="prefix each output line with the robot's name")
    parser.add_argument("--view", action="store_true", help="serve a web page of the robot on this computer")
    parser.add_argument("--teleop", action="store_true", help="with --view: add buttons that drive while they are held")
    _add_timing_arguments(parser)
    parser.add_argument(
        "--full-speed", action="store_true", help="with --real: do not limit speeds even if no preflight has passed"
    )
    parser.add_argument(
        "--no-flight-recorder",
        dest="flight_recorder",
        action="store_false",
        help="do not record the last minute of frames and events, which is otherwise saved to a file after a fault",
    )
    parser.add_argument(
        "--plant",
        metavar="FILE",
        help="simulated mechanics (load, base) of the virtual drives; see `drive --help`",
    )
    parser.add_argument(
        "--spawn",
        action="store_true",
        help="start all child processes (drives, software bus, flight recorder, ROS bridge) as new interpreters "
        "instead of forks of this process",
    )
    add_duration(
        parser,
        "stop S seconds after the controllers have started (or after the boot, if STOP is latched)",
        former="--duration",
        dest="duration",
    )
    add_ros_arguments(parser)


def _add_timing_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--kernel-sync",
        action="store_true",
        help="on SocketCAN: make the kernel send SYNC, so that it is punctual even if this process is late; the "
        "cycle is synchronised to it",
    )
    parser.add_argument(
        "--realtime",
        nargs="?",
        type=_priority,
        const=DEFAULT_PRIORITY,
        metavar="PRIORITY",
        help=f"run with SCHED_FIFO (default priority {DEFAULT_PRIORITY}) and locked memory, and fail if either is not "
        "permitted; disable CPU idle states if permitted",
    )
    parser.add_argument("--cpu", type=int, metavar="N", help="pin the robot's cycle thread to this CPU")


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select a robot and its channel."""
    add_file_arguments(parser)
    add_kind_arguments(parser)
    parser.add_argument(
        "--no-drives", action="store_true", help="do not start virtual drives, because they are already running"
    )
    parser.add_argument(
        "--like",
        metavar="NAME|FILE",
        help="make the virtual drives behave like the drives of a manufacturer; see `drive --help`",
    )
    add_new_name(parser, "name of this robot for its clients (default: name of the folder)")


_CHANNEL_HELP: Final = "channel of the drives: local:NAME (default), vcan0, can0, pcan:..."
_STRICT_HELP: Final = "treat repeated and unknown keys of ros2_controllers.yaml as errors"
_CONTROLLER_HELP: Final = "activate these controllers (repeatable; default: the first)"


def add_file_arguments(
    parser: argparse.ArgumentParser, *, channel: str | None = _CHANNEL_HELP, strict: str = _STRICT_HELP
) -> None:
    """Declare the options that select a robot's files, and how strictly they are read.

    `channel` is the help of --can; None hides this option for a verb that refuses it. `strict` is the help of --strict.
    """
    parser.add_argument("config", nargs="?", metavar="ROBOT", help="a robot folder, or the name of a bundled robot")
    parser.add_argument("xacro", nargs="*", metavar="NAME:=VALUE", help="an argument for the robot's xacro file")
    parser.add_argument("--bus", metavar="FILE", help="bus.yml, instead of the file in the folder")
    parser.add_argument(
        "--controllers", metavar="FILE", help="ros2_controllers.yaml, instead of the file in the folder"
    )
    parser.add_argument("--description", metavar="FILE", help="URDF or xacro, instead of the file in the folder")
    parser.add_argument(
        "--launch",
        metavar="FILE",
        help="a ROS launch file (XML, YAML or Python). It is parsed, not executed; it provides arguments, and files "
        "that are missing from the robot folder",
    )
    parser.add_argument(
        "--can",
        action="append",
        default=[],
        metavar="[BUS=]CHANNEL",
        help=argparse.SUPPRESS if channel is None else channel,
    )
    parser.add_argument("--strict", action="store_true", help=strict)
    parser.add_argument(
        "--peer-merge",
        action="store_true",
        help="let `defaults` of bus.yml take precedence over the nodes' own keys, as ros2_canopen does",
    )
    parser.add_argument(
        "--allow-unsupervised",
        action="store_true",
        help="accept drives that do not stop when the master ends, as `allow_unsupervised: true` in bus.yml does",
    )


def find_files(args: argparse.Namespace) -> RobotFiles:
    """Return the robot files selected by the arguments; raise ConfigError if they cannot be found."""
    from canopen_control.runtime.robot_files import find_robot

    return find_robot(
        args.config,
        bus=args.bus,
        controllers=args.controllers,
        description=args.description,
        arguments=args.xacro,
        launch=args.launch,
    )


def add_controller_argument(parser: argparse.ArgumentParser, text: str = _CONTROLLER_HELP) -> None:
    """Declare --controller with the help `text`."""
    parser.add_argument(
        "--controller",
        action=Names,
        metavar="NAME[,NAME..]",
        help=text,
    )


def add_ros_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --ros-args, the last option."""
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        metavar="...",
        help="must be last: ROS arguments for the bridge, such as parameters and remappings (needs --ros)",
    )


def add_kind_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select real drives or mock hardware, and the active controllers."""
    parser.add_argument("--real", action="store_true", help="use real drives; start no virtual drives")
    parser.add_argument("--mock", action="store_true", help="use mock hardware: no drives and no bus")
    add_controller_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.world is not None and not names_robot(args):
        return run_shared(args)
    return run_robot(args)


def names_robot(args: argparse.Namespace) -> bool:
    """Whether the arguments select a robot, by its folder or its files."""
    return any(
        option is not None for option in (args.config, args.launch, args.bus, args.controllers, args.description)
    )


@contextlib.contextmanager
def _shared_by_forks() -> Iterator[None]:
    """Context that, on exit, forbids forks again and discards the parsed EDS files."""
    try:
        yield
    finally:
        from canopen_control.host.fork import forbid_forks
        from canopen_control.od.eds import forget_files

        forbid_forks()
        forget_files()


@_shared_by_forks()
def run_robot(args: argparse.Namespace, *, motion: bool = False, table: bool = False) -> int:
    """Run a robot until it ends and return 0; raise ConfigError or CanopenError if boot or run fails."""
    if motion and args.real:
        raise ConfigError(f"--real: {_NO_DEMO}")
    with contextlib.ExitStack() as stack:
        with quick_start():
            files = find_files(args)
        bridge = stack.enter_context(_bridge_of(args, files)) if args.ros else None
        with quick_start():
            setup, options = _prepare(args, files, bridge, motion=motion, table=table)
        return _run(args, setup, options)


def _bridge_of(args: argparse.Namespace, files: RobotFiles) -> contextlib.AbstractContextManager[Child]:
    """Return a context manager that runs the ROS bridge process; raise ConfigError if the bridge cannot run."""
    from canopen_control.host.fork import allow_forks
    from canopen_control.host.sockets import check_name
    from canopen_control.ros.installation import require_ros
    from canopen_control.runtime.prepared_bridge import prepared_bridge

    arguments = bridge_arguments(args)
    require_ros()
    if not args.spawn:
        allow_forks()
    return prepared_bridge(check_name(args.name or files.name), arguments)


def _run(args: argparse.Namespace, setup: RobotSetup, options: RunOptions) -> int:
    """Run the robot of `setup` until it ends and return 0; raise CanopenError with the reason for a failure."""
    from canopen_control.runtime.run_session import RunSession

    slow = _slow_reason(setup) if setup.reaches_real_drives and not args.full_speed else None
    session = RunSession(setup, options)
    announcer = Announcer(sys.stderr if options.table else sys.stdout)
    session.reactor.call_soon(announcer.start)  # once the children are started: a process with threads is not forked
    try:
        prefix = f"{setup.name}: " if args.say_name else ""
        session.robot.observers.append(_EventPrinter(announcer, session, table=options.table, prefix=prefix))
        _warn(session)
        if slow is not None:
            _slow_down(session, slow)
        if options.table:
            session.supervisor.start_client(
                TABLE, ["canopen_control", "status", "--watch", "--name", setup.name], inherit_stdout=True
            )
        failure = session.run()
    finally:
        session.close()
        announcer.close()
    if failure is not None:
        raise (ConfigError if session.supervisor.refused else CanopenError)(failure)
    return 0


def _prepare(
    args: argparse.Namespace, files: RobotFiles, bridge: Child | None, *, motion: bool, table: bool
) -> tuple[RobotSetup, RunOptions]:
    """Read the files, check the options, and import the modules that child processes share."""
    setup = read_setup(args, files, keep=not args.spawn)
    if motion and setup.reaches_real_drives:
        channels = setup.files.hardware.real_word or ", ".join(setup.channels.values())
        raise ConfigError(f"{channels}: {_NO_DEMO}")
    _require_parts(args, setup)
    from canopen_control.check import checker  # noqa: F401 - for the warnings
    from canopen_control.runtime.run_session import RunOptions

    options = RunOptions(
        physics=args.physics,
        plant=_plant(args, setup),
        world=setup.world,
        drives=not (setup.real or args.mock or args.no_drives),
        like=args.like or "",
        ros=args.ros,
        ros_arguments=bridge_arguments(args),
        bridge=bridge,
        view=args.view,
        teleop=args.teleop,
        table=table,
        motion=motion,
        duration=args.duration,
        recorder=args.flight_recorder,
        realtime=args.realtime,
        cpu=args.cpu,
    )
    if not args.spawn:
        _share_imports(options)
    return setup, options


def _share_imports(options: RunOptions) -> None:
    """Allow forks; first import the modules of the drives, if started here, so that all forks share them."""
    from canopen_control.bus import hub  # noqa: F401 - for the forks
    from canopen_control.host.fork import allow_forks

    if options.drives:
        from canopen_control.cli import drive  # noqa: F401 - for the forks
        from canopen_control.virtual import device, launch, process  # noqa: F401 - for the forks
    allow_forks()


def _require_parts(args: argparse.Namespace, setup: RobotSetup) -> None:
    """Raise ConfigError if an option needs another option, or an extra of the package, that is missing."""
    from canopen_control.hardware.plugins import PluginKind

    if args.view:
        from canopen_control.view import require_view

        require_view()
    elif args.teleop:
        raise ConfigError("--teleop requires the page; add --view, or drive with keys: canopen-control teleop")
    if args.like is not None:
        _check_like(args, setup)
    if args.physics:
        _check_physics(args, setup)
    elif setup.world is not None and PluginKind.SIMULATION not in setup.kinds:
        raise ConfigError(f"{setup.files.hardware.world_word or '--world'} requires physics; add --physics")


def _check_like(args: argparse.Namespace, setup: RobotSetup) -> None:
    """Raise ConfigError if --like does not name a personality, or if the run starts no virtual drives."""
    from canopen_control.personality import read_personality
    from canopen_control.virtual.quirks import quirks_of

    if setup.reaches_real_drives or args.mock or args.no_drives:
        raise ConfigError("--like is for virtual drives that this program starts; omit it")
    quirks_of(read_personality(args.like))


def _check_physics(args: argparse.Namespace, setup: RobotSetup) -> None:
    """Raise ConfigError if physics is not available, or if it would have nothing to move."""
    from canopen_control.physics import require_physics
    from canopen_control.runtime.physics_plant import check_physics

    require_physics()
    check_physics(setup)
    if args.no_drives:
        raise ConfigError("--physics requires virtual drives of this run; omit --no-drives")


def _plant(args: argparse.Namespace, setup: RobotSetup) -> Path | None:
    """Return the plant file of --plant, or None; raise ConfigError for an invalid file or a conflicting option."""
    if getattr(args, "plant", None) is None:
        return None
    for name in ("physics", "real", "mock", "no_drives"):
        if getattr(args, name):
            raise ConfigError(f"--plant requires virtual drives of this run; omit --{name.replace('_', '-')}")
    from canopen_control.bus.channel import parse_channel
    from canopen_control.virtual.plant_file import read_world

    channels = [channel for channel in setup.channels.values() if not parse_channel(channel).kind.in_process]
    if len(channels) != 1 or len(setup.channels) != 1:
        raise ConfigError(
            f"--plant requires one bus outside this process for all drives, and {setup.name} is on "
            f"{', '.join(setup.channels.values()) or 'none'}; use --can local:NAME"
        )
    path = Path(args.plant)
    read_world(path).close()  # its errors are reported before anything is started
    return path


def bridge_arguments(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the arguments of the ROS bridge; raise ConfigError if arguments are given without --ros."""
    namespace = () if args.namespace is None else ("--namespace", args.namespace)
    ros = () if args.ros_args is None else ("--ros-args", *args.ros_args)
    if (namespace or ros) and not args.ros:
        raise ConfigError(f"{(namespace or ros)[0]} requires the ROS bridge; add --ros")
    return (*namespace, *ros)


def _slow_reason(setup: RobotSetup) -> SlowReason | None:
    """Return why speeds on real drives are limited and for which joints, or None if a preflight permits full speed."""
    from canopen_control.check.preflight_record import slow_reason

    return slow_reason(setup)


def _warn(session: RunSession) -> None:
    """Report the warnings of `check` as events."""
    from canopen_control.check.checker import start_warnings
    from canopen_control.master.event_log import Event, Level

    for text in start_warnings(session.robot.setup):
        session.robot.report(Event(session.reactor.now(), "check", "", text, Level.WARNING))


def _slow_down(session: RunSession, slow: SlowReason) -> None:
    from canopen_control.check.preflight_record import SLOW, limit_speed
    from canopen_control.master.event_log import Event, Level

    unknown = limit_speed(session.robot, slow.joints)
    unlimited = f"; NOT limited, since their speed is unknown: {', '.join(unknown)}" if unknown else ""
    text = (
        f"{slow.why}; speeds are limited to {SLOW:g} rad/s{unlimited} "
        "(run canopen-control preflight, or override with --full-speed)"
    )
    session.robot.report(Event(session.reactor.now(), "slow", "", text, Level.WARNING))


def read_setup(args: argparse.Namespace, files: RobotFiles | None = None, *, keep: bool = False) -> RobotSetup:
    """Read the robot's files and check the options; with `keep`, the parsed EDS files stay in memory for forks."""
    from canopen_control.host.sockets import check_name
    from canopen_control.urdf.description import DescriptionReader

    if args.real and (args.mock or args.no_drives):
        raise ConfigError("--real excludes --mock and --no-drives; omit them")
    files = files or find_files(args)
    if args.name is not None:
        check_name(args.name)
    mappings = files.mappings(mock=args.mock)
    with (
        contextlib.nullcontext()
        if files.bus_alone
        else DescriptionReader(files.description, mappings=mappings) as reader
    ):
        # xacro runs in another process during these imports
        from canopen_control.od.eds import keep_files
        from canopen_control.runtime.setup import read_robot

        if keep:
            keep_files()
        setup = read_robot(
            files,
            name=args.name,
            can=args.can,
            controllers=args.controller,
            mock=args.mock,
            real=args.real,
            strict=args.strict,
            peer_merge=args.peer_merge,
            allow_unsupervised=args.allow_unsupervised,
            kernel_sync=getattr(args, "kernel_sync", False),
            physics=getattr(args, "physics", False),
            drives=bool(args.can or files.hardware.channel),
            simulate=True,
            world=world_of(args, files),
            reader=reader,
        )
    if setup.real:
        setup.require_places(files.hardware.real_word or "--real")
        if args.no_drives:
            raise ConfigError(f"{files.hardware.real_word} starts no virtual drives; omit --no-drives")
    return setup


def world_of(args: argparse.Namespace, files: RobotFiles) -> Path | None:
    """Return the world file of --world or of the robot's files, or None; raise ConfigError if they differ."""
    path = None if getattr(args, "world", None) is None else Path(args.world).resolve()
    if path is not None and files.world not in (None, path):
        raise ConfigError(f"{files.hardware.world_word} contradicts --world {args.world}; omit one of them")
    return path or files.world


_WAITING_LINES: Final = 1000
_CLOSE_S: Final = 1.0  # for queuing the end mark, and again for printing the queued lines


class Announcer:
    """Printer of lines on a separate thread, so that a stopped terminal cannot stop the robot.

    Lines are printed from `start` on, or at the latest at `close`. `dropped` counts the lines that were dropped because
    the queue was full or the output could not be written.
    """

    def __init__(self, stream: TextIO) -> None:
        self.dropped = 0
        self._stream = stream
        self._lines: queue.Queue[tuple[str, bool] | None] = queue.Queue(_WAITING_LINES)
        self._thread = threading.Thread(target=self._print, name="announcer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, line: str, *, token: bool = False) -> None:
        """Queue a line without waiting; `token` adds the page's token when the line is printed (`with_token`)."""
        try:
            self._lines.put_nowait((line, token))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Print the queued lines and end the thread; wait two seconds at most."""
        if self._thread.ident is None:
            self.start()
        try:
            self._lines.put(None, timeout=_CLOSE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_S)

    def _print(self) -> None:
        while (item := self._lines.get()) is not None:
            line, token = item
            try:
                print(with_token(line) if token else line, file=self._stream, flush=True)
            except (OSError, ValueError):  # the output was closed; the robot keeps running
                self.dropped += 1


class _EventPrinter(RobotObserver):
    """Observer that prints events as lines; it counts the booted nodes if the robot has four or more.

    On a terminal the process of a live table prints the events above the table once it has subscribed to them, until
    the robot stops: two processes would overwrite each other's lines.
    """

    def __init__(self, announcer: Announcer, session: RunSession, *, table: bool, prefix: str) -> None:
        from canopen_control.master.event_log import Level

        self._announcer, self._session, self._prefix = announcer, session, prefix
        self._lowest = Level.WARNING if table else Level.INFO
        self._nodes = len(session.robot.nodes)
        self._has_table = table and sys.stdout.isatty() and sys.stderr.isatty()
        self._booted: set[str] = set()

    def event(self, event: Event) -> None:
        session = self._session
        self._has_table = self._has_table and event.kind not in ENDS
        if self._has_table and session.api.sends_events_to(session.supervisor.pids.get(TABLE)):
            return
        text = event.sentence
        if event.kind == _BOOTED and self._nodes >= _MANY:
            self._booted.add(event.node)
            text = f"{text} ({len(self._booted)} of {self._nodes} nodes)"
        if is_printed(event.kind, notable=event.level >= self._lowest):
            line = f"{self._prefix}{text}"
            self._announcer.put(line, token=event.kind == _VIEW)


_NO_DEMO = (
    "demo moves the robot without a command, so it refuses real drives; use virtual drives, "
    "or: canopen-control run ROBOT --real --can CHANNEL"
)
_VIEW = "view"
_BOOTED, _MANY = "ready", 4  # from this number of nodes on, the booted nodes are counted
TABLE: Final = "table"
