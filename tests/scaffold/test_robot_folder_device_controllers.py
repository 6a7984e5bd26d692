"""Controllers of devices that are no drives: outputs by name, batteries, and everything that is measured."""

import pytest
import yaml
from support.iomodule import io_eds

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.runtime.robot_files import find_robot
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import controllers_text, write_robot


def planned(number, name="cell"):
    path = data_path("eds", f"generic_cia{number}.eds")
    return plan_robot(name, [Device(9, path, read_eds(path, 9).od)])


def controllers_of(number):
    return yaml.safe_load(controllers_text(planned(number)))


def test_outputs_are_commanded_by_name():
    file = controllers_of(401)
    assert file["controller_manager"]["ros__parameters"]["io_9_outputs"]["type"].endswith("/GpioCommandController")
    given = file["io_9_outputs"]["ros__parameters"]
    assert given["gpios"] == ["io_9"]
    assert given["command_interfaces"]["io_9"]["interfaces"][:2] == ["do0", "do1"]


def test_a_battery_is_told_as_one():
    file = controllers_of(418)
    given = file["battery_9_broadcaster"]["ros__parameters"]
    assert given["batteries"] == ["battery_9"]
    assert given["interfaces"]["battery_9"] == {"battery_temperature": True, "battery_percentage": True}


def test_what_is_only_measured_is_told():
    assert controllers_of(410)["inclinometer_9_broadcaster"]["ros__parameters"]["joints"] == ["inclinometer_9"]


def test_the_joint_of_an_encoder_is_told_by_the_broadcaster_of_joints():
    kinds = controllers_of(406)["controller_manager"]["ros__parameters"]
    assert [each for each in kinds if isinstance(kinds[each], dict)] == ["joint_state_broadcaster"]


def test_what_an_encoder_cannot_do_is_a_jump():
    node = yaml.safe_load(bus_text(planned(406)))["defaults"]
    assert node["signals"] == [{"name": "position", "max_rate": 30}]
    assert "signals" not in yaml.safe_load(bus_text(planned(410)))["defaults"]


def test_outputs_that_nothing_switches_off_need_a_word(tmp_path):
    path = tmp_path / "io.eds"
    path.write_text(io_eds())
    device = Device(5, path, read_eds(path, 5).od)
    written = write_robot(plan_robot("bare", [device]), tmp_path)
    assert any("keep their values when the master dies" in each for each in written.warnings)
    word = write_robot(plan_robot("bare", [device], allow_unsupervised=True), tmp_path, force=True)
    assert not any("keep their values" in each for each in word.warnings)
    assert "NOTHING switches these outputs off" in (word.folder / "bus.yml").read_text()


@pytest.mark.parametrize("number", [401, 404, 406, 410, 418])
def test_a_device_alone_makes_a_robot_that_passes_the_strict_check(tmp_path, number):
    written = write_robot(planned(number), tmp_path)
    report = check_robot(find_robot(str(written.folder)), CheckOptions())
    assert report.passes(strict=True), report.findings
