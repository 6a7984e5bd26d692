"""Check a robot before it moves on real drives for the first time.

Checks the link and its bit rate, compares the devices on the bus with bus.yml, and checks EDS revisions, errors and
limits. Then, after you confirm each one, it turns the joints slowly one by one, and tests STOP. It starts no virtual
drives. A pass is valid for these files and these drives only; without one, `run --real` is limited to 1 rad/s unless
you give --full-speed.

Exit codes: 0 passed; 1 not passed; 2 wrong usage or configuration.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.can_interfaces import find_can_interface
from canopen_control.bus.channel import ChannelKind, parse_channel
from canopen_control.check.preflight_record import SLOW, config_hash, read_serials, save_record
from canopen_control.cli.run import add_file_arguments, find_files
from canopen_control.cli.support.arguments import add_new_name, number
from canopen_control.cli.support.output import json_alone, json_text, print_result
from canopen_control.cli.support.target import robot_on
from canopen_control.commissioning.identity import FIELDS, NAME, differences, identity_of, match_eds, read_known
from canopen_control.errors import CanopenError, ConfigError, NotEnabled, SdoAbort, SdoTimeout
from canopen_control.host.files import write_whole
from canopen_control.host.sockets import check_name
from canopen_control.master.direct import DirectBus
from canopen_control.od.codec import fitted
from canopen_control.robot import Robot
from canopen_control.runtime.background import BackgroundRobot
from canopen_control.runtime.run_session import RunOptions
from canopen_control.runtime.setup import read_robot
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from canopen_control.master.config import BusConfig
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.runtime.setup import RobotSetup


# The passive steps of a preflight: link, bit rate, devices on the bus, EDS revisions, errors, limits.
#
# Nothing is written to a drive; every step ends with a sentence that contains the measured values.


_ALL_NODES = range(1, 128)
_ANSWER_S = 0.2
_STATE: dict[tuple[int, int], str] = {
    (0x607D, 1): "lower position limit",
    (0x607D, 2): "upper position limit",
    (0x607F, 0): "maximum profile velocity",
    (0x6080, 0): "maximum motor speed",
    (0x6079, 0): "supply voltage",
}
_ERRORS: dict[tuple[int, int], str] = {(0x1001, 0): "error register", (0x603F, 0): "error code"}


@dataclass(frozen=True, slots=True)
class PreflightStep:
    """Result of a preflight step; `passed` is None if the step is only for information."""

    name: str
    passed: bool | None
    text: str


# -- link


def link_steps(channel: str, baudrate: int) -> list[PreflightStep]:
    """Check that a CAN interface is up and has the bit rate of bus.yml, `baudrate` in kbit/s."""
    spec = parse_channel(channel)
    if spec.kind is not ChannelKind.SOCKETCAN:
        return [PreflightStep("link", None, f"{channel}: not a kernel interface, so its bit rate cannot be read")]
    link = find_can_interface(spec.name)
    if link is None or not link.is_up:
        problem = "does not exist" if link is None else "is down"
        command = f"canopen-control bus up {spec.name} --bitrate {baudrate * 1000}"
        return [PreflightStep("link", False, f"{channel} {problem}; bring it up with: {command}")]
    steps = [PreflightStep("link", link.state in (None, "ERROR-ACTIVE"), f"{channel} is up{_state_of(link.state)}")]
    if link.bitrate is None:
        return [*steps, PreflightStep("bit rate", None, f"{channel} is a {link.kind} interface, which has no bit rate")]
    fits = link.bitrate == baudrate * 1000
    return [*steps, PreflightStep("bit rate", fits, f"{link.bitrate} bit/s, and {baudrate * 1000} in bus.yml")]


def _state_of(state: str | None) -> str:
    return f" and {state}" if state else ""


# -- devices on the bus


def node_steps(bus: BusConfig, channel: str) -> Iterator[PreflightStep]:
    """Identify all nodes, compare them with bus.yml and the EDS files, and read their errors and limits."""
    with DirectBus.open(channel, label="preflight", timeout_s=_ANSWER_S, retries=1) as direct:
        answers = direct.read_many((node_id, 0x1000, 0) for node_id in _ALL_NODES)
        present = {node_id for (node_id, _, _), answer in answers.items() if not isinstance(answer, SdoTimeout)}
        for node in bus.nodes.values():
            if node.node_id in present:
                yield from _known_node(direct, bus, node.name, node.node_id)
            else:
                text = f"node {node.node_id} ({node.name}) does not answer; check power, node-ID and bit rate"
                yield PreflightStep("node", False, text)
        for node_id in sorted(present - {node.node_id for node in bus.nodes.values()}):
            yield PreflightStep("node", None, f"node {node_id} answers, but is not in bus.yml")


def _known_node(direct: DirectBus, bus: BusConfig, name: str, node_id: int) -> Iterator[PreflightStep]:
    addresses = [*(address for address, _ in FIELDS.values()), NAME]
    answers = direct.read_many((node_id, *address) for address in addresses)
    identity = identity_of({(index, sub): answer for (_, index, sub), answer in answers.items()})
    title = f"node {node_id} ({name})"
    wrong = differences(identity, bus.plans[name].identity)
    device = f"{identity.device_name or 'a node without a name'}, serial number {identity.serial_number or 'none'}"
    yield PreflightStep("node", not wrong, f"{title}: {'; '.join(wrong) or device}")
    candidates, refused = read_known([bus.eds_paths[name]])
    eds, remark = match_eds(identity, candidates)
    if refused or not candidates:
        yield PreflightStep(
            "EDS", None, f"{title}: {bus.eds_paths[name].name} contains no product code, so nothing can be compared"
        )
    elif eds is None:
        yield PreflightStep("EDS", False, f"{title}: {bus.eds_paths[name].name} is for another product")
    else:
        yield PreflightStep(
            "EDS", None if remark else True, f"{title}: {eds.path.name}{_remark(remark, identity.revision_number)}"
        )
    yield from _readings(direct, bus.dictionaries[name], node_id, title)


def _remark(remark: str, revision: int | None) -> str:
    return f" {remark}, the drive has 0x{revision or 0:08X}" if remark else " and revision fit"


def _readings(direct: DirectBus, od: ObjectDictionary, node_id: int, title: str) -> Iterator[PreflightStep]:
    """Read the error objects, which must be 0, and the limits, which are printed."""
    addresses = [address for address in (*_ERRORS, *_STATE) if address in od]
    values: dict[tuple[int, int], int] = {}
    for address in addresses:
        try:
            data = direct.read(node_id, *address)
        except SdoAbort:
            continue
        entry = od[address]
        if (padded := fitted(data, entry.data_type)) is None:
            place = f"0x{address[0]:04X}:{address[1]:02X} {entry.name}"
            yield PreflightStep(
                "EDS",
                False,
                f"{title}: {place} answered {len(data)} bytes, which is not a valid {entry.data_type.name}",
            )
            continue
        values[address] = int.from_bytes(padded, "little", signed=entry.data_type.signed)
    errors = {_ERRORS[address]: value for address, value in values.items() if address in _ERRORS}
    text = ", ".join(f"{name} 0x{value:02X}" for name, value in errors.items())
    yield PreflightStep("errors", not any(errors.values()), f"{title}: {text or 'none'}")
    limits = ", ".join(f"{_STATE[address]} {value}" for address, value in values.items() if address in _STATE)
    if limits:
        yield PreflightStep("limits", None, f"{title}: {limits} (device units)")


# The jog of a preflight: each joint is turned slowly, all are stopped, and the motion is compared with the commands.
#
# One joint moves at a time, slowly and only after a confirmation; at the end all turn, to test STOP. A joint with a
# velocity interface gets a velocity; a joint with only a position interface is moved in small steps, within its limits;
# a joint with neither is not turned, and reported. Every step ends with a sentence that contains the measured values.


TOLERANCE = 0.2  # fraction of the commanded speed
STANDSTILL = 0.05  # rad/s
_TIMEOUT_S = 5.0
_STOP_S = 5.0
_POLL_S = 0.02
_FORWARD = "forward_command_controller/ForwardCommandController"
_CYCLES = 25  # length of a jog at constant speed, so that one cycle more or less does not matter
_RUN_UP_S = 0.3  # part of a jog after which a joint commanded by position counts as moving
_SPARE_S = 1.0  # part of a jog in which the joint accelerates and stops


def jog_interfaces(setup: RobotSetup) -> dict[str, str | None]:
    """Return the command interface for jogging each joint (velocity, position or None), in the order of the URDF."""
    parts = (part for tag in setup.description.hardware for part in tag.joints)
    return {
        part.name: next((interface for interface in (VELOCITY, POSITION) if interface in part.command_interfaces), None)
        for part in parts
    }


class Jog:
    """Robot whose joints are jogged, with one forward controller for each command interface.

    The context boots, enables and shuts down the robot. `joints` can be jogged; `turned` have turned as commanded.
    """

    def __init__(self, setup: RobotSetup, speed: float) -> None:
        self._interfaces = {joint: name for joint, name in jog_interfaces(setup).items() if name is not None}
        self.joints, self.speed = list(self._interfaces), speed
        self.turned: list[str] = []
        self._folder = tempfile.TemporaryDirectory(prefix="preflight-")
        path = Path(self._folder.name) / "ros2_controllers.yaml"
        groups = self._groups()
        path.write_text(_controllers(groups, setup.controllers.update_rate))
        files = replace(setup.files, controllers=path)
        channels = [f"{name}={channel}" for name, channel in setup.channels.items()]
        names = [_controller(name) for name in groups]
        self._setup = read_robot(files, name=setup.name, can=channels, controllers=names, real=True)
        self._robot = Robot(setup.name, BackgroundRobot(self._setup, RunOptions(drives=False)))
        self._hold_s = max(1.0, _CYCLES * self._setup.cycle_ns / 1e9)
        self._poll_s = max(_POLL_S, self._setup.cycle_ns / 1e9)
        self._targets: dict[str, float] = {}  # targets of the joints that are commanded by position
        self._commanded = 0.0  # monotonic time of the last command
        self._velocity = 0.0  # of the joint that a jog brings to its speed

    def __enter__(self) -> Jog:
        try:
            self._robot.start()
            self._targets = {joint: self._reading(joint)["position"] for joint in self._groups().get(POSITION, [])}
        except BaseException:
            self._robot.shutdown()
            self._folder.cleanup()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self._robot.shutdown()
        self._folder.cleanup()

    def range_refusal(self, joint: str) -> str | None:
        """Return why a joint does not have enough travel left for a jog, or None if it does."""
        if self._interfaces[joint] != POSITION:
            return None
        position, needed = self._reading(joint)["position"], self.speed * (self._hold_s + _SPARE_S)
        room = self._setup.description.joints[joint].limits.upper - position
        if room >= needed:
            return None
        text = f"it is at {position:.3f}, {room:.3f} before its limit"
        return f"{text}, and a jog at {self.speed:g} rad/s needs {needed:.3f}"

    def turn(self, joint: str) -> PreflightStep:
        """Jog one joint; check that it turns at the commanded speed, and that no other joint moves."""
        try:
            return self._turn(joint)
        except NotEnabled as error:  # the robot has stopped during the jog
            reason = self._why_stopped() or str(error)
            if self._velocity > self.speed * (1 + TOLERANCE):
                reason = f"{self._velocity:.3f} rad/s at a command of {self.speed:g}; {reason}"
            return PreflightStep("jog", False, f"{joint}: {reason}")

    def _turn(self, joint: str) -> PreflightStep:
        low, high = self.speed * (1 - TOLERANCE), self.speed * (1 + TOLERANCE)
        self._velocity = 0.0
        speeds, start = {joint: self.speed}, self._positions()
        if not self._until(speeds, lambda: self._is_fast(joint, start)):
            velocity = self._reading(joint)["velocity"]
            self._bring_to_rest()
            return PreflightStep(
                "jog", False, f"{joint}: {velocity:.3f} rad/s at a command of {self.speed:g}{_hint(velocity)}"
            )
        begin, since = self._positions(), time.monotonic()
        self._until(speeds, lambda: time.monotonic() - since >= self._hold_s)
        end, elapsed = self._positions(), time.monotonic() - since
        self._bring_to_rest()
        travels = {name: end[name] - begin[name] for name in self.joints}
        moved = [name for name in self.joints if name != joint and abs(travels[name]) > TOLERANCE * self.speed]
        text = f"{joint}: {travels[joint]:.3f} rad in {elapsed:.2f} s at a command of {self.speed:g} rad/s"
        text += _hint(travels[joint])
        if moved:
            text += f"; {', '.join(moved)} turned as well"
        passed = low <= travels[joint] / elapsed <= high and not moved
        self.turned += [joint] if passed else []
        return PreflightStep("jog", passed, text)

    def stop(self) -> PreflightStep:
        """Jog all joints that have passed, trigger STOP, and measure the time until the drives are disabled.

        Joints that are commanded by position move back towards the start of their jog.
        """
        speeds = {joint: self.speed * (-1 if joint in self._targets else 1) for joint in self.turned}
        start = self._positions()
        try:
            turns = self._until(speeds, lambda: all(self._is_fast(joint, start) for joint in speeds))
        except NotEnabled as error:
            return PreflightStep("STOP", False, f"STOP cannot be tested: {self._why_stopped() or error}")
        if not turns:
            return PreflightStep("STOP", False, "the joints do not turn, so STOP cannot be tested")
        since = time.monotonic()
        try:
            self._robot.stop()
        except CanopenError as error:
            return PreflightStep("STOP", False, str(error))
        elapsed = time.monotonic() - since
        velocities = {joint: self._reading(joint)["velocity"] for joint in self.joints}
        still = all(abs(velocity) <= STANDSTILL for velocity in velocities.values())
        text = ", ".join(f"{joint} {velocity:.3f} rad/s" for joint, velocity in velocities.items())
        return PreflightStep(
            "STOP", still and elapsed <= _STOP_S, f"drives disabled {elapsed:.2f} s after STOP: {text}"
        )

    def _why_stopped(self) -> str:
        """Return the last two errors of the robot, such as a fault and the stop that follows, "" without one."""
        errors = [event.text for event in self._robot.status().events if event.level == "error"]
        return "; ".join(text.partition("; to continue")[0] for text in errors[-2:])  # this program ends the robot

    def _is_fast(self, joint: str, start: Mapping[str, float]) -> bool:
        """Whether a joint has reached the jog speed; if commanded by position, whether it has moved far enough."""
        sample = self._reading(joint)
        if joint in self._targets:
            return abs(sample["position"] - start[joint]) >= self.speed * _RUN_UP_S
        self._velocity = sample["velocity"]
        return abs(sample["velocity"] - self.speed) <= self.speed * TOLERANCE

    def _groups(self) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for joint, interface in self._interfaces.items():
            groups.setdefault(interface, []).append(joint)
        return groups

    def _reading(self, joint: str) -> dict[str, float]:
        sample = self._robot.joints()[joint]
        values = {"position": sample.position, "velocity": sample.velocity}
        return {key: math.nan if value is None else value for key, value in values.items()}

    def _positions(self) -> dict[str, float]:
        return {joint: self._reading(joint)["position"] for joint in self.joints}

    def _until(self, speeds: Mapping[str, float], condition: Callable[[], bool]) -> bool:
        """Move only the joints in `speeds` until `condition` is true; return False after a timeout."""
        deadline = time.monotonic() + _TIMEOUT_S + self._hold_s
        self._commanded = time.monotonic()
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._command(speeds)
            time.sleep(self._poll_s)
        return True

    def _command(self, speeds: Mapping[str, float]) -> None:
        now = time.monotonic()
        passed, self._commanded = now - self._commanded, now
        for joint in self._targets:
            self._targets[joint] += speeds.get(joint, 0.0) * passed
        for interface, joints in self._groups().items():
            values = [self._targets.get(joint, speeds.get(joint, 0.0)) for joint in joints]
            self._robot.command(_controller(interface), values)

    def _bring_to_rest(self) -> None:
        self._until({}, lambda: max(abs(self._reading(joint)["velocity"]) for joint in self.joints) <= STANDSTILL)


def _hint(velocity: float) -> str:
    if math.isnan(velocity):
        return "; it reports no velocity: is 0x606C mapped?"
    if velocity < -STANDSTILL:
        return "; it turns the wrong way: check motor and encoder cables, and polarity (0x607E) in the drive"
    return ""


def _controller(interface: str) -> str:
    return f"preflight_{interface}"


def _controllers(groups: Mapping[str, list[str]], rate: int) -> str:
    """Return the text of a ros2_controllers.yaml with one forward controller for each group of joints."""
    head = (
        f"controller_manager:\n  ros__parameters:\n    update_rate: {rate}\n"
        "    joint_state_broadcaster:\n      type: joint_state_broadcaster/JointStateBroadcaster\n"
    )
    types = [f"    {_controller(name)}:\n      type: {_FORWARD}\n" for name in groups]
    sections = [
        f"{_controller(name)}:\n  ros__parameters:\n    joints: [{', '.join(joints)}]\n"
        f"    interface_name: {name}\n    command_timeout: 0.5\n"
        for name, joints in groups.items()
    ]
    return head + "".join(types + sections)


EXAMPLE = "canopen-control preflight robby --can can0"

_MARKS = {True: "ok  ", False: "FAIL", None: "note"}
_NOT_TURNED = "; it is not turned, and remains limited with --real"
_WARNING = (
    "The next steps turn the motors. Lift the wheels off the ground, keep hands and cables away, and have the supply "
    "within reach: STOP is not a safety function."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_file_arguments(parser)
    add_new_name(parser, "name of the robot for which the pass is recorded (default: name of the folder)")
    parser.add_argument("--yes", action="store_true", help="assume yes to all questions (unattended use)")
    parser.add_argument("--no-jog", action="store_true", help="check only, move nothing; this does not count as a pass")
    parser.add_argument(
        "--speed",
        type=number(f"speed above 0 and up to {SLOW:g} rad/s", lambda value: 0 < value <= SLOW),
        default=0.5,
        metavar="RAD/S",
        help=f"speed of the joints (default: 0.5, at most {SLOW:g})",
    )
    parser.add_argument("--report", metavar="FILE", help="write the findings as JSON to this file")


@dataclass(slots=True)
class Preflight:
    """State of a preflight, with functions that print a line and ask the user."""

    setup: RobotSetup
    report: Callable[[str], None]
    ask: Callable[[str], bool]
    speed: float
    steps: list[PreflightStep] = field(default_factory=list)
    covered: list[str] = field(default_factory=list)  # the joints that turned as commanded

    def note(self, steps: Iterable[PreflightStep]) -> bool:
        """Store and print the results of steps; return False if a step has failed."""
        good = True
        for step in steps:
            self.steps.append(step)
            self.report(f"{_MARKS[step.passed]}  {step.name:<8}  {step.text}")
            good = good and step.passed is not False
        return good

    def check_link(self) -> bool:
        """Check links and nodes without writing to a drive; return False if a step has failed."""
        good = True
        for name, bus in self.setup.buses.items():
            channel = self.setup.channels[name]
            linked = self.note(link_steps(channel, bus.master.baudrate))
            good = linked and self.note(node_steps(bus, channel)) and good
        return good

    def move(self) -> bool:
        """Jog every joint, then test STOP; return False if a step has failed or the user declines."""
        for joint, interface in jog_interfaces(self.setup).items():
            if interface is None:
                self.note(
                    [
                        PreflightStep(
                            "jog", None, f"{joint} has neither a velocity nor a position command interface{_NOT_TURNED}"
                        )
                    ]
                )
        if not any(jog_interfaces(self.setup).values()):
            verdict = None if self.setup.files.bus_alone else False  # its drives are turned by their targets alone
            return self.note([PreflightStep("jog", verdict, "no joint has a velocity or position command interface")])
        self.report(_WARNING)
        if not self.ask("Continue?"):
            return self.note([PreflightStep("jog", False, "declined by the user")])
        with Jog(self.setup, self.speed) as jog:
            if not all(self._turn(jog, joint) for joint in jog.joints):
                return False
            if not jog.turned:
                return self.note([PreflightStep("jog", False, "no joint could be turned")])
            self.covered += jog.turned
            return self.note([jog.stop()])

    def _turn(self, jog: Jog, joint: str) -> bool:
        if (why := jog.range_refusal(joint)) is not None:
            return self.note([PreflightStep("jog", None, f"{joint}: {why}{_NOT_TURNED}")])
        if not self.ask(f"Turn {joint} forward at {self.speed:g} rad/s?"):
            return self.note([PreflightStep("jog", False, f"{joint}: declined by the user")])
        if not self.note([jog.turn(joint)]):
            return False
        if self.ask(f"Did {joint}, and nothing else, turn forward?"):
            return True
        return self.note([PreflightStep("jog", False, f"{joint}: turned the wrong way, or something else turned")])


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if not (args.yes or args.no_jog or sys.stdin.isatty()):
        raise ConfigError(
            "standard input is not a terminal, so no question can be asked; add --yes to confirm all, or --no-jog"
        )
    if args.report is not None and not Path(args.report).absolute().parent.is_dir():  # before anything moves
        raise ConfigError(f"--report {args.report}: no folder {Path(args.report).parent}")
    setup = _read_setup(args)
    _refuse_running(setup)
    flight = Preflight(setup, print, (lambda _question: True) if args.yes else _ask, args.speed)
    with json_alone(args):
        passed = flight.check_link() and not args.no_jog and flight.move()
        code, document = _conclude(flight, passed=passed, check_only=args.no_jog, report=args.report)
    print_result(args, document)
    return code


def _read_setup(args: argparse.Namespace) -> RobotSetup:
    """Read the robot's files, as for real drives; raise ConfigError if they are invalid."""
    from canopen_control.runtime.setup import read_robot

    files = find_files(args)
    if args.name is not None:
        check_name(args.name)
    setup = read_robot(
        files,
        name=args.name,
        can=args.can,
        real=True,
        strict=args.strict,
        peer_merge=args.peer_merge,
        allow_unsupervised=args.allow_unsupervised,
    )
    setup.require_places("preflight")
    return setup


