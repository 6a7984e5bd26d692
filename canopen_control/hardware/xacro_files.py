"""Runs the real xacro over a file.

The law of the file: xacro is imported here only, and only when asked (it takes a tenth of a second); whatever it
raises, users' own expressions included, becomes one RobotConfigError with the file. `$(find package)` is answered by
ament where that knows the package, and otherwise by the folder above the file that is or holds the package.
"""

from __future__ import annotations

import contextlib
import io
import re
from typing import TYPE_CHECKING

from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

__all__ = ["find_package", "run_xacro"]


def run_xacro(path: Path, mappings: Mapping[str, str]) -> str:
    """Return the URDF text of a xacro file; `mappings` are its arguments. RobotConfigError if xacro cannot."""
    import xacro  # heavy, and not every robot needs it

    said = io.StringIO()
    try:
        with _finding(path), contextlib.redirect_stderr(said):
            document = xacro.process_file(str(path), mappings=dict(mappings))
            return str(document.toprettyxml(indent="  "))
    except Exception as error:  # a xacro file runs its author's expressions: anything may come
        reason = str(error).strip() or type(error).__name__
        raise RobotConfigError(f"{path}: xacro: {reason}{_where(said.getvalue())}") from error


def _where(said: str) -> str:
    """Return the macro stack that xacro wrote, on one line."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in said.splitlines()]
    return f" ({'; '.join(line for line in lines if line)})" if any(lines) else ""


@contextlib.contextmanager
def _finding(path: Path) -> Iterator[None]:
    """Answer `$(find ...)` with `find_package` while xacro runs."""
    from xacro import substitution_args

    before: Callable[[str], str] = substitution_args._eval_find  # noqa: SLF001 - xacro has no other door for it

    def find(package: str) -> str:
        return find_package(package, path)

    substitution_args._eval_find = find  # noqa: SLF001 - as above
    substitution_args._eval_dict["find"] = find  # noqa: SLF001 - as above
    try:
        yield
    finally:
        substitution_args._eval_find = before  # noqa: SLF001 - as above
        substitution_args._eval_dict["find"] = before  # noqa: SLF001 - as above


def find_package(package: str, path: Path) -> str:
    """Return the folder of a ROS package: ament's share folder, else one found around the file; RobotConfigError."""
    with contextlib.suppress(Exception):  # ament_index_python is absent, or does not know it: look around instead
        from ament_index_python.packages import get_package_share_directory

        return str(get_package_share_directory(package))
    for folder in path.resolve().parents:
        for candidate in (folder, folder / package):
            manifest = candidate / "package.xml"
            named = manifest.is_file() and f"<name>{package}</name>" in manifest.read_text(
                encoding="utf-8", errors="replace"
            )
            if named or (candidate.name == package and candidate.is_dir()):
                return str(candidate)
    raise RobotConfigError(f"package {package!r} of $(find {package}) is neither installed nor above {path}")
