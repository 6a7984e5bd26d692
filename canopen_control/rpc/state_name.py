"""Display names of states, in a module without slow imports."""

from __future__ import annotations


def state_name(state: str | None) -> str:
    """Return the name of a CiA 402 or NMT state as in the standard, with spaces; "-" for None."""
    return "-" if state is None else state.replace("_", " ")
