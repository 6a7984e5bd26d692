"""Run a whole robot in virtual time, in one process: hours in minutes, with the same result for the same seed.

Runtime, master, buses and virtual drives use the same classes as `run` and `drive`. Each process has its own clock,
which is a few ppm off, and wakes up late, as a real process does. The bus arbitrates frames, which take their
transmission time. The seed chooses commands, switches and faults (--faults). With --scenario FILE you choose them:

    for: 20s
    seed: 7
    steps:
      - {at: 1s, do: command, target: robby_forward_controller, values: [5, 5], for: 3s}
      - {at: 2s, node: 3, fault: heartbeat_lost, for: 1s}
      - {at: 4s, do: axis, name: fault-reset}
      - {at: 5s, do: axis, name: enable}
      - {at: 6s, do: stall, target: master, for: 300ms}

--seeds N runs N seeds, each with its own schedule (20 s and all faults by default), in --jobs processes or on the
Dask cluster at --dask. --aim M adds M schedules that inject faults in states not yet covered for that kind of fault. A
failing schedule is reduced to a minimal one and written to --out: as a scenario with the command that replays it and a
recording of its frames, next to a summary as JUnit and HTML.

--recording FILE replays a recording of a robot instead, with its commands and its bus faults; --out FILE.yml saves it
as a scenario. FILE is a flight recording, or the frames of the robot's only bus (faults only). --record FILE.zip writes
such a recording of a simulation, for `report`, `trace` and `replay --page`.

With --physics the virtual drives move the robot on a floor, as in a run (extra [physics]); --world FILE describes what
is on the floor. --world FILE without a robot simulates the robots listed in the file, in one world.

--speed 1 runs in real time in this one process, for a debugger. With --serve, programs can connect to the robot's
socket as to a running robot (status, command, view, ...). With --ros, ROS programs can use its topics, and it
publishes /clock. It then runs in real time unless --speed is higher, and nothing is randomised unless --seed, --faults
or --scenario is given.

Ctrl-C ends a simulation and keeps the results so far. --json prints one object at the end, with the SHA-256 of every
frame and event with its time.

Exit codes: 0 success; 1 an invariant was violated, the robot did not start, or its limits permit no motion; 2 wrong
usage or configuration; 130 the seeds were interrupted.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.run import (
    add_controller_argument,
    add_file_arguments,
    add_ros_arguments,
    bridge_arguments,
    find_files,
    names_robot,
    world_of,
)
from canopen_control.cli.support.arguments import add_new_name, number, seconds, whole_number
from canopen_control.cli.support.output import Progress, json_line
from canopen_control.errors import ConfigError, nearest
from canopen_control.host.quick_start import quick_start

if TYPE_CHECKING:
    import argparse

    from canopen_control.personality import Personality
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.scenario_steps import Scenario
    from canopen_control.simulation.simulation_run import SimulationResult, SimulationRun
    from canopen_control.virtual.scenario import ScenarioEvent


EXAMPLE = """canopen-control simulate robby --for 3 --seed 7
         canopen-control simulate robby --for 3 --faults heartbeat_lost,silent --json
         canopen-control simulate robby --seeds 3 --for 3 --json
         canopen-control simulate robby --for 5 --seed 7 --faults short_circuit --record fault.zip
         canopen-control simulate robby --recording fault.zip --out bug.yml"""

DEFAULT_NS: Final = 60_000_000_000
_LARGEST_SEED: Final = 1 << 63

_seed = whole_number("seed: a whole number from 0 on", range(_LARGEST_SEED))
_count = whole_number("number of seeds: 1 to 1000000", range(1, 1_000_001))
_jobs = whole_number("number of processes: 1 to 64", range(1, 65))
_factor = number("speed: max, or a number above 0", lambda value: value > 0.0)


def _speed(text: str) -> float:
    return math.inf if text == "max" else _factor(text)


def _duration(text: str) -> int:
    return round(seconds(text) * 1e9)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_file_arguments(parser, channel=None)
    add_controller_argument(parser)
    parser.add_argument(
        "--for", dest="length", type=_duration, metavar="T", help="simulated time, such as 1h or 30s (default: 1min)"
    )
    parser.add_argument(
        "--seed", type=_seed, metavar="N", help="seed of commands, faults, delays and clock errors (default: 0)"
    )
    parser.add_argument(
        "--scenario", metavar="FILE", help="play this scenario, see above, instead of choosing by the seed"
    )
    parser.add_argument("--recording", metavar="FILE", help="replay this recording: .zip, or .log, .asc, ...")
    parser.add_argument("--record", metavar="FILE.zip", help="write a flight recording of the simulation")
    parser.add_argument("--physics", action="store_true", help="make the drives move the robot on a floor")
    parser.add_argument(
        "--world",
        metavar="FILE",
        help="with --physics: objects on the floor, YAML or SDF; without ROBOT: simulate the robots that the "
        "file names",
    )
    parser.add_argument("--like", metavar="NAME|FILE", help="make all drives behave like the drives of a manufacturer")
    parser.add_argument(
        "--quirk", action="append", default=[], metavar="Q[=V][@AXIS]", help="give all drives a quirk (repeatable)"
    )
    parser.add_argument("--faults", metavar="all|LIST|none", help="faults to inject (default: none, with --seeds all)")
    _add_campaign(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    _add_serving(parser)


def _add_campaign(parser: argparse.ArgumentParser) -> None:
    """Declare the options of a campaign of seeds."""
    parser.add_argument("--seeds", type=_count, metavar="N", help="run a campaign of N seeds, starting with --seed")
    parser.add_argument(
        "--aim",
        type=_count,
        metavar="N",
        help="with --seeds: add N schedules for states in which no fault has been injected yet",
    )
    parser.add_argument(
        "--jobs", type=_jobs, metavar="J", help="with --seeds: number of processes (default: one for each processor)"
    )
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="with --seeds: address of a Dask cluster, such as tcp://host:8786"
    )
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        help="with --seeds: folder for failing schedules and the summary (default: simulate-ROBOT); with "
        "--recording: file for its scenario",
    )


def _add_serving(parser: argparse.ArgumentParser) -> None:
    """Declare the options for programs that use the simulated robot, and for its speed."""
    parser.add_argument(
        "--speed",
        type=_speed,
        metavar="max|F",
        help="highest speed, as a multiple of real time (default: max, with --serve 1)",
    )
    add_new_name(parser, "with --serve: name of the robot for its clients")
    parser.add_argument(
        "--serve", action="store_true", help="let programs connect to the robot's socket, as to a running robot"
    )
    parser.add_argument(
        "--ros", action="store_true", help="same as --serve, and start the ROS 2 bridge, which publishes /clock"
    )
    parser.add_argument("--namespace", metavar="NS", help="with --ros: namespace of all ROS names and frames")
    add_ros_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate a robot, a world or a campaign.

    Return 1 if an invariant was violated, the robot does not start or its limits permit no motion, 130 if a campaign
    was interrupted, else 0.
    """
    try:
        if args.world is not None and not names_robot(args):
            return _run_world(args)
        return _run_one(args) if args.seeds is None else _run_campaign(args)
    finally:
        gc.unfreeze()


