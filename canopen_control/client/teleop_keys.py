"""Velocities from keys: the keys of ROS's teleop_twist_keyboard, plus a dead-man timeout.

Sans-IO; times are monotonic nanoseconds. A terminal does not report the release of a key, only that a held key repeats,
the first time after 0.25 to 0.66 s, then about 25 times a second. So the first press moves for `first` seconds (longer
than that delay, or every start would stutter); once the key has repeated, the motion ends `repeat` seconds after the
last repetition. As in teleop_twist_keyboard, any other key that changes no speed stops at once.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

HELP: Final = """\
   u    i    o        forward, in curves      q/z  both speeds up/down by 10 %
   j    k    l        turn, k or space stops  w/x  only linear up/down
   m    ,    .        backward                e/c  only angular up/down
hold a key to move; anything else stops; Ctrl-C ends"""

SIDEWAYS_HELP: Final = """\
   U    I    O        with shift: sideways (J, L) and diagonally
   J         L        at the linear speed, without turning
   M    <    >"""

#: key -> (linear, angular), as factors of the speeds
MOTIONS: Final[dict[str, tuple[int, int]]] = {
    "i": (1, 0),
    "o": (1, -1),
    "j": (0, 1),
    "l": (0, -1),
    "u": (1, 1),
    ",": (-1, 0),
    ".": (-1, 1),
    "m": (-1, -1),
    "up": (1, 0),
    "down": (-1, 0),
    "left": (0, 1),
    "right": (0, -1),
}
#: key -> (forward, to the left), as factors of the linear speed, for a base that drives sideways
SIDEWAYS: Final[dict[str, tuple[int, int]]] = {
    "U": (1, 1),
    "I": (1, 0),
    "O": (1, -1),
    "J": (0, 1),
    "L": (0, -1),
    "M": (-1, 1),
    "<": (-1, 0),
    ">": (-1, -1),
}
#: key -> factors of (linear, angular) speed
SPEEDS: Final[dict[str, tuple[float, float]]] = {
    "q": (1.1, 1.1),
    "z": (0.9, 0.9),
    "w": (1.1, 1.0),
    "x": (0.9, 1.0),
    "e": (1.0, 1.1),
    "c": (1.0, 0.9),
}
_UP_AND_DOWN: Final = frozenset("tb")
_QUIT: Final = ("ctrl-c", "ctrl-d")
_MIN_SPEED, _MAX_SPEED = 1e-3, 1e3  # limits of a speed that keys change

_CSI: Final = re.compile(rb"\x1b\[[0-?]*[ -/]*[@-~]|\x1bO[@-~]")
_NAMES: Final[dict[bytes, str]] = {
    b"\x1b[A": "up",
    b"\x1b[B": "down",
    b"\x1b[C": "right",
    b"\x1b[D": "left",
    b"\x1bOA": "up",
    b"\x1bOB": "down",
    b"\x1bOC": "right",
    b"\x1bOD": "left",
    b"\x1b[I": "focus-in",
    b"\x1b[O": "focus-out",
}
_CONTROLS: Final = {0x03: "ctrl-c", 0x04: "ctrl-d", 0x20: "space"}
_ESCAPE: Final = 0x1B
_ESCAPE_NS: Final = 50_000_000  # an ESC that is not followed by other bytes in this time is a key
_LONGEST_SEQUENCE: Final = 32


class KeyDecoder:
    """Decoder of the bytes of a terminal to key names, such as "i", "up", "space", "ctrl-c", "focus-out" or "other"."""

    def __init__(self) -> None:
        self._buffer = b""
        self._since = 0

    def feed(self, data: bytes, now: int) -> list[str]:
        """Return the names of the completed keys; an escape sequence may arrive in pieces."""
        self._buffer += data
        self._since = now
        keys = []
        while self._buffer:
            name, length = self._first()
            if not length:
                break
            keys.append(name)
            self._buffer = self._buffer[length:]
        return keys

    def next_deadline(self) -> int | None:
        """Return the time at which `tick` ends an unfinished escape sequence, or None if there is none."""
        return self._since + _ESCAPE_NS if self._buffer else None

    def tick(self, now: int) -> list[str]:
        """Return ["other"] if an escape sequence is unfinished after the timeout, else an empty list."""
        deadline = self.next_deadline()
        if deadline is None or now < deadline:
            return []
        self._buffer = b""
        return ["other"]

    def _first(self) -> tuple[str, int]:
        """Return the name of the first key and its length in bytes; the length is 0 if the key is incomplete."""
        buffer = self._buffer
        if buffer[0] != _ESCAPE:
            return _CONTROLS.get(buffer[0]) or (chr(buffer[0]) if 0x20 < buffer[0] < 0x7F else "other"), 1
        match = _CSI.match(buffer)
        if match is not None:
            return _NAMES.get(match[0], "other"), match.end()
        begins_sequence = len(buffer) == 1 or buffer[1:2] in (b"[", b"O")
        if begins_sequence and len(buffer) < _LONGEST_SEQUENCE:
            return "", 0
        return "other", 1


@dataclass(frozen=True, slots=True)
class Velocities:
    """Commanded velocities of a base: `linear` and `lateral` (to the left) in m/s, and `angular` in rad/s."""

    linear: float = 0.0
    angular: float = 0.0
    lateral: float = 0.0

    @property
    def moving(self) -> bool:
        return bool(self.linear or self.angular or self.lateral)


class _Hold(Enum):
    RELEASED = 0
    PRESSED = 1  # once, and possibly held
    REPEATING = 2


class Teleop:
    """Motion from held keys; `velocities` is valid until `next_deadline`.

    `speed` and `turn` are the linear and angular speed, `first` and `repeat` the dead-man timeouts in s. `ended` is
    True once the user quits, `note` is a sentence about the last key or "". `sideways` means that the base can drive
    sideways.
    """

    def __init__(
        self,
        speed: float = 0.5,
        turn: float = 1.0,
        *,
        first: float = 0.7,
        repeat: float = 0.25,
        sideways: bool = False,
    ) -> None:
        self.speed, self.turn = speed, turn
        self.ended = False
        self.note = ""
        self._motions = {key: (linear, 0, angular) for key, (linear, angular) in MOTIONS.items()}
        if sideways:
            self._motions |= {key: (linear, lateral, 0) for key, (linear, lateral) in SIDEWAYS.items()}
        self._first_ns, self._repeat_ns = round(first * 1e9), round(repeat * 1e9)
        self._hold, self._key, self._deadline = _Hold.RELEASED, "", 0

    @property
    def velocities(self) -> Velocities:
        """Current velocities; zeros if no key is held."""
        if self._hold is _Hold.RELEASED:
            return Velocities()
        linear, lateral, angular = self._motions[self._key]
        return Velocities(linear * self.speed, angular * self.turn, lateral * self.speed)

    def key(self, name: str, now: int) -> None:
        """Start, change or stop the motion according to a key name from `KeyDecoder`."""
        self.tick(now)
        self.note = ""
        if name in self._motions:
            self._move(name, now)
        elif name in SPEEDS:
            self._change_speed(*SPEEDS[name])
        elif name != "focus-in":
            self.stop()
            self.ended = self.ended or name in _QUIT
            self.note = _note_of(name)

    def stop(self) -> None:
        """Stop the motion until a key is pressed."""
        self._hold = _Hold.RELEASED

    def tick(self, now: int) -> None:
        """Stop the motion if its key has not been repeated in time."""
        if self._hold is not _Hold.RELEASED and now >= self._deadline:
            self.stop()

    def next_deadline(self) -> int | None:
        """Return the time at which the motion ends unless a key is pressed, or None if nothing moves."""
        return None if self._hold is _Hold.RELEASED else self._deadline

    def _move(self, name: str, now: int) -> None:
        repeats = self._hold is not _Hold.RELEASED and name == self._key
        self._hold = _Hold.REPEATING if repeats else _Hold.PRESSED
        self._key = name
        self._deadline = now + (self._repeat_ns if repeats else self._first_ns)

    def _change_speed(self, linear: float, angular: float) -> None:
        """Change both speeds by factors; a motion continues at the new speed until its previous deadline."""
        self.speed = min(max(self.speed * linear, _MIN_SPEED), _MAX_SPEED)
        self.turn = min(max(self.turn * angular, _MIN_SPEED), _MAX_SPEED)


def _note_of(name: str) -> str:
    if name in _UP_AND_DOWN or name in SIDEWAYS:
        return f"{name}: this base cannot move sideways, up or down; use the keys without shift"
    return "the terminal has lost the focus: stopped" if name == "focus-out" else ""
