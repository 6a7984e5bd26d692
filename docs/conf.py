"""Sphinx configuration; writes the generated pages before Sphinx reads the sources."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "tools")]

from generate import write_pages  # noqa: E402 - sys.path is set above
from speed_history import write_history  # noqa: E402 - as above

import canopen_control  # noqa: E402 - as above

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "canopen_control"
release = version = canopen_control.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "canopen_control"
autodoc_typehints = "description"
autodoc_member_order = "bysource"
nitpicky = False
suppress_warnings = ["myst.header"]
default_role = "code"  # text in backquotes in docstrings
smartquotes = False  # keep the two hyphens of options

write_pages(HERE / "generated")
write_history(HERE / "generated")


def keep_the_tree(_app: object, what: str, name: str, _found: object, _options: object, lines: list[str]) -> None:
    """Show the exception tree in the docstring of `errors` verbatim."""
    if what == "module" and name == "canopen_control.errors":
        lines[1:] = ["", "::", "", *(f"    {line}" for line in lines[1:]), ""]


def setup(app: "Sphinx") -> None:
    """Connect the handlers; called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_the_tree)
