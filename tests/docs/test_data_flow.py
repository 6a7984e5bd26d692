"""The page on the path of a command, compared with the actual calls."""

import ast
import re
import sys
from pathlib import Path

import pytest
from support.faultbench import FaultBench
from support.generic import JOINTS, write_generic

import canopen_control

PACKAGE = Path(canopen_control.__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "architecture" / "data_flow.md"
WALK = re.compile(r"^ *\| (`[^|]+) \| `(\w+)`:", re.MULTILINE)
STOP = re.compile(r"`([a-z0-9_]+/[a-z0-9_/]+\.py)`: `([\w.]+)`")
FILE = re.compile(r"`([a-z0-9_]+/[a-z0-9_]+\.py)`")


def walk_of_the_page():
    """Return for each row of the table the files it names, of which one is on the way, and the function entered."""
    return [(FILE.findall(files), function) for files, function in WALK.findall(PAGE.read_text(encoding="utf-8"))]


def calls_to(frame):
    """Return the files of the package on the way to a frame, in the order of entry and with the function entered."""
    way = []
    while frame is not None:
        file = Path(frame.f_code.co_filename)
        if file.is_relative_to(PACKAGE):
            name = file.relative_to(PACKAGE).as_posix()
            if way and way[-1][0] == name:
                way.pop()
            way.append((name, frame.f_code.co_name))
        frame = frame.f_back
    return way[::-1]


def test_every_file_of_the_page_is_there():
    files = FILE.findall(PAGE.read_text(encoding="utf-8"))
    assert len(files) > 10
    assert [file for file in files if not (PACKAGE / file).exists()] == []


def defines(file, name):
    """Return whether a module has a class, function or method of a dotted name."""
    body = ast.parse((PACKAGE / file).read_text(encoding="utf-8")).body
    for part in name.split("."):
        node = next((node for node in body if getattr(node, "name", None) == part), None)
        if node is None:
            return False
        body = node.body
    return True


def test_every_stop_of_the_page_is_defined_in_its_file():
    stops = STOP.findall(re.sub(r"\s+", " ", PAGE.read_text(encoding="utf-8")))
    assert len(stops) > 20
    assert [stop for stop in stops if not defines(*stop)] == []
    assert not defines("runtime/core.py", "RobotCore.no_such_method")


@pytest.mark.sources
@pytest.mark.parametrize(("controller", "mode"), [("velocity", ""), ("position", ""), ("position", "position_mode: 1")])
def test_a_value_goes_from_its_interface_to_the_rpdo_by_the_files_of_the_page_none_twice(tmp_path, controller, mode):
    walk = walk_of_the_page()
    ways = []

    def look(frame, event, argument):
        if event == "call" and frame.f_code.co_name == "set" and frame.f_code.co_filename.endswith("master/cycle.py"):
            way = calls_to(frame)
            start = next((at for at, (file, _) in enumerate(way) if file in walk[0][0]), len(way))
            if ("hardware/joint_targets.py", "follow") in way:
                ways.append(way[start:])

    config = write_generic(tmp_path, modes=mode)
    bench = FaultBench("walk", config=config, drives=(2, 3), controllers=[controller])
    try:
        bench.start()
        sys.setprofile(look)
        bench.robot.command(controller, [0.3] * len(JOINTS), "test")
        bench.run(50)
    finally:
        sys.setprofile(None)
        bench.close()
    assert ways
    for way in ways:
        assert len(way) == len(walk), "each file once"
        for (file, function), (files, described) in zip(way, walk, strict=True):
            assert file in files, "in this order"
            assert function == described
