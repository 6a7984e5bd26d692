"""Mutants of the package, each a mistake that tests and simulations must detect, and commands to run with one.

    python tools/code_mutants.py                                # list them, each with what has to catch it
    python tools/code_mutants.py run NAME pytest -q tests/cia402 -m "not process"
    python tools/code_mutants.py run NAME seeds robby --seeds 40 --for 20
    python tools/code_mutants.py run NAME simulate robby --scenario FILE
    python tools/code_mutants.py measure [--tests] [--seeds] [NAME ...]

A mutant replaces code in one function (`Change`): an expression, or statements that follow each other, which must stand
there exactly once, however they are formatted. A mutant whose code has changed is a LookupError and not a pass. The
package on disk stays as it is: an import hook compiles the changed module. The whole measurement takes long, so it is
no test; that each mutant still applies is one (`tests/test_code_mutants.py`).

`measure --tests` runs the test module of each mutant, `measure --seeds` its simulations; what has caught one is run
without it too, since what fails anyway catches nothing. Exit codes: 0 all were caught, 1 not, 2 usage, 3 a mutant does
not apply.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import importlib.util
import runpy
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

ROOT: Final = Path(__file__).parents[1]
PACKAGE: Final = "canopen_control"
CAMPAIGN: Final = "tools/campaigner"


class Change(NamedTuple):
    """Code in a function of a module of the package ("" for module level), and its replacement."""

    module: str
    function: str
    old: str
    new: str

    @property
    def path(self) -> Path:
        """The path of the module's file."""
        return ROOT / PACKAGE / f"{self.module.replace('.', '/')}.py"

    @property
    def subpackage(self) -> str:
        """The changed subpackage."""
        return self.module.partition(".")[0]


class Mutant(NamedTuple):
    """A mutant: what it `does`, its change, and the simulations that detect it, as commands of `run`.

    `tests` is the test module, without processes and of the subpackage that is changed, that has to catch it. A mutant
    without `runs` is one that no simulation shows.
    """

    name: str
    does: str
    change: Change
    runs: tuple[str, ...]
    tests: str


_ROBBY: Final = "seeds robby --seeds 40 --for 20"
_ARM: Final = "seeds arm6 --seeds 40 --for 20"
_FORKLIFT: Final = "seeds forklift --seeds 40 --for 20"


def _scenario(robot: str, name: str) -> str:
    """Return the command that plays a scenario of the campaign, on a bundled robot or one of its small robots."""
    small = ROOT / CAMPAIGN / "robots" / robot
    where = f"{CAMPAIGN}/robots/{robot}" if small.is_dir() else ""
    file = f"{where}/{name}.yml" if where else f"{CAMPAIGN}/scenarios/{name}.yml"
    return f"simulate {where or robot} --scenario {file} --json"


