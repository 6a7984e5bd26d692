"""`drive`: one drive on a bench, as a new user meets it: first turn, stop, clone, firmware.

Everything is `canopen-control` with all its processes, on a `local:` bus that is paced to 1 Mbit/s. Times count from
when a command is given until the drive itself says so, past the bus, so that they hold the start of Python too.
"""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
import time
from argparse import Namespace
from typing import TYPE_CHECKING, Final

from canopen_control.bus.local import ask_hub
from canopen_control.cli.support.open_session import open_session
from canopen_control.client.drive_client import DriveClient
from canopen_control.commissioning.jobs import ProgramOptions
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.parameter_set import parameters_of
from canopen_control.commissioning.program_download import DownloadProgress, download
from canopen_control.commissioning.restore import quiet_node
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE
from canopen_control.master.direct import DirectBus
from canopen_control.od.dcf import eds_text
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry
from canopen_control.rpc.messages.drive import GetDriveState
from canopen_control.rpc.messages.hub import SetBitrate
from canopen_control.virtual.communication_objects import whole_program
from canopen_control_bench.figure import AT_LEAST, Figure, limited
from canopen_control_bench.stage import TIMEOUT_S, stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from canopen_control_bench.runner import Options
    from canopen_control_bench.stage import Stage


FIRST_TURN_S, DEAD_MAN_S, CLONE_S = 30.0, 0.5, 10.0
RATE_KB_S: Final = 0.8 * 51.0  # fraction of the maximum rate of block transfer at 1 Mbit/s
BITRATE: Final = 1_000_000
PARAMETERS: Final = 300
IMAGE_BYTES, QUICK_BYTES = 256 * 1024, 32 * 1024
KILLS: Final = 10
NODE: Final = 3
PROGRAM_DATA: Final = 0x1F50
_BUS, _CHANNEL = "desk", "local:desk"
_EDS: Final = str(data_path("eds", "generic_cia402_program.eds"))
_ENDS: Final = {"SIGKILL": "jog is killed", "terminal": "its terminal is closed"}
_LOOK_S: Final = 0.005


def measure(options: Options) -> list[Figure]:
    """Measure them one after the other, each on a separate bus."""
    rounds, kills, size = (1, 1, QUICK_BYTES) if options.quick else (3, KILLS, IMAGE_BYTES)
    ends = tuple(_ENDS)[:1] if options.quick else tuple(_ENDS)
    jogs = [_jogged(end) for _ in range(rounds) for end in ends]
    stops = {end: [stop for _, stop, reason in jogs if reason == end] for end in ends}
    return [
        limited("from nothing to a drive that turns", "s", [turn for turn, _, _ in jogs], limit=FIRST_TURN_S),
        *(limited(f"it stands after {_ENDS[end]}", "s", stops[end], limit=DEAD_MAN_S) for end in ends),
        limited(f"clone, {PARAMETERS} parameters, equal", "s", [_cloned() for _ in range(rounds)], limit=CLONE_S),
        *_programs(rounds, kills, size),
    ]


# -- turning and stopping


def _jogged(end: str) -> tuple[float, float, str]:
    """Return the seconds from the first command to a turn, and from the end of the jog to standstill."""
    with stage() as played:
        began = time.monotonic()
        _drives(played, str(NODE), _EDS)
        with contextlib.closing(DriveClient.connect(_CHANNEL, NODE)) as drive, _terminal_jog() as (process, terminal):
            turned = _until(lambda: abs(_speed(drive)) > 1.0, terminal) - began
            ended = time.monotonic()
            if end == "terminal":
                os.close(terminal)
            else:
                process.send_signal(signal.SIGKILL)
            return turned, _until(lambda: _speed(drive) == 0.0) - ended, end


def _drives(played: Stage, nodes: str, eds: str) -> None:
    program = played.start("canopen_control", "drive", "--node-id", nodes, "--eds", eds, "--can", _CHANNEL)
    program.line()
    program.drain()
    ask_hub(_BUS, SetBitrate(BITRATE))


