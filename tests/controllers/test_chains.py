from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.base import Controller
from canopen_control.controllers.chains import in_order, joints_of, users_of
from canopen_control.hardware.interfaces import CommandInterface, StateInterface


class Link(Controller):
    def __init__(self, name: str, *commands: str) -> None:
        super().__init__(name)
        self.wanted, self.own = [f"{command}/velocity" for command in commands], [CommandInterface(name, "velocity")]

    def command_interface_names(self) -> list[str]:
        return self.wanted

    def reference_interfaces(self) -> list[CommandInterface]:
        return self.own


def names(controllers) -> list[str]:
    return [controller.name for controller in controllers]


def test_a_controller_runs_before_the_controllers_it_commands():
    bottom, middle, top, alone = Link("bottom"), Link("middle", "bottom"), Link("top", "middle"), Link("alone")
    assert names(in_order([bottom, alone, middle, top])) == ["top", "middle", "bottom", "alone"]


def test_a_reader_of_exported_states_is_chained_but_does_not_command_the_joints():
    class Exporter(Link):
        def exported_states(self) -> list[StateInterface]:
            return [StateInterface(self.name, "position")]

    class Reader(Link):
        def state_interface_names(self) -> list[str]:
            return ["base/position"]

    base, reader, alone = Exporter("base", "wheel"), Reader("reader", "lamp"), Link("alone")
    everybody = [base, reader, alone]
    assert names(in_order(everybody)) == ["reader", "base", "alone"]
    assert names(users_of([base], everybody)) == ["reader", "base"]
    assert joints_of(reader, everybody) == ["lamp"]


def test_the_joints_of_a_controller_are_found_through_those_it_commands():
    left, right, base, top = (
        Link("left", "wheel_1"),
        Link("right", "wheel_2"),
        Link("base", "left", "right"),
        Link("top", "base"),
    )
    everybody = [left, right, base, top]
    assert [joints_of(item, everybody) for item in (left, base, top)] == [
        ["wheel_1"],
        ["wheel_1", "wheel_2"],
        ["wheel_1", "wheel_2"],
    ]


@given(st.dictionaries(st.integers(0, 6), st.sets(st.integers(0, 6), max_size=2), max_size=7))
def test_any_wiring_even_a_ring_gives_each_controller_once(wiring):
    links = [Link(str(name), *(str(item) for item in sorted(below))) for name, below in wiring.items()]
    order = names(in_order(links))
    assert sorted(order) == sorted(names(links))
    downhill = all(item < name for name, below in wiring.items() for item in below)
    if downhill:
        for name, below in wiring.items():
            assert all(order.index(str(name)) < order.index(str(item)) for item in below if item in wiring)
