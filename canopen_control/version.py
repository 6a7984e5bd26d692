"""Version of the package, which only this module defines, and the kind of build."""

from __future__ import annotations

TYPE_CHECKING = False  # every process imports this module, and few need more than the version
if TYPE_CHECKING:
    from typing import Final

__version__ = "0.3.0.dev0"

COMPILED: Final = "compiled"  # the modules of the cycle are extension modules, compiled by mypyc from the same sources
PURE: Final = "pure Python"
TO_COMPILE: Final = "faster: tools/compile --install"


def build() -> str:
    """Return the kind of build that this process runs: `COMPILED` or `PURE`."""
    import importlib.machinery
    import importlib.util

    spec = importlib.util.find_spec("canopen_control.frame")  # a compiled module that every process imports
    extension = tuple(importlib.machinery.EXTENSION_SUFFIXES)
    return COMPILED if spec is not None and str(spec.origin).endswith(extension) else PURE
