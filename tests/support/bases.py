"""The golden vectors of bases on wheels, and how what they say is compared."""

from __future__ import annotations

from typing import Any

from support.control import vectors
from support.trajectories import close


def cases(group: str) -> list[Any]:
    """Return the cases of a group of the bases' vectors."""
    return vectors(group, "bases.json")


def differences(found: dict[str, Any], wanted: dict[str, Any], tolerance: float) -> dict[str, Any]:
    """Return what is not as the vectors have it: (found, wanted) by name; flags are equal or not."""
    return {
        key: (found[key], value)
        for key, value in wanted.items()
        if key in found and not (found[key] is value or _close(found[key], value, tolerance))
    }


def _close(found: Any, wanted: Any, tolerance: float) -> bool:
    if isinstance(wanted, bool):
        return bool(found is wanted)
    return close(_listed(found), _listed(wanted), tolerance)


def _listed(value: Any) -> list[float]:
    return list(value) if isinstance(value, (list, tuple)) else [value]
