import pytest

from canopen_control.hardware.interfaces import Lifecycle, LifecycleState


class Component(Lifecycle):
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
def test_each_verb_goes_on(verbs, state, done):
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
