"""Dataclasses whose methods are created on first use, so that imports are faster at the start.

The standard decorator compiles up to eight methods for each class, which is two fifths of the time that the imports of
`run` take; most of the methods are never called. Python 3.13 and later compile all methods of a class at once, and are
left unchanged. The decorator also examines each annotation three times, for `ClassVar`, `InitVar` and `KW_ONLY`, which
a search of the text can exclude.
"""

from __future__ import annotations

import contextlib
import dataclasses
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FunctionType


_PACKAGE: Final = "canopen_control."
_SPECIAL: Final = ("ClassVar", "InitVar", "KW_ONLY")


class _Method:
    """Method of a dataclass that creates the actual function on lookup or call, and replaces itself."""

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
        """Call the function if it is wrapped in another function, such as the recursion guard of `repr`."""
        function = self._make()
        self._make = lambda: function
        return function(*arguments)


@contextlib.contextmanager
def quick_dataclasses() -> Iterator[None]:
    """Create methods of the package's dataclasses defined in this context on first use, except in compiled modules."""
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
        if _is_ours(owner.__module__) and not any(word in annotation for word in _SPECIAL):
            return False
        return is_type(annotation, owner, *arguments)

    dataclasses._create_fn, dataclasses._is_type = later, is_special  # type: ignore[attr-defined]  # noqa: SLF001 - no public way
    try:
        yield
    finally:
        dataclasses._create_fn, dataclasses._is_type = create, is_type  # type: ignore[attr-defined]  # noqa: SLF001 - as above


def _is_ours(module: str) -> bool:
    return module.startswith(_PACKAGE)
