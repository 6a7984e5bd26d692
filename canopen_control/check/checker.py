"""Check of a robot's files without opening a bus, for the command `check`.

Each file is read separately, so that an error in one file does not hide errors in another. Then the rules (`rules`) and
the bus load are checked and, if there are no errors, the robot is built as for a start. Each finding is reported once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from canopen_control.check import rules as rules
from canopen_control.check.drive_rules import check_timing, cycle_ns
from canopen_control.check.finding import Finding, sorted_findings
from canopen_control.check.stop_times import axis_facts, stop_time
from canopen_control.controllers.limiters import LONGEST_STOP_S
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.hardware.axis_parameters import add_plugin_interfaces
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.master.budget import HIGH, budget_of
from canopen_control.master.config import inspect_bus
from canopen_control.master.keys import SHORTEST_SYNC_US
from canopen_control.od.issues import Severity
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.default_description import default_warnings, unmoved_drives
from canopen_control.runtime.robot_files import unread_buses
from canopen_control.runtime.setup import clashes_of, plans_of, read_robot
from canopen_control.runtime.sync_choice import SyncSender
from canopen_control.urdf.description import read_description

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from canopen_control.check.stop_times import AxisFacts, StopTime
    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.master.budget import Budget
    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.robot_bus import RobotBus
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.runtime.sync_choice import SyncChoice
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.yamlfile.node import Problem


_SLOW_RAMP_S: Final = 60.0  # a longer ramp is a warning, a shorter one a note


@dataclass(frozen=True, slots=True)
class CheckOptions:
    """Options of `run` that affect the check."""

    controllers: Sequence[str] = ()
    can: Sequence[str] = ()
    mock: bool = False
    real: bool = False
    peer_merge: bool = False
    allow_unsupervised: bool = False
    launch: Path | None = None


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Findings in the order of file and line, with the load and the SYNC producer of each bus whose file is valid.

    `stops` are the stopping times of the joints on drives. `sync` and `stops` are empty if the robot cannot be built.
    """

    findings: tuple[Finding, ...]
    budgets: dict[str, Budget] = field(default_factory=dict)
    sync: dict[str, str] = field(default_factory=dict)
    stops: tuple[StopTime, ...] = ()

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity."""
        return sum(finding.severity is severity for finding in self.findings)

    def passes(self, *, strict: bool = False) -> bool:
        """Whether no errors and, with `strict`, no warnings were found."""
        return not self.count(Severity.ERROR) and not (strict and self.count(Severity.WARNING))


def check_robot(files: RobotFiles, options: CheckOptions) -> CheckReport:
    """Check the files of a robot; errors in the files are returned as findings, not raised."""
    checker = _Checker(files, options)
    checker.run()
    return CheckReport(tuple(sorted_findings(checker.findings)), checker.budgets, checker.sync, checker.stops)


def start_warnings(setup: RobotSetup) -> list[str]:
    """Return the texts of the warnings of `check` for a robot whose files have already been read."""
    if setup.files.bus_alone:
        return []
    buses, control, description = dict(setup.buses), setup.controllers, setup.description
    findings = rules.find(setup.files, _one_bus(buses), control, description, mock=setup.mock, real=setup.on_drives)
    for config in buses.values():
        findings += check_timing(config, control, description)
        for note in config.notes:  # notes with a line number are warnings
            notes = rules.findings_of(note, config.path, 0, Severity.WARNING)
            findings += [remark for remark in notes if remark.line]
    warnings = [finding for finding in sorted_findings(findings) if finding.severity is Severity.WARNING]
    return [str(replace(warning, source="")) for warning in warnings]


class _Checker:
    """State of one check: the files read so far, and the findings."""

    def __init__(self, files: RobotFiles, options: CheckOptions) -> None:
        self.findings: list[Finding] = []
        self.budgets: dict[str, Budget] = {}
        self.sync: dict[str, str] = {}
        self.stops: tuple[StopTime, ...] = ()
        self._files, self._options = files, options
        self._buses: dict[str, BusConfig] = {}
        self._valid_buses: dict[str, BusConfig] = {}  # only buses without errors

    def run(self) -> None:
        for name, path in self._files.buses.items():
            self._read_bus(name, path)
        for path, name in unread_buses(self._files).items():
            text = f"this file has nodes, but is not read; for a second bus, call it {name}"
            self.findings.append(Finding(str(path), 0, Severity.NOTE, text))
        self.findings += [_placed(text, self._files.description) for text in clashes_of(self._valid_buses)]
        alone = self._files.bus_alone
        control, description = (None, None) if alone else (self._read_controllers(), self._read_description())
        for text in default_warnings(self._valid_buses) if alone else ():
            self.findings += rules.findings_of(text, str(self._files.bus), 0, Severity.WARNING)
        for text in () if description is None else unmoved_drives(self._valid_buses, description, control):
            self.findings += rules.findings_of(text, str(self._files.bus), 0, Severity.NOTE)
        self.findings += rules.find(
            self._files,
            _one_bus(self._buses),
            control,
            description,
            controllers=self._options.controllers,
            launch=self._options.launch,
            mock=self._options.mock,
            real=self._options.real or bool(self._files.hardware.real),
        )
        self._read_world()
        for name, config in self._valid_buses.items():
            self.budgets[name] = budget = budget_of(config, cycle_ns(config, control))
            self.findings += _with_known_period(config, budget, control)
            self.findings += check_timing(config, control, description)
        if not any(finding.severity is Severity.ERROR for finding in self.findings):
            self._build()

    def _read_bus(self, name: str, path: Path) -> None:
        try:
            options = self._options
            config, problems = inspect_bus(
                path, peer_merge=options.peer_merge, allow_unsupervised=options.allow_unsupervised
            )
        except ConfigError as error:
            self.findings += rules.findings_of(str(error), str(path), 0, Severity.ERROR)
            return
        if config.nodes or not problems.errors:  # otherwise every joint would lack its node
            self._buses[name] = config
        if not problems.errors:
            self._valid_buses[name] = config
        self.findings += [_of_problem(problem, Severity.ERROR) for problem in problems.errors]
        self.findings += [_of_problem(problem, Severity.WARNING) for problem in problems.warnings]
        for note in config.notes[len(problems.warnings) :]:
            line = config.note_lines.get(note, 0)
            self.findings.append(Finding(config.path, line, Severity.NOTE, note.removeprefix(f"{config.path}: ")))
        for text in config.substitutes:
            self.findings.append(Finding(config.path, 0, Severity.NOTE, text.removeprefix(f"{config.path}: ")))
        self.findings += _of_eds(config)

    def _read_controllers(self) -> ControllersFile | None:
        path = self._files.controllers
        try:
            control, files = self._files.inspect_controllers()
        except ConfigError as error:
            self.findings += rules.findings_of(str(error), str(path), 0, Severity.ERROR)
            return None
        errors = [problem for problems in files for problem in problems.errors]
        self.findings += [_of_problem(problem, Severity.ERROR) for problem in errors]
        return control if control.controllers else None

    def _read_description(self) -> UrdfDescription | None:
        path = self._files.description
        try:
            mappings = self._files.mappings(mock=self._options.mock)
            # including plans of a bus with errors, or each drive with an error would lack its command interfaces too
            return add_plugin_interfaces(read_description(path, mappings=mappings), plans_of(self._buses))
        except ConfigError as error:
            self.findings += rules.findings_of(str(error), str(path), 0, Severity.ERROR)
        return None

    def _read_world(self) -> None:
        """Read the world file, if any, and report errors and notes."""
        path = self._files.world
        if path is None:
            return
        from canopen_control.physics.scene_file import read_world_description  # few robots have one

        try:
            world = read_world_description(path)
        except ConfigError as error:
            self.findings += rules.findings_of(str(error), str(path), 0, Severity.ERROR)
        else:
            for note in world.notes:
                self.findings += rules.findings_of(note, str(path), 0, Severity.NOTE)

    def _build(self) -> None:
        """Build the robot as for a start, without opening a bus; report a refusal as an error."""
        options = self._options
        try:
            setup = read_robot(
                self._files,
                can=options.can,
                controllers=options.controllers,
                mock=options.mock,
                real=options.real,
                peer_merge=options.peer_merge,
                allow_unsupervised=options.allow_unsupervised,
            )
            reactor = Reactor(ManualClock())
            try:
                robot = RobotCore(setup, reactor)
                if not setup.mock:
                    self.stops = tuple(stop_time(axis_fact) for axis_fact in axis_facts(setup, robot.manager))
                robot.close()
            finally:
                reactor.close()
        except CanopenError as error:
            self.findings += rules.findings_of(str(error), str(self._files.description), 0, Severity.ERROR)
            return
        self.sync = {name: _sync_words(bus, setup.sync[name]) for name, bus in robot.buses.items()}
        self.findings += _slow_stops(self._valid_buses, self.stops)


def _slow_stops(buses: dict[str, BusConfig], stops: tuple[StopTime, ...]) -> Iterator[Finding]:
    """Find drives whose controlled stop from maximum speed is so slow that a quick stop follows."""
    for stop in stops:
        case, facts = stop.slow_ramp, stop.facts
        config = next((bus for bus in buses.values() if facts.node in bus.nodes), None)
        if case is None or config is None:
            continue
        place = config.place(facts.node, "sdo")
        ramp, speed = f"{round(case.ramp_s):.6g}", f"{round(facts.speed):.12g}"
        text = (
            f"{facts.node}: {_subject(facts)} needs {ramp} s to brake from {speed} units/s "
            f"({case.by}); a stop that takes longer than {LONGEST_STOP_S:.0f} s becomes a quick stop"
        )
        limit = "0x607F" if facts.joint == facts.node else "the velocity limit of the joint, its <limit> or 0x607F"
        fix = f"write a faster ramp to the drive under `sdo`, or lower {limit}"
        if facts.own_unit:  # as in Kinco's FD5, whose ramps have another factor than its velocities
            fix = f"read the unit of the ramp in the manual: if it is that of the velocities per s, {fix}"
        severity = Severity.WARNING if case.ramp_s > _SLOW_RAMP_S else Severity.NOTE
        yield Finding(place.path, place.line, severity, text, fix, column=place.column)


def _subject(facts: AxisFacts) -> str:
    """Return the joint, or "it" on a bus without controllers, where the joint has the name of its node."""
    return facts.joint if facts.joint != facts.node else "it"


def _sync_words(bus: RobotBus, choice: SyncChoice) -> str:
    """Return a sentence about the SYNC producer, with the reason for the choice, or why the kernel cannot send SYNC."""
    refused = None if choice.sender is not SyncSender.KERNEL else bus.why_no_kernel_sync()
    return f"{bus.sync_words}; {refused or choice.words}"


def _of_problem(problem: Problem, severity: Severity) -> Finding:
    """Convert a problem in a YAML file to a finding, with the line of the file and a caret."""
    text = f"{problem.where}: {problem.message}" if problem.where else problem.message
    source = "\n".join(str(problem).split("\n")[1:])
    return Finding(problem.path, problem.line, severity, text, column=problem.column, source=source)


def _of_eds(config: BusConfig) -> Iterator[Finding]:
    """Yield a note for each EDS with issues: their number, and the first one."""
    for path, issues in config.eds_issues.items():
        odd = [issue for issue in issues if issue.severity is not Severity.NOTE]
        if odd:
            count = "1 issue" if len(odd) == 1 else f"{len(odd)} issues"
            text = f"{count} in this file, the first at line {odd[0].line}: {odd[0].text}"
            yield Finding(str(path), 0, Severity.NOTE, text, f"canopen-control eds check {path} lists all")


def _placed(text: str, path: Path) -> Finding:
    return next(iter(rules.findings_of(text, str(path), 0, Severity.ERROR)))


def _one_bus(buses: dict[str, BusConfig]) -> BusConfig | None:
    """Return all nodes of a robot as one bus, since node names are unique; None without a bus."""
    first = next(iter(buses.values()), None)
    if first is None:
        return None
    return replace(
        first,
        nodes={name: node for bus in buses.values() for name, node in bus.nodes.items()},
        plans={name: plan for bus in buses.values() for name, plan in bus.plans.items()},
        dictionaries={name: od for bus in buses.values() for name, od in bus.dictionaries.items()},
        sections={name: place for bus in buses.values() for name, place in bus.sections.items()},
        unreadable={name: node_id for bus in buses.values() for name, node_id in bus.unreadable.items()},
        incomplete=any(bus.incomplete for bus in buses.values()),
    )


def _with_known_period(config: BusConfig, budget: Budget, control: ControllersFile | None) -> Iterator[Finding]:
    """Find bus load problems: overload, PDOs longer than sync_window, event PDOs without inhibit time."""
    kbits, shortest = config.master.baudrate, budget.shortest_period_ns / 1e6
    path, line, cure = config.path, config.period_line, "raise sync_period"
    if not config.master.sync_period and control is not None:
        key = control.manager_keys.get("update_rate")
        path, line = (control.path, 0) if key is None else (key.path, key.line)
        cure = "lower update_rate"
    if not budget.fits:
        period = f"a cycle of {budget.period_ns / 1e6:g} ms"
        text = f"{period} is too short for its {budget.worst_bits} bits at {kbits} kbit/s"
        fix = f"the shortest possible period is {shortest:.2f} ms; {cure}, raise the bit rate, or map less"
        if 0 < config.master.sync_period < SHORTEST_SYNC_US:
            fix = f"sync_period is in us; write {config.master.sync_period}000 for {config.master.sync_period} ms"
        yield Finding(path, line, Severity.ERROR, text, fix)
    elif budget.load > HIGH:
        text = f"the bus has a load of {budget.load:.0%} by process data and heartbeats alone"
        fix = f"above {HIGH:.0%} too little bandwidth is left for SDO and EMCY; {cure}, raise the bit rate, or map less"
        yield Finding(path, line, Severity.WARNING, text, fix)
    window = config.master.sync_window
    if window and budget.shortest_period_ns > window * 1000:
        text = f"the synchronous PDOs take {shortest:.2f} ms, sync_window is {window / 1000:g} ms"
        yield Finding(config.path, 0, Severity.WARNING, text, "widen the window, or map less")
    for name in budget.unbounded:
        text = f"{name} is sent on events without an inhibit_time, and may be sent more often than once per cycle"
        yield Finding(config.path, 0, Severity.NOTE, text, "set inhibit_time, or transmission 1")
