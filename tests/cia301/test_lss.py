from __future__ import annotations

import pytest
from support.services import frame, vectors

from canopen_control.cia301.lss import BIT_TIMINGS, LssCommand, bit_timing_index, lss_frame

LSS = vectors()["lss"]
FRAMES = {vector["name"]: frame(vector["frame"]) for vector in LSS["vectors"]}

BUILT = {
    "switch global: waiting": lss_frame(LssCommand.SWITCH_GLOBAL, 0),
    "switch global: configuration": lss_frame(LssCommand.SWITCH_GLOBAL, 1),
    "switch selective vendor": lss_frame(LssCommand.SWITCH_SELECTIVE, 0x286),
    "switch selective answer": lss_frame(LssCommand.SWITCHED, cob_id=0x7E4),
    "fastscan serial confirm next=vendor (slave enters configuration)": lss_frame(
        LssCommand.FAST_SCAN, 0x12345678, tail=bytes((0, 3, 0))
    ),
}


@pytest.mark.parametrize("name", BUILT)
def test_frames_are_the_vectors(name):
    assert BUILT[name] == FRAMES[name]


def test_every_vector_has_eight_bytes_and_a_known_command():
    known = set(range(0x40, 0x52)) | set(range(0x5A, 0x5F)) | {int(command) for command in LssCommand}
    assert all(len(f.data) == 8 and f.data[0] in known for f in FRAMES.values())


def test_bit_timings_are_the_vectors():
    table = {int(index): rate for index, rate in LSS["bit_timing_table_0"].items() if isinstance(rate, int)}
    assert {index: rate // 1000 for index, rate in BIT_TIMINGS.items()} == table
    assert [bit_timing_index(rate) for rate in (1_000_000, 250_000, 12345)] == [0, 3, None]
