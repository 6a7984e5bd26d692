"""Program of the xacro process: writes the URDF of a xacro file, or an error, to standard output.

Xacro evaluates expressions in the file, which may need unlimited time or memory. Therefore limits are set first and
enforced by the kernel. The first byte of the answer is its kind: `URDF`, or `REFUSED` with a reason in UTF-8. `$(find
package)` is answered by `package_search`.

The program is a fork of its parent process, or runs as a script, without the package, and then imports little besides
xacro, because the start of xacro waits for it; the package search is imported only if a file needs it.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import re
import resource
import select
import signal
import sys

TYPE_CHECKING = False  # the import of typing takes longer than that of the rest of this module
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


URDF = b"U"
REFUSED = b"R"
LARGEST = 64 << 20  # maximum size of a URDF in bytes; a robot with five hundred joints needs half a million


def main(arguments: list[str]) -> int:
    """Run xacro within limits and write the result to standard output; return the exit code 0.

    `arguments` are the descriptor of a pipe that the parent process holds open, the folders to import from (one per
    line), the file, processor time in s, elapsed time in s, memory in bytes, and KEY:=VALUE for each xacro argument;
    the file need not use an argument `KEY?:=VALUE`.
    """
    lifeline, folders, path, processor_s, wall_s, memory, *mappings = arguments
    sys.path[:0] = folders.splitlines()
    _end_with_parent(int(lifeline))
    _limit(int(processor_s), int(wall_s), int(memory))
    answer, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)  # output of an expression is not part of the answer
    os.dup2(nothing, 2)
    kind, text = _run(path, dict(mapping.split(":=", 1) for mapping in mappings))
    with os.fdopen(answer, "wb") as out:
        out.write(kind + text.encode("utf-8", "replace"))
    return 0


def _end_with_parent(lifeline: int) -> None:
    """Make the kernel end this process when the pipe `lifeline` is closed, for example because the parent has ended."""
    with contextlib.suppress(AttributeError, OSError):  # systems without it use the time limit
        signal.signal(signal.SIGIO, signal.SIG_DFL)
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
        if select.select([lifeline], [], [], 0)[0]:  # it was closed before the signal was set up
            sys.exit(1)


def _limit(processor_s: int, wall_s: int, memory: int) -> None:
    """Set kernel limits for time and memory, which apply even after the parent process has ended."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(wall_s)
    limits = {resource.RLIMIT_CPU: processor_s, resource.RLIMIT_AS: memory, resource.RLIMIT_CORE: 0}
    for resource_kind, value in limits.items():
        with contextlib.suppress(ValueError, OSError):  # a system without it, or a lower limit is already set
            resource.setrlimit(resource_kind, (value, value))


