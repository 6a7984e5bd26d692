"""Who may import whom. The table is the architecture; this test keeps it true."""

import ast
import sys
from pathlib import Path

import pytest

PACKAGE = "canopen_control"
ROOT = Path(__file__).parents[1] / PACKAGE
STDLIB = frozenset(sys.stdlib_module_names)
PURE = frozenset(
    """__future__ abc binascii bisect collections contextlib copy dataclasses datetime difflib enum functools heapq
    itertools math operator pathlib re string struct types typing""".split()  # noqa: SIM905 - one name a line is no list
)
MARKS = frozenset({"mypy_extensions"})  # what may be derived from where it is compiled
EVERYBODY = frozenset({"errors", "frame"})

#: room -> (rooms it may import beside its own, modules from outside)
MAY_IMPORT = {
    "errors": (set(), PURE),
    "frame": (set(), PURE),
    "data_files": (set(), PURE),
    "host": (set(), STDLIB),
    "yamlproblems": ({"yamlnode"}, PURE),  # the annotations only: a problem stands at a node
    "yamlnode": ({"yamlproblems"}, PURE),
    "yamltree": ({"yamlnode", "yamlproblems"}, PURE | {"yaml", "os"}),
    "od": (set(), PURE),
    "cia301": ({"od"}, PURE),
    "cia402": ({"od", "cia301"}, PURE),
    "bus": ({"host"}, STDLIB | {"can"}),
    "master": ({"od", "cia301", "cia402", "bus", "yamltree", "data_files"}, STDLIB),
    "virtual": ({"od", "cia301", "cia402", "bus", "host", "yamltree"}, STDLIB | {"numpy"}),
    "hardware": (
        {"od", "cia301", "cia402", "master", "yamltree"},
        STDLIB | MARKS | {"xacro", "ament_index_python"},
    ),
    "controllers": ({"hardware.interfaces", "yamltree"}, STDLIB | MARKS | {"numpy"}),
    "runtime": (
        {
            "od",
            "cia301",
            "cia402",
            "bus",
            "host",
            "master",
            "virtual",
            "hardware",
            "controllers",
            "yamltree",
            "data_files",
        },
        STDLIB,
    ),
    "client": ({"host"}, STDLIB),
    "ros": ({"client", "host"}, None),
    "trace": (
        # what of ros is free of ROS: the numbers of its messages, for bags
        {"client", "host", "bus", "od", "cia301", "cia402", "ros.conversions", "ros.diagnosis", "ros.transforms"},
        STDLIB | {"rosbags", "numpy"},
    ),
    "monitor": ({"client", "host", "bus", "od", "cia301", "cia402", "trace"}, STDLIB | {"textual", "rich"}),
    "view": ({"client", "host"}, STDLIB | {"viser", "trimesh", "numpy", "websockets", "rich"}),
    "interop": ({"od", "bus", "client"}, STDLIB | {"canopen"}),
    "bench": (None, None),  # its peers are other packages
    "cli": (None, STDLIB),
}
#: the packages that only one room may touch
ONLY = {
    "rclpy": "ros",
    "can": "bus",
    "canopen": "interop",
    "yaml": "yamltree",
    "xacro": "hardware",
    "viser": "view",
    "textual": "monitor",
    "rosbags": "trace",
}


def modules():
    return sorted(
        path for path in ROOT.rglob("*.py") if path.name not in ("__main__.py",) and path.parent != ROOT / "data"
    )


def room_of(path):
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path):
    """Yield the dotted name of everything that is imported, annotations included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                yield f"{node.module}.{alias.name}"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_follow_the_layers(path):
    room = room_of(path)
    if room == "__init__":
        return
    assert room in MAY_IMPORT, f"{room} has no line in the table"
    ours, outside = MAY_IMPORT[room]
    for name in imported(path):
        top, _, rest = name.partition(".")
        if top != PACKAGE:
            assert outside is None or top in outside, f"{room} may not import {name}"
            assert ONLY.get(top, room) == room or "peers" in path.parts, f"only {ONLY[top]} imports {top}"
            continue
        other = rest.split(".")[0]
        if ours is None or other in EVERYBODY or other == room or other in ("", "__version__"):
            continue
        allowed = other in ours or any(rest.startswith(each + ".") or rest == each for each in ours)
        assert allowed, f"{room} may not import {rest}"


def test_master_and_virtual_drives_never_share_code_that_decides():
    for path in modules():
        if room_of(path) == "virtual":
            assert not any(name.startswith((f"{PACKAGE}.master", f"{PACKAGE}.hardware")) for name in imported(path)), (
                path
            )


def test_a_forbidden_import_would_be_seen(tmp_path):
    path = tmp_path / "x.py"
    path.write_text("import socket\nfrom canopen_control.master import network\n")
    assert list(imported(path)) == ["socket", "canopen_control.master.network"]
