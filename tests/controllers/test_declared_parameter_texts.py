"""Descriptions of all parameters; ROS gets the description of each declared parameter."""

import dataclasses

import pytest

from canopen_control.controllers.base_params import BaseParams, MecanumParams
from canopen_control.controllers.controllers_file import ManagerParams
from canopen_control.controllers.declared import declared_by
from canopen_control.controllers.gpio_command import GpioParams
from canopen_control.controllers.params import CommonParams
from canopen_control.controllers.types import TYPES, class_of
from canopen_control.yamlfile.convert import fields_of, help_of


def test_an_overridden_default_keeps_the_help_text_of_the_base_class():
    params = MecanumParams()
    texts = {reading.name: reading.text for reading in declared_by(params)}
    assert texts["pose_covariance_diagonal"] == "diagonal of the covariance of the odometry's pose"
    assert params.pose_covariance_diagonal != BaseParams().pose_covariance_diagonal


@pytest.mark.parametrize("type_name", TYPES)
def test_a_type_declares_its_parameters_with_their_texts(type_name):
    kind = class_of(type_name)
    assert kind.title
    assert kind.reads is not CommonParams
    for section in kind.sections.values():
        assert [entry.name for entry, _ in fields_of(section) if not help_of(section, entry)] == []
    cls = kind.reads
    needed = {field.name for field in dataclasses.fields(cls) if field.default is field.default_factory}
    readings = declared_by(cls(**dict.fromkeys(needed)))
    assert [reading.name for reading in readings if not reading.text] == []


def test_the_manager_has_its_texts():
    assert [item.name for item in declared_by(ManagerParams()) if not item.text] == []


def test_names_that_the_file_gives_have_the_text_of_their_section():
    gpio_params = GpioParams(gpios=("io",), safe_values={"io.lamp": 1.0})
    texts = {item.name: item.text for item in declared_by(gpio_params)}
    assert (
        texts["safe_values.io.lamp"]
        == "`.GPIO.INTERFACE`: value of the output after commands have expired; absent: 0.0"
    )
