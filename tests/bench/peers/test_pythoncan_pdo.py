"""The peer imports no master of ours (with processes: test_cycle)."""

from pathlib import Path

from canopen_control_bench.peers import pythoncan_pdo


def test_it_is_independent_of_our_master():
    text = Path(pythoncan_pdo.__file__).read_text()
    assert "canopen_control.master" not in text
    assert "canopen_control.cia" not in text
