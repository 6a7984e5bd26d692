import pytest

from canopen_control.rpc.messages.quantities import BitRate, Bits, Count, Identifier, Index, NodeId, Subindex, UnixTime
from canopen_control.rpc.wire import decode


@pytest.mark.parametrize(
    ("kind", "lowest", "highest"),
    [
        (Index, 0, 0xFFFF),
        (Subindex, 0, 0xFF),
        (NodeId, 1, 127),
        (Identifier, 0, 0xFFFFFFFF),
        (Bits, 0, 64),
        (BitRate, 1, (1 << 63) - 1),
        (Count, 0, (1 << 63) - 1),
        (UnixTime, 0, 99_999_999_999),
    ],
)
def test_a_number_is_taken_within_its_range_and_refused_beyond_it(kind, lowest, highest):
    for good in (lowest, highest):
        assert decode(str(good).encode(), kind) == good
    for bad in (lowest - 1, highest + 1, 10**40):
        with pytest.raises(ValueError, match=r"Expected|out of range"):
            decode(str(bad).encode(), kind)


@pytest.mark.parametrize("text", [b"true", b'"1"', b"null", b"1e999"])
def test_what_is_no_number_is_none(text):
    for kind in (Count, UnixTime):
        with pytest.raises(ValueError, match=r"Expected|out of range"):
            decode(text, kind)
