"""The modules that are compiled hold nothing that mypyc is known to translate wrongly."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
COMPILED = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]["include"]


def constants_of_floats(text):
    """Yield the names of module constants that are a Final tuple of floats and nothing else.

    Reading one raises NameError once it is compiled: github.com/mypyc/mypyc, issue 1183, seen with 2.4.1.
    """
    for node in ast.parse(text).body:
        if isinstance(node, ast.AnnAssign) and "Final" in ast.unparse(node.annotation) and node.value is not None:
            parts = node.value.elts if isinstance(node.value, ast.Tuple) else []
            if parts and all(isinstance(part, ast.Constant) and isinstance(part.value, float) for part in parts):
                yield node.target.id


def test_no_compiled_module_has_a_constant_tuple_of_floats():
    paths = [ROOT / name.lstrip("/") for name in COMPILED]
    assert len(paths) > 50
    result = {
        str(path.relative_to(ROOT)): list(constants_of_floats(path.read_text(encoding="utf-8"))) for path in paths
    }
    assert {path: names for path, names in result.items() if names} == {}, "make each float a constant of its own"


def derived_dataclasses(text):
    """Yield the names of dataclasses that are derived from others; compiled, their import fails (seen with 2.4.1)."""
    for node in ast.parse(text).body:
        if (
            isinstance(node, ast.ClassDef)
            and node.bases
            and "dataclass" in "".join(map(ast.unparse, node.decorator_list))
        ):
            yield node.name


def test_no_compiled_module_derives_a_dataclass_from_another():
    result = {
        name: list(derived_dataclasses((ROOT / name.lstrip("/")).read_text(encoding="utf-8"))) for name in COMPILED
    }
    assert {name: names for name, names in result.items() if names} == {}, "put them into a module that is not compiled"
    assert list(derived_dataclasses("@dataclass(frozen=True)\nclass A(B): ...\n@dataclass\nclass C: ...")) == ["A"]


def yields_in_handlers(text):
    """Return the lines of `except` clauses that contain a yield.

    Compiled, a `raise` after such a yield raises None and damages the interpreter's memory (seen with mypyc 2.4.1).
    """
    return [
        handler.lineno
        for handler in ast.walk(ast.parse(text))
        if isinstance(handler, ast.ExceptHandler)
        and any(isinstance(node, ast.Yield | ast.YieldFrom) for node in ast.walk(handler))
    ]


def test_no_compiled_generator_yields_while_it_handles_an_exception():
    result = {name: yields_in_handlers((ROOT / name.lstrip("/")).read_text(encoding="utf-8")) for name in COMPILED}
    assert {name: lines for name, lines in result.items() if lines} == {}, "yield after the except clause"
    example = "try:\n    a()\nexcept E:\n    yield from b()\n    raise\n"
    assert yields_in_handlers(example) == [3]
