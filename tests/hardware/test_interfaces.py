from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware

from canopen_control.errors import CanopenError, ControlError, InterfaceConflict, UnknownInterface
from canopen_control.hardware.interfaces import (
    CommandInterface,
    ComponentLifecycle,
    InterfaceRegistry,
    LifecycleState,
    StateInterface,
)


class Component(ComponentLifecycle):
    def __init__(self):
        super().__init__()
        self.done = []

    def _begin(self):
        self.done.append("begin")

    def _rest(self):
        self.done.append("rest")


def driven(*verbs):
    component = Component()
    for verb in verbs:
        getattr(component, verb)()
    return component.state.name, component.done


@pytest.mark.parametrize(
    ("verbs", "state", "done"),
    [
        (("configure",), "INACTIVE", ["begin"]),
        (("configure", "activate"), "ACTIVE", ["begin"]),
        (("configure", "activate", "deactivate"), "INACTIVE", ["begin", "rest"]),
        (("configure", "activate", "cleanup"), "UNCONFIGURED", ["begin", "rest"]),
        (("configure", "activate", "shutdown"), "FINALIZED", ["begin", "rest"]),
    ],
)
def test_each_verb_continues(verbs, state, done):
    assert driven(*verbs) == (state, done)


@pytest.mark.parametrize(
    ("verbs", "state", "done"),
    [
        (("activate",), "UNCONFIGURED", []),
        (("deactivate",), "UNCONFIGURED", []),
        (("cleanup",), "UNCONFIGURED", []),
        (("configure", "configure"), "INACTIVE", ["begin"]),
        (("configure", "activate", "configure", "activate"), "ACTIVE", ["begin"]),
        (("shutdown", "configure", "activate", "cleanup"), "FINALIZED", []),
    ],
)
def test_a_verb_that_does_not_fit_the_state_does_nothing(verbs, state, done):
    assert driven(*verbs) == (state, done)


def test_it_starts_unconfigured():
    assert Component().state is LifecycleState.UNCONFIGURED


@pytest.fixture
def registry() -> InterfaceRegistry:
    interface_registry = InterfaceRegistry()
    interface_registry.register(Hardware("l/velocity", "r/velocity", states=("l/position",), name="base"))
    interface_registry.register(Hardware("arm/position", name="arm"))
    return interface_registry


def test_interfaces_begin_with_no_value_and_no_owner():
    command, state = CommandInterface("l", "velocity"), StateInterface("l", "position")
    assert (command.name, command.owner, command.minimum, command.maximum) == ("l/velocity", None, -math.inf, math.inf)
    assert math.isnan(command.value)
    assert math.isnan(state.value)
    assert repr(command) == "CommandInterface(l/velocity=nan, owner=None)"


def test_interfaces_are_found_by_name_with_their_component(registry):
    assert registry.command("arm/position").joint == "arm"
    assert registry.state("l/position").interface == "position"
    assert registry.component_of("r/velocity").name == "base"
    assert registry.component_of("l/position").name == "base"
    for look in (registry.state, registry.command, registry.component_of):
        with pytest.raises(UnknownInterface, match="no interface 'x/velocity'"):
            look("x/velocity")


def test_a_claim_is_for_all_or_none(registry):
    registry.claim(["l/velocity"], "one")
    for names in (["r/velocity", "l/velocity"], ["r/velocity", "nothing/velocity"]):
        with pytest.raises(ControlError):
            registry.claim(names, "two")
    assert registry.command("r/velocity").owner is None
    assert [item.name for item in registry.claim(["l/velocity", "r/velocity"], "one")] == ["l/velocity", "r/velocity"]
    with pytest.raises(InterfaceConflict, match="claimed by one; deactivate that controller first"):
        registry.claim(["l/velocity"], "two")
    assert registry.release("one") == ["l/velocity", "r/velocity"]
    assert registry.release("one") == []


def test_names_are_unique_over_all_components(registry):
    with pytest.raises(ControlError, match="two hardware components are called 'base'"):
        registry.register(Hardware(name="base"))
    with pytest.raises(ControlError, match="other: command interface arm/position exists already"):
        registry.register(Hardware("arm/position", name="other"))
    with pytest.raises(ControlError, match="twice: state interface a/b exists already"):
        registry.register(Hardware(states=("a/b", "a/b"), name="twice"))
    assert len(registry.components) == 2
    assert len(registry.command_interfaces) == 3
    assert len(registry.state_interfaces) == 1


def test_states_of_a_controller_are_found_by_name_alone_and_can_be_withdrawn(registry):
    state = StateInterface("base/x", "position")
    registry.export([], "base", [state])
    assert registry.state("base/x/position") is state
    assert registry.is_exported_state("base/x/position")
    assert not registry.is_exported_state("l/position")
    assert state not in registry.state_interfaces
    for taken in (state, StateInterface("l", "position")):
        with pytest.raises(ControlError, match="exists already"):
            registry.export([], "other", [taken])
    registry.withdraw([], [state])
    with pytest.raises(UnknownInterface):
        registry.state("base/x/position")


def test_references_of_a_controller_have_no_component_and_can_be_withdrawn(registry):
    reference = CommandInterface("base/linear", "velocity")
    registry.export([reference], "base")
    assert registry.component_of("base/linear/velocity") is None
    assert registry.claim(["base/linear/velocity"], "nav") == [reference]
    with pytest.raises(ControlError, match="exists already"):
        registry.export([reference], "base")
    registry.withdraw([reference])
    with pytest.raises(UnknownInterface):
        registry.command("base/linear/velocity")


ACTIONS = st.tuples(
    st.booleans(), st.sampled_from("xyz"), st.lists(st.sampled_from(["l/velocity", "r/velocity", "q/w"]), max_size=3)
)


@given(st.lists(ACTIONS, max_size=20))
def test_whatever_is_claimed_and_released_an_owner_changes_only_by_a_claim_or_a_release(actions):
    registry = InterfaceRegistry()
    registry.register(Hardware("l/velocity", "r/velocity"))
    owners: dict[str, str] = {}
    for claim, owner, names in actions:
        if not claim:
            registry.release(owner)
            owners = {name: each for name, each in owners.items() if each != owner}
            continue
        possible = all(name != "q/w" and owners.get(name, owner) == owner for name in names)
        try:
            registry.claim(names, owner)
        except CanopenError:
            assert not possible
        else:
            assert possible
            owners.update(dict.fromkeys(names, owner))
        assert {
            interface.name: interface.owner for interface in registry.command_interfaces if interface.owner
        } == owners
