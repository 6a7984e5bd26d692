"""A hostile client of a robot's socket, as a process: `python -m campaigner.hostile KIND SOCKET SECONDS`."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import sys
import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable


_SOCKETS: Final = 8
_IDLE: Final = 80
_LONG: Final = 1 << 20


class _Attack:
    """Several connections for a limited time."""

    def __init__(self, path: str, seconds: float) -> None:
        self.path, self.end = path, time.monotonic() + seconds

    @property
    def goes_on(self) -> bool:
        return time.monotonic() < self.end

    def connect(self) -> socket.socket | None:
        each = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        each.settimeout(0.2)
        try:
            each.connect(self.path)
        except OSError:
            each.close()
            return None
        return each

    def flood(self, line: Callable[[], bytes], *, reads: bool) -> None:
        """Send lines on several connections as fast as they are accepted; reopen connections that were closed."""
        there: list[socket.socket | None] = [None] * _SOCKETS
        while self.goes_on:
            for place, entry in enumerate(there):
                if entry is None:
                    there[place] = self.connect()
                elif not _send(entry, line(), reads=reads):
                    entry.close()
                    there[place] = None
            time.sleep(0.001)

    def hold(self, count: int, first: bytes = b"") -> None:
        """Keep the given number of connections open, and send only `first`."""
        there: list[socket.socket] = []
        while self.goes_on:
            if len(there) < count and (each := self.connect()) is not None:
                with contextlib.suppress(OSError):
                    each.sendall(first)
                there.append(each)
            else:
                time.sleep(0.02)


def _send(each: socket.socket, data: bytes, *, reads: bool) -> bool:
    try:
        each.setblocking(False)
        if reads:
            with contextlib.suppress(BlockingIOError):
                while each.recv(1 << 16):
                    pass
        each.setblocking(True)
        each.settimeout(0.2)
        each.sendall(data)
    except TimeoutError:
        return False  # an incomplete line was sent
    except OSError:
        return False
    return True


def _junk(attack: _Attack) -> None:
    draw = random.Random(1)
    lines = (b"\xff\xfe\x00", b"[1,2", b"{}", b'{"method":7}', b'{"id":1,"method":"fly"}', b"[" * 5000, b'"\\ud800"')
    attack.flood(lambda: draw.choice((*lines, draw.randbytes(200).replace(b"\n", b" "))) + b"\n", reads=True)


def _long_lines(attack: _Attack) -> None:
    line = b'{"id":1,"method":"status","params":{"a":[' + b"0," * (_LONG // 2 - 40) + b"0]}}\n"
    attack.flood(lambda: line, reads=True)


def _requests(attack: _Attack) -> None:
    attack.flood(lambda: b'{"id":1,"method":"status","params":{}}\n' * 20, reads=True)


def _churn(attack: _Attack) -> None:
    while attack.goes_on:
        if (each := attack.connect()) is not None:
            each.close()


KINDS: Final[dict[str, Callable[[_Attack], None]]] = {
    "junk": _junk,
    "long_lines": _long_lines,
    "idle": lambda attack: attack.hold(_IDLE),
    "half_open": lambda attack: attack.hold(30, b'{"id":1,"method":"sta'),
    "deaf": lambda attack: attack.hold(
        8, b'{"id":1,"method":"subscribe","params":{"state_rate":1000,"events":true,"pdos":true}}\n'
    ),
    "requests": _requests,
    "churn": _churn,
}


def main(arguments: list[str]) -> None:
    """Attack as the command line says."""
    kind, path, seconds = arguments
    os.nice(5)  # the attack is not on the CPUs of the machine
    KINDS[kind](_Attack(path, float(seconds)))


if __name__ == "__main__":
    main(sys.argv[1:])
