"""The controller that the README shows, installed as a package of its own, runs on robby."""

import importlib
import re
import sys
from pathlib import Path

import pytest
from support.robots import Bench, copy_robby

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


def block(language, word):
    """Return the code block of the README that holds a word."""
    blocks = re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)
    return next(each for each in blocks if word in each)


@pytest.fixture
def dance(tmp_path, monkeypatch):
    """Install the example as pip would: a module, and the entry point of its pyproject.toml."""
    site = tmp_path / "site"
    info = site / "my_robot-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "dance.py").write_text(block("python", "class Dance"))
    name, target = re.search(r'^"(.*)" = "(.*)"$', block("toml", "Dance"), re.MULTILINE).groups()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_robot\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[canopen_control.controllers]\n{name} = {target}\n")
    monkeypatch.syspath_prepend(str(site))
    importlib.invalidate_caches()
    yield name
    sys.modules.pop("dance", None)


def test_the_readmes_controller_turns_a_wheel_of_robby(dance, tmp_path):
    place = "    robby_forward_controller:\n      type"
    dancer = f"    dancer:\n      type: {dance}\n      joint: left_wheel_joint\n"
    bench = Bench(
        "dance", config=str(copy_robby(tmp_path, controllers={place: dancer + place})), controllers=["dancer"]
    )
    bench.start()
    speeds = []
    for _ in range(70):
        bench.run(100)
        speeds.append(bench.robot.registry.state("left_wheel_joint/velocity").value)
    assert max(speeds) == pytest.approx(5.0, rel=0.03)
    assert min(speeds) == pytest.approx(-5.0, rel=0.03)
    assert [event.text for event in bench.events if event.kind == "error"] == []
    bench.close()


def test_its_mistakes_are_told_as_those_of_any_controller(dance, tmp_path):
    from canopen_control.errors import RobotConfigError

    place = "    robby_forward_controller:\n      type"
    dancer = f"    dancer:\n      type: {dance}\n      speed: fast\n"
    config = copy_robby(tmp_path, controllers={place: dancer + place})
    with pytest.raises(RobotConfigError, match=r"ros2_controllers\.yaml:12:14: .*speed: expected a number"):
        Bench("dance2", config=str(config), controllers=["dancer"])
