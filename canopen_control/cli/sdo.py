"""Read and write objects of a node, and transfer files.

The node belongs to a running robot (name or node-ID in bus.yml); with --can it is any node of a bare bus (node-ID). The
object is INDEX[:SUB] in hexadecimal, or its name in the EDS. The running robot uses the EDS of each node; --eds gives
another one. `read` explains a value as `trace` does, and reads every subindex if you give an index only.

Exit codes: 0 success; 1 the node aborted or did not answer; 2 wrong usage.
"""

from __future__ import annotations

import contextlib
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import one_name, timeout_seconds
from canopen_control.cli.support.output import REDRAW_S, Progress, json_text, print_result
from canopen_control.cli.support.target import add_target_arguments, names_file, open_target, refuse_as_node
from canopen_control.client.robot_client import periodic_call
from canopen_control.commissioning.node_session import is_abort
from canopen_control.commissioning.object_rows import TYPE_NAMES, parse_type, parse_value, show
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.files import write_whole
from canopen_control.od.address import find_object, parts_of
from canopen_control.od.codec import decode
from canopen_control.od.eds import SUFFIXES
from canopen_control.rpc.messages.declare import Document
from canopen_control.trace.network_description import NodeDescription
from canopen_control.trace.values import NodeWords, decoded

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.address import ObjectAddress
    from canopen_control.od.model import DataType


EXAMPLE = """canopen-control sdo read left_drive 0x6041
         canopen-control sdo write 3 "Profile velocity" 1600
         canopen-control sdo write 3 0x60FF -500 --can can0 --type i32
         canopen-control sdo upload 5 0x1021 device.eds --can can0
         canopen-control sdo download 5 0x1F50:1 program.bin --can can0"""


_IN_BRACKETS = re.compile(r"-?\d* ?\((.*)\)")
STREAM = "-"  # instead of FILE: standard input or output


class ObjectDocument(Document, frozen=True, kw_only=True):
    """Object in `sdo read --json`; `data` and a `value` of bytes are hexadecimal, unknown fields are null."""

    node_id: int
    node: str | None
    index: int
    subindex: int
    name: str | None
    type: str | None
    value: int | float | str | None
    data: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    read = actions.add_parser("read", help="read an object")
    write = actions.add_parser("write", help="write an object")
    upload = actions.add_parser("upload", help="read an object into a file, by block transfer if the node supports it")
    download = actions.add_parser("download", help="write a file into an object, by block transfer if it is large")
    for action in (read, write, upload, download):
        action.add_argument("node", type=one_name, metavar="NODE", help="name or node-ID; on a bare bus the node-ID")
        action.add_argument("object", metavar="INDEX[:SUB]", help="address in hexadecimal, or a name in the EDS")
    write.add_argument("value", metavar="VALUE", help="by type: a decimal or 0x number, a text, or hexadecimal bytes")
    for action in (upload, download):
        action.add_argument("file", metavar="FILE", help="a path, or - for standard input or output")
    for action in (read, write):
        action.add_argument("--type", metavar="T", help=f"data type, instead of the type in the EDS: {TYPE_NAMES}")
    for action in (read, write, upload, download):
        action.add_argument("--eds", metavar="FILE", help="EDS of the node: a path, or the name of a bundled file")
        action.add_argument(
            "--timeout",
            type=timeout_seconds,
            metavar="S",
            help="timeout of each answer in s (default: 0.5, or the value in bus.yml)",
        )
        add_target_arguments(action)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    refuse_as_node(args, args.node, _right_order(args), instead=_shown_in_file(args))
    with open_target(args) as target:
        node = target.session(args.node)
        address = find_object(args.object, node.od)
        if args.action == "read":
            return _read(args, node, parts_of(address, node.od))
        _ACTIONS[args.action](args, node, address)
    return 0


def _right_order(args: argparse.Namespace) -> str:
    """Return the command with its words in the right order; the user gave a file or an object as NODE."""
    last = getattr(args, "value", None) or getattr(args, "file", None)
    if not hasattr(args, "file") and any(map(names_file, (args.node, args.object))):  # read and write have no FILE
        return _without_file(args)
    words = [args.object, args.node, last]
    if names_file(args.node):  # FILE NODE INDEX:SUB
        words = [args.object, last or "INDEX:SUB", args.node]
    elif names_file(args.object):  # INDEX:SUB FILE NODE
        words = [last, args.node, args.object]
    return _line(["sdo", args.action, *(word for word in words if word)])


def _without_file(args: argparse.Namespace) -> str:
    """Return the command that reads or writes the object: the file can only be the EDS of the node."""
    file, other = (args.node, args.object) if names_file(args.node) else (args.object, args.node)
    value = [args.value] if args.action == "write" else []
    eds = ["--eds", file] if args.eds is None and Path(file).suffix.lower() in SUFFIXES else []
    return _line(["sdo", args.action, "NODE", other, *value, *eds])


def _shown_in_file(args: argparse.Namespace) -> str:
    """Return the command that shows the object in the file given as NODE, or "" if that is not meant."""
    is_eds = args.action == "read" and Path(args.node).suffix.lower() in SUFFIXES
    return _line(["eds", "show", args.node, args.object]) if is_eds else ""


def _line(words: Iterable[str]) -> str:
    return " ".join(f"'{word}'" if " " in word else word for word in words)


