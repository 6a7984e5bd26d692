"""Where the bundled EDS files and robot configurations are: in the wheel's data folder, or in a checkout."""

from __future__ import annotations

from pathlib import Path

__all__ = ["data_names", "data_path"]

_PACKAGE = Path(__file__).resolve().parent


def _folder(kind: str) -> Path:
    bundled = _PACKAGE / "data" / kind
    return bundled if bundled.is_dir() else _PACKAGE.parent / kind


def data_path(kind: str, name: str) -> Path:
    """Return the path that `name` has among the bundled files of `kind` ("eds" or "config"); it may not exist."""
    return _folder(kind) / name


def data_names(kind: str) -> list[str]:
    """Return what is bundled of `kind`, sorted."""
    return sorted(path.name for path in _folder(kind).iterdir()) if _folder(kind).is_dir() else []
