"""A mesh as convex parts: contacts know convex shapes alone, so each piece of a mesh that hangs together is one.

A piece that is flat, such as a wall that is drawn as a plane, gets a thickness of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["MeshPart", "convex_parts"]

_HEAD: Final = 84  # bytes before the faces of binary STL
_FACE: Final = np.dtype([("normal", "<3f4"), ("corners", "<9f4"), ("rest", "<u2")])
_GRAIN_M: Final = 1e-5  # corners that are nearer are one
_THIN_M: Final = 1e-4
_HALF_M: Final = 5e-4  # that a flat piece is thickened to each side
_MOST_PARTS: Final = 500
_MOST_FACES: Final = 200_000


@dataclass(frozen=True, eq=False)
class MeshPart:
    """The corners of a convex part, m: one row of x, y and z each."""

    corners: Any


def convex_parts(stl: bytes, scale: Sequence[float]) -> tuple[MeshPart, ...]:
    """Return the parts of binary STL at a scale; ValueError for one of which none can be made."""
    count = int.from_bytes(stl[80:84], "little")
    if count > _MOST_FACES:
        raise ValueError(f"{count} faces are more than the {_MOST_FACES} that are simulated; make a lighter one")
    corners = np.frombuffer(stl, _FACE, count, _HEAD)["corners"].reshape(-1, 3).astype(float) * np.array(scale)
    if not np.isfinite(corners).all():
        raise ValueError("a number in it is none")
    keys, faces = np.unique(np.round(corners / _GRAIN_M).astype(np.int64), axis=0, return_inverse=True)
    parts = tuple(_solid(keys[list(piece)] * _GRAIN_M) for piece in _pieces(faces.reshape(-1, 3), len(keys)))
    if len(parts) > _MOST_PARTS:
        raise ValueError(f"{len(parts)} separate pieces are more than the {_MOST_PARTS} that are simulated")
    return tuple(MeshPart(each) for each in parts)


def _pieces(faces: Any, count: int) -> Iterator[list[int]]:  # noqa: ANN401 - numpy's
    """Yield the corners that hang together by faces."""
    owner = list(range(count))

    def first(corner: int) -> int:
        while owner[corner] != corner:
            owner[corner] = owner[owner[corner]]
            corner = owner[corner]
        return corner

    for one, two, three in faces.tolist():
        owner[first(two)] = owner[first(three)] = first(one)
    pieces = dict[int, list[int]]()
    for corner in range(count):
        pieces.setdefault(first(corner), []).append(corner)
    yield from pieces.values()


def _solid(corners: Any) -> Any:  # noqa: ANN401 - as above
    """Return corners of which a body can be made: those of a flat piece on both sides of it."""
    middle = corners.mean(axis=0)
    axes = np.linalg.svd(corners - middle, full_matrices=True)[2]
    spread = np.ptp((corners - middle) @ axes.T, axis=0)
    for axis, length in zip(axes, spread, strict=True):
        if length < _THIN_M:
            corners = np.concatenate([corners - _HALF_M * axis, corners + _HALF_M * axis])
    return corners
