"""The peers' pattern: each cycle its own values, so that a repeated or skipped cycle shows."""

from canopen_control_bench.peers.pattern import STEPS, controlword, target


def test_neighbouring_cycles_and_drives_differ():
    assert len({target(cycle, 0) for cycle in range(1000)}) == 1000
    assert target(5, 1) != target(5, 0)


def test_enabling_resets_a_fault_first_and_ends_enabled():
    words = [controlword(step) for step in range(STEPS)]
    assert list(dict.fromkeys(words)) == [0x00, 0x80, 0x06, 0x07, 0x0F]
