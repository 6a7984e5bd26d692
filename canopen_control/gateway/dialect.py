"""Parser and formatter of CiA 309-3 commands and responses as in CANopenNode, without I/O.

    line    = [command] ["#" comment] LF
    command = "[" sequence "]" [[net] node] verb arguments

Numbers are written as in C: decimal, 0x or octal with a leading 0. The text of CiA 309-3 is not public: grammar, error
numbers and answers are those of CANopenNode's CO_gateway_ascii, byte for byte. If a number is too large, this module
answers with a syntax error, where CANopenNode wraps the number; only the sequence number is wrapped. A line is never
cut.
"""

from __future__ import annotations

import base64
import binascii
import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, TypeAlias

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.errors import CanopenError
from canopen_control.frame import BROADCAST, MAX_NODE_ID

if TYPE_CHECKING:
    from collections.abc import Callable


MAX_LINE: Final = 1 << 16  # bytes of a command
MAX_VALUE_LINE: Final = 1 << 24  # bytes of a command that writes a text, hex or base64 value
DEFAULT_TIMEOUT_MS: Final = 500
DEFAULT_SCAN_MS: Final = 100
_LONGEST_TOKEN: Final = 20
_LONGEST_VALUE: Final = 40
_END: Final = b"\r\n"
_U8, _U16, _U32 = 0xFF, 0xFFFF, 0xFFFFFFFF
_BLANKS: Final = b" \t\r\v\f"

ERRORS: Final = {
    100: "Request not supported.",
    101: "Syntax error.",
    102: "Request not processed due to internal state.",
    103: "Time-out.",
    104: "No default net set.",
    105: "No default node set.",
    106: "Unsupported net.",
    107: "Unsupported node.",
    204: "Wrong NMT state.",
    301: "Bus off.",
    501: "LSS implementation- / manufacturer-specific error.",
    502: "LSS node-ID not supported.",
    503: "LSS bit-rate not supported.",
    504: "LSS parameter storing failed.",
    505: "LSS command failed because of media error.",
    600: "Running out of memory.",
}
NOT_SUPPORTED, SYNTAX, INTERNAL_STATE, TIME_OUT, NO_DEFAULT_NODE = 100, 101, 102, 103, 105
UNSUPPORTED_NET, UNSUPPORTED_NODE, WRONG_NMT_STATE, BUS_OFF = 106, 107, 204, 301
LSS_MANUFACTURER, LSS_NODE_ID, LSS_BITRATE, LSS_STORE, LSS_MEDIA = 501, 502, 503, 504, 505

HELP: Final = {
    b"": """
Enter one command per line, such as:    [1] 5 read 0x6041 0 u16   # comment
A line has a sequence number in brackets, the node-ID (or net and node-ID), and a command:
  r[ead] INDEX SUBINDEX [TYPE]          read an object by SDO; without TYPE as hex bytes
  w[rite] INDEX SUBINDEX TYPE VALUE     write an object by SDO
  start | stop | preop[erational]       send the NMT command to NODE (0: all nodes)
  reset node | reset comm[unication]    send the NMT reset to NODE (0: all nodes)
  set network NET                       set the default network (no effect: there is only one)
  set node NODE                         set the default node for commands without NODE
  set sdo_timeout MS                    set the timeout of SDO answers in ms (default: 500)
  set sdo_block 0|1                     switch SDO block transfer off or on (default: 0)
  help [datatype | lss]                 print this text, the data types, or the LSS commands
  log                                   print the events since the last `log` command
  led                                   print the status LEDs, which are always off
The answer has the same sequence number, and OK, a value, ERROR:0xABORTCODE or ERROR:NUMBER.
Commands that may move a drive are refused unless the gateway was started with --allow-motion.""",
    b"datatype": """
b                    boolean
i8, i16, i32, i64    signed integer
u8, u16, u32, u64    unsigned integer
x8, x16, x32, x64    unsigned integer, printed in hexadecimal
r32, r64             floating-point number
vs                   visible string; quote it if it has blanks: "two words" (a quote in it is "")
os, us, d            octet string, unicode string, domain: in base64
hex                  hexadecimal bytes; blanks between bytes are optional""",
    b"lss": """
lss_switch_glob 0|1                                switch all nodes to waiting (0) or
                                                   configuration state (1)
lss_switch_sel VENDOR PRODUCT REVISION SERIAL      switch one node to configuration state
lss_set_node 1..127|255                            set the node-ID (255: unconfigured)
lss_conf_bitrate 0 INDEX                           set the bit rate by its index: 0: 1000,
                                                   1: 800, 2: 500, 3: 250, 4: 125, 6: 50,
                                                   7: 20, 8: 10 kbit/s, 9: automatic
lss_activate_bitrate DELAY_MS                      use the new bit rate after the switch delay
lss_store                                          store node-ID and bit rate in the node
lss_inquire_addr [0..3]                            read the identity, or one part of it: vendor,
                                                   product, revision, serial
lss_get_node                                       read the node-ID
_lss_fastscan [STEP_MS]                            find one node without a node-ID
lss_allnodes [STEP_MS [FIRST_NODE STORE [T VENDOR T PRODUCT T REVISION T SERIAL]]]
                                                   find all nodes without a node-ID, and number
                                                   them from FIRST_NODE (default: 2); STORE 1
                                                   stores the node-IDs (default: 1); T is
                                                   0 or 1 to scan a number, 2 to match it""",
}
_LEDS: Final = b" CANopen status LEDs: R  G         \r"  # without line feed, as CANopenNode prints LEDs that are off