MUTANTS: Final = (
    Mutant(
        "stop_begins_late",
        "a controlled stop begins 300 ms late",
        Change(
            "runtime.core",
            "RobotCore.stop",
            """
self.manager.running.forget(self.cycle.clock.now(), f"stop was commanded by {latched_by or by}")
for system in self.systems:
    system.stop(now)
""",
            """
def begin():
    self.manager.running.forget(self.cycle.clock.now(), f"stop was commanded by {latched_by or by}")
    for system in self.systems:
        system.stop(self.reactor.now())
self.reactor.call_later(300_000_000, begin)
""",
        ),
        (_scenario("robby", "robby_latch"), _ROBBY),
        "runtime/test_core",
    ),
    Mutant(
        "fault_reset_enables",
        "a fault reset enables again",
        Change(
            "hardware.joint",
            "JointDrive.fault_reset",
            "self._fire(PhaseTrigger.FAULT_RESET)",
            "self._fire(PhaseTrigger.FAULT_RESET)\nself.resume = True",
        ),
        (_scenario("robby", "robby_fault"),),
        "hardware/test_system",
    ),
    Mutant(
        "old_command_counts",
        "a command from before a disable counts after the enable",
        Change(
            "controllers.update_loop",
            "UpdateLoop._power_changed",
            "self._forget(entry, now, group.interfaces if len(entry.groups) > 1 else None, "
            "self._enable_status.reason(off))",
            "pass",
        ),
        (_scenario("robby", "robby_stale"),),
        "controllers/test_update_loop",
    ),
    Mutant(
        "command_while_off",
        "a command is accepted while drives are off",
        Change("controllers.manager", "ControllerManager._pass", "self._require_enabled(controller)", "pass"),
        (_scenario("robby", "robby_disabled"),),
        "controllers/test_manager",
    ),
    Mutant(
        "running_while_disabled",
        '"running" is reported while drives are disabled',
        Change(
            "runtime.core",
            "RobotCore._state",
            "RobotState.DISABLED if waiting else RobotState.RUNNING",
            "RobotState.RUNNING",
        ),
        (_scenario("robby", "robby_disabled"),),
        "runtime/test_core",
    ),
    Mutant(
        "position_of_another",
        "status and the samples show the position of another joint",
        Change(
            "runtime.status",
            "_joints",
            'values.pop("position", None)',
            'joints[sorted(joints)[0]].get("position")',
        ),
        (_scenario("robby", "robby_clients"),),
        "runtime/test_status",
    ),
    Mutant(
        "velocity_reversed",
        "velocity is reported with the wrong sign",
        Change(
            "hardware.feedback",
            "Feedback.read",
            "raw * self._axis.scale.vel_from_dev + 0.0",
            "-raw * self._axis.scale.vel_from_dev + 0.0",
        ),
        (_scenario("robby", "robby_clients"),),
        "hardware/test_feedback",
    ),
    Mutant(
        "heartbeat_doubled",
        "the heartbeat time-out is doubled",
        Change(
            "master.remote_node",
            "RemoteNode._settle",
            "self._owner.watch_heartbeat(self.node_id, self.plan.heartbeat_timeout_ns)",
            "self._owner.watch_heartbeat(self.node_id, 2 * self.plan.heartbeat_timeout_ns)",
        ),
        (_scenario("robby", "robby_lost"), _ROBBY),
        "master/test_remote_node",
    ),
    Mutant(
        "another_is_watched",
        "0x1016 watches another node-ID than the master's",
        Change(
            "master.plan",
            "_plan_consumer",
            "consumer_entry(master.node_id, timeout)",
            "consumer_entry(master.node_id + 1, timeout)",
        ),
        (_scenario("robby", "robby_lost"), _ROBBY),
        "master/test_plan",
    ),
    Mutant(
        "latch_lost_at_restart",
        "the STOP latch is lost at a restart",
        Change(
            "runtime.stop_latch",
            "StopLatch.keep",
            'self.by = str(json.loads(path.read_text())["by"])',
            "path.unlink()",
        ),
        (_scenario("robby", "robby_latch"),),
        "runtime/test_stop_latch",
    ),
    Mutant(
        "latch_leaves_with_client",
        "the STOP latch is released when any client leaves",
        Change(
            "runtime.core",
            "RobotCore.client_disconnected",
            "self.manager.running.client_disconnected(holder, why)",
            'self.manager.running.client_disconnected(holder, why)\nself.latch.release("who left", self.reactor.now())',
        ),
        (_scenario("robby", "robby_latch"),),
        "runtime/test_core",
    ),
    Mutant(
        "base_without_timeout",
        "a base ignores its command time-out",
        Change(
            "controllers.mobile_base",
            "MobileBase._update_request",
            "timeout.limit_ns and now - timeout.created > timeout.limit_ns",
            "timeout.limit_ns < 0",
        ),
        (_scenario("robby", "robby_commands"), _ROBBY),
        "controllers/test_mobile_base",
    ),
    Mutant(
        "software_limits_in_csp",
        "software limits are not applied in CSP",
        Change(
            "hardware.mode_targets",
            "PositionTarget._send_position",
            "not limits.low <= raw <= limits.high",
            "False",
        ),
        (_scenario("limits", "turns_and_levers"),),
        "hardware/test_mode_targets",
    ),
    Mutant(
        "limits_in_velocity_modes",
        "maximum velocity and limit switch are not applied in PV and CSV",
        Change(
            "hardware.axis",
            "AxisObjectLimits.of_velocity",
            "",
            "return raw",
        ),
        (_scenario("limits", "turns_and_levers"),),
        "hardware/test_axis",
    ),
    Mutant(
        "target_while_disabled",
        "a target stays written while its drive is disabled",
        Change("hardware.joint_targets", "JointTargets.hold", "", "return"),
        (
            _scenario("robby", "robby_fault"),
            _scenario("robby", "robby_disabled"),
            _scenario("robby", "robby_lost"),
        ),
        "hardware/test_joint_targets",
    ),
    Mutant(
        "group_forgets_one",
        "the stop of a group forgets one joint",
        Change(
            "hardware.axis_statechart",
            "StopGroup.stop",
            "for joint in self.joints:\n    joint.stop(now)",
            "for joint in self.joints[1:]:\n    joint.stop(now)",
        ),
        (_scenario("robby", "robby_lost"), _ROBBY),
        "hardware/test_axis_statechart_stop_group",
    ),
    Mutant(
        "emcy_not_told",
        "an EMCY is not reported",
        Change("master.node_log", "NodeLog.emcy", "self._gate.passes(now)", "False"),
        (_scenario("robby", "robby_fault"),),
        "master/test_node_log",
    ),
    Mutant(
        "answer_of_another_object",
        "an SDO answer of another index is accepted",
        Change(
            "cia301.sdo_client",
            "Awaiting.receive",
            "data[1:4] != exchange.mux or exchange.out or request is None",
            "exchange.out or request is None",
        ),
        (_scenario("robby", "robby_answer"), _ROBBY),
        "cia301/test_sdo_client",
    ),
    Mutant(
        "wide_object_a_byte_off",
        "a TPDO with one 64-bit object is decoded a byte off",
        Change(
            "master.network",
            "Network.receive",
            "pdo.unpack(data)",
            'pdo.unpack(data[1:] + b"\\0" if [each.bits for each in pdo.codec.objects] == [64] else data)',
        ),
        (_scenario("wide", "turns"),),
        "master/test_network",
    ),
    Mutant(
        "boot_skips_6007",
        "a boot skips 0x6007",
        Change(
            "master.boot_config",
            "configure",
            "groups(plan.writes)",
            "groups([each for each in plan.writes if each.index != 0x6007])",
        ),
        (_scenario("arm6", "arm6_goals"),),
        "master/test_boot_config",
    ),
    Mutant(
        "boot_skips_the_last",
        "a boot skips the last parameter",
        Change("master.boot_config", "configure", "groups(plan.writes)", "groups(plan.writes)[:-1]"),
        (_scenario("robby", "robby_fault"),),
        "master/test_boot_config",
    ),
    Mutant(
        "jump_at_the_wrap",
        "the position jumps at the wrap of the 32-bit count",
        Change(
            "cia402.units",
            "PositionUnwrapper.update",
            "not -half <= step < half",
            "False",
        ),
        (_scenario("robby", "robby_wrap"),),
        "cia402/test_units",
    ),
    Mutant(
        "goes_on_after_cancel",
        "a trajectory goes on after its cancel",
        Change(
            "controllers.trajectory.controller",
            "JointTrajectoryController.cancel",
            "self._brake()",
            "pass",
        ),
        (_scenario("arm6", "arm6_goals"),),
        "controllers/trajectory/test_controller",
    ),
    Mutant(
        "goal_tolerance_inverted",
        "a goal of the trajectory controller ends well outside of its tolerance, and not inside",
        Change(
            "controllers.trajectory.controller",
            "ToleranceMonitor.verdict",
            "self.over and self.outside < 0",
            "self.over and self.outside >= 0",
        ),
        (_scenario("arm6", "arm6_goals"),),
        "controllers/trajectory/test_controller_judgement",
    ),
    Mutant(
        "switch_in_parts",
        "a switch of controllers is not atomic: the old ones are stopped before the new ones are known to be possible",
        Change(
            "controllers.switcher",
            "Switcher.switch",
            """
for component, start, stop in plan.switches:
    component.prepare_command_mode_switch(start, stop)
for controller in plan.deactivate:
    self._stop(controller, now, "deactivated")
""",
            """
for controller in plan.deactivate:
    self._stop(controller, now, "deactivated")
for component, start, stop in plan.switches:
    component.prepare_command_mode_switch(start, stop)
""",
        ),
        (_scenario("limits", "turns_and_levers"),),
        "controllers/test_switcher",
    ),
    Mutant(
        "commands_interleaved",
        "the commands of two clients are interleaved: every other value is that of the command before",
        Change(
            "controllers.forward_command",
            "ForwardCommandController.set_command",
            "self._values[index] = float(values[index]) if command.enabled else math.nan",
            """
if not (index % 2 and self.command_timeout.live):
    self._values[index] = float(values[index]) if command.enabled else math.nan
""",
        ),
        (_scenario("robby", "robby_commands"), _ROBBY),
        "controllers/test_forward_command",
    ),
    Mutant(
        "first_end_takes_the_second",
        "the end of the first client takes the command of the second one away",
        Change(
            "controllers.update_loop",
            "UpdateLoop.client_disconnected",
            "controller.command_timeout.holder is holder",
            "controller.command_timeout.live",
        ),
        (_scenario("robby", "robby_clients"),),
        "controllers/test_update_loop",
    ),
    Mutant(
        "recorder_does_not_count",
        "a recorder drops frames without a count",
        Change("bus.recordings", "RecordingWriter.write", "self.left_out += 1", "pass"),
        (),
        "bus/test_recordings",
    ),
    Mutant(
        "toggle_ignored",
        "the toggle bit of guarding is ignored",
        Change(
            "cia301.guarding",
            "GuardingMaster.receive",
            "value >> 7 != node.toggle and node.answered",
            "value >> 7 > 1",
        ),
        (_scenario("guarded", "toggle"),),
        "cia301/test_guarding",
    ),
    Mutant(
        "fault_keeps_the_wish",
        "a fault keeps the wish to be enabled",
        Change(
            "hardware.system",
            "CanopenSystem._stop_group",
            'event.kind == "node_lost" and cause.node.config.motion.recovery == "enable"',
            'event.kind == "fault" or cause.node.config.motion.recovery == "enable"',
        ),
        (_scenario("robby", "robby_fault"),),
        "hardware/test_system",
    ),
    Mutant(
        "restart_ignored",
        "a node's own restart is ignored",
        Change("master.remote_node", "RemoteNode.on_heartbeat", "self._on_boot_up(now, since)", "pass"),
        (_scenario("robby", "robby_lost"), _ROBBY),
        "master/test_remote_node",
    ),
    Mutant(
        "stop_forgets_nothing",
        "a stop forgets no command",
        Change(
            "runtime.core",
            "RobotCore.stop",
            'self.manager.running.forget(self.cycle.clock.now(), f"stop was commanded by {latched_by or by}")',
            "pass",
        ),
        (_scenario("arm6", "arm6_goals"),),
        "runtime/test_core",
    ),
    Mutant(
        "pdo_with_cob_id_0",
        "a PDO is made active with COB-ID 0",
        Change(
            "master.plan_pdos",
            "_plan_live",
            "_write(builder, planned, 1, planned.cob_id, planned.reason)",
            '_write(builder, planned, 1, planned.cob_id & (~0x7FF if planned.kind == "tpdo" else -1), planned.reason)',
        ),
        (_scenario("robby", "robby_fault"),),
        "master/test_plan_pdos",
    ),
)
"""One for each row of the list, in its order."""

