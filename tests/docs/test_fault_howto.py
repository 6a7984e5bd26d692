"""The fault of the how-to page, and the test that the page shows of it, run as they stand there."""

import contextlib

from support.documents import DOCS, code_blocks
from support.faultbench import LEFT, FaultBench

from canopen_control.virtual.fault_table import FAULTS

FAULT, TEST = code_blocks(DOCS / "howto" / "fault.md", "python")


def test_the_row_and_its_test_run(monkeypatch):
    page: dict[str, object] = {}
    exec(FAULT, page)
    exec(TEST, page)
    monkeypatch.setitem(FAULTS, page["ROW"].name, page["ROW"])
    (shown,) = [each for name, each in page.items() if name.startswith("test_")]
    with contextlib.closing(FaultBench("fault_howto")) as bench:
        turning = bench.turning()
        bench.bus.clear_history()
        shown(turning)
        received = sum(frame.can_id == 0x700 + LEFT for _, frame in bench.bus.history)
    assert received == 15, "3 s with a heartbeat of 100 ms, halved"
