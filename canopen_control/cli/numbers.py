"""Numbers of the command line, refused in words."""

from __future__ import annotations

import argparse

__all__ = ["node_id", "whole"]

_NODE_IDS = range(1, 128)


def whole(text: str) -> int:
    """Read a whole number, decimal or 0x."""
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number, decimal or 0x") from None


def node_id(text: str) -> int:
    """Read a node id, decimal or 0x."""
    try:
        number = int(text, 0)
    except ValueError:
        number = 0
    if number not in _NODE_IDS:
        raise argparse.ArgumentTypeError(f"{text!r} is no node id: 1 to 127")
    return number