def _refuse_running(setup: RobotSetup) -> None:
    """Raise ConfigError if a robot runs on one of the channels, because an SDO server has one client."""
    for channel in setup.channels.values():
        if (owner := robot_on(channel)) is not None:
            raise ConfigError(
                f"robot {owner[0]} runs on {channel} and is the one client of its nodes; end it first: "
                f"canopen-control shutdown --name {owner[0]}"
            )


def _ask(question: str) -> bool:
    print(f"{question} [y/N] ", end="", flush=True)
    answer = ""
    try:
        answer = sys.stdin.readline()
    finally:
        if not answer.endswith("\n"):  # Ctrl-C or Ctrl-D: further output starts on a new line
            print(flush=True)
    return answer.strip().lower() in ("y", "yes")


def _conclude(flight: Preflight, *, passed: bool, check_only: bool, report: str | None) -> tuple[int, PreflightReport]:
    """Print the verdict, write the report and the record of a pass; return the exit code and the findings."""
    setup = flight.setup
    failed = [step for step in flight.steps if step.passed is False]
    serials = read_serials(setup) if passed else {}
    silent = [name for name, serial in serials.items() if serial is None]
    if passed and silent:
        raise CanopenError(f"{', '.join(silent)} no longer answers, so the passed preflight is not recorded")
    document = _findings(flight, passed, serials)
    code = 0 if passed or (check_only and not failed) else 1
    if passed:
        known_serials = {name: serial for name, serial in serials.items() if serial is not None}
        path = save_record(setup, known_serials, flight.covered)
        slow = [joint for joint in jog_interfaces(setup) if joint not in flight.covered]
        remark = f"; still limited, as they were not turned: {', '.join(slow)}" if slow else ""
        print(f"{setup.name} has passed{remark}; run it with --real ({path})")
    elif code:
        print(f"{setup.name} has not passed: {len(failed)} of {len(flight.steps)} steps failed")
    else:
        print(f"the checks found no problem; without the jog {setup.name} has not passed")
    if report is not None:  # last, so that a full disk does not cost the record of a pass
        write_whole(Path(report), f"{json_text(document)}\n".encode())
    return code, document


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """Result of a preflight; `serial_numbers` are by node, `joints` have turned as commanded."""

    robot: str
    time: str
    passed: bool
    channels: dict[str, str]
    configuration: str
    serial_numbers: dict[str, int | None]
    joints: list[str]
    steps: list[PreflightStep]


def _findings(flight: Preflight, passed: bool, serials: dict[str, int | None]) -> PreflightReport:
    return PreflightReport(
        robot=flight.setup.name,
        time=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        passed=passed,
        channels=flight.setup.channels,
        configuration=config_hash(flight.setup),
        serial_numbers=serials,
        joints=flight.covered,
        steps=flight.steps,
    )
