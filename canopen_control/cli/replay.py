"""Replay a recording onto a bus with its original timing; without --can, print it as `trace` does.

The bus is checked before anything is sent: nothing is replayed if a master or a node from the recording is active,
since two senders of one identifier destroy each other's frames, and a recorded controlword moves a real motor.

--page shows a flight recording instead: it is served as a robot with the name NAME_replay, so that `view`, `status
--watch` and `monitor` can show it, until Ctrl-C. Nothing moves. It is refused while a robot runs and ends when one
starts, so that STOP always refers to one robot only.

Exit codes: 0 success; 1 no frame was selected, or the bus is gone; 2 refused, wrong usage, or no such file or
channel; 130 interrupted.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import ChannelKind, open_port, parse_channel
from canopen_control.cli.support.arguments import number
from canopen_control.cli.support.bus_description import add_network_arguments, open_frames, report_gaps
from canopen_control.cli.support.frame_output import add_view_arguments, show_file
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.errors import ConfigError, SdoTimeout
from canopen_control.frame import Service, service_of
from canopen_control.host.sockets import list_sockets

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from canopen_control.bus.recordings import PlayReport, RecordedFrame
    from canopen_control.cli.support.bus_description import Source
    from canopen_control.host.reactor import Reactor
    from canopen_control.rpc.messages.robot import Description


EXAMPLE = """canopen-control replay run.log robby
         canopen-control replay run.log --can local:bench
         canopen-control replay run.blf --can vcan0 --speed 10
         canopen-control replay fault.zip robby --page"""
LABEL = "replay"
LISTEN_S = 1.2  # longer than a heartbeat period of 1 s, or ten periods of a slow SYNC
ANSWER_S = 0.1
_INTERRUPTED = 130
_POLL_NS = 500_000_000
_FROM_NODES = frozenset(
    (Service.EMCY, Service.HEARTBEAT, Service.SDO_SERVER, Service.TPDO1, Service.TPDO2, Service.TPDO3, Service.TPDO4)
)
_WITHOUT_NODE = frozenset((None, Service.NMT, Service.SYNC, Service.TIME, Service.LSS_MASTER, Service.LSS_SLAVE))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file", metavar="FILE", help="a recording: .log, .asc, .blf, .trc (text also as .gz), or a flight recording"
    )
    parser.add_argument("--can", metavar="CHANNEL", help="replay it onto this channel (local:NAME, vcan0, can0, ...)")
    parser.add_argument(
        "--speed",
        type=number("speed from 0.001 to 1000", lambda value: 0.001 <= value <= 1000),
        default=1.0,
        metavar="X",
        help="speed factor (default: 1)",
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="serve the recording as a robot, for view and monitor; ROBOT provides the description",
    )
    parser.add_argument("--force", action="store_true", help="replay even if a master or the recorded nodes are active")
    add_network_arguments(parser)
    add_view_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb; return 1 if the recording could not be read to its end, 130 after Ctrl-C, else 0."""
    if args.page:
        return _serve_recording(args)
    if args.can is None:
        return show_file(args, args.file)
    recording = open_frames(args.file, args.bus)
    channel = str(parse_channel(args.can))
    if parse_channel(channel).kind.in_process:
        raise ConfigError(
            f"{channel} exists in one process only, so no other program receives the frames; use local:NAME"
        )
    _print_new_bus(channel)
    if not args.force:
        _refuse_used_bus(recording, channel)
    return _play(args, recording, channel)


def _serve_recording(args: argparse.Namespace) -> int:
    """Serve a flight recording as a robot until Ctrl-C, or until another robot starts."""
    from canopen_control.trace.flight_file import is_flight_file, read_flight, read_samples

    path = Path(args.file)
    if args.can is not None or not is_flight_file(path):
        raise ConfigError(f"--page requires a flight recording (.zip) and no --can; FILE is {args.file}")
    if running := list_sockets("robot"):
        raise ConfigError(f"robot {running[0]} runs, and STOP must always refer to one robot; shut it down first")
    file, samples = read_flight(path), read_samples(path)
    from canopen_control.host.reactor import Reactor
    from canopen_control.trace.replayed_robot import ReplayedRobot

    name = args.name or f"{file.meta.robot}_replay"
    with Reactor() as reactor:
        robot = ReplayedRobot(name, file.meta, samples, file.events, _description(args), reactor, args.speed)
        try:
            reactor.handle_signals({signal.SIGINT: reactor.stop, signal.SIGTERM: reactor.stop})
            span = samples[-1].time - samples[0].time
            print(f"{name}: {span:.0f} s of {file.meta.robot}; see it: canopen-control view --name {name}", flush=True)
            _end_with_a_robot(reactor, name)
            reactor.run()
        finally:
            robot.close()
    return 0


def _end_with_a_robot(reactor: Reactor, name: str) -> None:
    """End the replay if another robot runs, else check again later: STOP must refer to one robot only."""
    if robots := [socket for socket in list_sockets("robot") if socket != name]:
        print(f"canopen-control: robot {robots[0]} has started; the replay ends", file=sys.stderr)
        reactor.stop()
    else:
        reactor.call_later(_POLL_NS, lambda: _end_with_a_robot(reactor, name))