def _run_one(args: argparse.Namespace) -> int:
    out = None if args.recording is not None else args.out
    for option, value in (("--jobs", args.jobs), ("--aim", args.aim), ("--out", out), ("--dask", args.dask)):
        if value is not None:
            raise ConfigError(f"{option} requires a campaign; add the number of seeds, as in --seeds 100")
    bridge = _bridge(args)
    if args.record is not None:
        from canopen_control.cli.support.simulation_recording import check_recording_name

        check_recording_name(Path(args.record))
    with quick_start():
        from canopen_control.personality import read_personality
        from canopen_control.simulation.robot_under_test import RobotUnderTest
        from canopen_control.simulation.simulation_run import SimulationRun

        setup = _setup(args)
    if setup.world is not None and not args.physics:
        raise ConfigError(f"{setup.files.hardware.world_word or '--world'} requires physics; add --physics")
    acts, seed, duration_ns = _schedule(args, setup)
    speed = 1.0 if args.speed is None and bridge is not None else _speed_limit(args.speed)
    like = None if args.like is None else read_personality(args.like)
    robot = RobotUnderTest(setup, seed, world=setup.world)
    _apply_quirks(robot, args.quirk, like)
    simulation = SimulationRun(setup, seed, acts, speed=speed, robot=robot)
    for note in () if simulation.robot.floor is None else simulation.robot.floor.notes:
        print(f"canopen-control: {note}", file=sys.stderr)
    try:
        if bridge is not None:
            _serve(simulation, bridge if args.ros else None)
        _watch(simulation, duration_ns, args.record, quiet=args.json)
        outcome = simulation.outcome
        failure = simulation.robot.core.failure
        never = simulation.start_failure(duration_ns) or simulation.immobility
    finally:
        simulation.close()
    _report(outcome, failure, as_json=args.json)
    if never:
        print(f"canopen-control: {never}", file=sys.stderr)
    return 1 if outcome.breaches or never else 0


