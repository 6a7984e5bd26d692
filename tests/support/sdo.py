"""A store, a perfect wire and a bad one between an SDO client and an SDO server, on a manual clock."""

from __future__ import annotations

import random
from collections import deque
from typing import TYPE_CHECKING

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_exchange import SdoOptions
from canopen_control.cia301.sdo_server import SdoServer, SdoServerAbort
from canopen_control.errors import SdoAbort
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import SdoRequest

NODE = 3
MS = 1_000_000
SECOND = 1_000_000_000
IDENTIFIERS = {">": 0x603, "<": 0x583}


def frame(text: str) -> CanFrame:
    """Make a frame of candump's log form."""
    identifier, data = text.split("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data))


def conversations(text: str) -> dict[str, str]:
    """Read conversations of a client and a server: a name, and the words of `play_client` or `play_server` below it."""
    result: dict[str, str] = {}
    for line in text.strip().splitlines():
        if not line.startswith(" "):
            result[line] = ""
        else:
            result[next(reversed(result))] += line
    return result


def _options(text: str) -> tuple[dict[str, int], list[str]]:
    """Split NAME=NUMBER off the words that follow."""
    words, options = text.split(), {}
    while "=" in words[0]:
        name, _, number = words.pop(0).partition("=")
        options[name] = int(number)
    return options, words


def _frame(side: str, digits: str) -> CanFrame:
    """Make a frame of eight bytes; zeros at its end are not written down."""
    return CanFrame(IDENTIFIERS[side], bytes.fromhex(digits).ljust(8, b"\0"))


def _play(core: SdoClient | SdoServer, words: list[str], sends: str) -> list[str]:
    """Let a core hear and say what it is to, frame for frame, and return the words behind `=`.

    `>` is a frame of the client and `<` one of the server; `!` behind it says that it is ignored. `+500` is 500 ms.
    What the core sends leaves only where it stands, and no time passes before.
    """
    now, sent = 0, []
    while words and (word := words.pop(0)) != "=":
        if word == sends:
            sent = sent or core.frames()
            assert sent
            assert sent.pop(0) == _frame(sends, words.pop(0))
            continue
        assert sent == []
        ignored = core.ignored
        if word.startswith("+"):
            assert core.frames() == []
            now += int(word) * MS
            core.tick(now)
        else:
            core.receive(_frame(word[0], words.pop(0)), now)
        assert core.ignored == ignored + word.endswith("!")
    assert (sent, core.frames()) == ([], [])
    return words


def play_client(text: str) -> None:
    """Play a conversation with a client of these options, behind `=` its end: the bytes, `written`, an error or `open`.

    #20 are the 20 bytes from 0 to 19.
    """
    options, (verb, address, *words) = _options(text)
    index, _, subindex = address.partition(":")
    tries = {name: options.pop(name) for name in ("retries",) if name in options}
    switches = {name: bool(options[name]) for name in ("crc", "announce_size") if name in options}  # 0 or 1 in the text
    client = SdoClient(NODE, options=SdoOptions(**options | switches), **tries)
    place, block = (int(index, 16), int(subindex or "0", 16)), {"block": True} if "block" in verb else {}
    if verb.endswith("write"):
        data = words.pop(0)
        value = bytes(range(int(data[1:]))) if data.startswith("#") else bytes.fromhex(data)
        request = client.write(*place, value, **block, now=0)
    else:
        request = client.read(*place, **block, now=0)
    end = _play(client, words, ">")
    if not request.done:
        ended = ["open"]
    elif isinstance(request.error, SdoAbort):
        ended = ["abort", f"{request.error.code:08X}"]
    elif request.error is not None:
        ended = [type(request.error).__name__]
    else:
        ended = ["written" if verb.endswith("write") else request.data.hex().upper() or "empty"]
    assert end == ended


def play_server(text: str) -> None:
    """Play a conversation with a server of these options, behind `=` what 0x2008 holds then if it was written.

    2007=20 makes 0x2007 the 20 bytes from 0 to 19; size=4 is the size of 0x2008.
    """
    options, words = _options(text)
    length = options.pop("2007", 0)
    store = MemoryStore({(0x2007, 0): bytes(range(length)) or b"0123456789", (0x2008, 0): b"old"})
    if "size" in options:
        store.sizes[0x2008, 0] = options.pop("size")
    if "timeout_ms" in options:
        options["timeout_ns"] = options.pop("timeout_ms") * MS
    server = SdoServer(NODE, store, **options)
    aborted = words[-2:-1] == ["<"] and words[-1].startswith("80")
    assert _play(server, words, "<") == [data.hex().upper() for *_, data in store.downloads]
    assert not aborted or server.next_deadline() is None


class MemoryStore:
    """Objects as bytes; `aborts` maps (index, subindex) to the code that every access gets."""

    def __init__(self, objects: dict[tuple[int, int], bytes] | None = None) -> None:
        self.objects = {(0x1000, 0): b"\x92\x01\x04\x00", (0x1001, 0): b"\0"} | (objects or {})
        self.aborts: dict[tuple[int, int], int] = {}
        self.sizes: dict[tuple[int, int], int] = {}
        self.uploads = 0
        self.downloads: list[tuple[int, int, bytes]] = []

    def upload(self, index: int, subindex: int) -> bytes:
        self._check(index, subindex)
        self.uploads += 1
        return self.objects[index, subindex]

    def download(self, index: int, subindex: int, data: bytes) -> None:
        self._check(index, subindex)
        size = self.sizes.get((index, subindex))
        if size is not None and len(data) != size:
            raise SdoServerAbort(0x06070012 if len(data) > size else 0x06070013)
        self.downloads.append((index, subindex, data))
        self.objects[index, subindex] = data

    def size_of(self, index: int, subindex: int) -> int | None:
        self._check(index, subindex)
        return self.sizes.get((index, subindex))

    def _check(self, index: int, subindex: int) -> None:
        code = self.aborts.get((index, subindex))
        if code is None and (index, subindex) not in self.objects:
            code = 0x06020000
        if code is not None:
            raise SdoServerAbort(code)


class Line:
    """Client and server with nothing between them; keeps what was said."""

    def __init__(self, client: SdoClient, server: SdoServer) -> None:
        self.client, self.server = client, server
        self.now = 0
        self.said: list[str] = []

    def run(self) -> None:
        """Carry frames until both are silent."""
        silent = False
        while not silent:
            silent = True
            for side, other in ((self.client, self.server), (self.server, self.client)):
                for one in side.frames():
                    silent = False
                    self.said.append(str(one))
                    other.receive(one, self.now)


class BadLine:
    """Frames get lost, doubled and late; those of one direction keep their order, as on a CAN bus."""

    def __init__(
        self,
        client: SdoClient,
        server: SdoServer,
        seed: int,
        *,
        loss: float = 0.0,
        double: float = 0.0,
        late: float = 0.0,
    ) -> None:
        self.client, self.server = client, server
        self.random = random.Random(seed)
        self.loss, self.double, self.late = loss, double, late
        self.now = 1
        self._ways: tuple[deque[tuple[int, CanFrame]], deque[tuple[int, CanFrame]]] = (deque(), deque())

    def run(self, request: SdoRequest, limit_ns: int = 3600 * SECOND) -> None:
        """Let time pass until `request` is done."""
        end = self.now + limit_ns
        self._drain()
        while not request.done:
            self.step()
            assert self.now < end, "the request never ends"

    def step(self) -> None:
        """Jump to the next thing that happens."""
        times = [way[0][0] for way in self._ways if way]
        times += [t for core in (self.client, self.server) if (t := core.next_deadline()) is not None]
        self.now = max(self.now, min(times))
        for way, core in zip(self._ways, (self.server, self.client), strict=True):
            while way and way[0][0] <= self.now:
                core.receive(way.popleft()[1], self.now)
        self.client.tick(self.now)
        self.server.tick(self.now)
        self._drain()

    def _drain(self) -> None:
        for way, core in zip(self._ways, (self.client, self.server), strict=True):
            for one in core.frames():
                self._put(way, one)

    def _put(self, way: deque[tuple[int, CanFrame]], one: CanFrame) -> None:
        if self.random.random() < self.loss:
            return
        delay = self.random.randrange(900 * MS) if self.random.random() < self.late else 100_000
        arrival = max(self.now + delay, way[-1][0] if way else 0)
        way.append((arrival, one))
        if self.random.random() < self.double:
            way.append((arrival, one))
