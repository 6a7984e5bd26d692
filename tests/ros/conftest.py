"""A robot, the bridge that shows it, and another ROS program that looks: one of each for all tests of a file."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from support import ros


@pytest.fixture(scope="module")
def ros_folder(tmp_path_factory):
    """The environment in which the robot, and the bridge after it, find each other."""
    folder = tmp_path_factory.mktemp("ros")
    folder.chmod(0o700)
    return {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder / "state"), "ROS_LOG_DIR": str(folder / "log")}


@pytest.fixture(scope="module")
def stage(ros_folder, request):
    """A robot, its bridge and another ROS program; NODES, LAYOUT, NODE_STATES, ARGUMENTS of the module: theirs."""
    with pytest.MonkeyPatch.context() as patch, ros.domain() as number:
        for name, value in ros_folder.items():
            patch.setenv(name, value)
        robot = ros.FakeRobot()
        robot.bus_nodes = getattr(request.module, "NODES", [])
        robot.layout = getattr(request.module, "LAYOUT", robot.layout)
        robot.nodes.update(getattr(request.module, "NODE_STATES", {}))
        with (
            robot,
            ros.bridge(number, *getattr(request.module, "ARGUMENTS", ()), **ros_folder) as process,
            ros.Peer(number, ROS_LOG_DIR=ros_folder["ROS_LOG_DIR"]) as peer,
        ):
            yield SimpleNamespace(robot=robot, bridge=process, peer=peer, domain=number)


@pytest.fixture(scope="module")
def maker(stage):
    """Another ROS program, with the package's interfaces where ROS has none."""
    with ros.Peer(stage.domain, "--interfaces") as peer:
        yield peer


@pytest.fixture
def fresh(stage):
    """The stage as it was at the beginning: nothing told, everything active but the base."""
    stage.robot.told.clear()
    stage.robot.refusals.clear()
    stage.robot.answers.clear()
    stage.robot.more, stage.robot.samples = {}, {}
    stage.robot.switch(joint_state_broadcaster="active", forward="active", base="inactive")
    return stage