def _apply_quirks(robot: RobotUnderTest, quirks: list[str], like: Personality | None) -> None:
    """Apply a personality and quirks to all drives; a quirk replaces the drive's quirk of the same name."""
    replaced = {text.partition("=")[0] for text in quirks}
    for drive in robot.drives.values():
        other_quirks = [text for text in drive.quirks if text.partition("=")[0] not in replaced]
        drive.quirks, drive.like = [*other_quirks, *quirks], like


def _speed_limit(speed: float | None) -> float | None:
    """Return the maximum speed as a multiple of real time, or None if unlimited."""
    return None if speed == math.inf else speed


def _bridge(args: argparse.Namespace) -> tuple[str, ...] | None:
    """Return the arguments of the ROS bridge if --ros or --serve is given, else None."""
    arguments = bridge_arguments(args)
    if args.ros:
        from canopen_control.ros.installation import require_ros

        require_ros()
    return arguments if args.ros or args.serve else None


def _serve(simulation: SimulationRun, bridge: tuple[str, ...] | None) -> None:
    """Serve the robot's socket for other programs, and start the ROS bridge if requested."""
    from canopen_control.simulation.served_simulation import ServedSimulation

    simulation.served = ServedSimulation(simulation.player)
    if bridge is not None:
        simulation.served.start_bridge(bridge)


def _run_world(args: argparse.Namespace) -> int:
    from canopen_control.simulation.random_schedule import known_faults

    for option, value in (("--serve", args.serve), ("--ros", args.ros)):
        if value:
            raise ConfigError(f"{option} needs a ROBOT; with --world also give --physics")
    all_faults = known_faults(physics=True)
    faults = (
        all_faults if args.faults == "all" else _faults("none" if args.faults is None else args.faults, known_faults())
    )
    from canopen_control.cli.support.simulation_world import simulate_world

    return simulate_world(args, args.length or DEFAULT_NS, faults)


def _setup(args: argparse.Namespace) -> RobotSetup:
    from canopen_control.runtime.setup import read_robot

    if args.can:
        raise ConfigError(f"--can {args.can[0]}: a simulation has buses of its own; omit the option")
    files = find_files(args)
    files.refuse_hardware("a simulation has drives and buses of its own")
    setup = read_robot(
        files,
        name=args.name,
        controllers=args.controller,
        strict=args.strict,
        peer_merge=args.peer_merge,
        allow_unsupervised=args.allow_unsupervised,
        physics=args.physics,
        world=world_of(args, files),
    )
    if args.physics:
        from canopen_control.physics import require_physics
        from canopen_control.runtime.physics_plant import check_physics

        require_physics()
        check_physics(setup)
    gc.collect()
    gc.freeze()  # exempt the files read from the garbage collection of each seed
    return setup


