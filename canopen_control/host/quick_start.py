"""Faster program start: creates dataclass methods and regular expressions on first use, without garbage collection.

The standard decorator compiles up to eight methods for each dataclass, which is two fifths of the time that the imports
of `run` take; most of the methods are never called. Python 3.13 and later compile all methods of a class at once, and
are left unchanged. The decorator also examines each annotation three times, for `ClassVar`, `InitVar` and `KW_ONLY`,
which a search of the text can exclude.

The modules that `run` imports define a hundred patterns; most are used for rare files, or never. A single pattern of
PyYAML, which the C reader makes superfluous, takes a hundredth of the start.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import re
import sys
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FunctionType


# -- dataclasses


_PACKAGE: Final = "canopen_control."
_SPECIAL_ANNOTATIONS: Final = ("ClassVar", "InitVar", "KW_ONLY")


class _Method:
    """Dataclass method that creates the actual function on first lookup or call, and replaces itself with it."""

    __slots__ = ("__name__", "_make")

    def __init__(self, name: str, make: Callable[[], FunctionType]) -> None:
        self.__name__ = name
        self._make = make

    def __get__(self, instance: object, owner: type) -> object:
        function = self._make()
        for base in owner.__mro__:
            if base.__dict__.get(self.__name__) is self:
                function.__qualname__ = f"{base.__qualname__}.{self.__name__}"
                setattr(base, self.__name__, function)
        return function if instance is None else function.__get__(instance, owner)

    def __call__(self, *arguments: object) -> object:
        """Call the function, for a method wrapped in another function, such as the recursion guard of `repr`."""
        function = self._make()
        self._make = lambda: function
        return function(*arguments)


@contextlib.contextmanager
def quick_dataclasses() -> Iterator[None]:
    """Make dataclasses of this package in this context create methods on first use, except in compiled modules."""
    create: Callable[..., FunctionType] | None = getattr(dataclasses, "_create_fn", None)
    is_type: Callable[..., bool] | None = getattr(dataclasses, "_is_type", None)
    if create is None or is_type is None:
        yield
        return

    def later(name: str, *arguments: object, globals: dict[str, object], **options: object) -> FunctionType | _Method:  # noqa: A002 - its name there
        def make() -> FunctionType:
            return create(name, *arguments, globals=globals, **options)

        is_source = str(globals.get("__file__", "")).endswith(".py")
        return _Method(name, make) if is_source and _is_ours(str(globals.get("__name__"))) else make()

    def is_special(annotation: str, owner: type, *arguments: object) -> bool:
        if _is_ours(owner.__module__) and not any(word in annotation for word in _SPECIAL_ANNOTATIONS):
            return False
        return is_type(annotation, owner, *arguments)

    dataclasses._create_fn, dataclasses._is_type = later, is_special  # type: ignore[attr-defined]  # noqa: SLF001 - no public way
    try:
        yield
    finally:
        dataclasses._create_fn, dataclasses._is_type = create, is_type  # type: ignore[attr-defined]  # noqa: SLF001 - as above


def _is_ours(module: str) -> bool:
    return module.startswith(_PACKAGE)


# -- regular expressions


_COMPILE: Final = re.compile
_LAZY_PACKAGES: Final = ("canopen_control", "yaml")
_METHODS: Final = ("match", "fullmatch", "search", "split", "findall", "finditer", "sub", "subn", "scanner")


class _LazyPattern:
    """Regular expression that is compiled on first use of one of its attributes."""

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
    """Defer the compilation of patterns that this package and PyYAML define in this context to their first use.

    The patterns of compiled modules are compiled at once.
    """
    compile_now = re.compile  # function of an outer context, or the standard one

    def compile_later(pattern: Any, flags: int = 0) -> Any:  # noqa: ANN401 - as re.compile
        module = str(sys._getframe(1).f_globals.get("__name__", ""))  # noqa: SLF001 - the frame of its caller
        if module.partition(".")[0] not in _LAZY_PACKAGES or not isinstance(pattern, str | bytes):
            return compile_now(pattern, flags)
        return _LazyPattern(pattern, int(flags))

    re.compile = compile_later
    try:
        yield
    finally:
        re.compile = compile_now


# -- program start


@contextlib.contextmanager
def quick_imports() -> Iterator[None]:
    """Make modules imported in this context create dataclass methods and compile regular expressions on first use."""
    with quick_dataclasses(), lazy_patterns():
        yield


@contextlib.contextmanager
def quick_start() -> Iterator[None]:
    """Speed up imports like `quick_imports`, and disable the garbage collector until the end of the context."""
    gc.disable()
    try:
        with quick_imports():
            yield
        gc.freeze()
    finally:
        gc.enable()
