"""The idle bench: a robot that stands, its view, and browsers that look at it."""

import pytest
from canopen_control_bench import idle
from canopen_control_bench.runner import Options

from canopen_control.host.sockets import list_sockets


@pytest.mark.process
@pytest.mark.browser
def test_the_runtime_is_measured_and_the_view_with_one_browser_and_with_more(monkeypatch):
    monkeypatch.setattr(idle, "VIEW_LIMITS", {1: 5.0, 2: 0.0})
    runtime, one, two = idle.measure(Options(seconds=0.5))
    assert 0 < runtime.ours < 1
    assert one.good
    assert 0 < two.ours < 5
    assert not two.good, "a limit of nothing"
    assert "2 browsers" in two.name
    assert list_sockets("robot") == []


@pytest.mark.process
def test_without_a_browser_the_runtime_alone_is_measured_and_in_a_quick_run_nothing(monkeypatch):
    assert idle.measure(Options(quick=True)) == []
    monkeypatch.setattr(idle, "_CHROMIUM", "/nowhere/chromium")
    (runtime,) = idle.measure(Options(seconds=0.3))
    assert "runtime" in runtime.name
