"""Checks the contents of a wheel against the checkout: sources, data, tags, and extension modules of compiled wheels.

    python tools/wheel_contents.py WHEEL ...

A wheel is compiled if its tags name a platform, and then has an extension module of its own Python beside the source of
each module that pyproject.toml names, and no other; one of tags py3-none-any has none.
"""

from __future__ import annotations

import sys
import tomllib
import zipfile
from email import message_from_string
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROOT = Path(__file__).parents[1]
PACKAGE = "canopen_control"
SHARED = f"{PACKAGE}__mypyc"  # the one extension module with all code; the others only import from it
NEEDED = (
    f"{PACKAGE}/py.typed",
    f"{PACKAGE}/data/eds/TMCM-1270.eds",
    f"{PACKAGE}/data/config/robby/bus.yml",
    f"{PACKAGE}_bench/command.py",
    f"{PACKAGE}/ros/interfaces/callbacks_aarch64.so",  # called by Fast DDS
    f"{PACKAGE}/ros/interfaces/callbacks_x86_64.so",
)
STRANGERS = ("tests/", "tools/", "docs/", "build/")


def compiled_modules() -> list[str]:
    """Return the sources of the compiled modules, relative to the root."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    hook = project["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]
    return [path.lstrip("/") for path in hook["include"]]


def problems(wheel: Path) -> list[str]:
    """Return the problems of a wheel as sentences."""
    python, _, platform = wheel.stem.split("-")[-3:]
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        return [
            *_content(archive, names),
            *_metadata(archive, names, f"{python}-", pure=platform == "any"),
            *_extensions(names, python, pure=platform == "any"),
        ]


def _content(archive: zipfile.ZipFile, names: Sequence[str]) -> Iterator[str]:
    yield from (f"{name} is missing" for name in NEEDED if name not in names)
    yield from (f"{name} does not belong into a wheel" for name in names if name.startswith(STRANGERS))
    yield from (f"{name} is bytecode" for name in names if name.endswith(".pyc"))
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if name not in names:
            yield f"{name} is missing"
        elif archive.read(name) != path.read_bytes():
            yield f"{name} is not that of the checkout"


def _metadata(archive: zipfile.ZipFile, names: Sequence[str], tag: str, *, pure: bool) -> Iterator[str]:
    (folder,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
    told = message_from_string(archive.read(f"{folder}/WHEEL").decode())
    if told["Root-Is-Purelib"] != str(pure).lower():
        yield f"Root-Is-Purelib is {told['Root-Is-Purelib']}"
    if not all(value.startswith(tag) for value in told.get_all("Tag", [])):
        yield f"WHEEL has the tags {told.get_all('Tag')}, the file's name {tag}"
    if "canopen-control = " not in archive.read(f"{folder}/entry_points.txt").decode():
        yield "the program canopen-control is not an entry point"
    if "Typing :: Typed" not in archive.read(f"{folder}/METADATA").decode():
        yield "METADATA does not say that the package is typed"


def _extensions(names: Sequence[str], python: str, *, pure: bool) -> Iterator[str]:
    """Compare the extension modules with those implied by the tags: `cp311` is `.cpython-311-`."""
    found = {str(PurePosixPath(name).with_name(PurePosixPath(name).name.split(".")[0])) for name in _libraries(names)}
    wanted = set() if pure else {SHARED, *(path.removesuffix(".py") for path in compiled_modules())}
    yield from (f"{name} is not compiled" for name in sorted(wanted - found))
    yield from (f"{name} is compiled, though pyproject.toml does not name it" for name in sorted(found - wanted))
    mark = f".cpython-{python.removeprefix('cp')}-"
    yield from (f"{name} is not of {python}" for name in _libraries(names) if mark not in name)


def _libraries(names: Sequence[str]) -> list[str]:
    """Return the extension modules; the callbacks for Fast DDS (callbacks_*.so) are not Python modules."""
    found = map(PurePosixPath, names)
    return [str(name) for name in found if ".so" in name.suffixes and not name.name.startswith("callbacks_")]


def main(wheels: Sequence[str]) -> int:
    """Print a line for each wheel, and its problems; return 1 if there are any, or no wheel is given."""
    bad = not wheels
    for wheel in map(Path, wheels):
        found = problems(wheel)
        print("\n  ".join([f"{wheel.name}: {'content good' if not found else 'WRONG'}", *found]))
        bad = bad or bool(found)
    return int(bad)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