@contextlib.contextmanager
def _terminal_jog() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Run `jog` on a terminal of its own; yield its process and the other end of that terminal."""
    master, slave = pty.openpty()
    words = ["jog", str(NODE), "--can", _CHANNEL, "--eds", _EDS, "--velocity", "60rpm", "--for", "600"]
    code = (
        "import fcntl, sys, termios\nfrom canopen_control.cli.main import main\nfcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", f"{code}sys.exit(main({words!r}))"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
    )
    os.close(slave)
    os.set_blocking(master, False)
    try:
        yield process, master
    finally:
        process.kill()
        process.wait(TIMEOUT_S)
        with contextlib.suppress(OSError):
            os.close(master)


def _until(condition: Callable[[], bool], terminal: int | None = None) -> float:
    """Wait for a condition and return the time; output on `terminal` is discarded meanwhile."""
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        if time.monotonic() > end:
            raise CanopenError(f"not within {TIMEOUT_S:g} s")
        if terminal is not None:
            with contextlib.suppress(BlockingIOError):
                os.read(terminal, 65536)
        time.sleep(_LOOK_S)
    return time.monotonic()


def _speed(drive: DriveClient) -> float:
    return drive.ask(GetDriveState()).axes[0].plant.velocity


# -- replacement


def _cloned() -> float:
    """Return the duration of a clone in s; raises CanopenError if the clone is not exact."""
    with stage() as played:
        eds = str(_large_eds(played.folder / "large.eds"))
        _drives(played, "3,4", eds)
        options = ("--can", _CHANNEL, "--eds", eds)
        for index in range(0x3000, 0x3000 + 40):
            _command("sdo", "write", "3", f"{index:04X}:0", str(index), *options)
        began = time.monotonic()
        _command("clone", "3", "4", *options)
        seconds = time.monotonic() - began
        _command("diff", "3", "4", *options)
        return seconds


def _large_eds(path: Path) -> Path:
    """Write the EDS of a drive with the given number of parameters."""
    od = read_eds(data_path("eds", "generic_cia402.eds"), NODE).od
    unmapped = 50  # mapping entries beyond their count
    for index in range(0x3000, 0x3000 + PARAMETERS + unmapped - len(parameters_of(od))):
        od.add(Entry(index, 0, f"Parameter {index:04X}", DataType.UNSIGNED32, "rw", default=0))
    path.write_text(eds_text(od), encoding="utf-8")
    return path


def _command(*words: str) -> str:
    """Run a verb and return its output; raises CanopenError with its error output."""
    done = subprocess.run([*MODULE, "canopen_control", *words], capture_output=True, text=True, timeout=TIMEOUT_S)
    if done.returncode:
        raise CanopenError(f"{' '.join(words)}: {done.returncode}: {done.stderr.strip()}")
    return done.stdout


# -- firmware download


def _programs(rounds: int, kills: int, size: int) -> list[Figure]:
    """Load a firmware file, then again after killed downloads; a small file shows no rate."""
    image = whole_program(bytes(range(256)) * (size // 256))
    with stage() as played:
        _drives(played, str(NODE), _EDS)
        path = played.folder / "drive.bin"
        path.write_bytes(image)
        words = ("firmware", str(NODE), str(path), "--can", _CHANNEL, "--eds", _EDS)
        seconds = [_seconds(words) for _ in range(rounds)]
        rates = [size / 1000 / _sending(image) for _ in range(rounds)]
        spoilt = sum(_spoilt(words, image, min(seconds) * (number + 0.5) / kills) for number in range(kills))
    return [
        limited(
            f"program of {size // 1024} kB, its data", "kB/s", rates,
            limit=RATE_KB_S if size == IMAGE_BYTES else None, direction=AT_LEAST,
            absolutes={"the whole command s": round(min(seconds), 2)},
        ),
        limited(f"SIGKILL {kills} times on the way: not mended", "", [float(spoilt)], limit=0.0, counted=True),
    ]  # fmt: skip


def _seconds(words: Sequence[str]) -> float:
    began = time.monotonic()
    _command(*words)
    return time.monotonic() - began


class _TimedSession(NodeSession):
    """A session that times the transfer of a firmware file."""

    sending_s = 0.0

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Download the bytes of an object."""
        began = time.monotonic()
        super().write(index, subindex, data)
        if index == PROGRAM_DATA:
            self.sending_s = time.monotonic() - began


def _sending(image: bytes) -> float:
    """Load a firmware file and return the seconds of its data transfer."""
    args = Namespace(can=_CHANNEL, name=None, eds=_EDS, timeout=1.0, node=str(NODE))
    with open_session(args) as opened:
        session = _TimedSession(opened.transfers, opened.node_id, opened.od)
        with quiet_node(session, starts_again=False):
            download(session, image, ProgramOptions(), DownloadProgress())
    return session.sending_s


def _spoilt(words: Sequence[str], image: bytes, after_s: float) -> bool:
    """Kill a download after a time; return whether a partial program runs, or the next download fails."""
    process = subprocess.Popen([*MODULE, "canopen_control", *words], stdout=subprocess.DEVNULL)
    time.sleep(after_s)
    process.kill()
    process.wait(TIMEOUT_S)
    if _runs() and not _runs(image):
        return True
    try:
        _command(*words)
    except CanopenError:
        return True
    return not _runs(image)


def _runs(image: bytes = b"") -> bool:
    """Whether the drive runs a program, or the given one, according to 0x1F51 and the CRC in 0x1F56."""
    with DirectBus.open(_CHANNEL, timeout_s=1.0) as bus:
        runs = bus.read(NODE, 0x1F51, 1)[0] == 1
        return runs and (not image or bus.read(NODE, 0x1F56, 1) == image[-4:])