BY_NAME: Final = {mutant.name: mutant for mutant in MUTANTS}


# -- applying a mutant


class _Replace(ast.NodeTransformer):
    """Replaces code: consecutive statements, or an expression; `count` is the number of replacements."""

    def __init__(self, old: str, new: str) -> None:
        before = ast.parse(old.strip()).body
        whole = before[0].value if len(before) == 1 and isinstance(before[0], ast.Expr) else None
        after = ast.parse(new.strip()).body
        plain = len(after) == 1 and isinstance(after[0], ast.Expr)
        self._expression = ast.dump(whole) if whole is not None and plain else None
        self._statements = [ast.dump(statement) for statement in before]
        self._before, self._after = before, after
        self.count = 0

    def visit(self, node: ast.AST) -> ast.AST:
        """Process the children of a node, then the node itself: the replacement may contain the old code."""
        if self._expression is not None and isinstance(node, ast.expr) and ast.dump(node) == self._expression:
            self.count += 1
            return self._after[0].value  # type: ignore[attr-defined]
        node = self.generic_visit(node)
        if self._expression is None:
            for _, body in ast.iter_fields(node):
                if isinstance(body, list) and body and isinstance(body[0], ast.stmt):
                    body[:] = self._in(body)
        return node

    def _in(self, body: list[ast.stmt]) -> list[ast.stmt]:
        """Return statements with the replacements made."""
        size, at, found = len(self._statements), 0, []
        while at < len(body):
            if [ast.dump(statement) for statement in body[at : at + size]] == self._statements:
                self.count += 1
                found += self._after
                at += size
            else:
                found.append(body[at])
                at += 1
        return found


