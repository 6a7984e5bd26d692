"""Gateway server: executes the commands of clients on a bus or a running robot, over stdio or a socket.

There is one client at a time, with one command at a time; other clients wait until it disconnects. Commands that may
move a drive are refused unless the gateway was started with permission. The robot's stop and supervision are not
affected, because they run in another process.
"""

from __future__ import annotations

import os
import re
import select
import socket
import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.cia301.lss import LssIdentity, LssMode, LssRefused
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState, state_of_byte
from canopen_control.errors import (
    BusClosed,
    BusOff,
    CanopenError,
    RemoteError,
    RemoteProtocolError,
    SdoAbort,
    SdoTimeout,
    UnknownName,
)
from canopen_control.frame import MAX_NODE_ID
from canopen_control.gateway import dialect as cia309
from canopen_control.gateway.dialect import (
    GatewayDialect,
    GatewayRefusal,
    LogOrder,
    LssOrder,
    NmtOrder,
    ReadOrder,
    WriteOrder,
)
from canopen_control.host.sockets import same_user

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.cia301.lss import LssMaster, LssRequest, LssResult
    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.frame import CanFrame
    from canopen_control.gateway.dialect import GatewayRequest


ALLOW_MOTION: Final = "--allow-motion"
_CHUNK: Final = 1 << 16
_SEND_S: Final = 5.0  # until a client that does not read is disconnected
_LOG_LINES: Final = 200

#: indices to which a write may move a drive, or disable its supervision (CiA 301, 7.5.2; CiA 302; CiA 402)
_MOVING: Final = (
    range(0x1005, 0x1008),  # SYNC: set-points are applied with it
    range(0x100C, 0x100E),  # node guarding: a drive stops when the master is lost
    range(0x1011, 0x1012),  # restore defaults: other parameters after the next reset
    range(0x1016, 0x1017),  # consumer heartbeat time, likewise
    range(0x1029, 0x102A),  # error behaviour
    range(0x1400, 0x1C00),  # PDO parameters: the sources of set-points
    range(0x1F51, 0x1F52),  # program control: starts a program
    range(0x6000, 0xA000),  # device profiles: CiA 402 and the outputs of CiA 401
)
_LSS_CHANGES: Final = frozenset(
    {"lss_set_node", "lss_conf_bitrate", "lss_activate_bitrate", "lss_store", "lss_allnodes"}
)
_ABORT_IN_TEXT: Final = re.compile(r"abort 0x([0-9A-F]{8})")  # the wording of `SdoAbort`
_SILENT: Final = frozenset({"SdoTimeout", "SdoStopped", "Timeout"})  # kinds of errors of a robot
_HTTP: Final = re.compile(rb"\A[A-Z]+ \S+ HTTP/\d")


class GatewayNetwork(Protocol):
    """Bus or running robot on which the gateway executes commands; every method may raise CanopenError."""

    def fileno(self) -> int:
        """Return the file descriptor that becomes readable when `take_in` must be called."""

    def take_in(self) -> None:
        """Read and handle received data; raise RemoteError or BusError if the robot or the bus is lost."""

    def read(self, node_id: int, index: int, subindex: int, *, block: bool, timeout_s: float) -> bytes:
        """Read an object of a node by SDO upload."""

    def write(self, node_id: int, index: int, subindex: int, data: bytes, *, block: bool, timeout_s: float) -> None:
        """Write data to an object of a node by SDO download."""

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command to a node; node-ID 0 addresses all nodes."""

    def lss(self, ask: Callable[[LssMaster], LssRequest], scan_s: float | None = None) -> LssResult:
        """Run an LSS service and return its result; `scan_s` is the time in s to wait for each Fastscan response."""

    def log(self) -> list[str]:
        """Return the events since the last call, one line each."""


class BusLog:
    """Log of the boot-ups, EMCY messages and NMT state changes on a bus, as lines of text."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=_LOG_LINES)
        self._states: dict[int, NmtState | None] = {}

    def receive(self, frame: CanFrame, _now: int) -> None:
        """Log the boot-up, NMT state change or EMCY message in a frame; ignore all other frames."""
        node_id = frame.can_id - ERROR_CONTROL_COB_ID
        if 1 <= node_id <= MAX_NODE_ID and len(frame.data) == 1:
            state = state_of_byte(frame.data[0])
            if state is not self._states.get(node_id) and state is not None:
                name = "boot-up" if state is NmtState.INITIALISING else state.name.replace("_", " ")
                self.add(f"node {node_id}: {name}")
            self._states[node_id] = state
        elif (message := EmcyMessage.parse(frame)) is not None:
            self.add(f"node {message.node_id}: EMCY {message}")

    def add(self, text: str) -> None:
        self._lines.append(f"{time.strftime('%H:%M:%S')} {' '.join(text.split())}")

    def take(self) -> list[str]:
        lines = list(self._lines)
        self._lines.clear()
        return lines


