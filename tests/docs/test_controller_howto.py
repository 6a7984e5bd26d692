"""The controller of the how-to page, installed as a separate package, runs on robby."""

import importlib
import sys

import pytest
from support.documents import DOCS, code_blocks, install
from support.robots import Bench, copy_robby

from canopen_control.errors import RobotConfigError

PLACE = "    robby_forward_controller:\n      type"
(YAML,) = code_blocks(DOCS / "howto" / "controller.md", "yaml")
DANCER = YAML[YAML.index("    dancer:") :]


@pytest.fixture
def dance(tmp_path, monkeypatch):
    """Install the example; return the name of its controller's type."""
    _, name, _ = install(tmp_path / "site", "my_dance")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    importlib.invalidate_caches()
    yield name
    sys.modules.pop("dance", None)


@pytest.mark.rest
def test_it_turns_a_wheel_of_robby(dance, tmp_path):
    assert f"type: {dance}\n" in DANCER
    config = copy_robby(tmp_path, controllers={PLACE: DANCER + PLACE})
    bench = Bench("dance", config=str(config), controllers=["dancer"])
    bench.start()
    speeds = []
    for _ in range(70):
        bench.run(100)
        speeds.append(bench.robot.registry.state("left_wheel_joint/velocity").value)
    assert max(speeds) == pytest.approx(3.0, rel=0.03)
    assert min(speeds) == pytest.approx(-3.0, rel=0.03)
    assert [event.text for event in bench.events if event.kind == "error"] == []
    bench.close()


def test_its_errors_are_reported_as_those_of_any_controller(dance, tmp_path):
    config = copy_robby(tmp_path, controllers={PLACE: DANCER.replace("3.0", "fast") + PLACE})
    with pytest.raises(RobotConfigError, match=r"ros2_controllers\.yaml:13:14: .*speed: expected a number"):
        Bench("dance2", config=str(config), controllers=["dancer"])
