"""What the files of a robot make."""

import errno
import shutil

import pytest
from support.configs import changed

from canopen_control.bus import kernel_sync
from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.assembly import Assembly
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


def assemble(config, **how):
    with Reactor(ManualClock()) as reactor:
        return Assembly(read_robot(find_robot(str(config)), **how), reactor, print, print, print)


def test_drives_make_a_bus_nodes_and_joints():
    made = assemble("robby")
    assert list(made.buses) == ["can"]
    assert sorted(made.nodes) == sorted(made.bus_by_node) == ["left_drive", "right_drive"]
    assert sorted(made.joints) == ["left_wheel_joint", "right_wheel_joint"]
    assert len(made.systems) == len(made.registry.components) == 1


@pytest.mark.parametrize(("config", "how"), [("diffbot_sim", {}), ("robby", {"mock": True})])
def test_what_is_on_no_bus_makes_none(config, how):
    made = assemble(config, **how)
    assert (made.buses, made.nodes, made.joints, made.systems) == ({}, {}, {}, [])
    assert len(made.registry.components) == 1


def test_a_drive_that_no_bus_has_is_refused_with_the_line_of_its_tag(tmp_path):
    files = changed(tmp_path, "diffbot_sim", description={">left_drive<": ">lft_drive<"})
    lines = files.description.read_text().splitlines()
    tag = next(number for number, line in enumerate(lines, 1) if "<ros2_control" in line)
    with pytest.raises(RobotConfigError, match=rf"diffbot\.urdf:{tag}: joint .*'lft_drive'.*did you mean 'left_drive'"):
        assemble(files.description.parent, real=True)


def test_a_description_without_hardware_is_refused(tmp_path):
    folder = tmp_path / "r"
    shutil.copytree(data_path("config", "diffbot_sim"), folder)
    (folder / "diffbot.urdf").write_text('<robot name="r"><link name="base_link"/></robot>')
    with pytest.raises(RobotConfigError, match=r"diffbot\.urdf: no <ros2_control> tag"):
        assemble(folder)


@pytest.mark.parametrize(
    ("channel", "error", "follows", "told"),
    [
        ("can0", None, True, []),
        ("local:x", None, False, []),
        ("can0", errno.EPROTONOSUPPORT, False, ["this kernel has no broadcast manager", "this program sends it"]),
    ],
)
def test_the_kernel_sends_sync_where_it_can_and_bus_yml_wishes_it(tmp_path, monkeypatch, channel, error, follows, told):
    monkeypatch.setattr(kernel_sync, "_bcm_socket", lambda: Bcm(error))
    files = changed(tmp_path, "robby", bus={"sync_period: 20000": "sync_period: 20000\n  sync_producer: kernel"})
    events = []
    with Reactor(ManualClock()) as reactor:
        made = Assembly(read_robot(files, can=[channel]), reactor, events.append, print, print)
        bus = made.buses["can"]
        assert bus.follows_sync is follows
        assert ("by the kernel" in bus.sync_words) is follows
    assert all(any(word in each.text for each in events) for word in told)
    assert len(events) == bool(told)


class Bcm:
    """A socket of the broadcast manager, or of a kernel that lacks something."""

    def __init__(self, error):
        self._error = error

    def connect(self, address):
        assert address == ("can0",)
        if self._error is not None:
            raise OSError(self._error, "no")

    def close(self):
        pass
