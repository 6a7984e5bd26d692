"""Display names of states, in a module without slow imports."""

from __future__ import annotations


def state_name(state: str | None) -> str:
    """Return a CiA 402 or NMT state name with spaces, as in the standards; "-" for None."""
    return "-" if state is None else state.replace("_", " ")
