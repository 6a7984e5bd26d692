"""The runner: a table with verdicts, JSON, and only ratios judged when it was quick."""

from types import SimpleNamespace

import pytest
from canopen_control_bench import machine, runner
from canopen_control_bench.figure import compared, limited
from support.benches import MACHINE

from canopen_control.errors import CanopenError


@pytest.fixture(autouse=True)
def no_commit(monkeypatch):
    """Leave git alone, which the description of the machine asks."""
    monkeypatch.setattr(machine, "_commit", lambda: None)


def report(**options):
    figures = [
        compared("fast", "us", [(1, 4)], peer_name="peer", limit=0.5, absolutes={"hub CPU us": 3.0}),
        compared("slow", "us", [(3, 4)], peer_name="peer", limit=0.5),
        limited("many", "", [5], limit=1),
    ]
    return runner.Report(MACHINE | {"idle": 0.5}, {"cycle": figures}, **options)


def test_what_is_short_is_marked_and_returned():
    text = str(report())
    assert text.count("SHORT") == 2
    assert "hub CPU us 3" in text
    assert "NOT IDLE" in text
    assert [item.name for item in report().short()] == ["slow", "many"]


def test_a_family_that_fails_does_not_take_the_others_with_it(monkeypatch):
    def fail(_options):
        raise CanopenError("a frame is missing")

    modules = {"load": SimpleNamespace(measure=fail), "boot": SimpleNamespace(measure=lambda _options: [])}
    monkeypatch.setattr(runner, "module_of", modules.__getitem__)
    families = runner.run_families(["load", "boot"], runner.Options(as_is=True))
    assert families.failures == {"load": "a frame is missing"}
    assert families.figures == {"boot": []}
    assert "FAILED: a frame is missing" in str(families)


@pytest.mark.parametrize("name", runner.FAMILIES)
def test_every_family_is_a_module_that_measures(name):
    assert callable(runner.module_of(name).measure)