def motion_reason(request: GatewayRequest) -> str:
    """Return why a request needs --allow-motion, or "" for a request that is always permitted."""
    advice = f"start the gateway with {ALLOW_MOTION} to allow it"
    if isinstance(request, NmtOrder):
        return f"NMT commands start and stop drives; {advice}"
    if isinstance(request, LssOrder) and request.verb in _LSS_CHANGES:
        return f"{request.verb} changes the network settings of nodes; {advice}"
    if isinstance(request, WriteOrder) and any(request.index in moving for moving in _MOVING):
        return f"Writing 0x{request.index:04X}:{request.subindex:02X} may move a drive or end its supervision; {advice}"
    return ""


class _LssConsole:
    """Executor of LSS commands, which tracks the configuration state of slaves like CANopenNode's master."""

    def __init__(self, network: GatewayNetwork) -> None:
        self._network = network
        self._configuring = False

    def answer(self, order: LssOrder) -> list[str]:
        """Run an LSS service and return the lines of the response, without the sequence number."""
        verb, numbers = order
        if verb == "lss_switch_glob" and not numbers[0]:
            return self._leave()
        enters = verb in ("lss_switch_glob", "lss_switch_sel", "_lss_fastscan", "lss_allnodes")
        if enters is self._configuring:
            busy = "A slave is already in configuration state; send lss_switch_glob 0 first"
            raise GatewayRefusal(
                cia309.INTERNAL_STATE,
                busy
                if enters
                else "No slave is in configuration state; send lss_switch_sel or lss_switch_glob 1 first",
            )
        if verb == "lss_allnodes":
            return self._all_nodes(*numbers)
        if verb == "_lss_fastscan":
            identity = self._scan(numbers[0] if numbers else 0)
            if identity is None:
                raise GatewayRefusal(cia309.TIME_OUT)
            self._configuring = True
            return [_words(identity)]
        return [self._one(verb, numbers)]

    def _leave(self) -> list[str]:
        self._network.lss(lambda master: master.switch_global(LssMode.WAITING))
        self._configuring = False
        return ["OK"]

    def _one(self, verb: str, numbers: tuple[int, ...]) -> str:
        ask = self._network.lss
        if verb == "lss_switch_glob":
            ask(lambda master: master.switch_global(LssMode.CONFIGURATION))
            self._configuring = True
        elif verb == "lss_switch_sel":
            _checked(cia309.TIME_OUT, lambda: ask(lambda master: master.switch_selective(LssIdentity(*numbers))))
            self._configuring = True
        elif verb == "lss_set_node":
            _checked(cia309.LSS_NODE_ID, lambda: ask(lambda master: master.configure_node_id(numbers[0])))
        elif verb == "lss_conf_bitrate":
            _checked(cia309.LSS_BITRATE, lambda: ask(lambda master: master.configure_bit_timing(numbers[1])))
        elif verb == "lss_activate_bitrate":
            ask(lambda master: master.activate_bit_timing(numbers[0]))
        elif verb == "lss_store":
            _checked(cia309.LSS_STORE, lambda: ask(lambda master: master.store()))
        elif verb == "lss_get_node":
            return f"0x{self._inquired('node_id'):02X}"
        else:  # lss_inquire_addr
            parts = [LssIdentity._fields[numbers[0]]] if numbers else LssIdentity._fields
            return " ".join(f"0x{self._inquired(part):08X}" for part in parts)
        return "OK"

    def _inquired(self, part: str) -> int:
        value = _checked(cia309.TIME_OUT, lambda: self._network.lss(lambda master: master.inquire(part)))
        assert isinstance(value, int)
        return value

    def _scan(self, step_ms: int = 0, known: tuple[int | None, ...] = (None,) * 4) -> LssIdentity | None:
        parts = dict(zip(LssIdentity._fields, known, strict=True))
        step_s = (step_ms or cia309.DEFAULT_SCAN_MS) / 1e3
        identity = _checked(
            cia309.TIME_OUT, lambda: self._network.lss(lambda master: master.fast_scan(**parts), scan_s=step_s)
        )
        assert identity is None or isinstance(identity, LssIdentity)
        return identity

    def _all_nodes(self, step_ms: int = 0, first: int = 2, store: int = 1, *scan: int) -> list[str]:
        types, values = scan[::2], scan[1::2]
        match = 2
        known = tuple(value if kind == match else None for kind, value in zip(types, values, strict=True))
        lines: list[str] = []
        for node_id in range(first, MAX_NODE_ID + 1):
            identity = self._scan(step_ms, known or (None,) * 4)
            if identity is None:
                return [*lines, f"# Found {len(lines)} nodes, search finished.", "OK"]
            try:
                self._one("lss_set_node", (node_id,))
                if store:
                    self._one("lss_store", ())
            finally:
                self._leave()  # Fastscan has switched the slave to configuration state (CiA 305)
            lines.append(f"# Node-ID {node_id} assigned to: {_words(identity)}")
        return [*lines, "# Not all nodes scanned!", "OK"]