@dataclass(frozen=True, slots=True)
class ReadOrder:
    """SDO upload requested by the client; `type_name` selects the format of the response."""

    node_id: int
    index: int
    subindex: int
    type_name: str


@dataclass(frozen=True, slots=True)
class WriteOrder:
    """SDO download requested by the client."""

    node_id: int
    index: int
    subindex: int
    data: bytes


class NmtOrder(NamedTuple):
    """Request to send an NMT command to a node, or to all nodes if `node_id` is 0."""

    node_id: int
    command: NmtCommand


class LssOrder(NamedTuple):
    """Request for an LSS service; `verb` is the command name, `numbers` are the arguments."""

    verb: str
    numbers: tuple[int, ...]


class LogOrder(NamedTuple):
    """Request for the events since the client's last `log` command."""


GatewayRequest: TypeAlias = ReadOrder | WriteOrder | NmtOrder | LssOrder | LogOrder


class GatewayRefusal(CanopenError):
    """Error response of CiA 309-3; `reason` is a sentence that adds to the text of the error number, or ""."""

    def __init__(self, number: int, reason: str = "") -> None:
        self.number, self.reason = number, reason
        super().__init__(f"{number} {ERRORS[number]} {reason}".rstrip())


# -- values


class _Fixed(NamedTuple):
    """Data type of fixed size: format character for `struct`, and format for printing values."""

    letter: str
    shown: str


