"""Check a device against CiA 301, 302, 305 and 402, and its EDS against CiA 306, and report violations.

Without --configure, --store and --motion the checks change no value; some send requests that a device has to refuse.
With --configure they write parameters, and start, stop and reset the node; with --store they store parameters; with
--motion they switch on the power stage of a drive and turn the shaft: --speed and --distance bound each motion (by
default 1 % of 0x607F and half a revolution), and the shaft returns to its start. You confirm each of the three once, or
use --yes. At the end the parameters that the EDS lists are compared and restored. Nodes of a running robot are
refused; with one of the three options, nodes that are OPERATIONAL are refused too.

With --master a virtual device joins the bus and checks the master that boots it, this package or another master. It
works normally for 8 s, then shows its faults one after another, in 80 to 120 s: FAULT, loss of the power stage,
PRE-OPERATIONAL, a flood of EMCY, resets with SDO answers that are missing, late or refused, a lost heartbeat, silence.
Enable the drive through the master in the first seconds, and later only between two faults. Ctrl-C ends the run and
prints its report.

Exit codes: 0 no mandatory check failed; 1 a mandatory check failed; 2 wrong usage, or nothing could be tested.
"""

from __future__ import annotations

import json
import signal
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.cia301.nmt import NmtState
from canopen_control.cli.support.arguments import seconds, whole_number
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.cli.support.target import LABEL, find_eds, parse_node_id, robot_on
from canopen_control.conformance.check import CheckTouch
from canopen_control.conformance.checked_node import CheckedNode, MotionBounds, NotApplicable
from canopen_control.conformance.master_run import DEFAULT_S, MasterRun
from canopen_control.conformance.report import changed_verdicts, html_page, junit, report_lines
from canopen_control.conformance.run import choose, run_checks
from canopen_control.data_files import data_path
from canopen_control.errors import BusError, ConfigError, RemoteProtocolError
from canopen_control.frame import Service, service_of
from canopen_control.host.files import write_whole
from canopen_control.host.reactor import Reactor
from canopen_control.od.eds import read_eds

if TYPE_CHECKING:
    import argparse

    from canopen_control.conformance.run import ConformanceReport


EXAMPLE = """canopen-control conform 5 --can can0 --eds drive.eds
         canopen-control conform 5 --can can0 --eds drive.eds --configure --yes --html conform.html
         canopen-control conform --master --can can0 --node-id 5 --eds drive.eds --html master.html"""

