"""Faster imports at start: dataclasses that create their methods on first use, and no garbage collector.

The standard decorator compiles up to eight methods for each class, which is two fifths of the time that the imports of
`run` take; most of them are never called. Python from 3.13 on compiles those of a class at once, and is left alone.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FunctionType


class _Method:
    """Method of a dataclass that creates the function on lookup or call and replaces itself."""

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
        """Call the function inside an enclosing one, such as `repr`'s guard against recursion."""
        function = self._make()
        self._make = lambda: function
        return function(*arguments)


@contextlib.contextmanager
def quick_dataclasses() -> Iterator[None]:
    """Make dataclasses defined in this context create methods on first use, except those of compiled modules.

    To be used around imports of this package only.
    """
    create: Callable[..., FunctionType] | None = getattr(dataclasses, "_create_fn", None)
    if create is None:
        yield
        return

    def later(name: str, *arguments: object, globals: dict[str, object], **options: object) -> FunctionType | _Method:  # noqa: A002 - its name there
        def make() -> FunctionType:
            return create(name, *arguments, globals=globals, **options)

        return _Method(name, make) if str(globals.get("__file__", "")).endswith(".py") else make()

    dataclasses._create_fn = later  # type: ignore[attr-defined]  # noqa: SLF001 - no public way
    try:
        yield
    finally:
        dataclasses._create_fn = create  # type: ignore[attr-defined]  # noqa: SLF001 - as above


@contextlib.contextmanager
def collector_off() -> Iterator[None]:
    """Disable the garbage collector during a start, which creates almost no garbage."""
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        gc.enable()
