"""Regular expressions that are compiled on first use, so that imports are faster at the start.

The modules that `run` imports define a hundred patterns; most are used for rare files, or never. A single pattern of
PyYAML, which the C reader makes superfluous, takes a hundredth of the start.
"""

from __future__ import annotations

import contextlib
import re
import sys
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator


_COMPILE: Final = re.compile
_PACKAGES: Final = ("canopen_control", "yaml")
_METHODS: Final = ("match", "fullmatch", "search", "split", "findall", "finditer", "sub", "subn", "scanner")


class _LazyPattern:
    """Regular expression that is compiled when one of its attributes is first used."""

    def __init__(self, pattern: str | bytes, flags: int) -> None:
        self._arguments = (pattern, flags)

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        compiled: re.Pattern[Any] = _COMPILE(*self._arguments)
        self.__dict__.update({method: getattr(compiled, method) for method in _METHODS})
        return getattr(compiled, name)


@contextlib.contextmanager
def lazy_patterns() -> Iterator[None]:
    """Defer the compilation of the patterns that this package and PyYAML define in this context until their first use.

    The patterns of compiled modules are compiled at once.
    """
    compile_now = re.compile  # of an outer context, or the standard one

    def compile_later(pattern: Any, flags: int = 0) -> Any:  # noqa: ANN401 - as re.compile
        module = str(sys._getframe(1).f_globals.get("__name__", ""))  # noqa: SLF001 - the frame of its caller
        if module.partition(".")[0] not in _PACKAGES or not isinstance(pattern, str | bytes):
            return compile_now(pattern, flags)
        return _LazyPattern(pattern, int(flags))

    re.compile = compile_later
    try:
        yield
    finally:
        re.compile = compile_now
