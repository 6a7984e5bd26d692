"""Compare the parameters of two nodes, two DCF files, or a file with a node.

When comparing a file with a node, only the objects in the file are read; no EDS is needed, since the file is a complete
DCF. COB-IDs that follow the node id are compared without it. Differences in product, revision or software version are
printed to standard error and do not count as parameter differences.

Exit codes, as those of diff: 0 equal; 1 different, or a node did not answer; 2 wrong usage.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import add_session_arguments, sides
from canopen_control.cli.support.output import Table, json_text
from canopen_control.commissioning.parameter_set import differences
from canopen_control.rpc.messages.declare import Document

if TYPE_CHECKING:
    import argparse

    from canopen_control.cli.support.open_session import Side
    from canopen_control.commissioning.parameter_set import ParameterDifference


EXAMPLE = """canopen-control diff left_drive right_drive
         canopen-control diff node3.dcf 3 --can can0"""


class ParameterDocument(Document, frozen=True, kw_only=True):
    """Different parameter in `diff --json`: values as in a DCF; null if one side lacks the object."""

    index: int
    subindex: int
    name: str
    a: str | None
    b: str | None


class DiffDocument(Document, frozen=True, kw_only=True):
    """Document of `diff --json`: number of compared parameters, differences of devices and of parameters."""

    a: str
    b: str
    compared: int
    identity: list[str]
    differences: list[ParameterDocument]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    for name in ("a", "b"):
        parser.add_argument(name, metavar="FILE|NODE", help="a DCF file, or a node by name or node id")
    add_session_arguments(parser, node=False)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    a, b = sides(args.a, args.b, args)
    changes = differences(a.parameters, b.parameters)
    identity = [
        *a.parameters.identity.strangers(b.parameters.identity),
        *a.parameters.identity.variations(b.parameters.identity),
    ]
    compared = len({*a.parameters.values, *b.parameters.values})
    if args.json:
        shown = [_document(change) for change in changes]
        print(json_text(DiffDocument(a=a.parameters.where, b=b.parameters.where, compared=compared, identity=identity,
                                     differences=shown)))  # fmt: skip
    else:
        _print(a, b, changes, identity, compared)
    return 1 if changes else 0


def _document(change: ParameterDifference) -> ParameterDocument:
    a, b = (
        text if value is not None else None for text, value in ((change.a_text, change.a), (change.b_text, change.b))
    )
    return ParameterDocument(index=change.entry.index, subindex=change.entry.subindex, name=change.name, a=a, b=b)


def _print(a: Side, b: Side, changes: list[ParameterDifference], identity: list[str], compared: int) -> None:
    for line in identity:
        print(f"canopen-control: {line}", file=sys.stderr)
    if not changes:
        print(f"{a.parameters.where} and {b.parameters.where}: {compared} parameters, equal")
        return
    refused = [{unread.entry.address: unread.why for unread in side.left_out} for side in (a, b)]
    table = Table(("object", "name", a.parameters.where, b.parameters.where))
    for difference in changes:
        texts = (difference.a_text, difference.b_text)
        shown = (text or why.get(difference.entry.address, "-") for text, why in zip(texts, refused, strict=True))
        table.add((f"0x{difference.entry.index:04X}:{difference.entry.subindex:02X}", difference.name, *shown))
    print("\n".join(table.lines()))
