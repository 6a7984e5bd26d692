"""The version of the package, here alone: wheel and documentation read it from this file; and which build runs."""

import importlib.machinery
import importlib.util
from typing import Final

__version__ = "0.3.0.dev0"

COMPILED: Final = "compiled"  # the modules of the cycle are extension modules, made by mypyc of the same sources
PURE: Final = "pure Python"


def build() -> str:
    """Return which build this process runs: `COMPILED` or `PURE`."""
    found = importlib.util.find_spec(
        "canopen_control.frame"
    )  # of those that are compiled, the one everybody has imported
    extension = tuple(importlib.machinery.EXTENSION_SUFFIXES)
    return COMPILED if found is not None and str(found.origin).endswith(extension) else PURE
