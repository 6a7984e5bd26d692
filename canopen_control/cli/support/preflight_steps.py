"""The steps of a pre-flight that only look: link, bit rate, who is there, EDS revisions, errors, limits.

The law of this file: nothing is written to a drive, and every step ends in a sentence with what it was judged by.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.can_interfaces import find_can_interface
from canopen_control.bus.channel import ChannelKind, parse_channel
from canopen_control.cli.support.identity import FIELDS, NAME, differences, identity_of, match_eds, read_known
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.master.direct import DirectBus
from canopen_control.od.codec import fitted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.config import BusConfig
    from canopen_control.od.model import ObjectDictionary

__all__ = ["Step", "link_steps", "node_steps"]

_ALL_NODES = range(1, 128)
_ANSWER_S = 0.2
_STATE: dict[tuple[int, int], str] = {
    (0x607D, 1): "lower position limit",
    (0x607D, 2): "upper position limit",
    (0x607F, 0): "greatest profile velocity",
    (0x6080, 0): "greatest motor speed",
    (0x6079, 0): "supply voltage",
}
_ERRORS: dict[tuple[int, int], str] = {(0x1001, 0): "error register", (0x603F, 0): "error code"}


@dataclass(frozen=True, slots=True)
class Step:
    """What a step came to; `passed` is None for what is only told."""

    name: str
    passed: bool | None
    text: str


# -- the link


def link_steps(channel: str, baudrate: int) -> list[Step]:
    """Compare state and bit rate of a channel to the bus.yml's (`baudrate`, kbit/s)."""
    spec = parse_channel(channel)
    if spec.kind is not ChannelKind.SOCKETCAN:
        return [Step("link", None, f"{channel}: no interface of the kernel, its bit rate cannot be looked at")]
    link = find_can_interface(spec.name)
    if link is None or not link.is_up:
        what = "is not there" if link is None else "is down"
        typed = f"canopen-control bus up {spec.name} --bitrate {baudrate * 1000}"
        return [Step("link", False, f"{channel} {what}; type: {typed}")]
    steps = [Step("link", link.state in (None, "ERROR-ACTIVE"), f"{channel} is up{_state_of(link.state)}")]
    if link.bitrate is None:
        return [*steps, Step("bit rate", None, f"{channel} is a {link.kind} interface and has none")]
    fits = link.bitrate == baudrate * 1000
    return [*steps, Step("bit rate", fits, f"{link.bitrate} bit/s, bus.yml says {baudrate * 1000}")]


def _state_of(state: str | None) -> str:
    return f" and {state}" if state else ""


# -- who is there


def node_steps(bus: BusConfig, channel: str) -> Iterator[Step]:
    """Ask all node ids who they are, compare to bus.yml and EDS files; read errors and limits of the robot's own."""
    with DirectBus.open(channel, label="pre-flight", timeout_s=_ANSWER_S, retries=1) as direct:
        answers = direct.read_many((node_id, 0x1000, 0) for node_id in _ALL_NODES)
        there = {node_id for (node_id, _, _), answer in answers.items() if not isinstance(answer, SdoTimeout)}
        for node in bus.nodes.values():
            if node.node_id in there:
                yield from _known_node(direct, bus, node.name, node.node_id)
            else:
                text = (
                    f"node {node.node_id} ({node.name}) does not answer; is it powered, its node id and bit rate set?"
                )
                yield Step("node", False, text)
        for node_id in sorted(there - {node.node_id for node in bus.nodes.values()}):
            yield Step("node", None, f"node {node_id} answers and is not in bus.yml")


def _known_node(direct: DirectBus, bus: BusConfig, name: str, node_id: int) -> Iterator[Step]:
    addresses = [*(address for address, _ in FIELDS.values()), NAME]
    answers = direct.read_many((node_id, *address) for address in addresses)
    identity = identity_of({(index, sub): answer for (_, index, sub), answer in answers.items()})
    title = f"node {node_id} ({name})"
    wrong = differences(identity, asdict(bus.plans[name].identity))
    who = f"{identity.device_name or 'a node without a name'}, serial number {identity.serial_number or 'none'}"
    yield Step("node", not wrong, f"{title}: {'; '.join(wrong) or who}")
    known, refused = read_known([bus.eds_paths[name]])
    eds, remark = match_eds(identity, known)
    if refused or not known:
        yield Step(
            "EDS", None, f"{title}: {bus.eds_paths[name].name} names no product, so that nothing can be compared"
        )
    elif eds is None:
        yield Step("EDS", False, f"{title}: {bus.eds_paths[name].name} is for another product")
    else:
        yield Step(
            "EDS", None if remark else True, f"{title}: {eds.path.name}{_remark(remark, identity.revision_number)}"
        )
    yield from _readings(direct, bus.dictionaries[name], node_id, title)


def _remark(remark: str, revision: int | None) -> str:
    return f" {remark}, the drive has 0x{revision or 0:08X}" if remark else " and revision fit"


def _readings(direct: DirectBus, od: ObjectDictionary, node_id: int, title: str) -> Iterator[Step]:
    """Read what tells of errors, which must be none, and of limits, which are only told."""
    wanted = [address for address in (*_ERRORS, *_STATE) if address in od]
    values: dict[tuple[int, int], int] = {}
    for address in wanted:
        try:
            data = direct.read(node_id, *address)
        except SdoAbort:
            continue
        entry = od[address]
        if (whole := fitted(data, entry.data_type)) is None:
            where = f"0x{address[0]:04X}:{address[1]:02X} {entry.name}"
            yield Step("EDS", False, f"{title}: {where} answered {len(data)} bytes, which is no {entry.data_type.name}")
            continue
        values[address] = int.from_bytes(whole, "little", signed=entry.data_type.signed)
    errors = {_ERRORS[address]: value for address, value in values.items() if address in _ERRORS}
    told = ", ".join(f"{name} 0x{value:02X}" for name, value in errors.items())
    yield Step("errors", not any(errors.values()), f"{title}: {told or 'tells of none'}")
    limits = ", ".join(f"{_STATE[address]} {value}" for address, value in values.items() if address in _STATE)
    if limits:
        yield Step("limits", None, f"{title}: {limits} (device units)")
