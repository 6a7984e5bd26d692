from __future__ import annotations

import importlib.metadata

import pytest

from canopen_control.controllers import types
from canopen_control.controllers.base import Controller
from canopen_control.errors import ControlError


class Dance(Controller):
    """A controller of somebody else's package."""


def offer(monkeypatch, value: str) -> None:
    point = importlib.metadata.EntryPoint("me/Dance", value, types.GROUP)

    def entry_points(*, group: str, name: str):
        return [point] if (group, name) == (types.GROUP, "me/Dance") else []

    monkeypatch.setattr(types.importlib.metadata, "entry_points", entry_points)


@pytest.mark.parametrize("name", types.TYPES)
def test_every_type_of_the_table_can_be_made(name):
    controller = types.make_controller("c", name)
    assert (controller.name, controller.type) == ("c", name)


def test_a_type_of_another_package_comes_by_its_entry_point(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "dancing", __import__("types").SimpleNamespace(Dance=Dance))
    offer(monkeypatch, "dancing:Dance")
    assert isinstance(types.make_controller("c", "me/Dance"), Dance)


@pytest.mark.parametrize("value", ["no_such_module:Dance", "math:Dance", "builtins:dict", "builtins:object"])
def test_a_broken_entry_point_is_one_sentence(monkeypatch, value):
    offer(monkeypatch, value)
    with pytest.raises(ControlError, match="controller c: "):
        types.make_controller("c", "me/Dance")


def test_an_unknown_type_is_answered_with_the_nearest():
    with pytest.raises(ControlError, match="did you mean 'diff_drive_controller/DiffDriveController'"):
        types.make_controller("c", "diff_drive_controller/DiffDriveControler")


def test_a_reader_is_listed_without_creating_one(monkeypatch):
    assert types.is_broadcaster("joint_state_broadcaster/JointStateBroadcaster")
    assert types.is_broadcaster("canopen_control/DiagnosticsBroadcaster")
    assert not types.is_broadcaster("diff_drive_controller/DiffDriveController")
    assert not types.is_broadcaster("nobody/Nothing")
    assert types.moves_joints("diff_drive_controller/DiffDriveController")
    assert types.moves_joints("nobody/Nothing")
    assert not types.moves_joints("joint_state_broadcaster/JointStateBroadcaster")
    assert not types.moves_joints("gpio_controllers/GpioCommandController")
    offer(monkeypatch, "no_such_module:Dance")
    assert not types.is_broadcaster("me/Dance")
