"""candump's log format, ``(1700000000.123456) can0 183#3706``, written and read frame by frame.

As can-utils has it: error frames keep their classes and details and remote frames their length, which python-can's own
writer leaves out.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO

__all__ = ["interface_name", "line_of", "parse_line", "read_lines"]

_STANDARD_DIGITS = 3
_NS = 1_000_000_000
_LONGEST_NAME = 15  # IFNAMSIZ without the zero
_LONGEST_LINE = 4096  # of any that is a frame, by far
_LINE = re.compile(
    r"\((?P<sign>-?)(?P<seconds>\d{1,11})\.(?P<fraction>\d{1,18})\)\s+(?P<channel>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?P<data>[Rr]\d?|(?:[0-9A-Fa-f]{2}\.?){0,8})(?:_[9A-Fa-f])?(?P<rest>\s+[RTrt])?\s*"
)


def interface_name(channel: str) -> str:
    """Return a channel as the name of a network interface, which other programs take it for."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", channel)[:_LONGEST_NAME] or "can0"


def line_of(time_ns: int, channel: str, frame: CanFrame) -> str:
    """Return the line of a frame with its end; `time_ns` in Unix time is cut to microseconds."""
    sign = "-" if time_ns < 0 else ""
    seconds, ns = divmod(abs(time_ns), _NS)
    # of an error frame candump writes the flag too
    text = f"{frame.can_id:08X}#{frame.data.hex().upper()}" if frame.is_error else str(frame)
    return f"({sign}{seconds:010d}.{ns // 1000:06d}) {channel} {text}\n"


def parse_line(line: str) -> tuple[int, CanFrame] | None:
    """Return time and frame of a line; None for what is none: CAN FD, or another format.

    A clock that was set can make times negative. A DLC above 8 (`_9` to `_F`, can-utils 2020 and later) means 8 bytes.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    time_ns = int(found["seconds"]) * _NS + int(f"{found['fraction']:0<9}"[:9])
    time_ns = -time_ns if found["sign"] else time_ns
    can_id = int(found["id"], 16)
    if len(found["id"]) > _STANDARD_DIGITS and not can_id & ERROR_FLAG:
        can_id = can_id & ~REMOTE_FLAG | EXTENDED_FLAG
    data = found["data"]
    if data[:1] in ("R", "r"):
        return time_ns, CanFrame(can_id | REMOTE_FLAG, bytes(min(int(data[1:] or 0), 8)))
    return time_ns, CanFrame(can_id, bytes.fromhex(data.replace(".", "")))


def read_lines(file: TextIO) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield the frames of a log, None for each line that is none; empty lines do not count."""
    while line := file.readline(_LONGEST_LINE):
        if text := line.strip():
            yield parse_line(text)
