"""Name of a state for people, in a module that a verb imports in no time."""

from __future__ import annotations


def state_name(state: str | None) -> str:
    """Return the name of a state (of CiA 402 or NMT) as the standard writes it, "-" for none."""
    return "-" if state is None else state.replace("_", " ")
