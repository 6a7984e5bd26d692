"""A robot and another ROS program for all tests of a file, and the bridge between them for all files."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import pytest
from support import ros


def folder_for(factory):
    """Return the environment in which a robot, and the bridge after it, find each other."""
    folder = factory.mktemp("ros")
    folder.chmod(0o700)
    return {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder / "state"), "ROS_LOG_DIR": str(folder / "log")}


@contextlib.contextmanager
def bridged(folder, *arguments):
    """Run a bridge in a domain of its own."""
    with ros.domain() as number, ros.bridge(number, *arguments, **folder) as process:
        yield SimpleNamespace(folder=folder, domain=number, process=process)


@pytest.fixture(scope="session")
def common_bridge(tmp_path_factory):
    """Return the bridge of all files without ARGUMENTS, a new one after a test has ended it.

    It finds the robot of each file, as it finds one that comes back.
    """
    with contextlib.ExitStack() as stack:
        bridges = []

        def running():
            if not bridges or bridges[-1].process.poll() is not None:
                bridges.append(stack.enter_context(bridged(folder_for(tmp_path_factory))))
            return bridges[-1]

        yield running


@pytest.fixture(scope="session")
def common_peers():
    """Return the other ROS programs of all files: one for each domain and each ARGUMENTS, which begins anew."""
    with contextlib.ExitStack() as stack:
        peers = {}

        def begun(number, *arguments, **environment):
            peer = peers.get((number, arguments))
            if peer is None:
                peer = peers[number, arguments] = stack.enter_context(ros.Peer(number, *arguments, **environment))
            else:
                peer.begin()
            return peer

        yield begun


@pytest.fixture(scope="module")
def own_bridge(request, tmp_path_factory):
    """The bridge of this file: the common one, or one with the ARGUMENTS of the module."""
    if not hasattr(request.module, "ARGUMENTS"):
        yield request.getfixturevalue("common_bridge")()
        return
    with bridged(folder_for(tmp_path_factory), *request.module.ARGUMENTS) as result:
        yield result


@pytest.fixture(scope="module")
def ros_folder(own_bridge):
    """The environment in which the robot, and the bridge after it, find each other."""
    return own_bridge.folder


@pytest.fixture(scope="module")
def stage(own_bridge, common_peers, request):
    """A robot, the bridge and another ROS program; NODES, LAYOUT, NODE_STATES, ARGUMENTS of the module: theirs."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in own_bridge.folder.items():
            patch.setenv(name, value)
        robot = ros.FakeRobot()
        robot.bus_nodes = getattr(request.module, "NODES", [])
        robot.layout = getattr(request.module, "LAYOUT", robot.layout)
        robot.nodes.update(getattr(request.module, "NODE_STATES", {}))
        peer = common_peers(own_bridge.domain, ROS_LOG_DIR=own_bridge.folder["ROS_LOG_DIR"])
        with robot:
            yield SimpleNamespace(robot=robot, bridge=own_bridge.process, peer=peer, domain=own_bridge.domain)


@pytest.fixture(scope="module")
def maker(stage, common_peers):
    """Another ROS program, with the package's interfaces where ROS has none."""
    return common_peers(stage.domain, "--interfaces")


@pytest.fixture
def fresh(stage):
    """The stage as it was at the beginning: nothing reported, everything active but the base."""
    stage.robot.collected.clear()
    stage.robot.refusals.clear()
    stage.robot.answers.clear()
    stage.robot.more, stage.robot.samples = {}, {}
    stage.robot.switch(joint_state_broadcaster="active", forward="active", base="inactive")
    return stage
