"""The declared public surface: each name is found, typed and documented, and costs nothing before it is used."""

import ast
import importlib
import inspect
from pathlib import Path

import pytest

import canopen_control
from canopen_control import errors

SOURCE = Path(canopen_control.__file__).read_text(encoding="utf-8")
NAMES = [name for name in canopen_control.__all__ if name != "__version__"]


def imports_for_types():
    """Return name -> module of what the package imports for type checkers alone."""
    block = next(node for node in ast.parse(SOURCE).body if isinstance(node, ast.If))
    return {
        alias.name: item.module.removeprefix("canopen_control.")
        for item in block.body
        if isinstance(item, ast.ImportFrom)
        for alias in item.names
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_is_found_and_reports_what_it_is(name):
    result = getattr(canopen_control, name)
    assert result.__name__ == name
    assert (result.__doc__ or "").strip()


@pytest.mark.parametrize("name", NAMES)
def test_every_public_method_is_documented(name):
    methods = inspect.getmembers(getattr(canopen_control, name), inspect.isfunction)
    assert [method for method, code in methods if method[0] != "_" and not inspect.getdoc(code)] == []


def test_dir_lists_what_is_public():
    assert set(canopen_control.__all__) <= set(dir(canopen_control))


def test_a_type_checker_finds_each_name_where_it_is_imported():
    assert imports_for_types() == canopen_control._HOMES
    assert sorted(canopen_control._HOMES) == sorted(NAMES)


def test_a_public_name_is_defined_in_its_module():
    for name, home in canopen_control._HOMES.items():
        result = getattr(importlib.import_module(f"canopen_control.{home}"), name)
        assert result.__module__.startswith(f"canopen_control.{home}"), (name, result.__module__)


def test_the_package_imports_nothing_but_its_version_before_a_name_is_used():
    top = [node for node in ast.parse(SOURCE).body if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {getattr(node, "module", None) or node.names[0].name for node in top}
    assert names == {"__future__", "importlib", "canopen_control.version"}


def test_what_is_not_public_is_not_found():
    with pytest.raises(AttributeError, match="no attribute 'MasterNode'"):
        _ = canopen_control.MasterNode


def test_every_error_is_public():
    classes = [var for var in vars(errors).values() if isinstance(var, type) and var.__module__ == errors.__name__]
    assert {class_name.__name__ for class_name in classes} <= set(errors.__all__)
    assert all(issubclass(class_name, errors.CanopenError) for class_name in classes)