def _description(args: argparse.Namespace) -> Description:
    """Return the description (URDF) of the ROBOT argument, or an empty description without ROBOT."""
    from canopen_control.rpc.messages.robot import Description

    if args.config is None:
        return Description("")
    from canopen_control.runtime.robot_files import find_robot
    from canopen_control.runtime.setup import read_robot

    description = read_robot(find_robot(args.config)).description
    return Description(description.urdf_xml, str(Path(description.path).resolve()))


def _print_new_bus(channel: str) -> None:
    """Print a notice if no program has the local bus open, since the name may be mistyped."""
    spec = parse_channel(channel)
    if spec.kind is ChannelKind.LOCAL and spec.name not in (buses := list_sockets("bus")):
        names = ", ".join(f"local:{bus}" for bus in buses) or "none"
        print(f"canopen-control: no program has {channel} open, so it is created; open buses: {names}", file=sys.stderr)


def _play(args: argparse.Namespace, recording: Source, channel: str) -> int:
    """Play the recording and print the result, even after Ctrl-C; return the exit code."""
    from canopen_control.bus.recordings import PlayReport, play

    port, played, interrupted = open_port(channel, label=LABEL), PlayReport(), False
    progress = Progress(f"playing into {channel}, Ctrl-C ends it", "frames")
    try:
        play(_with_progress(recording, played, progress), port, played, speed=args.speed)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        port.close()
        progress.end()
    result = {"file": args.file, "channel": channel, "frames": played.frames, "late_max_s": round(played.late_max, 6)}
    result |= {"left_out": played.errors, "lost": port.stats.lost}
    print(json_text(result, indent=None) if args.json else _sentence(channel, played, port.stats.lost))
    report_gaps(recording)
    return _INTERRUPTED if interrupted else 1 if recording.problem else 0


def _with_progress(recording: Source, played: PlayReport, progress: Progress) -> Iterator[RecordedFrame]:
    """Yield the frames of a recording and update the progress display."""
    for frame in recording:
        progress.at(played.frames)
        yield frame


def _sentence(channel: str, played: PlayReport, lost: int) -> str:
    text = f"{played.frames} frames into {channel}, none later than {1e3 * played.late_max:.1f} ms"
    text += f", {played.errors} error frames left out" if played.errors else ""
    return text + (f", {lost} lost" if lost else "")


def node_ids_in(frames: Iterable[RecordedFrame]) -> set[int]:
    """Return the node-IDs in the COB-IDs of frames, by the predefined connection set (CiA 301)."""
    node_ids = set()
    for _, frame in frames:
        service, node_id = service_of(frame.can_id) or (None, 0)
        if service not in _WITHOUT_NODE and node_id:
            node_ids.add(node_id)
    return node_ids


def _refuse_used_bus(recording: Source, channel: str) -> None:
    """Raise ConfigError for frames of several buses, or if a robot, a master or a node of them is active here."""
    from canopen_control.cli.support.target import robot_on

    if (owner := robot_on(channel)) is not None:
        raise ConfigError(f"{channel} is the bus of the running robot {owner[0]}; shut it down, or use another bus")
    node_ids = node_ids_in(recording)
    if recording.mixture:  # one identifier belongs to a node on each bus
        raise ConfigError(f"{recording.mixture} (--force plays all frames)")
    active, has_master = _listen(channel)
    if has_master:
        raise ConfigError(f"on {channel} a master is active: its SYNC or NMT was received; --force plays anyway")
    if alive := sorted(active & node_ids or _answering(channel, node_ids)):
        names = ", ".join(str(node_id) for node_id in alive)
        raise ConfigError(f"on {channel} node {names} of {recording.path} is active; --force plays anyway")


def _listen(channel: str) -> tuple[set[int], bool]:
    """Listen for `LISTEN_S`, or until a master sends NMT commands or SYNC; return who sends, and whether one did."""
    from canopen_control.trace.listen import batches

    nodes, has_master = set(), False
    port = open_port(channel, label=LABEL)
    try:
        for _, frame in (item for batch in batches(port, LISTEN_S) for item in batch):
            service, node_id = service_of(frame.can_id) or (None, 0)
            has_master = has_master or service in (Service.NMT, Service.SYNC)
            if service in _FROM_NODES:
                nodes.add(node_id)
            if has_master:
                break
    finally:
        port.close()
    return nodes, has_master


def _answering(channel: str, node_ids: Iterable[int]) -> set[int]:
    """Return the nodes that respond to a read of the device type (0x1000); an abort counts as a response."""
    from canopen_control.master.direct import DirectBus

    with DirectBus.open(channel, label=LABEL, timeout_s=ANSWER_S, retries=0) as bus:
        answers = bus.read_many((node_id, 0x1000, 0) for node_id in sorted(node_ids))
    return {node_id for (node_id, _, _), answer in answers.items() if not isinstance(answer, SdoTimeout)}
