"""What each parameter means, and that ROS is told it of every parameter that any controller declares."""

import dataclasses

import pytest

from canopen_control.controllers.base_params import BaseParams
from canopen_control.controllers.broadcasters import BatteryParams
from canopen_control.controllers.controllers_file import ManagerParams
from canopen_control.controllers.declared import TEXTS, declared_by, text_of
from canopen_control.controllers.diff_drive_params import DiffDriveParams
from canopen_control.controllers.gpio_command import GpioParams
from canopen_control.controllers.mecanum_params import MecanumParams
from canopen_control.controllers.omni_params import OmniParams
from canopen_control.controllers.params import ForwardParams, SingleParams


def test_a_class_that_derives_says_what_its_own_means_and_the_base_the_rest():
    assert text_of(DiffDriveParams, "odom_frame_id") == TEXTS["BaseParams"]["odom_frame_id"]
    assert text_of(DiffDriveParams, "wheel_radius") == "m; absent: the description's"
    assert text_of(BaseParams, "wheel_radius") == ""


@pytest.mark.parametrize(
    "cls", [BatteryParams, DiffDriveParams, ForwardParams, GpioParams, MecanumParams, OmniParams, SingleParams]
)
def test_every_declared_parameter_has_its_text(cls):
    needed = {field.name for field in dataclasses.fields(cls) if field.default is field.default_factory}
    readings = declared_by(cls(**dict.fromkeys(needed)))
    assert [each.name for each in readings if not each.text] == []


def test_the_manager_has_its_texts():
    assert [each.name for each in declared_by(ManagerParams()) if not each.text] == []


def test_names_that_the_file_gives_have_the_text_of_their_section():
    given = GpioParams(gpios=("io",), safe_values={"io.lamp": 1.0})
    texts = {each.name: each.text for each in declared_by(given)}
    assert texts["safe_values.io.lamp"] == TEXTS["GpioParams"]["safe_values"]
