"""How a quirk is written, and the switches of quirks."""

from __future__ import annotations

import pytest
from support.quirky import Quirky
from support.virtualbench import Bench, servo

from canopen_control.errors import ConfigError
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_outbox import QuirkSwitched
from canopen_control.virtual.quirks import QUIRKS, check_quirks, parse_quirk, switches_of


@pytest.mark.parametrize(
    ("text", "value", "axis", "written"),
    [
        ("brake_delay", 0.5, None, "brake_delay=0.5"),
        ("brake_delay=1.25", 1.25, None, "brake_delay=1.25"),
        ("brake_delay@1", 0.5, 1, "brake_delay=0.5@1"),
        ("enable_faults=0x7000@0", 0x7000, 0, "enable_faults=28672@0"),
        ("remote_never", 0.0, None, "remote_never"),
        ("clock_drift=-50", -50.0, None, "clock_drift=-50"),
    ],
)
def test_how_a_quirk_is_written(text, value, axis, written):
    setting = parse_quirk(text)
    assert (setting.value, setting.axis, setting.text) == (value, axis, written)
    assert parse_quirk(written) == setting


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "brake_dely",
            "no quirk 'brake_dely' (did you mean 'brake_delay'?); see: canopen-control quirk list (faults: fault list)",
        ),
        ("brake_delay=100", "quirk 'brake_delay=100': the strength must be a number, 0.001 to 60 s"),
        ("brake_delay=soon", "quirk 'brake_delay=soon': the strength must be a number, 0.001 to 60 s"),
        ("brake_delay=nan", "quirk 'brake_delay=nan': the strength must be a number, 0.001 to 60 s"),
        ("one_mode=2.5", "quirk 'one_mode=2.5': the strength must be a whole number, 1 to 10 mode"),
        ("remote_never=1", "quirk 'remote_never=1': remote_never has no strength; omit =1"),
        ("remote_never@x", "quirk 'remote_never@x': the text after @ must be an axis number, 0 to 7"),
        ("remote_never@8", "quirk 'remote_never@8': the text after @ must be an axis number, 0 to 7"),
        ("", "no quirk ''; see: canopen-control quirk list (faults: fault list)"),
        ("@1", "no quirk ''; see: canopen-control quirk list (faults: fault list)"),
        ("sdo_late@1", "quirk 'sdo_late@1': sdo_late applies to the whole node; omit @1"),
    ],
)
def test_what_is_not_a_quirk_is_one_sentence(text, sentence):
    with pytest.raises(ConfigError) as error:
        parse_quirk(text)
    assert str(error.value) == sentence


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        (
            ("remote_never", "remote_when_enabled"),
            "quirk 'remote_when_enabled': remote_never and remote_when_enabled exclude each other; use only one",
        ),
        (
            ("brake_delay", "brake_delay=1@1"),
            "quirk 'brake_delay=1@1': brake_delay is given twice, also as 'brake_delay=0.5'",
        ),
    ],
)
def test_what_an_axis_cannot_have_together_is_one_sentence(texts, sentence):
    with pytest.raises(ConfigError) as error:
        check_quirks([parse_quirk(text) for text in texts])
    assert str(error.value) == sentence
    with pytest.raises(ConfigError):
        make_device(servo(axes=2).od, 5, quirks=texts)


def test_other_axes_may_have_what_excludes_it():
    quirky = Quirky("remote_never@0", "remote_when_enabled@1", "brake_delay=1@1", "brake_delay@0", node=servo(axes=2))
    assert quirky.quirks.active == ["brake_delay=0.5@0", "brake_delay=1@1", "remote_when_enabled@1", "remote_never@0"]
    assert not quirky.enable(3).statusword & 1 << 9
    assert quirky.enable(3, axis=1).node.drives[1].statusword() & 1 << 9


def test_a_quirk_of_an_axis_that_is_not_there_and_of_a_device_that_is_not_a_drive():
    with pytest.raises(ConfigError, match=r"^quirk 'remote_never@1': node 5 has no axis 1; it has: 0$"):
        Quirky("remote_never@1")
    module = make_device("eds/generic_cia401.eds", 9)
    with pytest.raises(ConfigError, match=r"^quirk 'remote_never' is only for drives; node 9 is "):
        switches_of(module).start_with(["remote_never"])
    switches_of(module).start_with(["sdo_late"])


def test_a_quirk_is_reported_replaced_by_another_strength_and_switched_off_by_its_name():
    bench = Quirky()
    bench.set("brake_delay=1")
    bench.set("brake_delay=2")
    assert bench.quirks.active == ["brake_delay=2"]
    bench.set("brake_delay", on=False)
    assert bench.quirks.active == []
    bench.set("brake_delay", on=False)
    reported = [event for event in bench.events if isinstance(event, QuirkSwitched)]
    assert reported[:2] == [QuirkSwitched("brake_delay=1", True), QuirkSwitched("brake_delay=2", True)]
    with pytest.raises(ConfigError):
        bench.set("remote_nevr")


def test_all_quirks_that_go_together_are_undone_together():
    bench, groups = Quirky(), set()
    plain = Bench(servo())
    for quirk in QUIRKS.values():
        if not quirk.group or quirk.group not in groups:
            groups.add(quirk.group)
            bench.set(quirk.name)
    assert len(bench.quirks.active) > 80
    for name in QUIRKS:
        bench.set(name, on=False)
    assert bench.quirks.active == []
    power, healthy = bench.drive.power, plain.drive.power
    assert power.acts == healthy.acts == {}
    assert (power.delays_ns, power.stop_states, power.unsupplied) == ({}, {}, healthy.unsupplied)
    assert bench.drive.readings.statusword.changes == ()
    assert bench.drive.modes.conditions == ()
    assert bench.drive.objects.model is plain.drive.objects.model
    assert bench.node.store.power_on == plain.node.store.power_on


def test_a_drive_without_a_quirk_has_nothing_in_its_way():
    bench = Quirky()
    assert bench.node.filter is None
    assert bench.enable(3).drive.modes.gate is None
    bench.set("brake_delay")
    assert bench.drive.modes.gate is not None
    bench.set("brake_delay", on=False)
    assert bench.drive.modes.gate is None


# The rows of the table of quirks.


ALLOWED = ("mapping_count_first", "clock_drift", "records_kept")  # by the standard


def test_every_quirk_states_its_change_its_default_and_its_source():
    assert len(QUIRKS) >= 60
    for quirk in QUIRKS.values():
        assert quirk.does[0].islower()
        assert not quirk.does.endswith(".")
        assert quirk.clause.startswith(("CiA 301, ", "CiA 402-2, ")) or quirk.name in ALLOWED
        assert quirk.source
        assert (quirk.axis is None) != (quirk.node is None)
        if quirk.strength is not None:
            assert quirk.strength.low <= quirk.strength.default <= quirk.strength.high
            assert quirk.strength.unit
    assert sum(quirk.source != "unsourced" for quirk in QUIRKS.values()) >= 53
