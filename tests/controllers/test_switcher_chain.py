from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.base import Controller
from canopen_control.controllers.switcher import in_order, joints_of, users_of
from canopen_control.hardware.interfaces import CommandInterface, StateInterface


class Link(Controller):
    def __init__(self, name: str, *commands: str) -> None:
        super().__init__(name)
        self.wanted, self.own = [f"{each}/velocity" for each in commands], [CommandInterface(name, "velocity")]

    def command_interface_names(self) -> list[str]:
        return self.wanted

    def reference_interfaces(self) -> list[CommandInterface]:
        return self.own


def names(controllers) -> list[str]:
    return [each.name for each in controllers]


def test_who_commands_runs_before_whom_it_commands():
    bottom, middle, top, alone = Link("bottom"), Link("middle", "bottom"), Link("top", "middle"), Link("alone")
    assert names(in_order([bottom, alone, middle, top])) == ["top", "middle", "bottom", "alone"]


def test_a_chain_stops_as_a_whole_and_others_go_on():
    bottom, middle, top, alone = Link("bottom"), Link("middle", "bottom"), Link("top", "middle"), Link("alone")
    assert names(users_of([middle], [bottom, middle, top, alone])) == ["top", "middle", "bottom"]
    assert names(users_of([alone], [bottom, middle, top, alone])) == ["alone"]
    assert users_of([alone], [bottom]) == []


def test_who_reads_what_another_exports_is_chained_to_it_but_does_not_command_its_joints():
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
    assert [joints_of(each, everybody) for each in (left, base, top)] == [
        ["wheel_1"],
        ["wheel_1", "wheel_2"],
        ["wheel_1", "wheel_2"],
    ]


@given(st.dictionaries(st.integers(0, 6), st.sets(st.integers(0, 6), max_size=2), max_size=7))
def test_any_wiring_even_a_ring_gives_each_controller_once(wiring):
    links = [Link(str(name), *(str(each) for each in sorted(below))) for name, below in wiring.items()]
    order = names(in_order(links))
    assert sorted(order) == sorted(names(links))
    downhill = all(each < name for name, below in wiring.items() for each in below)
    if downhill:
        for name, below in wiring.items():
            assert all(order.index(str(name)) < order.index(str(each)) for each in below if each in wiring)