def _run_campaign(args: argparse.Namespace) -> int:
    with quick_start():
        from canopen_control.cli.support.simulation_campaign import CampaignOrder, run_campaign
        from canopen_control.simulation.random_schedule import known_faults

    singles = ("--scenario", args.scenario), ("--recording", args.recording), ("--record", args.record)
    served = ("--serve", args.serve), ("--ros", args.ros), ("--like", args.like), ("--quirk", args.quirk)
    for option, setting in (*singles, *served, ("--speed", args.speed), ("--world", args.world)):
        if setting:
            raise ConfigError(f"{option} is for a single simulation; omit it with --seeds")
    if args.dask is not None and args.jobs is not None:
        raise ConfigError("--jobs sets processes of this computer, --dask selects a cluster; give only one of them")
    with quick_start():
        setup = _setup(args)
    all_faults = known_faults(physics=args.physics)
    faults = all_faults if args.faults in (None, "all") else _faults(args.faults, known_faults())
    files = (("--bus", args.bus), ("--controllers", args.controllers), ("--description", args.description))
    words = [args.config or ".", *args.xacro]
    words += [word for option, value in (*files, ("--launch", args.launch)) if value for word in (option, value)]
    words += [word for name in args.controller for word in ("--controller", name)]
    words += ["--physics"] if args.physics else []
    seeds = range(args.seed or 0, (args.seed or 0) + args.seeds)
    folder = None if args.out is None else Path(args.out)
    order = CampaignOrder(
        seeds,
        args.length or DEFAULT_NS // 3,
        faults,
        words,
        args.jobs or min(_processors(), args.seeds),
        folder,
        args.json,
        args.dask,
        args.aim or 0,
    )
    return run_campaign(setup, order, folder or Path(f"simulate-{setup.name}"))


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _schedule(args: argparse.Namespace, setup: RobotSetup) -> tuple[tuple[ScenarioEvent, ...], int, int]:
    """Return the events, the seed and the duration in ns; the events may be drawn from the seed."""
    from canopen_control.simulation.motions import motions_of
    from canopen_control.simulation.random_schedule import draw_schedule, known_faults
    from canopen_control.simulation.scenario_steps import read_scenario_steps

    faults = _faults("none" if args.faults is None else args.faults, known_faults())
    if args.scenario is not None or args.recording is not None:
        option = "--scenario" if args.recording is None else "--recording"
        if faults:
            raise ConfigError(f"--faults draws faults from the seed, and {option} defines them; give only one of them")
        if args.scenario is not None and args.recording is not None:
            raise ConfigError("--scenario and --recording both define the events; give only one of them")
        scenario = _recorded(args, setup) if args.scenario is None else read_scenario_steps(Path(args.scenario), setup)
        for warning in scenario.warnings:
            print(f"canopen-control: warning: {warning}", file=sys.stderr)
        seed = args.seed if args.seed is not None else scenario.seed or 0
        last = max((act.at_ns + (act.for_ns or 0) for act in scenario.acts), default=0)
        return scenario.acts, seed, args.length or scenario.duration_ns or last + DEFAULT_NS // 6
    seed, duration_ns = args.seed or 0, args.length or DEFAULT_NS
    if (args.serve or args.ros) and args.seed is None and not faults:
        return (), seed, duration_ns  # the connected programs cause the events
    nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]
    return draw_schedule(seed, duration_ns, motions_of(setup), nodes, faults), seed, duration_ns


def _recorded(args: argparse.Namespace, setup: RobotSetup) -> Scenario:
    """Return the scenario of a recording, and write it to the file --out if given."""
    from canopen_control.cli.support.simulation_recording import recorded_scenario
    from canopen_control.simulation.campaign import write_text
    from canopen_control.simulation.scenario_steps import scenario_text

    scenario = recorded_scenario(Path(args.recording), setup)
    if args.out is not None:
        length = scenario.duration_ns or DEFAULT_NS
        seed = args.seed or 0
        write_text(Path(args.out), scenario_text(scenario.acts, seed=seed, duration_ns=length, note=args.recording))
    return scenario


def _faults(text: str, known: list[str]) -> list[str]:
    if text == "none":
        return []
    if text == "all":
        return known
    names = [field.strip() for field in text.split(",")]
    for name in names:
        if not name:
            raise ConfigError(f"--faults {text!r}: a name is empty; write names separated by commas, all, or none")
        if name not in known:
            raise ConfigError(f"--faults: no fault {name!r}{nearest(name, known)}; see: canopen-control fault list")
    return names


def _watch(simulation: SimulationRun, duration_ns: int, record: str | None, *, quiet: bool) -> None:
    """Run the simulation, print events and progress, and write the recording; Ctrl-C ends the run."""
    from canopen_control.cli.support.simulation_world import EventPrinter
    from canopen_control.runtime.core import RobotState

    progress = Progress("robot time", "s", stream=sys.stderr)
    if not quiet:
        simulation.robot.observers.append(EventPrinter(progress))
    recorder = None
    if record is not None:
        from canopen_control.cli.support.simulation_recording import SimulationRecorder

        recorder = SimulationRecorder(simulation)
    with contextlib.suppress(KeyboardInterrupt), progress:
        simulation.run(
            duration_ns,
            lambda robot_s, _real: progress.at(int(robot_s), int(duration_ns / 1e9) or None),
            lambda: simulation.robot.up and simulation.robot.core.state is RobotState.STOPPED,  # killed robots restart
        )

    if recorder is not None and record is not None:
        recorder.write(Path(record))


def _report(outcome: SimulationResult, failure: str | None, *, as_json: bool) -> None:
    if as_json:
        print(json_line(outcome))
        return
    factor = outcome.robot_s / outcome.real_s if outcome.real_s else 0.0
    print(
        f"seed {outcome.seed}: {outcome.robot_s:g} s of the robot in {outcome.real_s:.1f} s ({factor:.0f} times real "
        f"time), {outcome.frames} frames, {outcome.events} events, sha256 {outcome.sha256}"
    )
    for breach in outcome.breaches:
        print(f"breach: {breach}")
    if failure is not None:
        print(f"the robot ended: {failure}")