def _words(identity: LssIdentity) -> str:
    return " ".join(f"0x{part:08X}" for part in identity)


def _checked(refused: int, ask: Callable[[], LssResult]) -> LssResult:
    """Run an LSS service and turn errors into GatewayRefusal; `refused` is the gateway error for LSS error 1."""
    try:
        return ask()
    except LssRefused as refusal:
        numbers = {1: refused, 2: cia309.LSS_MEDIA}
        raise GatewayRefusal(numbers.get(refusal.code, cia309.LSS_MANUFACTURER)) from None
    except RemoteProtocolError:
        raise GatewayRefusal(cia309.TIME_OUT) from None


class GatewayService:
    """Gateway server for one client at a time; without `allow_motion`, commands that may move a drive are refused."""

    def __init__(self, network: GatewayNetwork, *, allow_motion: bool = False) -> None:
        self.network, self.allow_motion = network, allow_motion
        self._lss = _LssConsole(network)

    def answers(self, client: GatewayDialect, data: bytes) -> Iterator[bytes]:
        """Yield the responses to a client's input; raise RemoteError or BusClosed if the robot or the bus is lost."""
        client.receive(data)
        while (event := client.next_event()) is not None:
            yield event if isinstance(event, bytes) else self._answer(client, event)

    def _answer(self, client: GatewayDialect, request: GatewayRequest) -> bytes:
        reason = "" if self.allow_motion else motion_reason(request)
        if reason:
            return client.error(GatewayRefusal(cia309.INTERNAL_STATE, reason))
        try:
            return self._carried_out(client, request)
        except GatewayRefusal as refusal:
            return client.error(refusal)
        except CanopenError as error:
            code = _abort_of(error)
            return client.error(_refusal_of(error)) if code is None else client.abort(code)

    def _carried_out(self, client: GatewayDialect, request: GatewayRequest) -> bytes:
        timeout_s = client.timeout_ms / 1e3
        if isinstance(request, ReadOrder):
            address = request.node_id, request.index, request.subindex
            data = self.network.read(*address, block=client.block, timeout_s=timeout_s)
            return client.value(request.type_name, data)
        if isinstance(request, LogOrder):
            return client.log(self.network.log())
        if isinstance(request, LssOrder):
            *comments, last = self._lss.answer(request)
            return "".join(f"{line}\n" for line in comments).encode() + client.text(last)
        if isinstance(request, WriteOrder):
            address = request.node_id, request.index, request.subindex
            self.network.write(*address, request.data, block=client.block, timeout_s=timeout_s)
        else:
            self.network.nmt(request.command, request.node_id)
        return client.ok()

    # -- transports

    def serve_stdio(self) -> bool:
        """Serve standard input until end of file; return False if the input ends within a line."""
        client = GatewayDialect(optional_sequence=True)
        source, sink = sys.stdin.fileno(), sys.stdout.buffer
        poll = self._poll_with(source)
        while True:
            if not self._ready(poll, source):
                continue
            data = os.read(source, _CHUNK)
            if not data:
                return not client.unfinished
            for answer in self.answers(client, data):
                sink.write(answer)
                sink.flush()

    def serve_listener(self, listener: socket.socket) -> None:
        """Serve the clients of a listening socket one after the other, until the robot or the bus is lost."""
        poll = self._poll_with(listener.fileno())
        while True:
            if not self._ready(poll, listener.fileno()):
                continue
            try:
                sock, _ = listener.accept()
            except (BlockingIOError, ConnectionAbortedError):
                continue
            with sock:
                if sock.family != socket.AF_UNIX or same_user(sock):
                    self._serve_client(sock)

    def _serve_client(self, sock: socket.socket) -> None:
        sock.settimeout(_SEND_S)
        client = GatewayDialect()
        poll = self._poll_with(sock.fileno())
        has_received = False
        while True:
            if not self._ready(poll, sock.fileno()):
                continue
            try:
                data = sock.recv(_CHUNK)
                # HTTP: any page in the user's browser can send requests to a port of this host
                if not data or (not has_received and _HTTP.match(data)):
                    return
                has_received = True
                for answer in self.answers(client, data):
                    sock.sendall(answer)
            except OSError:
                return  # the client has disconnected, or does not read

    def _poll_with(self, descriptor: int) -> select.poll:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        poll.register(self.network.fileno(), select.POLLIN)
        return poll

    def _ready(self, poll: select.poll, descriptor: int) -> bool:
        """Wait for data from the client or the network, and handle network data; return whether the client has data."""
        ready = {number for number, _ in poll.poll()}
        self.network.take_in()
        return descriptor in ready


def _abort_of(error: CanopenError) -> int | None:
    """Return the SDO abort code for an error, or None for an error without an abort code."""
    if isinstance(error, SdoAbort):
        return error.code
    if isinstance(error, SdoTimeout) or (isinstance(error, RemoteError) and error.kind in _SILENT):
        return AbortCode.TIMED_OUT
    if isinstance(error, RemoteError) and error.kind == SdoAbort.__name__:
        code = _ABORT_IN_TEXT.search(str(error))
        return int(code[1], 16) if code is not None else AbortCode.GENERAL_ERROR
    return None


def _refusal_of(error: CanopenError) -> GatewayRefusal:
    """Convert an error to an error response of CiA 309-3; re-raise it if the robot or the bus is lost."""
    kind = error.kind if isinstance(error, RemoteError) else type(error).__name__
    if kind == BusClosed.__name__:
        raise error
    numbers = {UnknownName.__name__: cia309.UNSUPPORTED_NODE, BusOff.__name__: cia309.BUS_OFF}
    return GatewayRefusal(numbers.get(kind, cia309.INTERNAL_STATE), str(error))