_EDS = "TMCM-1270.eds"
LEVELS = ("301", "302", "305", "306", "402", "all")
_bound = whole_number("whole number above 0", range(1, 1 << 31))
HEARTBEAT_S = 1.2  # enough for a heartbeat with a period of 1 s
_MASTER_SERVICES = {Service.NMT: "NMT command", Service.SYNC: "SYNC", Service.SDO_CLIENT: "SDO request"}
_QUESTIONS = {
    CheckTouch.CONFIGURE: "write parameters of the node, start, stop and reset it",
    CheckTouch.MOTION: "switch on the power stage and turn the shaft, which must be free to move",
    CheckTouch.STORE: "store parameters of the node, and restore its defaults (0x1010, 0x1011)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("node", nargs="?", metavar="NODE", help="node-ID of the device to check")
    parser.add_argument("--can", required=True, metavar="CHANNEL", help="channel of the bus (can0, local:NAME, ...)")
    parser.add_argument(
        "--eds",
        metavar="FILE",
        help="EDS of the device; without it, fewer checks are run (--master: TMCM-1270)",
    )
    parser.add_argument("--master", action="store_true", help="act as a virtual device and check the master on the bus")
    parser.add_argument("--node-id", metavar="N", help="with --master: node-ID of the virtual device")
    parser.add_argument(
        "--for",
        dest="duration",
        type=seconds,
        metavar="S",
        help=f"with --master: time of the run in s (default: {DEFAULT_S:g}); faults that do not fit are left out",
    )
    parser.add_argument("--level", choices=LEVELS, default="all", help="checks of one document (default: all)")
    parser.add_argument("--configure", action="store_true", help="also write parameters and reset the node")
    parser.add_argument("--store", action="store_true", help="also store parameters and restore defaults")
    parser.add_argument(
        "--motion", action="store_true", help="also switch on the power stage and turn the shaft, which must be free"
    )
    parser.add_argument(
        "--speed", type=_bound, default=0, metavar="N", help="speed of motions in units of the drive (1 %% of 0x607F)"
    )
    parser.add_argument(
        "--distance",
        type=_bound,
        default=0,
        metavar="N",
        help="distance of motions in units of the drive (half a revolution)",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask before --configure, --store and --motion")
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=0.5,
        metavar="S",
        help="timeout of each answer in s (default: 0.5)",
    )
    parser.add_argument("--junit", metavar="FILE", help="write a JUnit XML report")
    parser.add_argument("--html", metavar="FILE", help="write a page with the verdict per clause and a summary")
    parser.add_argument(
        "--against", metavar="OLD.json", help="show the differences from the --json output of an older run"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    _check_options(args)
    if args.master:
        return _run_master(args)
    node_id = parse_node_id(args.node)
    eds = None if args.eds is None else read_eds(find_eds(args.eds), node_id)
    old = None if args.against is None else _old_verdicts(Path(args.against).expanduser())
    touches = [touch for touch in CheckTouch if touch is CheckTouch.READ or getattr(args, touch.name.lower())]
    checks = choose(args.level, touches)
    if not checks:
        raise ConfigError(f"level {args.level} has no checks for these options; give --configure too")
    _refuse_robot(args.can, node_id)
    for touch in touches[1:]:
        _confirm(touch, node_id, yes=args.yes)
    with Reactor() as reactor:
        port = open_port(args.can, label=LABEL, join=True)
        try:
            node = CheckedNode(
                reactor, port, node_id, eds, timeout_s=args.timeout, bounds=MotionBounds(args.distance, args.speed)
            )
            if len(touches) > 1:
                _refuse_master(node)
            with Progress(f"checking node {node_id}", "checks", rate=True) as progress:
                report = run_checks(node, checks, progress.at)
        except BusError as error:
            raise ConfigError(f"nothing could be tested: {error}") from error
        finally:
            port.close()
    _write(args, report, old, [] if eds is None else [str(issue) for issue in eds.issues])
    return 1 if report.failed else 0


def _check_options(args: argparse.Namespace) -> None:
    """Raise ConfigError if an option is missing, or is for the other kind of check (of a device or of the master)."""
    if not args.master:
        if args.node is None:
            raise ConfigError("give the node-ID of the device to check, or --master to check the master on the bus")
        for name, value in (("--node-id", args.node_id), ("--for", args.duration)):
            if value is not None:
                raise ConfigError(f"{name} requires --master; add --master, or omit {name}")
        return
    if args.node is not None:
        raise ConfigError(f"--master takes its node-ID from --node-id; write --node-id {args.node}")
    if args.node_id is None:
        raise ConfigError("--master needs --node-id: a node that the master boots and that is not on the bus")
    for option in ("configure", "store", "motion"):
        if getattr(args, option):
            raise ConfigError(f"--{option} is for the check of a device; omit it with --master")


def _run_master(args: argparse.Namespace) -> int:
    from canopen_control.virtual.device import make_device
    from canopen_control.virtual.launch import NodeIdCheck

    node_id = parse_node_id(args.node_id)
    eds = read_eds(data_path("eds", _EDS) if args.eds is None else find_eds(args.eds), node_id)
    old = None if args.against is None else _old_verdicts(Path(args.against).expanduser())
    with Reactor() as reactor:
        port = open_port(args.can, label=LABEL)
        try:
            NodeIdCheck(reactor, port, [node_id]).finish()
            seconds = DEFAULT_S if args.duration is None else args.duration
            device = make_device(eds.od, node_id)
            run = MasterRun(reactor, port, device, seconds, _print)
            _print(f"node {node_id} ({device.name}) is on {args.can} and is waiting for its master")
            reactor.handle_signals({signal.SIGINT: run.stop})
            with Progress(f"checking the master of node {node_id}", "s", rate=True) as progress:
                report = run.run(progress.at)
        except BusError as error:
            raise ConfigError(f"nothing could be tested: {error}") from error
        finally:
            port.close()
    _write(args, report, old, [str(issue) for issue in eds.issues])
    return 1 if report.failed else 0


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _refuse_robot(channel: str, node_id: int) -> None:
    owner = robot_on(channel)
    if owner is not None and any(node_id == node.node_id for node in owner[1].nodes):
        raise ConfigError(f"node {node_id} on {channel} belongs to the running robot {owner[0]}; shut it down first")


def _refuse_master(node: CheckedNode) -> None:
    """Raise ConfigError if a master is active on the bus, or if the node is OPERATIONAL."""
    frames = [frame for _, frame in node.listen(HEARTBEAT_S)]
    services = {service_of(frame.can_id): None for frame in frames}
    signs = [
        _MASTER_SERVICES[service[0]] + (f" to node {service[1]}" if service[1] else "")
        for service in services
        if service is not None and service[0] in _MASTER_SERVICES
    ]
    if signs and not (signs == ["SYNC"] and _produces_sync(node)):
        raise ConfigError(
            f"a master is active on {node.port.channel} ({', '.join(signs)}); stop it before the node is written to"
        )
    if node.state is NmtState.OPERATIONAL:
        raise ConfigError(
            f"node {node.node_id} is OPERATIONAL: a master may be using it; stop that master, then send "
            f"`canopen-control nmt preop {node.node_id} --can {node.port.channel}`"
        )


def _produces_sync(node: CheckedNode) -> bool:
    try:
        return bool(node.number(0x1005) >> 30 & 1)  # CiA 301 7.5.2.5: bit 30, the device generates SYNC
    except (NotApplicable, RemoteProtocolError):
        return False


def _confirm(touch: CheckTouch, node_id: int, *, yes: bool) -> None:
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"{touch.value} needs a confirmation, and standard input is not a terminal; add --yes")
    print(f"{touch.value}: node {node_id}: {_QUESTIONS[touch]}. Continue? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ConfigError(f"{touch.value} was not confirmed; nothing was done")


def _old_verdicts(path: Path) -> dict[str, str]:
    """Return the verdicts of an older report by check id."""
    try:
        results = json.loads(path.read_text(encoding="utf-8"))["results"]
        return {str(result["id"]): str(result["verdict"]) for result in results}
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise ConfigError(f"{path} is not a report of `conform --json`") from None


def _write(args: argparse.Namespace, report: ConformanceReport, old: dict[str, str] | None, issues: list[str]) -> None:
    """Print the report, then write its files, so that the printed report survives a full disk."""
    changes = [] if old is None else changed_verdicts(report, old)
    if args.json:
        print(json_text({**asdict(report), "changes": changes}))
    else:
        for line in (*report_lines(report), *changes):
            print(line)
    if args.junit is not None:
        write_whole(Path(args.junit).expanduser(), junit(report))
    if args.html is not None:
        from canopen_control.virtual.quirks import QUIRKS

        descriptions = {quirk.name: quirk.does for quirk in QUIRKS.values()}
        write_whole(Path(args.html).expanduser(), html_page(report, descriptions, issues).encode())
