"""Paths of the bundled EDS files and robot configurations, and size-limited reading of user files and texts.

Bundled files are in the wheel's data folder, or in a checkout.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_UNPACK = "unpack it, and give the file in it"
_FORMATS = (  # beginning of the data, and the format it indicates
    (b"PK\x03\x04", f"a ZIP archive; {_UNPACK}"),
    (b"\x1f\x8b", f"compressed by gzip; {_UNPACK}"),
    (b"%PDF", "a PDF document, not a text"),
    (b"\xd0\xcf\x11\xe0", "an Office document, not a text"),
    (b"\x7fELF", "a program, not a text"),
)
BINARY = "a binary file, not a text"
_SAMPLE_SIZE = 4096  # bytes of a file that show whether it is a text
LONGEST_TEXT = 50_000_000
"""Maximum length of a description or launch file in bytes."""


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
    """Return the bytes of a regular file; raise ValueError for a folder, a device, or more than `limit` bytes.

    Raise OSError if it cannot be opened.
    """
    if path.exists() and not path.is_file():
        raise ValueError("it is a folder" if path.is_dir() else "it is not a regular file")
    with path.open("rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        size = max(path.stat().st_size, len(data))
        raise ValueError(f"it has {size / 1e6:.1f} MB, more than the limit of {limit / 1e6:g} MB")
    return data


def foreign_format(data: bytes) -> str:
    """Return the format of data that are not a text, such as "a ZIP archive", with advice; "" for a possible text."""
    if known := next((name for begin, name in _FORMATS if data.startswith(begin)), ""):
        return known
    in_utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff") or (data[1:2] == b"\0" and data[:1] != b"\0")
    return BINARY if b"\0" in data[:_SAMPLE_SIZE] and not in_utf16 else ""


def read_utf8(path: Path, limit: int = LONGEST_TEXT) -> str:
    """Return the text of a UTF-8 file; raise ValueError for any other file, OSError if it cannot be opened."""
    data = read_limited(path, limit)
    if foreign := foreign_format(data):
        raise ValueError(f"it is {foreign}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        raise ValueError(f"byte 0x{byte:02X} in line {line} is not UTF-8; save the file as UTF-8") from None
