import pytest
from support.simulated import MS, S, setup_of

from canopen_control.frame import CanFrame
from canopen_control.simulation.recorded_scenario import BusHistory

BEGIN = 1_700_000_000 * S
END = 8 * S
SYNC, NMT = CanFrame(0x80), 0x000


def steady(can_id, data, period, until=END, without=()):
    """Frames of a period in ms, but in the times of `without` in s."""
    times = range(0, until, period * MS)
    quiet = [(round(low * S), round(high * S)) for low, high in without]
    return [(BEGIN + at, CanFrame(can_id, data)) for at in times if not any(low <= at < high for low, high in quiet)]


def healthy(*, node=None, master=(), without=()):
    """A bus of the master and nodes 2 and 3; node 2 has gaps."""
    frames = steady(0x80, b"", 20, without=master)
    for each in (2, 3):
        quiet = without if each == 2 else ()
        frames += steady(0x180 + each, b"\x37\x06", 20, without=quiet)
        frames += steady(0x700 + each, b"\x05", 100, without=node if each == 2 and node else quiet)
    return frames


def acts_of(frames, *more, resets=()):
    there = sorted([*frames, *((BEGIN + round(at * S), frame) for at, frame in more)], key=lambda each: each[0])
    return list(BusHistory(setup_of().bus, there, [BEGIN + round(at * S) for at in resets]).acts())


def shown(acts):
    return [
        (act.kind, act.target, act.name, round((act.at_ns - BEGIN) / S, 1), act.for_ns and round(act.for_ns / S, 1))
        for act in acts
    ]


def test_where_nothing_goes_wrong_nothing_happens():
    assert acts_of(healthy()) == []


def test_a_node_that_says_nothing_has_its_cable_cut():
    assert shown(acts_of(healthy(without=[(2, 4)]))) == [("cut", "2", "", 2.0, 2.0)]


def test_to_the_end_it_is_cut_for_good():
    assert shown(acts_of(healthy(without=[(5, 9)]))) == [("cut", "2", "", 5.0, None)]


def test_one_that_boots_after_that_was_without_supply():
    assert shown(acts_of(healthy(without=[(2, 4.01)]), (4.0, CanFrame(0x702, b"\0")))) == [("power", "2", "", 2.0, 2.0)]


def test_a_boot_in_between_is_a_reset_of_its_own_unless_the_master_wanted_it():
    boot = (3.0, CanFrame(0x702, b"\0"))
    assert shown(acts_of(healthy(), boot)) == [("fault", "2", "spontaneous_reset", 3.0, None)]
    assert acts_of(healthy(), (2.9, CanFrame(NMT, b"\x82\x02")), boot) == []


def test_heartbeats_alone_are_missing():
    assert shown(acts_of(healthy(node=[(2, 4)]))) == [("fault", "2", "heartbeat_lost", 1.9, 2.1)]


@pytest.mark.parametrize(
    ("code", "fault", "lasts"),
    [(0x2320, "short_circuit", 1.9), (0x8611, "following_error", 1.9), (0x7500, "drive_fault", 1.9),
     (0x5000, "device_error", 2.0)],
)  # fmt: skip
def test_an_emergency_is_a_fault_that_shows_it_and_ends_before_its_reset(code, fault, lasts):
    told = [(at, CanFrame(0x82, value.to_bytes(2, "little") + bytes(6))) for at, value in ((3.0, code), (5.0, 0))]
    [act] = acts_of(healthy(), *told, resets=[2.0, 4.99])
    assert (act.kind, act.target, act.name) == ("fault", "2", fault)
    assert act.at_ns - BEGIN == 3 * S
    assert act.for_ns == pytest.approx(lasts * S, abs=0.1 * S)


def test_an_emergency_about_the_bus_is_a_consequence():
    assert acts_of(healthy(), (3.0, CanFrame(0x82, b"\x30\x81" + bytes(6)))) == []


def test_a_master_that_is_silent_is_stalled_and_killed_where_it_boots_nodes_anew():
    assert shown(acts_of(healthy(master=[(2, 4)]))) == [("stall", "master", "", 2.0, 2.0)]
    assert shown(acts_of(healthy(master=[(2, 4)]), (4.1, CanFrame(NMT, b"\x81\x00")))) == [("kill", "", "", 2.0, 2.0)]


def test_commands_that_no_boot_gives_are_a_strangers():
    [act] = acts_of(healthy(), (3.0, CanFrame(NMT, b"\x80\x03")))
    assert (act.kind, act.values) == ("frame", (0.0, 128.0, 3.0))


def test_a_recording_of_nothing_has_nothing():
    assert acts_of([]) == []