_FIXED: Final = {
    "b": _Fixed("B", "{}"),
    **{f"i{8 << step}": _Fixed(letter, "{}") for step, letter in enumerate("bhiq")},
    **{f"u{8 << step}": _Fixed(letter, "{}") for step, letter in enumerate("BHIQ")},
    **{f"x{8 << step}": _Fixed(letter, f"0x{{:0{2 << step}X}}") for step, letter in enumerate("BHIQ")},
    "r32": _Fixed("f", "{:g}"),
    "r64": _Fixed("d", "{:g}"),
}
_TEXT, _HEX = "vs", "hex"
_OPEN: Final = (_TEXT, _HEX, "os", "us", "d")
_NUMBER: Final = re.compile(rb"([+-]?)(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_REAL: Final = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_QUOTED: Final = re.compile(rb'"((?:[^"]|"")*)"(?:\s+(?:#.*)?)?', re.DOTALL)
_WORD: Final = re.compile(rb'((?:[^\s"]|"")+)(?:\s+(?:#.*)?)?', re.DOTALL)
_BASE64: Final = re.compile(rb"([A-Za-z0-9+/]+)[=\s]*(?:(?<=[=\s])#.*)?", re.DOTALL)
_LONG_VALUE: Final = re.compile(
    rb"\s*(?:\[[^\]\s]*\]\s+)?(?:\d\w*\s+){0,2}w(?:rite)?\s+\w+\s+\w+\s+(?:vs|hex|os|us|d)\s", re.IGNORECASE
)


def shown_value(type_name: str, data: bytes) -> str:
    """Format an object's data like CANopenNode; in hexadecimal if the length does not fit the type."""
    fixed = _FIXED.get(type_name)
    if fixed is not None and len(data) == struct.calcsize(fixed.letter):
        return fixed.shown.format(*struct.unpack(f"<{fixed.letter}", data))
    if type_name == _TEXT:
        text = data.replace(b"\0", b"").replace(b"\r", b"").replace(b'"', b'""')
        return f'"{text.decode("utf-8", "surrogateescape")}"'
    if fixed is None and type_name != _HEX:
        return base64.b64encode(data).decode()
    return data.hex(" ").upper()


def _c_number(token: bytes) -> tuple[int, bool]:
    """Parse a number like C's strtoul; the flag is True if the token is a number or empty."""
    match = _NUMBER.match(token)
    if match is None:
        return 0, not token
    sign, digits = match[1], match[2].decode()
    base = 16 if digits[:2].lower() == "0x" else 8 if digits[0] == "0" else 10
    value = int(digits, base)
    return -value if sign == b"-" else value, match.end() == len(token)


def _fixed_bytes(fixed: _Fixed, token: bytes) -> bytes:
    if fixed.letter in "fd":
        if _REAL.fullmatch(token) is None:
            raise GatewayRefusal(SYNTAX)
        value: float = float(token)
    else:
        value, whole = _c_number(token)
        if not whole:
            raise GatewayRefusal(SYNTAX)
    try:
        return struct.pack(f"<{fixed.letter}", value)
    except (struct.error, OverflowError):
        raise GatewayRefusal(SYNTAX) from None


def _open_bytes(type_name: str, raw: bytes) -> bytes:
    """Return the data of a text, hex or base64 value up to the end of the line; raise GatewayRefusal if invalid."""
    data = b""
    if type_name == _TEXT:
        match = (_QUOTED if raw[:1] == b'"' else _WORD).fullmatch(raw)
        data = b"" if match is None or b"\0" in match[1] else match[1].replace(b'""', b'"')
    elif type_name == _HEX:
        words = raw.split(b"#")[0].split()
        pairs = [word[start : start + 2] for word in words for start in range(0, len(word), 2)]
        if all(re.fullmatch(rb"[0-9a-fA-F]+", pair) for pair in pairs):
            data = bytes(int(pair, 16) for pair in pairs)
    elif (match := _BASE64.fullmatch(raw)) is not None:
        try:
            data = binascii.a2b_base64(match[1] + b"=" * (-len(match[1]) % 4))
        except binascii.Error:  # a single letter encodes less than a byte
            data = b""
    if not data:
        raise GatewayRefusal(SYNTAX)
    return data


# -- a line


class _Line:
    """Command line, read token by token; `closed` means that only a comment, or nothing, follows."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.net_prefix: int | None = None
        self.node_prefix: int | None = None
        self._position = 0
        self._skip()

    @property
    def closed(self) -> bool:
        return self.raw[self._position : self._position + 1] in (b"", b"#")

    def token(self, longest: int = _LONGEST_TOKEN) -> bytes:
        """Return the next token, or b"" at the end of the line; raise GatewayRefusal if it is too long."""
        begin = end = self._position
        while end < len(self.raw) and 0x21 <= self.raw[end] <= 0x7E and self.raw[end] != ord("#"):
            end += 1
            if end - begin > longest:
                raise GatewayRefusal(SYNTAX)
        self._position = end
        self._skip()
        return self.raw[begin:end]

    def last(self, longest: int = _LONGEST_TOKEN) -> bytes:
        """Return the next token; raise GatewayRefusal unless it is the last token of the line."""
        token = self.token(longest)
        if not token or not self.closed:
            raise GatewayRefusal(SYNTAX)
        return token

    def more(self) -> bytes:
        """Return the next token; raise GatewayRefusal if it is missing or the last token of the line."""
        token = self.token()
        if not token or self.closed:
            raise GatewayRefusal(SYNTAX)
        return token

    def rest(self) -> bytes:
        return self.raw[self._position :]

    def end(self) -> None:
        """Raise GatewayRefusal if another token follows."""
        if not self.closed:
            raise GatewayRefusal(SYNTAX)

    def demand_token(self) -> None:
        """Raise GatewayRefusal if no token follows."""
        if self.closed:
            raise GatewayRefusal(SYNTAX)

    def _skip(self) -> None:
        raw = self.raw
        while self._position < len(raw) and raw[self._position] in _BLANKS:
            self._position += 1
        following = raw[self._position : self._position + 1]
        if following and not b"\x21" <= following <= b"\x7e" and following < b"\x80":
            raise GatewayRefusal(SYNTAX)  # a control character; bytes of UTF-8 occur only in texts


def _type_name(token: bytes) -> str:
    name = token.lower().decode("ascii", "replace")
    if name not in _FIXED and name not in _OPEN:
        raise GatewayRefusal(SYNTAX)
    return name


def _ranged(token: bytes, low: int, high: int) -> int:
    value, whole = _c_number(token)
    if not token or not whole or not low <= value <= high:
        raise GatewayRefusal(SYNTAX)
    return value


# -- the dialect


class _Arguments(NamedTuple):
    """Arguments of an LSS command: how many are permitted, and the range of each argument."""

    counts: tuple[int, ...]
    ranges: tuple[tuple[int, int], ...] = ()


_ABORTS: Final = {int(AbortCode.NO_OBJECT): "object does not exist"}  # all other codes have the text of `abort_text`
_NMT: Final = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "preoperational": NmtCommand.ENTER_PRE_OPERATIONAL,
}
_RESETS: Final = {
    b"node": NmtCommand.RESET_NODE,
    **dict.fromkeys((b"comm", b"communication"), NmtCommand.RESET_COMMUNICATION),
}
_SETTINGS: Final = {b"network": (0, _U16), b"node": (1, MAX_NODE_ID), b"sdo_timeout": (1, _U16), b"sdo_block": (0, 1)}
_RESERVED_TIMING: Final = 5  # CiA 305, bit timing table 0: index 5 is reserved
_ANY: Final = (0, _U32)
_SCAN: Final = ((0, 2), _ANY)  # scan type and value
_LSS: Final = {
    "lss_switch_glob": _Arguments((1,), ((0, 1),)),
    "lss_switch_sel": _Arguments((4,), (_ANY,) * 4),
    "lss_set_node": _Arguments((1,), ((1, UNCONFIGURED),)),
    "lss_conf_bitrate": _Arguments((2,), ((0, 0), (0, 9))),
    "lss_activate_bitrate": _Arguments((1,), ((0, _U16),)),
    "lss_store": _Arguments((0,)),
    "lss_inquire_addr": _Arguments((0, 1), ((0, 3),)),
    "lss_get_node": _Arguments((0,)),
    "_lss_fastscan": _Arguments((0, 1), ((0, _U16),)),
    "lss_allnodes": _Arguments((0, 1, 3, 11), ((0, _U16), (1, MAX_NODE_ID), (0, 1), *_SCAN, *_SCAN, *_SCAN, *_SCAN)),
}


class GatewayDialect:
    """Session of one client, with its default node, SDO settings and unfinished line.

    With `optional_sequence`, for people who type, a line may begin with the command; the sequence number is then 0.
    """

    def __init__(self, *, optional_sequence: bool = False) -> None:
        self.optional_sequence = optional_sequence
        self.sequence = 0
        self.node_id: int | None = None
        self.timeout_ms = DEFAULT_TIMEOUT_MS
        self.block = False
        self._input = bytearray()
        self._searched = 0
        self._discarding = False

    @property
    def unfinished(self) -> bool:
        """Whether the received bytes end within a line."""
        return bool(self._input.strip()) or self._discarding

    def receive(self, data: bytes) -> None:
        self._input += data

    def next_event(self) -> GatewayRequest | bytes | None:
        """Return the next request, or the response to a command without bus access; None if no line is complete."""
        try:
            line = self._next_line()
            return None if line is None else self._parsed(line)
        except GatewayRefusal as refusal:
            return self.error(refusal)

    def _next_line(self) -> bytes | None:
        while True:
            end = self._input.find(b"\n", self._searched)
            length = len(self._input) if end < 0 else end
            if not self._discarding and length > MAX_LINE and length > self._limit():
                self._discarding = True
            if end < 0:
                if self._discarding:
                    self._input.clear()
                self._searched = len(self._input)
                return None
            line = bytes(self._input[:end])
            del self._input[: end + 1]
            self._searched = 0
            if not self._discarding:
                return line
            self._discarding = False
            limits = f"{MAX_LINE} bytes, {MAX_VALUE_LINE} to write a text, hex or base64 value"
            raise GatewayRefusal(SYNTAX, f"The line is longer than {limits}.")

    def _limit(self) -> int:
        return MAX_VALUE_LINE if _LONG_VALUE.match(self._input) else MAX_LINE

    def _parsed(self, raw: bytes) -> GatewayRequest | bytes:
        if self.optional_sequence and raw[:1] not in (b"[", b"#") and 0x21 <= raw[0:1].ljust(1)[0] <= 0x7E:
            raw = b"[0] " + raw
        line = _Line(raw)
        if line.closed:
            return _END
        token = line.more()
        if token[:1] != b"[" or token[-1:] != b"]" or len(token) < 2:
            raise GatewayRefusal(SYNTAX)
        value, whole = _c_number(token[1:-1])
        self.sequence = value & _U32  # strtoul and a cast to 32 bits
        if not whole:
            raise GatewayRefusal(SYNTAX)
        verb = self._prefixes(line).lower().decode("ascii", "replace")
        parse = self._VERBS.get(verb)
        if parse is None:
            raise GatewayRefusal(NOT_SUPPORTED)
        return parse(self, line, verb)

    def _prefixes(self, line: _Line) -> bytes:
        """Parse the optional net and node of a line, and return the command name that follows."""
        numbers: list[int] = []
        while (token := line.token())[:1].isdigit():
            line.demand_token()
            numbers.append(_ranged(token, 0, _U32))
            if len(numbers) > 2:
                raise GatewayRefusal(SYNTAX)
        if not token:
            raise GatewayRefusal(SYNTAX)
        if len(numbers) == 2:
            line.net_prefix = numbers[0]
            if numbers[0] > _U16:
                raise GatewayRefusal(UNSUPPORTED_NET)
        if numbers:
            line.node_prefix = numbers[-1]
            if numbers[-1] > MAX_NODE_ID:
                raise GatewayRefusal(UNSUPPORTED_NODE)
        return token

    def _node(self, line: _Line, lowest: int) -> int:
        node_id = self.node_id if line.node_prefix is None else line.node_prefix
        if node_id is None:
            raise GatewayRefusal(NO_DEFAULT_NODE)
        if node_id < lowest:
            raise GatewayRefusal(UNSUPPORTED_NODE)
        return node_id

    # -- commands

    def _read(self, line: _Line, _verb: str) -> GatewayRequest:
        node_id = self._node(line, 1)
        line.demand_token()
        index = _ranged(line.more(), 0, _U16)
        token = line.token()
        if not token:
            raise GatewayRefusal(SYNTAX)
        subindex = _ranged(token, 0, _U8)
        return ReadOrder(node_id, index, subindex, _HEX if line.closed else _type_name(line.last()))

    def _write(self, line: _Line, _verb: str) -> GatewayRequest:
        node_id = self._node(line, 1)
        line.demand_token()
        index, subindex = _ranged(line.more(), 0, _U16), _ranged(line.more(), 0, _U8)
        name = _type_name(line.token())
        fixed = _FIXED.get(name)
        line.demand_token()
        data = _open_bytes(name, line.rest()) if fixed is None else _fixed_bytes(fixed, line.last(_LONGEST_VALUE))
        return WriteOrder(node_id, index, subindex, data)

    def _nmt(self, line: _Line, verb: str) -> GatewayRequest:
        node_id = self._node(line, BROADCAST)
        line.end()
        return NmtOrder(node_id, _NMT[verb])

    def _reset(self, line: _Line, _verb: str) -> GatewayRequest:
        node_id = self._node(line, BROADCAST)
        line.demand_token()
        command = _RESETS.get(line.last().lower())
        if command is None:
            raise GatewayRefusal(SYNTAX)
        return NmtOrder(node_id, command)

    def _set(self, line: _Line, _verb: str) -> bytes:
        line.demand_token()
        setting = line.token().lower()
        if setting not in _SETTINGS:
            raise GatewayRefusal(NOT_SUPPORTED)
        line.demand_token()
        value = _ranged(line.last(), *_SETTINGS[setting])
        if setting == b"node":
            self.node_id = value
        elif setting == b"sdo_timeout":
            self.timeout_ms = value
        elif setting == b"sdo_block":
            self.block = bool(value)
        return self.ok()  # `network` is accepted: there is a single net, as in CANopenNode's usual build

    def _lss(self, line: _Line, verb: str) -> GatewayRequest:
        numbers: list[int] = []
        bounds = _LSS[verb]
        while not line.closed and len(numbers) < len(bounds.ranges):
            numbers.append(_ranged(line.token(), *bounds.ranges[len(numbers)]))
        line.end()
        if len(numbers) not in bounds.counts:
            raise GatewayRefusal(SYNTAX)
        if verb == "lss_set_node" and MAX_NODE_ID < numbers[0] < UNCONFIGURED:
            raise GatewayRefusal(SYNTAX)
        if verb == "lss_conf_bitrate" and numbers[1] == _RESERVED_TIMING:
            raise GatewayRefusal(SYNTAX)
        return LssOrder(verb, tuple(numbers))

    def _log(self, line: _Line, _verb: str) -> GatewayRequest:
        line.end()
        return LogOrder()

    def _help(self, line: _Line, _verb: str) -> bytes:
        text = HELP.get(b"" if line.closed else line.last().lower())
        if text is None:
            raise GatewayRefusal(SYNTAX)
        return text.encode() + _END

    def _led(self, line: _Line, _verb: str) -> bytes:
        line.end()
        return _LEDS

    _VERBS: ClassVar[dict[str, Callable[[GatewayDialect, _Line, str], GatewayRequest | bytes]]] = {
        **dict.fromkeys(("r", "read"), _read),
        **dict.fromkeys(("w", "write"), _write),
        **dict.fromkeys(("start", "stop", "preop", "preoperational"), _nmt),
        "reset": _reset,
        "set": _set,
        "log": _log,
        "help": _help,
        "led": _led,
        **dict.fromkeys(_LSS, _lss),
    }

    # -- answers, to be sent in one piece each, because cocomm expects a whole answer from one read

    def ok(self) -> bytes:
        """Return the response to a successful command without a value."""
        return self.text("OK")

    def text(self, text: str) -> bytes:
        """Return a response with the sequence number of the command."""
        signed = self.sequence - (1 << 32) if self.sequence >> 31 else self.sequence  # CANopenNode prints PRId32
        return f"[{signed}] {text}".encode("utf-8", "surrogateescape") + _END

    def value(self, type_name: str, data: bytes) -> bytes:
        """Return the response to a successful upload."""
        return self.text(shown_value(type_name, data))

    def abort(self, code: int) -> bytes:
        """Return the response to an aborted SDO transfer."""
        meaning = _ABORTS.get(code) or abort_text(code)
        return self.text(f"ERROR:0x{code:08X} #{meaning[:1].upper()}{meaning[1:]}.")

    def error(self, refusal: GatewayRefusal) -> bytes:
        """Return the response to a refused command."""
        reason = " ".join(refusal.reason.split())
        return self.text(f"ERROR:{refusal.number} #{ERRORS[refusal.number]} {reason}".rstrip())

    @staticmethod
    def log(lines: list[str]) -> bytes:
        """Return the response to the `log` command, which has no sequence number."""
        return "\n".join(lines).encode("utf-8", "surrogateescape") + _END