def mutated(change: Change, source: str | None = None) -> ast.Module:
    """Return the changed module; LookupError where its function, or the code in it, does not stand there once."""
    tree = ast.parse(change.path.read_text(encoding="utf-8") if source is None else source)
    where: ast.AST = tree
    for name in change.function.split(".") if change.function else ():
        found = [node for node in where.body if getattr(node, "name", None) == name]  # type: ignore[attr-defined]
        if len(found) != 1:
            raise LookupError(f"{change.module} has no {change.function}: write the mutant anew")
        where = found[0]
    if not change.old:
        body = where.body  # type: ignore[attr-defined]
        body[bool(ast.get_docstring(where)) :] = ast.parse(change.new).body  # type: ignore[arg-type]
    else:
        replaced = _Replace(change.old, change.new)
        replaced.visit(where)
        if replaced.count != 1:
            text = f"{change.function} of {change.module} has this {replaced.count} times and not once:"
            raise LookupError(f"{text}\n{change.old.strip()}\nwrite the mutant anew")
    return ast.fix_missing_locations(tree)


class _Hook(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Import hook that loads one module from changed code; `used` is set when it did."""

    def __init__(self, change: Change) -> None:
        self._change = change
        self._code = compile(mutated(change), str(change.path), "exec")
        self._name = f"{PACKAGE}.{change.module}"
        self.used = False

    def find_spec(self, name: str, _path: object, _target: object = None) -> importlib.machinery.ModuleSpec | None:
        """Find the changed module."""
        if name != self._name:
            return None
        return importlib.util.spec_from_file_location(name, self._change.path, loader=self)

    def exec_module(self, module: ModuleType) -> None:
        """Execute the changed code."""
        self.used = True
        exec(self._code, module.__dict__)


def apply(mutant: Mutant) -> None:
    """Make this process import the mutated package; RuntimeError if the module is already imported."""
    name = f"{PACKAGE}.{mutant.change.module}"
    if name in sys.modules:
        raise RuntimeError(f"{name} was imported before it could be changed")
    sys.meta_path.insert(0, _Hook(mutant.change))


# -- running a program with a mutant


def run_with(mutant: Mutant | None, command: Sequence[str]) -> int:
    """Run `pytest ...`, `seeds ...` or `simulate ...` in this process with a mutant; return the exit code.

    It is 3 where the mutant does not apply, which must not look like one that was caught.
    """
    try:
        if mutant is not None:
            apply(mutant)
    except LookupError as error:
        print(error, file=sys.stderr)
        return 3
    program, *arguments = command
    if program == "seeds":
        return run_seeds(arguments)
    sys.argv = [program, "-n", "0", "-p", "no:cacheprovider", *arguments]
    module = "pytest"
    if program != "pytest":
        sys.argv, module = [PACKAGE, *command], PACKAGE
    try:
        runpy.run_module(module, run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def run_seeds(arguments: Sequence[str]) -> int:
    """Simulate the seeds of a robot until one violates an invariant; return 1 in that case."""
    parser = argparse.ArgumentParser(prog="seeds")
    parser.add_argument("robot")
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--for", dest="seconds", type=int, default=20)
    parser.add_argument("--controller", action="append", default=[])
    given = parser.parse_args(arguments)
    from canopen_control.runtime.robot_files import find_robot
    from canopen_control.runtime.setup import read_robot
    from canopen_control.simulation.motions import motions_of
    from canopen_control.simulation.random_schedule import draw_schedule, known_faults
    from canopen_control.simulation.simulation_run import SimulationRun

    setup = read_robot(find_robot(given.robot), controllers=tuple(given.controller))
    motions, length = motions_of(setup), given.seconds * 1_000_000_000
    nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]
    for seed in range(given.seeds):
        run = SimulationRun(setup, seed, draw_schedule(seed, length, motions, nodes, known_faults()), motions=motions)
        try:
            run.run(length, stop=lambda run=run: bool(run.invariants.breaches))  # type: ignore[misc]
            if run.breaches:
                print(f"seed {seed}: {run.breaches[0]}")
                return 1
        finally:
            run.close()
    return 0


def _caught(name: str, command: Sequence[str], seconds: float = 900.0) -> tuple[bool, float, str]:
    """Return whether a command fails with a mutant ("" for none), its duration, and its last output line."""
    began = time.monotonic()
    here = [sys.executable, __file__, *(("run", name) if name else ("plain",))]
    try:
        ended = subprocess.run(
            [*here, *command], cwd=ROOT, capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return True, seconds, "it never ends"
    refused = ended.returncode == 2 and command[0] != "pytest"  # by the check of the robot's files before the run
    if ended.returncode not in (0, 1) and not refused:
        print(ended.stdout[-2000:], ended.stderr[-2000:], sep="\n")
        raise RuntimeError(f"{' '.join(command)} ended with {ended.returncode}")
    lines = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR", "seed ", "breach"))]
    lines = lines or ended.stderr.splitlines()[:1] if refused else lines
    return ended.returncode != 0, time.monotonic() - began, lines[0] if lines else ended.stdout.strip()[-200:]


def tests_of(mutant: Mutant) -> list[str]:
    """Return the command of the tests that must detect a mutant."""
    return ["pytest", "-q", "-x", "-m", "not process and not alone", f"tests/{mutant.tests}.py"]


def measure(names: Sequence[str], *, tests: bool, seeds: bool) -> int:
    """Print which mutants are detected, and by what; return 0 if all are that should be."""
    clean: dict[str, bool] = {}
    missed = 0
    for mutant in (candidate for candidate in MUTANTS if not names or candidate.name in names):
        kinds = {"tests": [tests_of(mutant)] if tests else [], "seeds": [run.split() for run in mutant.runs if seeds]}
        for kind, commands in kinds.items():
            by = ""
            began = time.monotonic()
            for command in commands:
                key = " ".join(command)
                found, _, word = _caught(mutant.name, command)
                if found and key not in clean:
                    failed, _, why = _caught("", command)
                    clean[key] = not failed
                    if failed:
                        print(f"this fails without a mutant and shows nothing: {key}: {why}", flush=True)
                if found and clean[key]:
                    by = word
                    break
            if commands:
                missed += not by
                took = time.monotonic() - began
                print(f"{mutant.name:<26}{kind} {took:4.0f} s  {by or 'MISSED'}", flush=True)
    return 1 if missed else 0


def main(arguments: Sequence[str]) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="code_mutants.py", description=(__doc__ or "").partition("\n")[0])
    verbs = parser.add_subparsers(dest="verb")
    one = verbs.add_parser("run", help="run a command with a mutant")
    one.add_argument("name", choices=BY_NAME, metavar="NAME")
    one.add_argument("command", nargs=argparse.REMAINDER)
    plain = verbs.add_parser("plain", help="run a command without one")
    plain.add_argument("command", nargs=argparse.REMAINDER)
    all_of_them = verbs.add_parser("measure", help="say which are caught")
    all_of_them.add_argument("--tests", action="store_true")
    all_of_them.add_argument("--seeds", action="store_true")
    all_of_them.add_argument("names", nargs="*", metavar="NAME")
    given = parser.parse_args(arguments)
    if given.verb == "run":
        return run_with(BY_NAME[given.name], given.command)
    if given.verb == "plain":
        return run_with(None, given.command)
    if given.verb == "measure":
        both = not (given.tests or given.seeds)
        return measure(given.names, tests=given.tests or both, seeds=given.seeds or both)
    for mutant in MUTANTS:
        print(f"{mutant.name:<28}{mutant.does} ({mutant.change.module})")
        print(f"{'':<28}tests/{mutant.tests}.py; {' or '.join(mutant.runs) or 'no simulation'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
