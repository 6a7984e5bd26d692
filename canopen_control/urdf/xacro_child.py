"""The process in which xacro runs: `main` reads a file and writes the URDF, or why there is none, to standard output.

Xacro evaluates its author's expressions, which may need for ever or all memory there is, so that
limits are set before it begins and the kernel keeps them. The answer's first byte says what the rest is: `URDF` or
`REFUSED`, a reason in UTF-8. `$(find package)` is answered by `package_search`.

It runs as a file, without the package around it, and imports only what xacro does: it is on the way of every start;
the search for packages only where a file asks for one.
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

TYPE_CHECKING = False  # the module typing takes longer to import than the rest of this
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


URDF = b"U"
REFUSED = b"R"
LARGEST = 64 << 20  # bytes of a URDF; one with five hundred joints has half a million


def main(arguments: list[str]) -> None:
    """Run xacro within limits.

    `arguments` are the folders to import from, one a line, the file, s of the processor, s, bytes of memory, and
    KEY:=VALUE for each argument of the file; `KEY?:=VALUE` is one that the file need not have.
    """
    folders, path, processor_s, wall_s, memory, *mappings = arguments
    sys.path[:0] = folders.splitlines()
    _end_with_starter()
    _limit(int(processor_s), int(wall_s), int(memory))
    answer = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # whatever an expression prints is no answer
    kind, text = _run(path, dict(each.split(":=", 1) for each in mappings))
    with os.fdopen(answer, "wb") as out:
        out.write(kind + text.encode("utf-8", "replace"))


def _end_with_starter() -> None:
    """Let the kernel end this process when standard input is closed: its other end dies with who started us."""
    with contextlib.suppress(AttributeError, OSError):  # a system without it has the clock
        signal.signal(signal.SIGIO, signal.SIG_DFL)
        fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)
        if select.select([0], [], [], 0)[0]:  # it was closed before anybody was told
            sys.exit(1)


def _limit(processor_s: int, wall_s: int, memory: int) -> None:
    """Let the kernel end this process, whoever started it still lives or not."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(wall_s)
    limits = {resource.RLIMIT_CPU: processor_s, resource.RLIMIT_AS: memory, resource.RLIMIT_CORE: 0}
    for what, value in limits.items():
        with contextlib.suppress(ValueError, OSError):  # a system without it, or a lower limit that holds already
            resource.setrlimit(what, (value, value))


class _Arguments(dict[str, str]):
    """The arguments of a file as xacro keeps them; `asked` are those that the file declares or uses."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__({name.removesuffix("?"): value for name, value in given.items()})
        self._wanted = [name for name in given if not name.endswith("?")]
        self.asked: dict[str, None] = {}

    def __contains__(self, name: object) -> bool:
        self.asked[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked[name] = None
        return super().__getitem__(name)

    def unknown(self) -> str:
        """Say which arguments nothing in the file asks for, "" where there is none; xacro itself says nothing."""
        strange = [name for name in self._wanted if name not in self.asked]
        return "; ".join(f"no argument {name!r}{_hint(name, self.asked)}" for name in strange)


def _hint(name: str, known: Iterable[str]) -> str:
    import difflib  # only a mistake needs it

    near = difflib.get_close_matches(name, known, 1, 0.6)
    names = ", ".join(known)
    return f", did you mean {near[0]!r}?" if near else f"; it has {names}" if names else "; it has none"


def _run(path: str, given: Mapping[str, str]) -> tuple[bytes, str]:
    said, arguments = io.StringIO(), _Arguments(given)
    try:
        with contextlib.redirect_stderr(said):
            import xacro  # after the limits

            with _finding(path):
                text = str(xacro.process_file(path, mappings=arguments).toprettyxml(indent="  "))
    except Exception as error:  # noqa: BLE001 - a xacro file runs its author's expressions: anything may come
        reason = next((words for kind, words in _TOO_MUCH.items() if _has_cause(error, kind)), "")
        reason = reason or _absent_package(error) or str(error).strip() or type(error).__name__
        text = f"{reason}{_where(said.getvalue())}"
        return REFUSED, "; ".join(each for each in (text, arguments.unknown()) if each)
    if strange := arguments.unknown():
        return REFUSED, strange
    if len(text) > LARGEST:
        return REFUSED, f"its URDF has more than {LARGEST >> 20} MiB; a macro or an expression in it makes too much"
    return URDF, text


_TOO_MUCH = {
    MemoryError: "it needs too much memory; an expression or a macro in it makes too much",
    RecursionError: "it nests without end; a macro or an include in it uses itself",
}


def _has_cause(error: BaseException, kind: type[BaseException]) -> bool:
    """Whether an exception is of a kind, or was raised while one was handled: xacro tells the expression instead."""
    return any(isinstance(each, kind) for each in _causes(error))


def _absent_package(error: BaseException) -> str:
    """Return what `find_package` said, "" where nothing was sought in vain; xacro says it twice, with its class."""
    return next((str(each) for each in _causes(error) if type(each) is LookupError), "")


def _causes(error: BaseException) -> Iterator[BaseException]:
    each: BaseException | None = error
    while each is not None:
        yield each
        each = each.__cause__ or each.__context__


_LONGEST_STACK = 5  # lines of a macro stack that are told; an endless one has hundreds


def _where(said: str) -> str:
    """Return the macro stack that xacro wrote, on one line."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in said.splitlines()]
    told = [line for line in lines if line]
    more = ["..."] if len(told) > _LONGEST_STACK else []
    return f" ({'; '.join([*told[:_LONGEST_STACK], *more])})" if told else ""


@contextlib.contextmanager
def _finding(path: str) -> Iterator[None]:
    """Answer `$(find ...)` with `find_package` while xacro runs, and open its files where sources have them."""
    import xacro
    from xacro import substitution_args  # after the limits

    before = substitution_args._eval_find  # noqa: SLF001 - xacro has no other door for it
    folders: list[str] = []

    def find(package: str) -> str:
        from canopen_control.urdf.package_search import find_package  # most files ask for none

        folders.append(find_package(package, path))
        return folders[-1]

    def open_installed(name: str, *more: object, **named: object) -> object:
        """Open a file, of a package whose CMake installs its folder elsewhere too."""
        if folders and not os.path.exists(name):
            from pathlib import Path

            from canopen_control.urdf.package_search import installed_file

            for folder in folders:
                if name.startswith(f"{folder}/"):
                    name = str(installed_file(Path(folder), Path(name).relative_to(folder)))
        return open(name, *more, **named)  # type: ignore[call-overload]  # as xacro calls it

    substitution_args._eval_find = find  # noqa: SLF001 - as above
    substitution_args._eval_dict["find"] = find  # noqa: SLF001 - as above
    xacro.open = open_installed  # the name that its functions look up before the built-in one
    try:
        yield
    finally:
        del xacro.open
        substitution_args._eval_find = before  # noqa: SLF001 - as above
        substitution_args._eval_dict["find"] = before  # noqa: SLF001 - as above


if __name__ == "__main__":
    main(sys.argv[1:])