class _Arguments(dict[str, str]):
    """Xacro arguments, with a record of the names that the file declares or uses.

    With `lenient`, an argument without a value is "" and is recorded in `absent`.
    """

    def __init__(self, mappings: Mapping[str, str], *, lenient: bool = False) -> None:
        super().__init__({name.removesuffix("?"): value for name, value in mappings.items()})
        self._required = [name for name in mappings if not name.endswith("?")]
        self._lenient = lenient
        self.declared: dict[str, None] = {}
        self.absent: dict[str, None] = {}

    def __contains__(self, name: object) -> bool:
        self.declared[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.declared[name] = None
        if self._lenient and not super().__contains__(name):
            self.absent[name] = None
            return ""
        return super().__getitem__(name)

    def unknown(self) -> str:
        """Return an error text for required arguments that the file does not use (xacro ignores them), else ""."""
        unused = [name for name in self._required if name not in self.declared]
        return "; ".join(f"no argument {name!r}{_hint(name, self.declared)}" for name in unused)


def _hint(name: str, known: Iterable[str]) -> str:
    import difflib  # needed only for an error text

    near = difflib.get_close_matches(name, known, 1, 0.6)
    names = ", ".join(known)
    return f" (did you mean {near[0]!r}?)" if near else f"; it has {names}" if names else "; it has none"


def _run(path: str, mappings: Mapping[str, str]) -> tuple[bytes, str]:
    output, arguments = io.StringIO(), _Arguments(mappings)
    try:
        with contextlib.redirect_stderr(output):
            text = _urdf(path, arguments)
    except Exception as error:  # noqa: BLE001 - a xacro file runs its author's expressions: anything may come
        reason = next((words for kind, words in _TOO_MUCH.items() if _has_cause(error, kind)), "")
        reason = reason or _absent_package(error) or _absent_arguments(error, path, mappings, arguments)
        reason = reason or _one_line(str(error)) or type(error).__name__
        text = f"{reason}{_where(output.getvalue())}"
        return REFUSED, "; ".join(part for part in (text, arguments.unknown()) if part)
    if unused := arguments.unknown():
        return REFUSED, unused
    if len(text) > LARGEST:
        return REFUSED, f"its URDF has more than {LARGEST >> 20} MiB; a macro or an expression generates too much"
    return URDF, text


def _urdf(path: str, arguments: _Arguments) -> str:
    """Return the URDF that xacro makes of a file; raise what xacro or an expression of the file raises."""
    import xacro  # after the limits

    with _source_lookup(path):
        return str(xacro.process_file(path, mappings=arguments).toprettyxml(indent="  "))


def _one_line(text: str) -> str:
    return ", ".join(line.strip() for line in text.splitlines() if line.strip())


_TOO_MUCH = {
    MemoryError: "it needs too much memory; an expression or a macro generates too much",
    RecursionError: "it nests endlessly; a macro or an include uses itself",
}


def _has_cause(error: BaseException, kind: type[BaseException]) -> bool:
    """Whether an exception or one of its causes is an instance of `kind`.

    The causes count, because xacro replaces an exception with another one about the expression.
    """
    return any(isinstance(cause, kind) for cause in _causes(error))


def _absent_package(error: BaseException) -> str:
    """Return the message of `find_package` if a package was not found, else ""."""
    return next((str(cause) for cause in _causes(error) if type(cause) is LookupError), "")


def _absent_arguments(error: BaseException, path: str, mappings: Mapping[str, str], arguments: _Arguments) -> str:
    """Return a message with all arguments that have no value, if an error is about one of them, else "".

    xacro stops at the first. A second run gives "" for each, and ends at the latest where such a text cannot be used;
    the names in it are added to those of the first run.
    """
    from xacro.substitution_args import ArgException  # imported by the first run

    if not any(isinstance(getattr(cause, "exc", cause), ArgException) for cause in _causes(error)):
        return ""
    lenient = _Arguments(mappings, lenient=True)
    with contextlib.suppress(Exception), contextlib.redirect_stderr(io.StringIO()):
        _urdf(path, lenient)
    arguments.declared |= lenient.declared
    names, many = ", ".join(lenient.absent), len(lenient.absent) > 1
    return (
        f"{'arguments' if many else 'argument'} {names} {'have' if many else 'has'} neither a value nor a default; "
        f"give {'each' if many else 'it'} as {'NAME' if many else names}:=VALUE, or the launch file with --launch"
    )


def _causes(error: BaseException) -> Iterator[BaseException]:
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__


_LONGEST_STACK = 5  # lines of a macro stack that are shown; an endless recursion has hundreds


def _where(output: str) -> str:
    """Return the macro stack in xacro's error output as one line with at most `_LONGEST_STACK` entries, or ""."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in output.splitlines()]
    stack = [line for line in lines if line]
    more = ["..."] if len(stack) > _LONGEST_STACK else []
    return f" ({'; '.join([*stack[:_LONGEST_STACK], *more])})" if stack else ""


@contextlib.contextmanager
def _source_lookup(path: str) -> Iterator[None]:
    """Context in which xacro finds packages with `find_package`, and missing installed files in the sources."""
    import xacro
    from xacro import substitution_args  # after the limits

    before = substitution_args._eval_find  # noqa: SLF001 - xacro has no public hook for it
    folders: list[str] = []

    def find(package: str) -> str:
        from canopen_control.urdf.package_search import find_package  # needed by few files

        folders.append(find_package(package, path))
        return folders[-1]

    def open_installed(name: str, *more: object, **named: object) -> object:
        """Open a file; if it is missing, open the source file from which CMake would install it."""
        if folders and not os.path.exists(name):
            from pathlib import Path

            from canopen_control.urdf.package_search import installed_file

            for folder in folders:
                if name.startswith(f"{folder}/"):
                    name = str(installed_file(Path(folder), Path(name).relative_to(folder)))
        return open(name, *more, **named)  # type: ignore[call-overload]  # as xacro calls it

    substitution_args._eval_find = find  # noqa: SLF001 - as above
    substitution_args._eval_dict["find"] = find  # noqa: SLF001 - as above
    xacro.open = open_installed  # its functions find this name before the built-in one
    try:
        yield
    finally:
        del xacro.open
        substitution_args._eval_find = before  # noqa: SLF001 - as above
        substitution_args._eval_dict["find"] = before  # noqa: SLF001 - as above


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
