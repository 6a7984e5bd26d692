"""Up together, down together."""

from types import SimpleNamespace

import pytest

from canopen_control.hardware.groups import StopGroup

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint


class Joint:
    """As much of a joint as a group sees."""

    def __init__(self, *, rising=False, falling=False, ready=False):
        self.wanted = rising
        self.rising, self.falling = rising, falling
        self.may_rise = self.at_rest = ready
        self.machine = SimpleNamespace(held=rising, hold=self._hold)
        self.stopped = self.off = False

    def _hold(self, on):
        self.machine.held = on

    def has_come_to_rest(self, now):
        return self.at_rest

    def switch_off(self):
        self.off, self.falling = True, False

    def stop(self, now):
        self.stopped = True


def group_of(*joints):
    group = StopGroup()
    group.joints, group.busy = list(joints), True
    return group


def test_nobody_is_let_through_before_the_last_one_waits():
    first, last = Joint(rising=True, ready=True), Joint(rising=True)
    group = group_of(first, last)
    group.coordinate(0)
    assert first.machine.held
    assert not group.open
    last.may_rise = True
    group.coordinate(0)
    assert not first.machine.held
    assert not last.machine.held
    assert not group.open, "until they are enabled"
    first.rising = last.rising = False
    group.coordinate(0)
    assert group.open
    assert not group.busy


def test_nobody_is_disabled_before_the_last_one_stands():
    first, last = Joint(falling=True, ready=True), Joint(falling=True)
    group = group_of(first, last)
    group.coordinate(0)
    assert not first.off
    last.at_rest = True
    group.coordinate(0)
    assert first.off
    assert last.off
    group.coordinate(0)
    assert not group.busy


@pytest.mark.parametrize("wanted", [True, False])
def test_a_stop_is_for_all_and_names_those_that_were_to_move(wanted):
    joints = [Joint(rising=wanted), Joint()]
    group = group_of(*joints)
    assert group.stop(0) == ([joints[0]] if wanted else [])
    assert all(joint.stopped for joint in joints)