def _type_of(args: argparse.Namespace, address: ObjectAddress) -> DataType | None:
    if args.type is not None:
        return parse_type(args.type)
    return address.entry.data_type if address.entry is not None else None


def _read(args: argparse.Namespace, node: NodeSession, parts: list[ObjectAddress]) -> int:
    """Read and print an object or all its subindices; return 1 if the node refused all of them, else 0."""
    words = NodeWords(NodeDescription(node.name, node.node_id, node.od))
    documents = []
    for address in parts:
        try:
            data = node.read(address.index, address.subindex)
        except CanopenError as error:
            if len(parts) == 1 or not is_abort(error):
                raise
            print(f"canopen-control: {error}", file=sys.stderr)
            continue
        data_type = _fitting(data, _type_of(args, address), node, address)
        documents.append(_document(data, data_type, node, address))
        if not args.json:
            print(f"{node}: {address.label}: {_in_words(data, data_type, address, words)}")
    if args.json:
        print(json_text(documents if len(parts) > 1 else documents[0]))
    return 0 if documents else 1


def _in_words(data: bytes, data_type: DataType | None, address: ObjectAddress, words: NodeWords) -> str:
    """Return a value with its meaning, such as `592 (0x0250): SWITCH ON DISABLED`."""
    shown, value = show(data, data_type), decoded(data, data_type)
    if not isinstance(value, int):
        return shown
    text = words.text(address.index, address.subindex, value)
    meaning = text.removeprefix(f"0x{data[::-1].hex().upper()}").strip()
    if (brackets := _IN_BRACKETS.fullmatch(meaning)) is not None:
        meaning = brackets[1]
    return f"{shown}: {meaning}" if meaning not in ("", str(value)) else shown


def _fitting(data: bytes, data_type: DataType | None, node: NodeSession, address: ObjectAddress) -> DataType | None:
    """Return the data type; None, with a printed note, if the data does not fit it."""
    if data_type is None:
        return None
    try:
        decode(data, data_type)
    except ValueError as error:
        print(f"canopen-control: {node}: {address.label}: {error}; shown without a type", file=sys.stderr)
        return None
    return data_type


def _document(data: bytes, data_type: DataType | None, node: NodeSession, address: ObjectAddress) -> ObjectDocument:
    value = None if data_type is None else decode(data, data_type)
    return ObjectDocument(
        node_id=node.node_id,
        node=node.name or None,
        index=address.index,
        subindex=address.subindex,
        name=address.entry.name if address.entry is not None else None,
        type=None if data_type is None else data_type.name,
        value=value.hex() if isinstance(value, bytes) else value,
        data=data.hex(),
    )


def _write(args: argparse.Namespace, node: NodeSession, address: ObjectAddress) -> None:
    data_type = _type_of(args, address)
    if data_type is None:
        reason = "it is not in the EDS" if node.od is not None else "its EDS is missing"
        raise ConfigError(f"0x{address.index:04X}:{address.subindex:02X}: {reason}; give its type, as in --type u32")
    data = parse_value(args.value, data_type)
    node.write(address.index, address.subindex, data)
    text = f"{node}: {address.label}: written {show(data, data_type)}"
    print_result(args, _document(data, data_type, node, address), text)


def _upload(args: argparse.Namespace, node: NodeSession, address: ObjectAddress) -> None:
    path = None if args.file == STREAM else Path(args.file).expanduser()
    if path is None and args.json:
        raise ConfigError("--json prints a summary, but standard output carries the data; give a FILE")
    if path is not None and not path.parent.is_dir():
        raise ConfigError(f"no folder {path.parent} for {args.file}")
    with _transfer_progress(f"reading {node}: {address.label}", node):
        data = node.read(address.index, address.subindex, block=True)
    if path is None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
        return
    write_whole(path, data)
    _print_transfer(args, node, address, f"{len(data)} bytes to {args.file}", len(data))


def _download(args: argparse.Namespace, node: NodeSession, address: ObjectAddress) -> None:
    try:
        data = sys.stdin.buffer.read() if args.file == STREAM else Path(args.file).expanduser().read_bytes()
    except OSError as error:
        raise ConfigError(f"{args.file} cannot be read: {error.strerror}") from None
    with _transfer_progress(f"writing {node}: {address.label}", node):
        node.write(address.index, address.subindex, data)
    _print_transfer(args, node, address, f"{len(data)} bytes from {args.file}", len(data))


def _print_transfer(
    args: argparse.Namespace, node: NodeSession, address: ObjectAddress, text: str, length: int
) -> None:
    place = {"node_id": node.node_id, "index": address.index, "subindex": address.subindex}
    print_result(args, {**place, "file": args.file, "bytes": length}, f"{node}: {address.label}: {text}")


@contextlib.contextmanager
def _transfer_progress(title: str, node: NodeSession) -> Iterator[None]:
    """Context that prints the progress of a transfer."""
    with (
        Progress(title, "bytes") as progress,
        periodic_call(lambda: progress.at(*node.transfers.progress()), REDRAW_S / 2, name="progress"),
    ):
        yield


_ACTIONS: dict[str, Callable[[argparse.Namespace, NodeSession, ObjectAddress], None]] = {
    "write": _write,
    "upload": _upload,
    "download": _download,
}
