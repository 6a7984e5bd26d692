"""Paths of the bundled EDS files and robot configurations, and size-limited reading of user files.

Bundled files are in the wheel's data folder, or in a checkout.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def _folder(kind: str) -> Path:
    bundled = _PACKAGE / "data" / kind
    return bundled if bundled.is_dir() else _PACKAGE.parent / kind


def data_path(kind: str, name: str) -> Path:
    """Return the path of the bundled file `name` of `kind` ("eds" or "config"), even if it does not exist."""
    return _folder(kind) / name


def data_names(kind: str) -> list[str]:
    """Return the names of the bundled files of `kind`, sorted."""
    return sorted(path.name for path in _folder(kind).iterdir()) if _folder(kind).is_dir() else []


def read_limited(path: Path, limit: int) -> bytes:
    """Return the bytes of a regular file; ValueError for a folder, a device, or more than `limit` bytes.

    OSError as raised by `open`.
    """
    if path.exists() and not path.is_file():
        raise ValueError("it is a folder" if path.is_dir() else "it is not a regular file")
    with path.open("rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        size = max(path.stat().st_size, len(data))
        raise ValueError(f"it has {size / 1e6:.1f} MB, more than the limit of {limit / 1e6:g} MB")
    return data
